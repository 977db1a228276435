"""Calibrate one unit: from its recording to map, interval, forecast and decision. The only place where that is done.

The line, a batch, its workers, a watched folder and the screens all call `calibrate`, and all know a calibration again
by `input_sha256`. No fit sees a reference of the unit; an audit decides, and fits nothing.
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property

import numpy as np

from softcal.core.errors import InputError, UnitRefused
from softcal.core.identity import content_sha256
from softcal.core.maps.affine_map import IDENTITY, LABEL_SHIFT
from softcal.core.maps.choose import ChosenMap, choose_map, fit_family
from softcal.core.maps.interface import Anchors, FitProblem, UnitMap
from softcal.core.maps.monotone import BETWEEN
from softcal.core.maps.paired import PHASE, SYNCHRONOUS, fit_pairs
from softcal.core.maps.readout_lag import ReadoutLag, find_readout_lag
from softcal.core.maps.synchrony import paired_rows
from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.unit.audit_reading import line_of, output_level
from softcal.core.unit.audited import with_audit
from softcal.core.unit.bridge import Bridge
from softcal.core.unit.budget import Reference
from softcal.core.unit.calibration import (
    OUTPUT_REST,
    OUTPUT_SPAN,
    Calibration,
)
from softcal.core.unit.estimate import estimate
from softcal.core.unit.findings import contradictions, map_findings, opening_findings
from softcal.core.unit.forecast import (
    MapEvidence,
    Trial,
    forecast_error,
    gather_evidence,
    load_levels,
    rms,
    variance_table,
)
from softcal.core.unit.health import OutputLimits, check_alive, health_findings, output_limits
from softcal.core.unit.judging import UNREADABLE, Grounds, MeasuredError, limit_evidence
from softcal.core.unit.line_spread import LineSpread, line_reason
from softcal.core.unit.method import Method
from softcal.core.unit.own_forecast import forecast_own, own_terms
from softcal.core.unit.rules import RuleFacts, rule_findings, rules_in_force
from softcal.core.unit.scoring import Scores, score_map
from softcal.core.unit.source_model import SourceModel
from softcal.core.unit.uncertainty import ErrorForecast
from softcal.core.unit.verdict import Finding, Limit, default_limit
from softcal.core.windows import TAPS
from softcal.core.words.reason import Reason, reason


@dataclass(frozen=True, eq=False)
class UnitProblem:
    """All that the calibration of one unit starts from.

    Args:
        source: what `make_source_model` made of the lot's source with the method in force.
        limit: tolerance limit of the lot; None derives one from the source's own error and says so.
        anchors: known loads of the unit, where someone took them.
        audit: labelled recording of the unit, which decides and fits nothing; None where there is none.
        own: how the unit's own calibration is trained on its audit, for comparison; None trains none.
        line: how differently the line presses units, where somebody stated it.
        reference: what the source was compared with; None where nobody said, and nothing is traced to it.
        bridge: the source unit pressed again in the sitting of this unit, where somebody did.
        beside: networks of the lot's other sources, which the unit was compared with (`sources.py`).
        rules: identities of the rules of other packages that may hold the unit back; those installed here by default.
        unread_audit: why a file that was brought as its audit cannot be read; "" where none was or it can.
    """

    source: SourceModel
    recording: OutputRecording
    limit: Limit | None = None
    anchors: Anchors | None = None
    audit: LabelledRecording | None = None
    own: NetworkConfig | None = None
    line: LineSpread | None = None
    reference: Reference | None = None
    bridge: Bridge | None = None
    beside: tuple[str, ...] = ()
    rules: tuple[str, ...] = field(default_factory=rules_in_force)
    unread_audit: str = ""

    @cached_property
    def input_sha256(self) -> str:
        """Identity of the calibration this problem leads to."""
        return input_sha256(self, self.source.method)


def input_sha256(facts: UnitProblem, method: Method) -> str:
    """Return the content hash of everything a calibration depends on: equal input, equal result.

    Args:
        method: every number of the calibration.
    """
    anchors, audit = facts.anchors, facts.audit
    settings: dict[str, object] = {
        "recording": facts.recording.sha256,
        "network": facts.source.network.id,
        "method": method.id,
        "limit": None if facts.limit is None else facts.limit.to_json(),
        "anchors": None if anchors is None else [anchors.output.tolist(), anchors.reference.tolist()],
        "audit": None if audit is None else audit.sha256,
        # Without an audit no own calibration is trained, whatever was asked.
        "own": None if audit is None or facts.own is None else asdict(facts.own),
        **({} if facts.line is None else {"line": facts.line.to_json()}),
    }
    if facts.bridge is not None:
        settings["golden"] = facts.bridge.sha256
    if facts.reference is not None:
        settings["reference"] = facts.reference.to_json()
    if facts.beside:
        settings["beside"] = sorted(facts.beside)
    if facts.unread_audit:
        settings["unread_audit"] = facts.unread_audit
    if facts.rules:
        settings["rules"] = sorted(facts.rules)
    return content_sha256({}, settings)


def calibrate(problem: UnitProblem, on_map: Callable[[], None] | None = None) -> Calibration:
    """Fit the unit's map, say how far it can be trusted, and decide.

    Args:
        problem: the unit with its lot's source; the method is the one its source model was made with.
        on_map: told once the map and its forecast are there, before an audit is scored: that may train a network.

    Raises:
        UnitRefused: the recording allows no map at all; the reason says why and what to do.
        InputError: the limit is stated in another unit than the reference, or a rule is not installed here.
    """
    model, target = problem.source, problem.recording
    limit = _limit(problem)
    method = model.method
    known = model.source.unlabelled
    check_alive(target, known, method.health)
    limits = output_limits(target, known, is_rising=model.interval.slope_limit > 0, config=method.health)
    fit = _fit_problem(problem)
    chosen = choose_map(fit)
    evidence = _evidence(problem, fit, chosen, limits)
    forecast = forecast_error(evidence.budget, evidence.knowledge)
    lag = find_readout_lag(fit.source.unlabelled, target, fit.synchrony, method.map)
    findings = contradictions(known, target, limits, method, fit.synchrony) or (
        *health_findings(target, known, limits, method.health),
        *map_findings(model, target, evidence, lag),
        *(opening_findings(chosen.evidence, method.findings) if lag is None else ()),
    )
    if on_map is not None:
        on_map()
    scores = None if problem.audit is None else _scores(problem, chosen.unit_map, problem.audit)
    grounds = Grounds(
        forecast,
        findings,
        _held(problem, evidence, forecast, limit, scores),
        told=(*_bridge_reason(problem, fit), _line_reason(problem, evidence)),
        measured=None if scores is None or problem.audit is None else MeasuredError(scores, len(problem.audit.windows)),
        bars=_bars(problem),
        rules=problem.rules,
    )
    calibration = Calibration(
        serial=target.serial,
        network_id=model.network.id,
        unit_map=chosen.unit_map,
        interval=model.interval.widened(variance_table(model, evidence) + _reference_variance(problem)),
        output_limits=limits,
        forecast=forecast,
        decision=grounds.decide(limit, method.decision),
        grounds=grounds,
        knowledge=evidence.knowledge,
        evidence=_numbers(model, target, chosen, evidence, limit, findings, lag),
        method=method,
        scores=scores,
        reference=problem.reference,
    )
    return calibration if problem.audit is None else with_audit(model.network, calibration, problem.audit, target)


def _fit_problem(problem: UnitProblem) -> FitProblem:
    """Return what the map is fitted to: the golden run where the unit shares its loads in time, else the source."""
    model, bridge = problem.source, problem.bridge
    direct = FitProblem(model.source, model.network, problem.recording, problem.anchors, model.method.map)
    if bridge is None:
        return direct
    bridged = replace(direct, source=bridge.golden)
    return bridged if bridged.synchrony.is_synchronous else direct


def _crossed(problem: UnitProblem, fit: FitProblem) -> Bridge | None:
    """Return the bridge that the map was fitted over; None where it was fitted to the source's recording."""
    bridge = problem.bridge
    return bridge if bridge is not None and fit.source is bridge.golden else None


def _bridge_reason(problem: UnitProblem, fit: FitProblem) -> tuple[Reason, ...]:
    if problem.bridge is None:
        return ()
    bridge = _crossed(problem, fit)
    if bridge is None:
        missed = replace(fit, source=problem.bridge.golden).synchrony
        return (reason("bridge.unused", correlation=missed.rank_correlation),)
    if not bridge.is_measured:
        return (reason("bridge.read"),)
    return (reason("bridge.measured", day=bridge.day_rmse, unit=bridge.golden.reference_unit),)


def _bars(problem: UnitProblem) -> tuple[Reason, ...]:
    highest = float(problem.source.source.reference.max())
    barred = () if problem.reference is None else problem.reference.bars(highest)
    unread = (reason(UNREADABLE, error=problem.unread_audit),) if problem.unread_audit else ()
    return (*unread, *barred)


def _reference_variance(problem: UnitProblem) -> Array:
    reference, loads = problem.reference, load_levels(problem.source)
    return np.zeros_like(loads) if reference is None else reference.variance(loads)


def read_gain(network: Network, calibration: Calibration, recording: LabelledRecording) -> float:
    """Return the slope of a unit's estimates over the reference: 1 where it reads its loads in full."""
    return line_of(estimate(network, calibration, recording.unlabelled).estimate, recording.reference)[0]


def _limit(problem: UnitProblem) -> Limit:
    model = problem.source
    unit = model.source.reference_unit
    limit = problem.limit or default_limit(unit, model.held_out_rmse, model.method.decision)
    if limit.unit != unit:
        raise InputError(f"limit is in {limit.unit}, the reference in {unit}; state it in that")
    if problem.reference is None:
        return limit
    factor = model.method.decision.coverage_factor
    return replace(limit, reference_expanded=problem.reference.expanded(rms(model.source.reference), factor))


def _held(
    problem: UnitProblem, evidence: MapEvidence, forecast: ErrorForecast, limit: Limit, scores: Scores | None
) -> tuple[Finding, ...]:
    """Return what rules of other packages have against the unit."""
    measured = None if scores is None else scores.after
    facts = RuleFacts(problem.recording, problem.source.source, evidence.estimate, forecast, limit, measured)
    return rule_findings(problem.rules, facts)


def _scores(problem: UnitProblem, unit_map: UnitMap, audit: LabelledRecording) -> Scores:
    return score_map(problem.source.network, unit_map, audit, problem.own, problem.source.method.decision)


def _line_reason(problem: UnitProblem, evidence: MapEvidence) -> Reason:
    """Return what the line adds that no recording shows."""
    config = problem.source.method.line
    share = (problem.line or LineSpread(config.load_spread, config.day_spread)).share
    return line_reason(share, evidence.load_rms, problem.source.source.reference_unit, problem.line is not None)


def _evidence(problem: UnitProblem, fit: FitProblem, chosen: ChosenMap, limits: OutputLimits) -> MapEvidence:
    """Look at the unit through its map, the maps it might have had, and maps fitted without a part of it."""
    trials = _trials(problem, fit, chosen)
    bridge = _crossed(problem, fit)
    # Where the stage position or a common load is known, that tells more than leaving shares out.
    is_measured = bool(trials) or chosen.family == PHASE
    return gather_evidence(
        problem.source,
        problem.recording,
        chosen.unit_map,
        alternatives=[other for name, other in chosen.alternatives.items() if name != IDENTITY],
        resampled=[] if is_measured else _refitted(fit, chosen, problem.source.method),
        limits=limits,
        trials=trials,
        gain_error=_gain_error(chosen, problem.source.method),
        is_anchored=problem.anchors is not None,
        line=problem.line,
        day_rmse=0.0 if bridge is None else bridge.day_rmse,
        straight=chosen.alternatives.get(LABEL_SHIFT) if chosen.family == BETWEEN else None,
    )


def _gain_error(chosen: ChosenMap, method: Method) -> float:
    """Return the standard error of log gain; a gain far from the source's is a doubt unless loads were given."""
    error, gain = float(chosen.evidence.get("gain_error", 0.0)), float(chosen.evidence.get("gain", 1.0))
    far = abs(float(np.log(gain)))
    is_doubtful = "anchor_gain" not in chosen.evidence and far > np.log(method.findings.said_stretch)
    return float(np.hypot(error, far)) if is_doubtful else error


def _trials(problem: UnitProblem, fit: FitProblem, chosen: ChosenMap) -> list[Trial]:
    """Return maps with the windows under one load at once to judge them by, where the map rests on such windows.

    An opening holds few presses, which the map has been bent to: there, each map has not seen the windows it is
    judged by.
    """
    if chosen.family != SYNCHRONOUS:
        return []
    source_rows, target_rows = paired_rows(fit.source.unlabelled, fit.target, fit.synchrony, fit.config.synchrony)
    bridge = _crossed(problem, fit)
    floor = 0.0 if bridge is None else bridge.floor
    if not np.isfinite(fit.synchrony.until_s):
        return [Trial(chosen.unit_map, fit.source, source_rows, target_rows, floor)]
    parts = problem.source.method.forecast.opening_parts
    part = np.arange(len(target_rows)) * parts // len(target_rows)
    trials = []
    for held in (part == k for k in range(parts)):
        unit_map = fit_pairs(fit, source_rows[~held], target_rows[~held], SYNCHRONOUS)
        trials.append(Trial(unit_map, fit.source, source_rows[held], target_rows[held], floor))
    return trials


def _refitted(fit: FitProblem, chosen: ChosenMap, method: Method) -> list[UnitMap]:
    """Fit the chosen family again with one share of the recording left out at a time."""
    config, refits = method.forecast, []
    for part in range(config.parts):
        target = _without_share(fit.target, part, config.parts, config.stretches)
        try:
            refits.append(fit_family(replace(fit, target=target), chosen.family))
        except UnitRefused:
            continue
    return refits


def _without_share(target: OutputRecording, part: int, parts: int, stretches: int) -> OutputRecording:
    """Leave out every parts-th of many stretches, so that what is left still covers the whole programme."""
    length = max(len(target) // (parts * stretches), TAPS)
    keep = (np.arange(len(target)) // length) % parts != part
    stage_mm = None if target.stage_mm is None else target.stage_mm[keep]
    return replace(target, t_s=target.t_s[keep], output=target.output[keep], stage_mm=stage_mm)


def _numbers(
    model: SourceModel,
    target: OutputRecording,
    chosen: ChosenMap,
    evidence: MapEvidence,
    limit: Limit,
    findings: tuple[Finding, ...],
    lag: ReadoutLag | None,
) -> Mapping[str, float | str | None]:
    own = own_terms(model, target, chosen.unit_map, evidence)
    rest = model.method.decision.audit_rest
    level = output_level(target, is_rising=model.interval.slope_limit > 0, rest=rest)
    return {
        **{f"map_{name}": value for name, value in chosen.evidence.items()},
        **{f"u_{name}": value for name, value in evidence.budget.items()},
        "correction_rms": evidence.correction_rms,
        "load_rms": evidence.load_rms,
        OUTPUT_REST: level.rest,
        OUTPUT_SPAN: level.span,
        **limit_evidence(limit),
        "findings": ", ".join(finding.kind for finding in findings),
        **({} if lag is None else {"readout_lag_s": lag.time_constant_s}),
        **{f"own_{name}": value for name, value in own.items()},
        "own_rmse_forecast": forecast_own(own, evidence.knowledge),
    }
