"""What the mapped windows of a unit tell about it: wrong programme, other sensor, reversed wiring, drift, creep."""

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import numpy as np

from softcal.core.maps.crossing import CACHED, swings
from softcal.core.maps.readout_lag import ReadoutLag
from softcal.core.maps.synchrony import Synchrony, find_synchrony
from softcal.core.messages.reason import Reason, reason
from softcal.core.metrics import quantile
from softcal.core.recording import RATE_TOLERANCE, Array, OutputRecording
from softcal.core.unit.correspondence import BLIND
from softcal.core.unit.evidence import MapEvidence, rest_rows
from softcal.core.unit.forecast import map_variance
from softcal.core.unit.health import OutputLimits
from softcal.core.unit.method import FindingConfig, Method
from softcal.core.unit.source_model import SourceModel
from softcal.core.unit.verdict import Finding, Verdict


def map_findings(
    model: SourceModel, target: OutputRecording, evidence: MapEvidence, lag: ReadoutLag | None = None
) -> tuple[Finding, ...]:
    """Say in words what the mapped windows show against the unit, if anything.

    A lag shows only beside the source's own load: there the unit ran the source's programme, which is not blamed.
    """
    lagging = None
    if lag is not None:
        # So strong a lag that it hid the common load leaves a map of nothing.
        best = Verdict.CONDITIONAL if lag.is_paired else Verdict.RETEST
        lagging = Finding(reason("lagging", lag=lag.time_constant_s), best)
    checks = (
        lagging,
        _unfamiliar(model, evidence),
        None if lag else _operation_mismatch(evidence, model.method.findings),
        _uncovered(model, target, evidence),
        _stage_bias(model, evidence) or _restless(model, target, evidence),
        _not_better(model, evidence),
        _stretched(model, target, evidence),
    )
    return tuple(finding for finding in checks if finding is not None)


def contradictions(
    source: OutputRecording,
    target: OutputRecording,
    limits: OutputLimits,
    method: Method,
    shared: Synchrony | None = None,
) -> tuple[Finding, ...]:
    """Return what the two outputs say against the unit being what it is declared to be; the first of them alone.

    A channel the wrong way round, or in another physical unit, also looks clipped or pressed by a wrong programme.
    `shared` is None where nobody compared them in time.
    """
    if _is_reversed(source, target, limits, method, shared):
        return (Finding(reason("reversed"), Verdict.FAIL),)
    if shared is not None and not shared.is_synchronous and (times := _times_as_fast(source, target, method)) != 1:
        return (Finding(reason("other_speed", times=times), Verdict.RETEST),)
    (low, high), (source_low, source_high) = (
        _quantile_range(recording.output, method.health.span) for recording in (target, source)
    )
    apart = max(low - source_high, source_low - high)
    # Ranges of good units overlap throughout, and their levels at rest differ by tens of per cent.
    if apart > 0.5 * max(high - low, source_high - source_low, abs(source_low + source_high) / 2):
        ranges: dict[str, float | str] = {
            "low": low,
            "high": high,
            "least": source_low,
            "most": source_high,
            "unit": target.output_unit,
        }
        factor = _unit_factor((low, high), (source_low, source_high), method.findings.unit_step)
        cause = reason("elsewhere", **ranges) if factor == 1 else reason("other_unit", factor=factor, **ranges)
        return (Finding(cause, Verdict.RETEST),)
    return ()


def _unit_factor(target: tuple[float, float], source: tuple[float, float], unit_step: float) -> float:
    """Return the power of `unit_step` by which level and span of an output are those of another; 1 where there is none.

    Units of one kind differ by less than the root of it.
    """
    of_target, of_source = (np.abs([np.mean(one), np.ptp(one)]) for one in (target, source))
    ratios = np.log10(np.maximum(of_target, 1e-12) / np.maximum(of_source, 1e-12)) / np.log10(unit_step)
    steps = np.round(ratios)
    is_same = steps[0] == steps[1] != 0
    return float(unit_step ** steps[0]) if is_same else 1.0


def opening_findings(evidence: Mapping[str, float | str], config: FindingConfig) -> tuple[Finding, ...]:
    """Return a finding where a unit follows the source late in an opening that both run from their own start."""
    lag_s = float(evidence.get("lag_s", 0.0))
    if "shared_until_s" not in evidence or lag_s < config.late_s:
        return ()
    return (Finding(reason("late", lag=lag_s)),)


def _unfamiliar(model: SourceModel, evidence: MapEvidence) -> Finding | None:
    share = float(np.mean(evidence.distance > model.interval.familiar_distance))
    config = model.method.findings
    if share <= config.unfamiliar_share:
        return None
    limit = model.interval.support.roughness_limit
    rough = float(np.mean(evidence.shape.roughness > limit))
    cause = Reason("part.fast" if rough > share / 2 else "part.loads")
    best = Verdict.FAIL if share > config.failing_share else Verdict.CONDITIONAL
    return Finding(reason("unfamiliar", share=share, cause=cause), best)


def _uncovered(model: SourceModel, target: OutputRecording, evidence: MapEvidence) -> Finding | None:
    """Return a finding where the unit was pressed over too little of the source's range: by position where known."""
    source, shares = model.source.unlabelled, model.method.map.ends.quantile_range
    if target.stage_mm is not None and source.stage_mm is not None:
        code, unit = "part.pressed", "mm"
        covered, full_range = _quantile_range(target.stage_mm, shares), _quantile_range(source.stage_mm, shares)
    else:
        code, unit = "part.loaded", model.network.reference_unit
        covered, full_range = _quantile_range(evidence.estimate, shares), (model.interval.low, model.interval.high)
    share = (min(covered[1], full_range[1]) - max(covered[0], full_range[0])) / (full_range[1] - full_range[0])
    if share >= model.method.map.synchrony.covered_share:
        return None
    return Finding(
        reason(
            "not_covered",
            what=Reason(code),
            low=covered[0],
            high=covered[1],
            share=max(share, 0.0),
            least=full_range[0],
            most=full_range[1],
            unit=unit,
        )
    )


def _quantile_range(values: Array, shares: tuple[float, float]) -> tuple[float, float]:
    low, high = quantile(values, shares)
    return float(low), float(high)


def _operation_mismatch(evidence: MapEvidence, config: FindingConfig) -> Finding | None:
    """Return a finding where the unit's loads and speeds are not the source's.

    Where the stage position is known the map does not rest on that mix; else nothing firm can be said. Units under one
    load at once ran one programme.
    """
    best = evidence.correspondence.config.mismatch_verdict
    is_alike = 1 / config.speed_factor <= evidence.speed <= config.speed_factor
    if not best or (evidence.overlap >= config.enough_overlap and is_alike):
        return None
    furthest = config.speed_factor**2
    if evidence.overlap >= config.enough_overlap**2 and 1 / furthest <= evidence.speed <= furthest:
        # The forecast has terms for a mix that differs: it is wider for it, and still says something.
        best = min(Verdict(best), Verdict.CONDITIONAL, key=lambda verdict: verdict.severity)
    return Finding(reason("wrong_programme", share=evidence.overlap, speed=evidence.speed), Verdict(best))


def _stretched(model: SourceModel, target: OutputRecording, evidence: MapEvidence) -> Finding | None:
    """Return a finding where the unit would have to answer much less or more than the source.

    A unit pressed over a small part of the source's range looks like an insensitive one. The stage position, a common
    load or known loads tell them apart. Beyond what units of one kind differ by, they tell of another physical unit. A
    readout that clips looks so, too, and is named for what it is.
    """
    if evidence.budget["clipping"]:
        return None
    raw = model.interval.support.shape(target.windows[evidence.rows])
    spans = [
        np.subtract(*_quantile_range(shape.level, model.method.map.ends.quantile_range)[::-1])
        for shape in (evidence.shape, raw)
    ]
    gain, config = float(spans[0] / max(spans[1], 1e-12)), model.method.findings
    times, is_supported = max(gain, 1 / gain), evidence.correspondence.is_matched or evidence.correspondence.is_anchored
    if times <= (config.stretch if is_supported else config.reported_stretch):
        return None
    best = Verdict.RETEST if is_supported or times > config.blind_stretch else Verdict.CONDITIONAL
    return Finding(reason("stretched", gain=gain), best)


def _stage_bias(model: SourceModel, evidence: MapEvidence) -> Finding | None:
    """Return a finding where the unit reads other loads than the source did at equal stage histories, for long."""
    # Where unit and source were pressed by one load at once, equal positions say nothing more.
    slow = evidence.budget.get("slow", 0.0) if "slow" in evidence.correspondence.sensitivity else 0.0
    # Half of what f itself misreads is worth no word.
    if slow <= 0.5 * model.held_out_rmse:
        return None
    return Finding(reason("misread", slow=slow, unit=model.network.reference_unit))


def _restless(model: SourceModel, target: OutputRecording, evidence: MapEvidence) -> Finding | None:
    """Return a finding where estimates at rest wander: a trend over the recording is drift, else slow recovery."""
    spread = evidence.budget["rest"]
    config = model.method.findings
    if spread < config.drift_factor * model.held_out_rmse:
        return None
    at_rest = rest_rows(model, evidence.estimate, evidence.shape)
    t_s = target.t_s[target.window_rows[evidence.rows]][at_rest]
    value = evidence.estimate[at_rest]
    trend = np.polyfit(t_s - t_s.mean(), value, 1)[0]
    explained = float(np.corrcoef(t_s, value)[0, 1] ** 2)
    unit = model.network.reference_unit
    # A drift where a straight line explains more than half of the scatter.
    if explained > 0.5:
        return Finding(reason("drift", moved=float(trend * (t_s[-1] - t_s[0])), unit=unit))
    # Slow holds at low loads count as rest too, and recordings hold more or fewer of them.
    at_rest = rest_rows(model, model.estimate, model.shape)
    if spread < float(np.std(model.estimate[at_rest])):
        return None
    return Finding(reason("creep", spread=spread, unit=unit))


def _is_reversed(
    source: OutputRecording, target: OutputRecording, limits: OutputLimits, method: Method, shared: Synchrony | None
) -> bool:
    """Tell whether the output falls where the source's rises: along the stage, in time, or in how its levels lie."""
    config = method.findings
    if target.stage_mm is not None and source.stage_mm is not None:
        along = _along_stage(target), _along_stage(source)
        return min(map(abs, along)) > config.along_stage and along[0] * along[1] < 0
    if shared is not None and shared.rank_correlation <= -method.map.synchrony.min_rank_correlation:
        return True
    # Wasserstein's distance of the levels, as they are and upside down. k presses leave 1 / sqrt(k) of it to chance.
    unit, source_levels = (_levels(recording, method) for recording in (target, source))
    upright, mirrored = (float(np.mean(np.abs(levels - source_levels))) for levels in (unit, 1 - unit[::-1]))
    presses = max(min(swings(recording, method.map.crossing) for recording in (target, source)) / 2, 1.0)
    is_nearer = (upright - mirrored) * presses**0.5 > config.upside_down
    # A readout that clips heaps its levels at the loaded end: like the source it is neither way.
    is_clipped = bool(np.isfinite([limits.rail_low, limits.rail_high]).any())
    return is_nearer and not (is_clipped and mirrored > config.clipped_likeness * upright)


def _times_as_fast(source: OutputRecording, target: OutputRecording, method: Method) -> float:
    """Return how many times as fast as the source's a unit's whole programme went by; 1 where it is not the source's.

    The drive cannot do that by itself: the samples were taken, or are told to be taken, at another rate.
    """
    target_s, source_s = (recording.t_s[-1] - recording.t_s[0] for recording in (target, source))
    times = float(source_s / target_s)
    if abs(times - 1) <= RATE_TOLERANCE:
        return 1.0
    # One programme makes the same presses at any rate; twice as many are another one, which no comparison need show.
    presses = [swings(recording, method.map.crossing) for recording in (source, target)]
    if max(presses) > 2 * min(presses):
        return 1.0
    since_s = (target.t_s - target.t_s[0]) * times
    at_s = source.t_s - source.t_s[0]
    paced = replace(source, serial=target.serial, output=np.interp(at_s, since_s, target.output), stage_mm=None)
    return times if find_synchrony(source, paced, method.map).is_synchronous else 1.0


@lru_cache(maxsize=CACHED)
def _levels(recording: OutputRecording, method: Method) -> Array:
    """Return the quantiles of the output, as shares of the span between its tails."""
    low, high = _quantile_range(recording.output, method.health.span)
    shares = np.linspace(*method.map.ends.quantile_range, method.forecast.quantiles)
    return np.asarray((quantile(recording.output, shares) - low) / (high - low))


@lru_cache(maxsize=CACHED)
def _along_stage(recording: OutputRecording) -> float:
    """Return the correlation of output and stage position."""
    return float(np.corrcoef(recording.output, recording.stage_mm)[0, 1])


def _not_better(model: SourceModel, evidence: MapEvidence) -> Finding | None:
    """Return a finding where the map may be worse than doing nothing.

    It corrects less than it is uncertain by. Or, where no position speaks for it, it makes the unit hardly more like
    the source than it was. A map that changes next to nothing does no harm either way.
    """
    config, unit = model.method.findings, model.network.reference_unit
    uncertainty, correction = (
        float(np.sqrt(map_variance(evidence.budget, evidence.correspondence))),
        evidence.correction_rms,
    )
    # A correction by half of what f itself misreads does no harm either way.
    harmless = 0.5 * evidence.budget["model"]
    is_blind = evidence.correspondence.kind == BLIND and correction > harmless
    gained = evidence.overlap - evidence.unmapped_overlap
    if uncertainty > max(correction, harmless):
        cause = reason("part.uncertain", doubt=uncertainty, unit=unit)
    elif is_blind and gained < config.overlap_gain:
        cause = reason("part.no_nearer", gained=gained)
    else:
        return None
    return Finding(reason("not_better", correction=correction, unit=unit, why=cause))
