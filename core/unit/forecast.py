"""Forecast the error of one unit without a label: a budget of what source, map and recording leave open."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softcal.core.maps.interface import UnitMap
from softcal.core.recording import Array, Indices, OutputRecording
from softcal.core.unit.health import OutputLimits, clipped_share
from softcal.core.unit.source_model import SourceModel
from softcal.core.unit.stage_check import unit_difference
from softcal.core.unit.support import WindowShape
from softcal.core.unit.uncertainty import DIRECTIONS, LEVELS, ErrorForecast

ROWS = 8_000
"""Windows looked at per unit, evenly spaced: enough for every number below, whatever the recording's length."""

REACH = (0.005, 0.995)
"""Quantiles between which a unit's recording is said to reach."""

QUANTILES = np.linspace(0.005, 0.995, 100)

SENSITIVITY = {
    "disagreement": 0.07,
    "stability": 0.31,
    "support": 0.78,
    "shift": 0.16,
    "rest": 0.80,
    "resolution": 1.5,
    "clipping": 1.5,
    "extrapolation": 0.16,
    "overlap": 0.25,
    "speed": 0.06,
    "corners": 0.13,
    "gain": 0.37,
}
"""Sensitivity coefficients c_i where nothing else speaks for the loads, from `benchmarks/verdict.py --fit`."""

SENSITIVITY_ON_STAGE = {
    "stage": 0.59,
    "slow": 1.0,
    "support": 0.16,
    "clipping": 0.92,
    "extrapolation": 0.08,
    "resolution": 1.5,
    "overlap": 0.05,
}
"""The same where source and unit carry the stage position: the load over position says more than all the rest."""

SENSITIVITY_PAIRED = {"clipping": 0.84, "extrapolation": 0.16}
"""The same where unit and source were pressed by one load at once: the source's reference has measured the rest."""

MOST_GROWTH = 3.0
"""No more than this is made of what a lightly pressed unit would misread under the source's loads."""

UNSEEN = 1.1
"""A map errs this much more on loads it was not fitted to than on its own pairs."""

LOG_ERROR_PAIRED = (-0.35, 0.35)
"""Set, not fitted: what errors of slow presses, alike for seconds, leave open on another stretch."""

LOG_ERROR, LOG_ERROR_ON_STAGE = (-1.75, 0.78), (-0.41, 0.23)
"""2.5 % and 97.5 % quantiles of log(true / forecast RMSE) over good units: from `--seeds 1003 1089 4`, lots in which
mostly nothing speaks for the loads, and from the same command as the coefficients."""

INTERVAL_SHARE, INTERVAL_SHARE_ON_STAGE = 1.1, 0.1
"""Share of the map's variance that widens the interval, so that it covers 90 % of good units' samples: from
`benchmarks/interval_coverage.py --fit`."""


@dataclass(frozen=True, eq=False)
class MapEvidence:
    """What the mapped windows of one unit show.

    Args:
        rows: (n,) indices of the windows looked at, among the recording's full windows.
        estimate: (n,) f on the mapped windows, in the reference unit.
        shape: of the mapped windows.
        distance: (n,) of the mapped windows from the source's support.
        disagreement: (n,) RMS difference of the other candidate maps' estimates from `estimate`.
        unmapped: (n,) f on the raw windows: what doing nothing would say.
        overlap, unmapped_overlap: of the unit's mix of loads and speeds with the source's, 0 to 1, with and without
            the map.
        speed: how fast the unit's fast movements are, over the source's.
        budget: standard uncertainties in the reference unit: `model` and the names of `SENSITIVITY`, and `stage` and
            `slow` where source and unit carry the stage position.
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

    @property
    def correction_rms(self) -> float:
        """RMS difference between doing something and doing nothing, in the reference unit."""
        return _rms(self.estimate - self.unmapped)


@dataclass(frozen=True, eq=False)
class Trial:
    """A map with windows under one load at once to judge it by.

    Args:
        unit_map: the unit's map, or one fitted without these windows.
        source_rows, target_rows: full windows of source and unit, equal lengths.
    """

    unit_map: UnitMap
    source_rows: Indices
    target_rows: Indices


def gather_evidence(
    model: SourceModel,
    target: OutputRecording,
    unit_map: UnitMap,
    alternatives: Sequence[UnitMap],
    resampled: Sequence[UnitMap],
    limits: OutputLimits,
    trials: Sequence[Trial] = (),
    gain_error: float = 0.0,
) -> MapEvidence:
    """Look at one unit through its map and through the maps it might have had.

    Args:
        model: the lot's source.
        target: recording of the unit.
        unit_map: the chosen map.
        alternatives: other candidates for the whole recording.
        resampled: the same kind of map fitted to parts of the recording.
        limits: rails of the raw output.
        trials: maps with windows under one load at once, where the unit was pressed so.
        gain_error: standard error of the logarithm of the map's gain, where it rests on matched levels.
    """
    rows = np.unique(np.linspace(0, len(target.windows) - 1, ROWS).astype(np.int64))
    raw = target.windows[rows]
    network, interval = model.network, model.interval
    mapped = unit_map.apply(raw)
    estimate = network.evaluate(mapped)
    shape = interval.support.shape(mapped)
    distance = interval.support.distance(shape)
    disagreement = _spread(estimate, [network.evaluate(other.apply(raw)) for other in alternatives])
    stability = _spread(estimate, [network.evaluate(part.apply(raw)) for part in resampled])
    cells = interval.direction(shape), interval.column(estimate)
    overlap, speed = use_overlap(model, shape), _fast(shape) / _fast(model.shape)
    budget = {
        "model": _rms(model.residuals.rmse_table[cells]),
        "disagreement": _rms(disagreement),
        "stability": _rms(stability),
        "support": interval.sensitivity * _rms(distance),
        "shift": _rms(np.quantile(estimate, QUANTILES) - np.quantile(model.estimate, QUANTILES)),
        "rest": _rest_spread(model, estimate, shape),
        "resolution": _resolution(model, target, mapped, raw),
        "clipping": _clipping(model, target, limits),
        "extrapolation": _extrapolation(model, estimate),
        "overlap": (1 - overlap) ** 2 * (interval.high - interval.low),
        "speed": float(np.log(speed)) ** 2 * (interval.high - interval.low),
        "corners": _corners(model, shape) * (interval.high - interval.low),
        "gain": gain_error * _load(estimate),
        **_stage_terms(model, target, unit_map),
    }
    if trials:
        budget["paired"] = _rms(np.concatenate([_misread(model, target, trial) for trial in trials]))
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
    )


def forecast_error(budget: Mapping[str, float]) -> ErrorForecast:
    """Combine a budget: u_c^2 = u_model^2 + sum (c_i u_i)^2 (GUM, JCGM 100:2008, eq. 10), with its own uncertainty.

    What was measured against the source's reference replaces the model's term: it holds that error already.
    """
    base = UNSEEN * budget["paired"] if "paired" in budget else budget["model"]
    rmse = float(np.sqrt(base**2 + _squares(budget)))
    low, high = LOG_ERROR_PAIRED if "paired" in budget else LOG_ERROR_ON_STAGE if "stage" in budget else LOG_ERROR
    return ErrorForecast(rmse, rmse * float(np.exp(low)), rmse * float(np.exp(high)))


def sensitivity(budget: Mapping[str, float]) -> Mapping[str, float]:
    """Return the coefficients c_i that hold for a budget, by what is known of the loads."""
    if "paired" in budget:
        return SENSITIVITY_PAIRED
    return SENSITIVITY_ON_STAGE if "stage" in budget else SENSITIVITY


def map_variance(budget: Mapping[str, float]) -> float:
    """Return the part of the forecast's variance that is the map's and the recording's, not the network's."""
    if "paired" not in budget:
        return _squares(budget)
    return _squares(budget) + max((UNSEEN * budget["paired"]) ** 2 - budget["model"] ** 2, 0.0)


def is_placed(budget: Mapping[str, float]) -> bool:
    """Tell whether the loads are known otherwise than by how they are distributed: by position, or by the source's."""
    return "paired" in budget or "stage" in budget


def _squares(budget: Mapping[str, float]) -> float:
    return float(sum((coefficient * budget[name]) ** 2 for name, coefficient in sensitivity(budget).items()))


def variance_table(model: SourceModel, evidence: MapEvidence) -> Array:
    """Spread the map's variance over direction and load level: (3, LEVELS), half even, half where the maps disagree.

    Half of it all goes with the square of the load where the gain rests on matched levels alone: if that is wrong, the
    error grows with the load. What the unit has not shown of the source's loads counts there alone.
    """
    budget = evidence.budget
    share = INTERVAL_SHARE_ON_STAGE if "stage" in budget else INTERVAL_SHARE
    share = 1.0 if "paired" in budget else share
    unseen = sensitivity(budget)["extrapolation"]
    pattern = 0.5 + 0.5 * _disagreement_pattern(model, evidence)
    if not is_placed(budget) and budget["gain"]:
        pattern = 0.5 * pattern + 0.5 * _load_pattern(model, evidence)
    beyond = unseen * _beyond(_levels(model), evidence.estimate)
    return share * (map_variance(budget) - (unseen * budget["extrapolation"]) ** 2) * pattern + beyond**2


def _levels(model: SourceModel) -> Array:
    low, high = model.interval.low, model.interval.high
    return low + (np.arange(LEVELS) + 0.5) * (high - low) / LEVELS


def _disagreement_pattern(model: SourceModel, evidence: MapEvidence) -> Array:
    pattern = np.ones((len(DIRECTIONS), LEVELS))
    mean_square = float(np.mean(evidence.disagreement**2))
    if mean_square == 0:
        return pattern
    cells = model.interval.direction(evidence.shape), model.interval.column(evidence.estimate)
    counts, sums = np.zeros_like(pattern), np.zeros_like(pattern)
    np.add.at(counts, cells, 1.0)
    np.add.at(sums, cells, evidence.disagreement**2 / mean_square)
    return (_smooth(sums) + 5.0) / (_smooth(counts) + 5.0)


def _load_pattern(model: SourceModel, evidence: MapEvidence) -> Array:
    """Return the squared load over its mean square in the unit's recording: (LEVELS,)."""
    load = np.maximum(_levels(model) - _rest_level(evidence.estimate), 0.0)
    return np.asarray((load / max(_load(evidence.estimate), 1e-12)) ** 2)


def _smooth(table: Array) -> Array:
    kernel = np.ones(9)
    return np.stack([np.convolve(row, kernel, mode="same") for row in table])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if np.size(values) else 0.0


def _spread(estimate: Array, others: Sequence[Array]) -> Array:
    if not others:
        return np.zeros_like(estimate)
    return np.asarray(np.sqrt(np.mean([(other - estimate) ** 2 for other in others], axis=0)))


def rest_rows(model: SourceModel, estimate: Array, shape: WindowShape) -> NDArray[np.bool_]:
    """Mark the windows at rest: holding still at the unit's own lowest loads."""
    low = _rest_level(estimate)
    still = model.interval.direction(shape) == 1
    return np.asarray(still & (estimate < low + 0.1 * (model.interval.high - model.interval.low)))


def _rest_spread(model: SourceModel, estimate: Array, shape: WindowShape) -> float:
    """Return how far estimates at rest scatter beyond what the source's own do: drift, creep, a loose mount."""
    spread = [
        float(np.std(e[rest_rows(model, e, s)])) if rest_rows(model, e, s).any() else 0.0
        for e, s in ((estimate, shape), (model.estimate, model.shape))
    ]
    return float(np.sqrt(max(spread[0] ** 2 - spread[1] ** 2, 0.0)))


def _resolution(model: SourceModel, target: OutputRecording, mapped: Array, raw: Array) -> float:
    """Return d / (2 sqrt 3) for the step d of the unit's readout, carried through map and network."""
    steps = np.abs(np.diff(np.unique(target.output)))
    quantum = float(np.min(steps, initial=np.inf))
    gain = float(np.std(mapped) / np.std(raw)) / model.network.output_scale
    source_quantum = float(np.min(np.abs(np.diff(np.unique(model.source.unlabelled.output)))))
    excess = max((quantum * gain) ** 2 - (source_quantum / model.network.output_scale) ** 2, 0.0)
    return model.interval.sensitivity * float(np.sqrt(excess / 12))


def _clipping(model: SourceModel, target: OutputRecording, limits: OutputLimits) -> float:
    """Return the error of a clipped stretch: the load there is anywhere in the upper third of the range."""
    share = clipped_share(target.output, limits)
    return float(np.sqrt(share / 12)) * (model.interval.high - model.interval.low) / 3


def _load(estimate: Array) -> float:
    """Return the RMS load above rest: what an error of the gain is multiplied with."""
    return _rms(estimate - _rest_level(estimate))


def _rest_level(estimate: Array) -> float:
    return float(np.quantile(estimate, 0.02))


def _stage_terms(model: SourceModel, target: OutputRecording, unit_map: UnitMap) -> dict[str, float]:
    """Return how far the unit's load is from the source's at equal stage histories, beyond the source's own scatter.

    What a unit misreads grows with the load; a unit pressed less hard than its source will misread more later.
    """
    if model.stage_floor is None:
        return {}
    estimate = model.network.evaluate(unit_map.apply(target.windows))
    difference = unit_difference(model.source, target, estimate)
    if difference is None:
        return {}
    beyond = difference.beyond(model.stage_floor)
    growth = float(np.clip(_load(model.estimate) / max(_load(estimate), 1e-12), 1.0, MOST_GROWTH))
    return {"stage": growth * beyond.rms, "slow": growth * beyond.slow_rms}


def _misread(model: SourceModel, target: OutputRecording, trial: Trial) -> Array:
    """Return the differences of the unit's estimates from the source's reference at the same instants."""
    spread = np.linspace(0, len(trial.source_rows) - 1, min(ROWS, len(trial.source_rows))).astype(np.int64)
    estimate = model.network.evaluate(trial.unit_map.apply(target.windows[trial.target_rows[spread]]))
    return np.asarray(estimate - model.source.window_reference[trial.source_rows[spread]])


def _extrapolation(model: SourceModel, estimate: Array) -> float:
    """Return the RMS distance of the source's loads from the range of loads this unit has shown."""
    return _rms(_beyond(model.estimate, estimate))


def _beyond(load: Array, estimate: Array) -> Array:
    """Return how far loads lie outside the range that a unit's estimates reach."""
    low, high = np.quantile(estimate, REACH)
    return np.asarray(np.maximum(np.maximum(low - load, load - high), 0.0))


def use_overlap(model: SourceModel, shape: WindowShape) -> float:
    """Return the shared area of the unit's and the source's distributions over level and slope, 0 to 1.

    The grid is coarse enough for short recordings.
    """
    low, high = np.quantile(model.shape.level, REACH)
    levels = np.linspace(low, high, 11)
    slopes = np.linspace(-1, 1, 8) * np.quantile(np.abs(model.shape.slope), 0.98)
    source, unit = (_use(part, levels, slopes) for part in (model.shape, shape))
    return float(np.minimum(source, unit).sum())


def _fast(shape: WindowShape) -> float:
    return max(float(np.quantile(np.abs(shape.slope), 0.95)), 1e-9)


def _corners(model: SourceModel, shape: WindowShape) -> float:
    """Return the squared log ratio of how sharply unit and source turn, where the unit is the duller.

    Lag rounds corners. It is the 99 % quantile of the bend over the 95 % quantile of the slope, so that pressing faster
    alone changes little.
    """
    unit, source = (float(np.quantile(np.abs(part.bend), 0.99)) / _fast(part) for part in (shape, model.shape))
    return min(float(np.log(max(unit, 1e-9) / max(source, 1e-9))), 0.0) ** 2


def _use(shape: WindowShape, levels: Array, slopes: Array) -> Array:
    level, slope = np.clip(shape.level, levels[0], levels[-1]), np.clip(shape.slope, slopes[0], slopes[-1])
    counts, *_ = np.histogram2d(level, slope, (levels, slopes))
    return np.asarray(counts / len(level))
