"""What a map is tried by, what the mapped windows show, and the uncertainty budget of it (GUM, JCGM 100:2008).

Each term of the budget is a standard uncertainty in the reference unit: how well f reads its own source, how much
candidate maps disagree, what of the source's loads the unit has not shown, and so on.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from softcal.core.errors import UnitRefused
from softcal.core.maps.affine_map import IDENTITY, TWO_POINT
from softcal.core.maps.choose import ChosenMap, fit_family
from softcal.core.maps.crossing import CACHED
from softcal.core.maps.interface import FitProblem, UnitMap, mapped_segments
from softcal.core.maps.monotone import AVERAGED
from softcal.core.maps.paired import SHARED_LOAD, STAGE_MATCHED, SYNCHRONOUS, fit_pairs
from softcal.core.maps.synchrony import paired_rows
from softcal.core.metrics import quantile, rms
from softcal.core.recording import Array, Indices, LabelledRecording, Mask, OutputRecording
from softcal.core.unit.correspondence import SHARED, Correspondence, find_correspondence
from softcal.core.unit.health import OutputLimits, clipped_share
from softcal.core.unit.lot_fit_part import LotFitPart
from softcal.core.unit.method import ForecastConfig, Method
from softcal.core.unit.source_model import SourceModel, unit_difference
from softcal.core.unit.uncertainty import WindowShape
from softcal.core.windows import TAPS, evenly

LINE, DAY = "line", "day"
"""Terms of the budget for what line and day do to the load; they weigh 1 whatever is known of the loads."""


@dataclass(frozen=True, eq=False)
class MapEvidence:
    """What the mapped windows of one unit show.

    Args:
        rows: (n,) indices of the windows looked at, among the recording's full windows.
        estimate: (n,) f on the mapped windows, in the reference unit.
        distance: (n,) of the mapped windows from the source's support.
        disagreement: (n,) RMS difference of the other candidate maps' estimates from `estimate`.
        unmapped: (n,) f on the raw windows: what doing nothing would say.
        overlap, unmapped_overlap: of the unit's loads and speeds with the source's, 0 to 1, with and without
            the map.
        speed: how fast the unit's fast movements are, over the source's.
        budget: standard uncertainties in the reference unit: `model` and the terms of every kind of correspondence
            (`correspondence.py`). `stage` and `slow` are there where source and unit carry the stage position, `line`
            where the spread of the line was stated, `day` where a golden run measured its day, `shared` and `own_part`
            where the lot was fitted together.
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
    correspondence: Correspondence
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
        source_rows: (k,) of the source's windows.
        windows: (k, TAPS) of the unit, beside them.
        reference_rmse: RMS error that the reference of these windows does not hold: that of f, where f itself read it.
    """

    unit_map: UnitMap
    source: LabelledRecording
    source_rows: Indices
    windows: Array
    reference_rmse: float = 0.0


@dataclass(frozen=True, eq=False)
class OtherMaps:
    """Other maps that fit the unit's recording, or parts of it.

    Args:
        alternatives: other candidates for the whole recording.
        resampled: the same kind of map fitted to parts of the recording.
        trials: maps with paired windows to test them by, where source and unit were pressed together.
        gain_error: standard error of the logarithm of the map's gain, where it rests on matched levels.
        linear_map: a map that was not bent to spend the unit's time as the source's; by default the unit's map. How the
            loads differ shows through it alone.
    """

    alternatives: Sequence[UnitMap] = ()
    resampled: Sequence[UnitMap] = ()
    trials: Sequence[Trial] = ()
    gain_error: float = 0.0
    linear_map: UnitMap | None = None


def other_maps(fit: FitProblem, chosen: ChosenMap, method: Method, reference_rmse: float) -> OtherMaps:
    """Return what the chosen map is tried by; `reference_rmse` is the RMS error of the paired reference."""
    trials = _trials(fit, chosen, method.map.pairs.every, reference_rmse) if chosen.family == SYNCHRONOUS else []
    # Where the stage position or a common load is known, that tells more than leaving shares out.
    is_measured = bool(trials) or chosen.family in (STAGE_MATCHED, SHARED_LOAD)
    gain_error = float(chosen.evidence.get("gain_error", 0.0))
    log_gain = float(np.log(float(chosen.evidence.get("gain", 1.0))))
    # A gain far from the source's is itself a doubt unless loads were given.
    if "anchor_gain" not in chosen.evidence and abs(log_gain) > np.log(method.findings.reported_stretch):
        gain_error = float(np.hypot(gain_error, log_gain))
    return OtherMaps(
        alternatives=[other for name, other in chosen.alternatives.items() if name != IDENTITY],
        resampled=[] if is_measured else _refitted(fit, chosen, method),
        trials=trials,
        gain_error=gain_error,
        linear_map=chosen.alternatives.get(TWO_POINT) if chosen.family in (AVERAGED, SHARED_LOAD) else None,
    )


def _trials(fit: FitProblem, chosen: ChosenMap, parts: int, reference_rmse: float) -> list[Trial]:
    """Return maps with the windows under one load at once to judge them by.

    An opening holds few presses, which the map has been bent to: there, each map has not seen the windows it is
    judged by.
    """
    source_rows, target_rows = paired_rows(fit.source.unlabelled, fit.target, fit.synchrony)
    if not np.isfinite(fit.synchrony.until_s):
        return [Trial(chosen.unit_map, fit.source, source_rows, fit.target.windows[target_rows], reference_rmse)]
    part = np.arange(len(target_rows)) * parts // len(target_rows)
    trials = []
    for held_out in (part == k for k in range(parts)):
        unit_map = fit_pairs(fit, source_rows[~held_out], target_rows[~held_out], SYNCHRONOUS)
        trials.append(
            Trial(
                unit_map, fit.source, source_rows[held_out], fit.target.windows[target_rows[held_out]], reference_rmse
            )
        )
    return trials


def _refitted(fit: FitProblem, chosen: ChosenMap, method: Method) -> list[UnitMap]:
    """Fit the chosen family again with one share of the recording left out at a time."""
    parts, target, refits = method.forecast.parts, fit.target, []
    # Each share is made of many stretches, so that what is left still covers the whole programme.
    # Bridged, a few lost samples move no stretch.
    all_s = target.bridged.t_s
    length = max(len(all_s) // (parts * method.forecast.stretches), TAPS)
    part_of = np.searchsorted(all_s, target.t_s) // length % parts
    for is_included in (part_of != part for part in range(parts)):
        stage_mm = None if target.stage_mm is None else target.stage_mm[is_included]
        rest = replace(target, t_s=target.t_s[is_included], output=target.output[is_included], stage_mm=stage_mm)
        try:
            refits.append(fit_family(replace(fit, target=rest), chosen.family))
        except UnitRefused:
            continue
    return refits


def gather_evidence(
    model: SourceModel,
    target: OutputRecording,
    unit_map: UnitMap,
    limits: OutputLimits,
    others: OtherMaps = OtherMaps(),  # noqa: B008 - frozen
    is_anchored: bool = False,
    line_share: float = 0.0,
    day_rmse: float = 0.0,
    lot_fit: LotFitPart | None = None,
) -> MapEvidence:
    """Collect the budget of one unit from its map and from other maps that fit its recording too.

    `line_share` is what the line adds, as a share of the load; `day_rmse` what the day of the recording changes, as a
    golden run showed it, in the reference unit.
    """
    config, network, interval, operation = (
        model.method.forecast,
        model.network,
        model.interval,
        _source_operation(model),
    )
    # Evenly spaced rows: every statistic below costs the same however long the recording is.
    rows = evenly(len(target.windows), 2 * model.method.map.pairs.pairs)
    raw, mapped = target.windows[rows], _mapped(unit_map, target, rows)
    estimate, shape = network.evaluate(mapped), interval.support.shape(mapped)
    distance = interval.support.distance(shape)
    by_others = {id(other): network.evaluate(_mapped(other, target, rows)) for other in others.alternatives}
    disagreement = _spread(estimate, list(by_others.values()))
    stability = _spread(estimate, [network.evaluate(_mapped(part, target, rows)) for part in others.resampled])
    unbent_load, unbent_shape = estimate, shape
    if (linear_map := others.linear_map) is not None:
        unbent = _mapped(linear_map, target, rows)
        unbent_load = by_others[id(linear_map)] if id(linear_map) in by_others else network.evaluate(unbent)
        unbent_shape = interval.support.shape(unbent)
    rest, span = _rest_level(model, estimate), interval.high - interval.low
    load_rms = rms(estimate - rest)
    # A map of a lot fit may take the mean of a window alone: what moved within it is gone behind it.
    moving = shape if lot_fit is None else unbent_shape
    overlap, speed = _operation_overlap(operation, unbent_shape), _fast(moving, config) / operation.fast
    sharpness = _sharpness(moving, config)
    # A map is only as good as the agreement of those that could have been chosen instead (disagreement), and of the
    # same family on other parts of the recording (stability, a delete-a-group jackknife).
    budget = {
        "model": rms(model.rmse_table[interval.direction(shape), interval.column(estimate)]),
        "disagreement": rms(disagreement),
        "stability": rms(stability),
        "support": interval.sensitivity * rms(distance),
        "shift": rms(quantile(unbent_load, operation.shares) - operation.loads),
        # The scatter of estimates at rest beyond the source's own: drift, creep, a loose mount.
        "rest": float(np.sqrt(max(_spread_at_rest(model, estimate, shape) ** 2 - operation.rest_spread**2, 0.0))),
        "resolution": _resolution(model, target, float(np.std(mapped) / np.std(raw))),
        # The load of a clipped sample is uniform over the upper part of the range.
        "clipping": float(np.sqrt(clipped_share(target.output, limits) / 12)) * span / config.clipped_part,
        "extrapolation": rms(beyond(model.estimate, estimate, model.method.map.ends.quantile_range)),
        "overlap": (1 - overlap) ** 2 * span,
        "speed": float(np.log(speed)) ** 2 * span,
        # A lagging sensor rounds the corners of its signal; one that turns more sharply than the source does not.
        "corners": min(float(np.log(max(sharpness, 1e-9) / max(operation.sharpness, 1e-9))), 0.0) ** 2 * span,
        "gain": others.gain_error * load_rms,
        **_stage_terms(model, target, unit_map, estimate if len(rows) == len(target.windows) else None),
    }
    if line_share:
        budget[LINE] = line_share * load_rms
    if day_rmse:
        budget[DAY] = day_rmse
    if lot_fit is not None:
        budget |= {SHARED: lot_fit.common_rmse, "own_part": lot_fit.unit_rmse}
    if others.trials:
        paired_rmse = rms(np.concatenate([_paired_errors(model, trial) for trial in others.trials]))
        budget["paired"] = float(np.hypot(paired_rmse, max(trial.reference_rmse for trial in others.trials)))
    return MapEvidence(
        rows,
        estimate,
        shape,
        distance,
        disagreement,
        unmapped=network.evaluate(raw),
        overlap=overlap,
        unmapped_overlap=_operation_overlap(operation, interval.support.shape(raw)),
        speed=speed,
        budget=budget,
        correspondence=find_correspondence(budget, model.method.correspondence, is_anchored),
        rest=rest,
    )


def _mapped(unit_map: UnitMap, target: OutputRecording, rows: Indices) -> Array:
    """Return the windows of the given rows behind a map."""
    if len(rows) < len(target.windows):
        return unit_map.apply(target.windows[rows])
    # Sample by sample: a window shares all its samples but one with the next.
    parts = [mapped for _, mapped in mapped_segments(unit_map, target)]
    return np.ascontiguousarray(parts[0]) if len(parts) == 1 else np.concatenate(parts)


@dataclass(frozen=True, eq=False)
class _SourceOperation:
    """How the source was pressed, as each of its units is compared with it.

    Args:
        shares, loads: quantiles of f on the source, in the reference unit.
        rest_spread: standard deviation of f at rest, in the reference unit.
        levels, slopes: edges of the grid that uses are compared on.
        cell_shares: share of the source's windows in each cell of it.
    """

    shares: Array
    loads: Array
    rest_spread: float
    rms_load: float
    fast: float
    sharpness: float
    levels: Array
    slopes: Array
    cell_shares: Array


@lru_cache(maxsize=CACHED)
def _source_operation(model: SourceModel) -> _SourceOperation:
    config, shape, estimate = model.method.forecast, model.shape, model.estimate
    shares = np.linspace(*model.method.map.ends.quantile_range, config.quantiles)
    low, high = quantile(shape.level, model.method.map.ends.quantile_range)
    # A coarse grid: with finer cells two short recordings of one programme would seem to differ.
    levels = np.linspace(low, high, config.overlap_edges[0])
    slopes = np.linspace(-1, 1, config.overlap_edges[1])
    slopes *= quantile(np.abs(shape.slope), model.method.map.curve.shares[1])
    return _SourceOperation(
        shares=shares,
        loads=quantile(estimate, shares),
        rest_spread=_spread_at_rest(model, estimate, shape),
        rms_load=rms_load(model, estimate),
        fast=_fast(shape, config),
        sharpness=_sharpness(shape, config),
        levels=levels,
        slopes=slopes,
        cell_shares=_cell_shares(shape, levels, slopes),
    )


def _spread(estimate: Array, others: Sequence[Array]) -> Array:
    if not others:
        return np.zeros_like(estimate)
    return np.asarray(np.sqrt(np.mean([(other - estimate) ** 2 for other in others], axis=0)))


def rest_rows(model: SourceModel, estimate: Array, shape: WindowShape) -> Mask:
    """Mark the windows at rest: output still, load among the unit's own lowest."""
    band = model.method.health.near_end * (model.interval.high - model.interval.low)
    still = model.interval.direction(shape) == 1
    return np.asarray(still & (estimate < _rest_level(model, estimate) + band))


def _spread_at_rest(model: SourceModel, estimate: Array, shape: WindowShape) -> float:
    rows = rest_rows(model, estimate, shape)
    return float(np.std(estimate[rows])) if rows.any() else 0.0


def _resolution(model: SourceModel, target: OutputRecording, gain: float) -> float:
    """Return the quantisation uncertainty d / (2 sqrt 3) of the readout's step d, carried through map and network."""
    scale, source_step = model.network.output_scale, model.source.unlabelled.step
    # f was trained on the source's steps: only a coarser readout adds error.
    excess = max((target.step * (gain / scale)) ** 2 - (source_step / scale) ** 2, 0.0)
    return model.interval.sensitivity * float(np.sqrt(excess / 12))


def rms_load(model: SourceModel, estimate: Array) -> float:
    """Return the RMS load above rest: the sensitivity to a gain error."""
    return rms(estimate - _rest_level(model, estimate))


def _rest_level(model: SourceModel, estimate: Array) -> float:
    return float(quantile(estimate, model.method.map.crossing.robust_range[0]))


def _stage_terms(
    model: SourceModel, target: OutputRecording, unit_map: UnitMap, estimate: Array | None
) -> dict[str, float]:
    """Return how far the unit's load is from the source's at equal stage histories, beyond the source's own scatter.

    The error of a map grows with the load. A unit pressed less hard than the source is therefore scaled up to the
    source's loads.
    """
    if model.stage_scatter is None:
        return {}
    if estimate is None:
        estimate = model.network.evaluate(unit_map.apply(target.windows))
    difference = unit_difference(model.source, target, estimate, model.method)
    if difference is None:
        return {}
    excess = difference.beyond(model.stage_scatter)
    ratio = _source_operation(model).rms_load / max(rms_load(model, estimate), 1e-12)
    growth = float(np.clip(ratio, 1.0, model.method.forecast.max_growth))
    return {"stage": growth * excess.rms, "slow": growth * excess.slow_rms}


def _paired_errors(model: SourceModel, trial: Trial) -> Array:
    """Return the differences of the unit's estimates from the source's reference at the same instants."""
    spread = evenly(len(trial.source_rows), 2 * model.method.map.pairs.pairs)
    estimate = model.network.evaluate(trial.unit_map.apply(trial.windows[spread]))
    return np.asarray(estimate - trial.source.window_reference[trial.source_rows[spread]])


def beyond(load: Array, estimate: Array, shares: tuple[float, float]) -> Array:
    """Return how far loads lie outside the range that a unit's estimates reach."""
    low, high = quantile(estimate, shares)
    return np.asarray(np.maximum(np.maximum(low - load, load - high), 0.0))


def _operation_overlap(operation: _SourceOperation, shape: WindowShape) -> float:
    """Return the overlap (1 - total variation distance) of the two distributions over level and slope, 0 to 1."""
    return float(np.minimum(operation.cell_shares, _cell_shares(shape, operation.levels, operation.slopes)).sum())


def _fast(shape: WindowShape, config: ForecastConfig) -> float:
    return max(float(quantile(np.abs(shape.slope), config.fast)), 1e-9)


def _sharpness(shape: WindowShape, config: ForecastConfig) -> float:
    """Return the extreme bend over the extreme slope: pressing faster raises both, so that speed changes little."""
    return float(quantile(np.abs(shape.curvature), config.sharp)) / _fast(shape, config)


def _cell_shares(shape: WindowShape, levels: Array, slopes: Array) -> Array:
    level, slope = np.clip(shape.level, levels[0], levels[-1]), np.clip(shape.slope, slopes[0], slopes[-1])
    counts, *_ = np.histogram2d(level, slope, (levels, slopes))
    return np.asarray(counts / len(level))
