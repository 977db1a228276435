"""Forecast the error of one unit without a label, as a measurement uncertainty budget (GUM, JCGM 100:2008).

Each term is a standard uncertainty in the reference unit: how well f reads its own source, how much candidate maps
disagree, what of the source's loads the unit has not shown, and so on. Sensitivity coefficients, chosen on simulated
lots for each kind of knowledge about the loads (`knowledge.py`), combine them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from softcal.core.maps.crossing import KEPT
from softcal.core.maps.interface import UnitMap
from softcal.core.recording import Array, Indices, LabelledRecording, OutputRecording
from softcal.core.unit.health import OutputLimits, clipped_share
from softcal.core.unit.knowledge import LoadKnowledge, known_by
from softcal.core.unit.line_spread import LineSpread
from softcal.core.unit.method import LEVELS, ForecastConfig
from softcal.core.unit.source_model import SourceModel
from softcal.core.unit.stage_check import unit_difference
from softcal.core.unit.support import WindowShape
from softcal.core.unit.uncertainty import DIRECTIONS, ErrorForecast
from softcal.core.windows import TAPS

LINE, DAY = "line", "day"
"""Terms of the budget for what line and day do to the load; they weigh 1 whatever is known of the loads."""


@dataclass(frozen=True, eq=False)
class MapEvidence:
    """What the mapped windows of one unit show, and the uncertainty budget made of it.

    Args:
        rows: (n,) indices of the windows looked at, among the recording's full windows.
        estimate: (n,) f on the mapped windows, in the reference unit.
        distance: (n,) of the mapped windows from the source's support.
        disagreement: (n,) RMS difference of the other candidate maps' estimates from `estimate`.
        unmapped: (n,) f on the raw windows: what doing nothing would say.
        overlap, unmapped_overlap: of the unit's loads and speeds with the source's, 0 to 1, with and without
            the map.
        speed: how fast the unit's fast movements are, over the source's.
        budget: standard uncertainties in the reference unit: `model` and the terms of every kind of knowledge
            (`knowledge.py`). `stage` and `slow` are there where source and unit carry the stage position, `line` where
            the spread of the line was stated, `day` where a golden run measured its day.
        rest: level of the estimates at rest, in the reference unit.
    """

    rows: Indices
    estimate: Array
    shape: WindowShape
    distance: Array
    disagreement: Array
    unmapped: Array
    overlap: float
    unmapped_overlap: float
    speed: float
    budget: Mapping[str, float]
    knowledge: LoadKnowledge
    rest: float

    @cached_property
    def load_rms(self) -> float:
        """RMS load above rest: the sensitivity to a gain error, in the reference unit."""
        return rms(self.estimate - self.rest)

    @property
    def correction_rms(self) -> float:
        """RMS difference between doing something and doing nothing, in the reference unit."""
        return rms(self.estimate - self.unmapped)


@dataclass(frozen=True, eq=False)
class Trial:
    """A map, and paired windows of source and unit (equal load at equal time) that test it.

    Args:
        unit_map: the unit's map, or one fitted without these windows.
        source: recording of the source unit that the unit was pressed together with.
        source_rows, target_rows: full windows of both, equal lengths.
        floor: RMS error that the reference of these windows does not hold: that of f, where f itself read it.
    """

    unit_map: UnitMap
    source: LabelledRecording
    source_rows: Indices
    target_rows: Indices
    floor: float = 0.0


def gather_evidence(
    model: SourceModel,
    target: OutputRecording,
    unit_map: UnitMap,
    alternatives: Sequence[UnitMap],
    resampled: Sequence[UnitMap],
    limits: OutputLimits,
    trials: Sequence[Trial] = (),
    gain_error: float = 0.0,
    is_anchored: bool = False,
    line: LineSpread | None = None,
    day_rmse: float = 0.0,
    straight: UnitMap | None = None,
) -> MapEvidence:
    """Collect the budget of one unit from its map and from other maps that fit its recording too.

    Args:
        model: the lot's source.
        alternatives: other candidates for the whole recording.
        resampled: the same kind of map fitted to parts of the recording.
        limits: rails of the raw output.
        trials: maps with paired windows to test them by, where source and unit were pressed together.
        gain_error: standard error of the logarithm of the map's gain, where it rests on matched levels.
        is_anchored: whether known loads of the unit entered its map.
        line: the line's spread, where somebody stated it.
        day_rmse: what the day of the recording changes, as a golden run showed it, in the reference unit.
        straight: a map that was not bent to spend the unit's time as the source's; by default `unit_map`. How the loads
            differ shows through it alone.
    """
    config = model.method.forecast
    # Evenly spaced rows: every statistic below costs the same however long the recording is.
    rows = np.unique(np.linspace(0, len(target.windows) - 1, config.rows).astype(np.int64))
    raw = target.windows[rows]
    network, interval = model.network, model.interval
    mapped = _mapped(unit_map, target, rows)
    estimate = network.evaluate(mapped)
    shape = interval.support.shape(mapped)
    distance = interval.support.distance(shape)
    others = {id(other): network.evaluate(_mapped(other, target, rows)) for other in alternatives}
    disagreement = _spread(estimate, list(others.values()))
    stability = _spread(estimate, [network.evaluate(_mapped(part, target, rows)) for part in resampled])
    cells = interval.direction(shape), interval.column(estimate)
    seen_load, seen_shape = estimate, shape
    if straight is not None:
        unbent = _mapped(straight, target, rows)
        seen_load = others[id(straight)] if id(straight) in others else network.evaluate(unbent)
        seen_shape = interval.support.shape(unbent)
    known, rest = _known_use(model), _rest_level(estimate, config)
    load_rms = rms(estimate - rest)
    overlap, speed = use_overlap(model, seen_shape), _fast(shape, config) / known.fast
    # A map is only as good as the agreement of those that could have been chosen instead (disagreement), and of the
    # same family on other parts of the recording (stability, a delete-a-group jackknife).
    budget = {
        "model": rms(model.residuals.rmse_table[cells]),
        "disagreement": rms(disagreement),
        "stability": rms(stability),
        "support": interval.sensitivity * rms(distance),
        "shift": rms(np.quantile(seen_load, _load_shares(config)) - known.loads),
        "rest": _rest_spread(model, estimate, shape),
        "resolution": _resolution(model, target, mapped, raw),
        "clipping": _clipping(model, target, limits),
        "extrapolation": _extrapolation(model, estimate),
        "overlap": (1 - overlap) ** 2 * (interval.high - interval.low),
        "speed": float(np.log(speed)) ** 2 * (interval.high - interval.low),
        "corners": _corners(model, shape) * (interval.high - interval.low),
        "gain": gain_error * load_rms,
        **_stage_terms(model, target, unit_map, estimate if len(rows) == len(target.windows) else None),
    }
    if line is not None:
        budget[LINE] = line.share * load_rms
    if day_rmse:
        budget[DAY] = day_rmse
    if trials:
        misread = rms(np.concatenate([_misread(model, target, trial) for trial in trials]))
        budget["paired"] = float(np.hypot(misread, max(trial.floor for trial in trials)))
    unmapped_overlap = use_overlap(model, interval.support.shape(raw))
    return MapEvidence(
        rows,
        estimate,
        shape,
        distance,
        disagreement,
        unmapped=network.evaluate(raw),
        overlap=overlap,
        unmapped_overlap=unmapped_overlap,
        speed=speed,
        budget=budget,
        knowledge=known_by(budget, model.method.knowledge, is_anchored),
        rest=rest,
    )


def _mapped(unit_map: UnitMap, target: OutputRecording, rows: Indices) -> Array:
    """Return the windows of the given rows behind a map."""
    if len(rows) < len(target.windows):
        return unit_map.apply(target.windows[rows])
    # Sample by sample: a window shares all its samples but one with the next.
    parts = [unit_map.apply_signal(target.output[s]) for s in target.segments if s.stop - s.start >= TAPS]
    return np.ascontiguousarray(parts[0]) if len(parts) == 1 else np.concatenate(parts)


@dataclass(frozen=True, eq=False)
class _KnownUse:
    """How the source was pressed, as each of its units is compared with it.

    Args:
        loads: quantiles of f on the source, in the reference unit.
        rest_spread: standard deviation of f at rest, in the reference unit.
        rms_load: RMS load above rest, in the reference unit.
        step: of its readout, in the output unit.
        levels, slopes: edges of the grid that uses are compared on.
        use: share of the source's windows in each cell of it.
    """

    loads: Array
    rest_spread: float
    rms_load: float
    fast: float
    sharpness: float
    step: float
    levels: Array
    slopes: Array
    use: Array


@lru_cache(maxsize=KEPT)
def _known_use(model: SourceModel) -> _KnownUse:
    config, shape, estimate = model.method.forecast, model.shape, model.estimate
    low, high = np.quantile(shape.level, config.reach)
    # A coarse grid: with finer cells two short recordings of one programme would seem to differ.
    levels = np.linspace(low, high, config.overlap_levels)
    slopes = np.linspace(-1, 1, config.overlap_slopes) * np.quantile(np.abs(shape.slope), config.overlap_slope)
    return _KnownUse(
        loads=np.quantile(estimate, _load_shares(config)),
        rest_spread=_spread_at_rest(model, estimate, shape),
        rms_load=rms_load(estimate, config),
        fast=_fast(shape, config),
        sharpness=_sharpness(shape, config),
        step=float(np.min(np.abs(np.diff(np.unique(model.source.unlabelled.output))))),
        levels=levels,
        slopes=slopes,
        use=_use(shape, levels, slopes),
    )


def _load_shares(config: ForecastConfig) -> Array:
    return np.linspace(*config.reach, config.quantiles)


def forecast_error(budget: Mapping[str, float], knowledge: LoadKnowledge) -> ErrorForecast:
    """Combine a budget: u_c^2 = u_base^2 + sum (c_i u_i)^2 (GUM, JCGM 100:2008, eq. 10), with its own uncertainty.

    What line and day add has coefficient 1 whatever is known of the loads: no recording of the unit shows it.

    Args:
        budget: standard uncertainties u by term, in the reference unit.
        knowledge: how the loads are known: it names the base term and the sensitivity coefficients c.
    """
    outside = budget.get(LINE, 0.0) ** 2 + budget.get(DAY, 0.0) ** 2
    rmse = float(np.sqrt(_base(budget, knowledge) ** 2 + _squares(budget, knowledge) + outside))
    low, high = knowledge.config.log_error
    return ErrorForecast(rmse, rmse * float(np.exp(low)), rmse * float(np.exp(high)))


def map_variance(budget: Mapping[str, float], knowledge: LoadKnowledge) -> float:
    """Return the part of the forecast's variance that comes from map and recording, without network and line."""
    beyond_model = _base(budget, knowledge) ** 2 - budget["model"] ** 2
    return _squares(budget, knowledge) + max(beyond_model, 0.0)


def _base(budget: Mapping[str, float], knowledge: LoadKnowledge) -> float:
    return knowledge.config.base_factor * budget[knowledge.config.base_term]


def _squares(budget: Mapping[str, float], knowledge: LoadKnowledge) -> float:
    return float(sum((coefficient * budget[name]) ** 2 for name, coefficient in knowledge.sensitivity.items()))


def variance_table(model: SourceModel, evidence: MapEvidence) -> Array:
    """Distribute the map's variance over direction and load level: (3, LEVELS).

    Half is even, half is in proportion to the squared disagreement of the candidate maps. Where the gain of the map
    rests on matched levels alone, half of this in turn grows with the square of the load, as a gain error does. The
    variance of loads that the unit has not shown is added at those loads only. What the line adds grows with the square
    of the load as well.
    """
    budget, knowledge = evidence.budget, evidence.knowledge
    unseen = knowledge.sensitivity["extrapolation"]
    pattern = 0.5 + 0.5 * _disagreement_pattern(model, evidence)
    if not knowledge.is_placed and budget["gain"]:
        pattern = 0.5 * pattern + 0.5 * _load_pattern(model, evidence)
    reach = model.method.forecast.reach
    beyond = unseen * _beyond(load_levels(model), evidence.estimate, reach)
    spread_out = map_variance(budget, knowledge) - (unseen * budget["extrapolation"]) ** 2
    line = budget.get(LINE, 0.0) ** 2 * _load_pattern(model, evidence)
    return knowledge.config.interval_share * spread_out * pattern + beyond**2 + line + budget.get(DAY, 0.0) ** 2


def load_levels(model: SourceModel) -> Array:
    """Return the middle of each load level of the interval, (LEVELS,) in the reference unit."""
    low, high = model.interval.low, model.interval.high
    return low + (np.arange(LEVELS) + 0.5) * (high - low) / LEVELS


def _disagreement_pattern(model: SourceModel, evidence: MapEvidence) -> Array:
    pattern = np.ones((len(DIRECTIONS), LEVELS))
    mean_square = float(np.mean(evidence.disagreement**2))
    if mean_square == 0:
        return pattern
    cells = model.interval.direction(evidence.shape), model.interval.column(evidence.estimate)
    flat, size = cells[0] * LEVELS + cells[1], pattern.size
    weights: tuple[Array, Array] = (evidence.disagreement**2 / mean_square, np.ones(len(flat)))
    tables = [np.asarray(np.bincount(flat, one, size), dtype=np.float64).reshape(pattern.shape) for one in weights]
    config = model.method.forecast
    # Pseudo-counts pull cells with few windows towards an even disagreement of 1.
    sums, counts = (_smooth(table, config.smooth) + config.cell_prior for table in tables)
    return sums / counts


def _load_pattern(model: SourceModel, evidence: MapEvidence) -> Array:
    """Return the squared load over its mean square in the unit's recording: (LEVELS,)."""
    load = np.maximum(load_levels(model) - evidence.rest, 0.0)
    return np.asarray((load / max(evidence.load_rms, 1e-12)) ** 2)


def _smooth(table: Array, levels: int) -> Array:
    kernel = np.ones(levels)
    return np.stack([np.convolve(row, kernel, mode="same") for row in table])


def rms(values: Array) -> float:
    """Return the root mean square; 0 of nothing."""
    return float(np.sqrt(np.mean(np.square(values)))) if np.size(values) else 0.0


def _spread(estimate: Array, others: Sequence[Array]) -> Array:
    if not others:
        return np.zeros_like(estimate)
    return np.asarray(np.sqrt(np.mean([(other - estimate) ** 2 for other in others], axis=0)))


def rest_rows(model: SourceModel, estimate: Array, shape: WindowShape) -> NDArray[np.bool_]:
    """Mark the windows at rest: output still, load among the unit's own lowest."""
    config = model.method.forecast
    low = _rest_level(estimate, config)
    still = model.interval.direction(shape) == 1
    return np.asarray(still & (estimate < low + config.rest_band * (model.interval.high - model.interval.low)))


def _rest_spread(model: SourceModel, estimate: Array, shape: WindowShape) -> float:
    """Return the scatter of estimates at rest beyond the source's own: drift, creep, a loose mount."""
    spread = _spread_at_rest(model, estimate, shape)
    return float(np.sqrt(max(spread**2 - _known_use(model).rest_spread ** 2, 0.0)))


def _spread_at_rest(model: SourceModel, estimate: Array, shape: WindowShape) -> float:
    rows = rest_rows(model, estimate, shape)
    return float(np.std(estimate[rows])) if rows.any() else 0.0


def _resolution(model: SourceModel, target: OutputRecording, mapped: Array, raw: Array) -> float:
    """Return the quantisation uncertainty d / (2 sqrt 3) of the readout's step d, carried through map and network."""
    steps = np.abs(np.diff(np.unique(target.output)))
    quantum = float(np.min(steps, initial=np.inf))
    gain = float(np.std(mapped) / np.std(raw)) / model.network.output_scale
    source_quantum = _known_use(model).step
    # f was trained on the source's steps: only a coarser readout adds error.
    excess = max((quantum * gain) ** 2 - (source_quantum / model.network.output_scale) ** 2, 0.0)
    return model.interval.sensitivity * float(np.sqrt(excess / 12))


def _clipping(model: SourceModel, target: OutputRecording, limits: OutputLimits) -> float:
    """Return the uncertainty of clipped samples: their load is uniform over the upper third of the range."""
    share = clipped_share(target.output, limits)
    return float(np.sqrt(share / 12)) * (model.interval.high - model.interval.low) / model.method.forecast.clipped_part


def rms_load(estimate: Array, config: ForecastConfig) -> float:
    """Return the RMS load above rest: the sensitivity to a gain error."""
    return rms(estimate - _rest_level(estimate, config))


def _rest_level(estimate: Array, config: ForecastConfig) -> float:
    return float(np.quantile(estimate, config.rest_level))


def _stage_terms(
    model: SourceModel, target: OutputRecording, unit_map: UnitMap, estimate: Array | None
) -> dict[str, float]:
    """Return how far the unit's load is from the source's at equal stage histories, beyond the source's own scatter.

    The error of a map grows with the load. A unit pressed less hard than the source is therefore scaled up to the
    source's loads.

    Args:
        estimate: f on all the unit's mapped windows, where it is known.
    """
    if model.stage_floor is None:
        return {}
    if estimate is None:
        estimate = model.network.evaluate(unit_map.apply(target.windows))
    difference = unit_difference(model.source, target, estimate, model.method)
    if difference is None:
        return {}
    beyond = difference.beyond(model.stage_floor)
    config = model.method.forecast
    ratio = _known_use(model).rms_load / max(rms_load(estimate, config), 1e-12)
    growth = float(np.clip(ratio, 1.0, config.most_growth))
    return {"stage": growth * beyond.rms, "slow": growth * beyond.slow_rms}


def _misread(model: SourceModel, target: OutputRecording, trial: Trial) -> Array:
    """Return the differences of the unit's estimates from the source's reference at the same instants."""
    count = min(model.method.forecast.rows, len(trial.source_rows))
    spread = np.linspace(0, len(trial.source_rows) - 1, count).astype(np.int64)
    estimate = model.network.evaluate(trial.unit_map.apply(target.windows[trial.target_rows[spread]]))
    return np.asarray(estimate - trial.source.window_reference[trial.source_rows[spread]])


def _extrapolation(model: SourceModel, estimate: Array) -> float:
    """Return the RMS distance of the source's loads from the range of loads this unit has shown."""
    return rms(_beyond(model.estimate, estimate, model.method.forecast.reach))


def _beyond(load: Array, estimate: Array, shares: tuple[float, float]) -> Array:
    """Return how far loads lie outside the range that a unit's estimates reach."""
    low, high = np.quantile(estimate, shares)
    return np.asarray(np.maximum(np.maximum(low - load, load - high), 0.0))


def use_overlap(model: SourceModel, shape: WindowShape) -> float:
    """Return the overlap (1 - total variation distance) of the two distributions over level and slope, 0 to 1."""
    known = _known_use(model)
    return float(np.minimum(known.use, _use(shape, known.levels, known.slopes)).sum())


def _fast(shape: WindowShape, config: ForecastConfig) -> float:
    return max(float(np.quantile(np.abs(shape.slope), config.fast)), 1e-9)


def _corners(model: SourceModel, shape: WindowShape) -> float:
    """Return the squared log ratio of how sharply unit and source turn; 0 where the unit turns more sharply.

    A lagging sensor rounds the corners of its signal. Sharpness is the 99 % quantile of the second difference over the
    95 % quantile of the slope: pressing faster raises both, so that speed alone changes little.
    """
    unit, source = _sharpness(shape, model.method.forecast), _known_use(model).sharpness
    return min(float(np.log(max(unit, 1e-9) / max(source, 1e-9))), 0.0) ** 2


def _sharpness(shape: WindowShape, config: ForecastConfig) -> float:
    return float(np.quantile(np.abs(shape.bend), config.sharp)) / _fast(shape, config)


def _use(shape: WindowShape, levels: Array, slopes: Array) -> Array:
    level, slope = np.clip(shape.level, levels[0], levels[-1]), np.clip(shape.slope, slopes[0], slopes[-1])
    counts, *_ = np.histogram2d(level, slope, (levels, slopes))
    return np.asarray(counts / len(level))
