"""What the mapped windows of a unit tell about it: wrong programme, other sensor, reversed wiring, drift, creep."""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from softcal.core.maps.crossing import KEPT
from softcal.core.maps.readout_lag import ReadoutLag
from softcal.core.recording import Array, OutputRecording
from softcal.core.unit.forecast import MapEvidence, map_variance, rest_rows
from softcal.core.unit.method import FindingConfig
from softcal.core.unit.source_model import SourceModel
from softcal.core.unit.verdict import Finding, Verdict
from softcal.core.words.reason import Reason, reason


def map_findings(
    model: SourceModel, target: OutputRecording, evidence: MapEvidence, lag: ReadoutLag | None = None
) -> tuple[Finding, ...]:
    """Say in words what the mapped windows show against the unit, if anything.

    A lag was seen beside the source's own load, so that the programme was the source's and is not blamed.
    """
    checks = (
        _lagging(lag),
        _unfamiliar(model, evidence),
        None if lag else _other_use(evidence, model.method.findings),
        _uncovered(model, target, evidence),
        _misread(model, evidence) or _restless(model, target, evidence),
        _not_better(model, evidence),
        _stretched(model, target, evidence),
    )
    return tuple(finding for finding in checks if finding is not None)


def wiring_findings(model: SourceModel, target: OutputRecording) -> tuple[Finding, ...]:
    """Return a finding where the unit is wired the wrong way round.

    It is the only one to be told then: upside down a unit at rest looks clipped, and the right programme wrong.
    """
    found = _reversed(model, target)
    return () if found is None else (found,)


def opening_findings(evidence: Mapping[str, float | str], config: FindingConfig) -> tuple[Finding, ...]:
    """Return a finding where a unit follows the source late in an opening that both run from their own start.

    Args:
        evidence: of the chosen map (`ChosenMap.evidence`).
        config: how late is too late.
    """
    lag_s = float(evidence.get("lag_s", 0.0))
    if "shared_until_s" not in evidence or lag_s < config.late_s:
        return ()
    return (Finding(reason("late", lag=lag_s)),)


def _lagging(lag: ReadoutLag | None) -> Finding | None:
    """Return a finding where the readout lags. So strong a lag that it hid the common load leaves a map of nothing."""
    if lag is None:
        return None
    best = Verdict.CONDITIONAL if lag.is_paired else Verdict.RETEST
    return Finding(reason("lagging", lag=lag.time_constant_s), best)


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
    source, shares = model.source.unlabelled, model.method.forecast.reach
    if target.stage_mm is not None and source.stage_mm is not None:
        what, unit = "part.pressed", "mm"
        reach, whole = _reach(target.stage_mm, shares), _reach(source.stage_mm, shares)
    else:
        what, unit = "part.loaded", model.network.reference_unit
        reach, whole = _reach(evidence.estimate, shares), (model.interval.low, model.interval.high)
    share = (min(reach[1], whole[1]) - max(reach[0], whole[0])) / (whole[1] - whole[0])
    if share >= model.method.findings.covered_share:
        return None
    return Finding(
        reason(
            "not_covered",
            what=Reason(what),
            low=reach[0],
            high=reach[1],
            share=max(share, 0.0),
            least=whole[0],
            most=whole[1],
            unit=unit,
        )
    )


def _reach(values: Array, shares: tuple[float, float]) -> tuple[float, float]:
    low, high = np.quantile(values, shares)
    return float(low), float(high)


def _other_use(evidence: MapEvidence, config: FindingConfig) -> Finding | None:
    """Return a finding where the unit's mix of loads and speeds is not the source's.

    Where the stage position is known the map does not rest on that mix; else nothing firm can be said. Units under one
    load at once ran one programme.
    """
    best = evidence.knowledge.config.other_use
    is_alike = 1 / config.speed_factor <= evidence.speed <= config.speed_factor
    if not best or (evidence.overlap >= config.enough_overlap and is_alike):
        return None
    furthest = config.meaningless_speed
    if evidence.overlap >= config.meaningless_overlap and 1 / furthest <= evidence.speed <= furthest:
        # The forecast has terms for a mix that differs: it is wider for it, and still says something.
        best = min(Verdict(best), Verdict.CONDITIONAL, key=lambda verdict: verdict.severity)
    return Finding(reason("wrong_programme", share=evidence.overlap, speed=evidence.speed), Verdict(best))


def _stretched(model: SourceModel, target: OutputRecording, evidence: MapEvidence) -> Finding | None:
    """Return a finding where the unit would have to answer much less or more than the source.

    A unit pressed over a small part of the source's range looks like an insensitive one. The stage position or known
    loads tell them apart; one clock does not. A readout that clips looks so, too, and is named for what it is.
    """
    if evidence.knowledge.kind == "stage" or evidence.knowledge.is_anchored or evidence.budget["clipping"]:
        return None
    raw = model.interval.support.shape(target.windows[evidence.rows])
    spans = [np.subtract(*_reach(shape.level, model.method.forecast.reach)[::-1]) for shape in (evidence.shape, raw)]
    gain, config = float(spans[0] / max(spans[1], 1e-12)), model.method.findings
    times = max(gain, 1 / gain)
    if evidence.knowledge.is_placed:
        return Finding(reason("stretched", gain=gain)) if times > config.stretch else None
    if times <= config.said_stretch:
        return None
    best = Verdict.RETEST if times > config.blind_stretch else Verdict.CONDITIONAL
    return Finding(reason("stretched", gain=gain), best)


def _misread(model: SourceModel, evidence: MapEvidence) -> Finding | None:
    """Return a finding where the unit reads other loads than the source did at equal stage histories, for long."""
    # Where unit and source were pressed by one load at once, equal positions say nothing more.
    slow = evidence.budget.get("slow", 0.0) if "slow" in evidence.knowledge.sensitivity else 0.0
    if slow <= model.method.findings.misread_factor * model.held_out_rmse:
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
    if explained > config.drift_explained:
        return Finding(reason("drift", moved=float(trend * (t_s[-1] - t_s[0])), unit=unit))
    # Slow holds at low loads count as rest too, and recordings hold more or fewer of them.
    at_rest = rest_rows(model, model.estimate, model.shape)
    if spread < config.creep_factor * float(np.std(model.estimate[at_rest])):
        return None
    return Finding(reason("creep", spread=spread, unit=unit))


def _reversed(model: SourceModel, target: OutputRecording) -> Finding | None:
    """Return a finding where the output moves against the source's direction."""
    source, config = model.source.unlabelled, model.method.findings
    if target.stage_mm is None or source.stage_mm is None:
        unit_sign, source_sign = (_lean(recording, config) for recording in (target, source))
    else:
        unit_sign = _along_stage(target)
        source_sign = _along_stage(source)
    is_sure = min(abs(unit_sign), abs(source_sign)) > config.lean
    if not is_sure or unit_sign * source_sign > 0:
        return None
    return Finding(reason("reversed"), Verdict.FAIL)


@lru_cache(maxsize=KEPT)
def _along_stage(recording: OutputRecording) -> float:
    """Return the correlation of output and stage position."""
    return float(np.corrcoef(recording.output, recording.stage_mm)[0, 1])


@lru_cache(maxsize=KEPT)
def _lean(recording: OutputRecording, config: FindingConfig) -> float:
    """Return the robust skewness (Bowley 1901, with 2 % tails): positive where the unit rests low and peaks high."""
    lower, upper = config.lean_tails
    low, middle, high = np.quantile(recording.output, (lower, 0.5, upper))
    return float((high + low - 2 * middle) / (high - low))


def _not_better(model: SourceModel, evidence: MapEvidence) -> Finding | None:
    """Return a finding where the map may be worse than doing nothing.

    It corrects less than it is uncertain by; or, where no position speaks for it, it makes the unit hardly more like
    the source than it was. A map that changes next to nothing does no harm either way.
    """
    config, unit = model.method.findings, model.network.reference_unit
    doubt, correction = float(np.sqrt(map_variance(evidence.budget, evidence.knowledge))), evidence.correction_rms
    harmless = config.blind_correction * evidence.budget["model"]
    is_blind = not evidence.knowledge.is_placed and correction > harmless
    gained = evidence.overlap - evidence.unmapped_overlap
    if doubt > max(correction, harmless):
        why = reason("part.uncertain", doubt=doubt, unit=unit)
    elif is_blind and gained < config.overlap_gain:
        why = reason("part.no_nearer", gained=gained)
    else:
        return None
    return Finding(reason("not_better", correction=correction, unit=unit, why=why))
