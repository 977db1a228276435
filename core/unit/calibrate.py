"""Calibrate one unit: from its recording to map, interval, forecast and decision. The only place where that is done.

The line, a batch, its workers, a watched folder and the screens all call `calibrate`. All know a calibration again
by the `input_sha256` of its problem. No fit sees a reference of the unit; an audit decides, and fits nothing.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from softcal.core.errors import UnitRefused
from softcal.core.maps.choose import ChosenMap, choose_map
from softcal.core.maps.monotone import shape_distance
from softcal.core.maps.readout_lag import ReadoutLag, find_readout_lag
from softcal.core.unit.audit_reading import output_level
from softcal.core.unit.audited import with_audit
from softcal.core.unit.calibration import OUTPUT_REST, OUTPUT_SPAN, Calibration
from softcal.core.unit.evidence import MapEvidence, gather_evidence, other_maps
from softcal.core.unit.findings import contradictions, map_findings, opening_findings
from softcal.core.unit.forecast import forecast_error, forecast_own, own_terms, variance_table
from softcal.core.unit.health import check_alive, health_findings, output_limits
from softcal.core.unit.judging import Grounds, limit_evidence
from softcal.core.unit.missing import check_windows, jump_findings, missing_findings, missing_samples
from softcal.core.unit.rules import RuleFacts, rule_findings
from softcal.core.unit.scoring import score_map
from softcal.core.unit.unit_problem import UnitProblem
from softcal.core.unit.verdict import Finding


def calibrate(problem: UnitProblem, on_map: Callable[[], None] | None = None) -> Calibration:
    """Fit the unit's map, say how far it can be trusted, and decide.

    Args:
        problem: the unit with its lot's source; the method is the one its source model was made with.
        on_map: told once the map and its forecast are there, before an audit is scored: that may train a network.

    Raises:
        UnitRefused: the recording allows no map at all; the reason says why and what to do.
        InputError: the limit is stated in another unit than the reference, or a rule is not installed here.
    """
    model, target, limit, audit = problem.source, problem.recording, problem.limit_in_force, problem.audit
    method, known = model.method, model.source.unlabelled
    check_windows(target, method.inspection)
    check_alive(target, known, method.health)
    limits = output_limits(target, known, is_rising=model.interval.slope_limit > 0, config=method.health)
    fit, bridge = problem.fit, problem.crossed
    chosen = choose_map(fit)
    evidence = gather_evidence(
        model,
        target,
        chosen.unit_map,
        limits,
        other_maps(fit, chosen, method, floor=0.0 if bridge is None else bridge.floor),
        is_anchored=problem.anchors is not None,
        line=problem.line,
        day_rmse=0.0 if bridge is None else bridge.day_rmse,
    )
    forecast = forecast_error(evidence.budget, evidence.knowledge)
    lag = find_readout_lag(fit.source.unlabelled, target, fit.synchrony, method.map)
    # What a logger did comes first: the rest may be a consequence.
    findings = missing_findings(target, method) + jump_findings(target, method.inspection)
    if all(finding.best.is_open for finding in findings):
        findings += contradictions(known, target, limits, method, fit.synchrony) or (
            *health_findings(target, known, limits, method.health),
            *map_findings(model, target, evidence, lag),
            *(opening_findings(chosen.evidence, method.findings) if lag is None else ()),
        )
    if on_map is not None:
        on_map()
    scores = None if audit is None else score_map(model.network, chosen.unit_map, audit, problem.own, method.decision)
    measured_rmse = None if scores is None else scores.after.rmse
    grounds = Grounds(
        forecast,
        findings,
        # What rules of other packages have against the unit.
        rule_findings(
            problem.rules, RuleFacts(target, model.source, evidence.estimate, forecast, limit, measured_rmse)
        ),
        told=(*problem.bridge_reasons(), problem.line_reason(evidence.load_rms)),
        measured=scores,
        bars=problem.bars(),
        rules=problem.rules,
    )
    calibration = Calibration(
        serial=target.serial,
        network_id=model.network.id,
        unit_map=chosen.unit_map,
        interval=model.interval.widened(variance_table(model, evidence) + problem.reference_variance()),
        output_limits=limits,
        forecast=forecast,
        decision=grounds.decide(limit),
        grounds=grounds,
        knowledge=evidence.knowledge,
        evidence=_numbers(problem, chosen, evidence, findings, lag),
        method=method,
        reference=problem.reference,
    )
    return calibration if audit is None else with_audit(model.network, calibration, audit, target)


def _numbers(
    problem: UnitProblem,
    chosen: ChosenMap,
    evidence: MapEvidence,
    findings: tuple[Finding, ...],
    lag: ReadoutLag | None,
) -> Mapping[str, float | str | None]:
    model, target = problem.source, problem.recording
    own = own_terms(model, target, chosen.unit_map, evidence)
    rest = model.method.map.crossing.robust_range[0]
    level = output_level(target, is_rising=model.interval.slope_limit > 0, rest=rest)
    return {
        **{f"map_{name}": value for name, value in chosen.evidence.items()},
        **{f"u_{name}": value for name, value in evidence.budget.items()},
        "correction_rms": evidence.correction_rms,
        "load_rms": evidence.load_rms,
        OUTPUT_REST: level.rest,
        OUTPUT_SPAN: level.span,
        **missing_samples(target, problem.source.method.inspection).to_evidence(),
        **limit_evidence(problem.limit_in_force),
        "findings": ", ".join(finding.kind for finding in findings),
        **({} if lag is None else {"readout_lag_s": lag.time_constant_s}),
        **{f"own_{name}": value for name, value in own.items()},
        "own_rmse_forecast": forecast_own(own, evidence.knowledge),
    }


def nearest(problems: Sequence[UnitProblem]) -> UnitProblem:
    """Choose the source of one unit of a lot with several, by evidence that needs no label of it.

    Where pairs with a source are to be had, at equal time or stage position, the forecast says which source reads the
    unit best. Where nothing is shared, a forecast is a guess: there the source is taken that the unit's output is bent
    most like.

    Args:
        problems: the unit with each source, in the order of the lot; every one names the others in `beside`.

    Returns:
        The problem to calibrate; the first where no source allows a map, so that its reason is told.
    """
    ranked = []
    for place, problem in enumerate(problems):
        try:
            made = calibrate(replace(problem, audit=None, own=None))
            if made.forecast is not None and made.knowledge.is_placed:
                ranked.append((0, made.forecast.rmse, place))
            else:
                known, config = problem.source.source, problem.source.method.map
                ranked.append((1, shape_distance(known, problem.recording, config), place))
        except UnitRefused:
            continue
    return problems[min(ranked)[-1]] if ranked else problems[0]
