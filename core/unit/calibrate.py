"""Calibrate one unit: from its recording to map, interval, forecast and decision. The only place where that is done.

The line, a batch, its workers, a watched folder and the screens all call `calibrate`. All know a calibration again
by the `input_sha256` of its problem. No fit sees a reference of the unit; an audit decides, and fits nothing.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from softcal.core.errors import UnitRefused
from softcal.core.maps.choose import choose_map
from softcal.core.maps.interface import map_sha256
from softcal.core.maps.monotone import shape_distance
from softcal.core.maps.readout_lag import find_readout_lag
from softcal.core.recording import Array
from softcal.core.unit.audit import measure
from softcal.core.unit.evidence import gather_evidence, other_maps
from softcal.core.unit.findings import contradictions, map_findings, opening_findings
from softcal.core.unit.fit import Fit, FittedMap
from softcal.core.unit.forecast import forecast_error, variance_table
from softcal.core.unit.health import check_alive, health_findings, output_limits
from softcal.core.unit.missing import check_windows, jump_findings, missing_findings, missing_samples
from softcal.core.unit.output_level import output_level
from softcal.core.unit.rules import RuleInput, rule_findings
from softcal.core.unit.state import UnitState
from softcal.core.unit.unit_problem import UnitProblem


def calibrate(problem: UnitProblem, on_map: Callable[[], None] | None = None) -> UnitState:
    """Fit the unit's map, forecast its error, and measure it where there is an audit.

    Args:
        problem: the unit with its lot's source; the method is the one its source model was made with.
        on_map: called once the map and its forecast are there, before an audit is scored: that may train a network.

    Raises:
        UnitRefused: the recording allows no map at all; the reason says why and what to do.
        InputError: the limit is stated in another unit than the reference, or a rule is not installed here.
    """
    limit, audit, network = problem.limit_in_force, problem.audit, problem.source.network
    fit, estimates = fit_unit(problem)
    state = UnitState(fit=fit, limit=limit, unreadable_audit=problem.unreadable_audit)
    if on_map is not None:
        on_map()
    if audit is not None:
        state = measure(network, state, audit, problem.recording, problem.own_calibration)
    return _with_rules(problem, state, estimates)


def fit_unit(problem: UnitProblem) -> tuple[Fit, Array]:
    """Fit the unit's map and forecast its error; return beside it f on evenly spaced mapped windows.

    Raises:
        UnitRefused: the recording allows no map at all.
    """
    model, target = problem.source, problem.recording
    method, source_recording = model.method, model.source.unlabelled
    check_windows(target, method.inspection)
    check_alive(target, source_recording, method.health)
    limits = output_limits(target, source_recording, is_rising=model.interval.slope_limit > 0, method=method)
    fit, correction = problem.fit, problem.applied_day_correction
    lot_map = problem.lot_map
    chosen = choose_map(fit) if lot_map is None else lot_map.chosen
    # How a unit was pressed is read across a few lost samples; no fit sees what stands for them.
    target_recording = target.bridged
    evidence = gather_evidence(
        model,
        target_recording,
        chosen.unit_map,
        limits,
        other_maps(fit, chosen, method, reference_rmse=0.0 if correction is None else correction.reference_rmse),
        is_anchored=problem.anchors is not None,
        line_share=problem.line_share,
        day_rmse=0.0 if correction is None else correction.day_rmse,
        lot_fit=None if lot_map is None else lot_map.part,
    )
    lag = find_readout_lag(fit.source.unlabelled, target, fit.synchrony, method.map)
    # What a logger did comes first: the rest may be a consequence.
    findings = missing_findings(target, method) + jump_findings(target, method.inspection)
    if all(finding.best.is_open for finding in findings):
        findings += contradictions(source_recording, target, limits, method, fit.synchrony) or (
            *health_findings(target, source_recording, limits, method),
            *map_findings(model, target_recording, evidence, lag),
            *(opening_findings(chosen.evidence, method.findings) if lag is None else ()),
        )
    rest = method.map.crossing.robust_range[0]
    interval = model.interval.widened(variance_table(model, evidence) + problem.reference_variance())
    fitted = Fit(
        id=problem.fit_id,
        serial=target.serial,
        network_id=model.network.id,
        recording_sha256=target.sha256,
        family=chosen.unit_map.family,
        map_sha256=map_sha256(chosen.unit_map),
        method=method,
        correspondence=evidence.correspondence,
        forecast=forecast_error(evidence.budget, evidence.correspondence),
        budget=evidence.budget,
        diagnostics=chosen.evidence,
        findings=findings,
        remarks=(
            *problem.lot_fit_reasons(),
            *problem.day_correction_reasons(),
            *problem.line_reasons(evidence.load_rms),
        ),
        blocking_reasons=problem.blocking_reasons(),
        rules=problem.rules,
        reference=problem.reference,
        output_level=output_level(target, is_rising=model.interval.slope_limit > 0, rest=rest),
        missing=missing_samples(target, method.inspection).shares,
        load_rms=evidence.load_rms,
        correction_rms=evidence.correction_rms,
        lot_fit=None if lot_map is None else lot_map.part,
        readout_lag_s=None if lag is None else lag.time_constant_s,
        fitted=FittedMap(chosen.unit_map, interval, limits),
    )
    return fitted, evidence.estimate


def _with_rules(problem: UnitProblem, state: UnitState, estimates: Array) -> UnitState:
    """Return the state with what rules of other packages have against the unit."""
    if not problem.rules:
        return state
    measured = None if state.scores is None else state.scores.after.rmse
    source, fit = problem.source.source, state.fit
    inputs = RuleInput(problem.recording, source, estimates, fit.forecast, state.limit, measured)
    return replace(state, fit=replace(fit, rule_findings=rule_findings(problem.rules, inputs)))


def nearest(problems: Sequence[UnitProblem]) -> UnitProblem:
    """Choose the source of one unit of a lot with several, by evidence that needs no label of it.

    Where pairs with a source are to be had, at equal time or stage position, the forecast says which source reads the
    unit best. Where nothing is shared, a forecast is a guess: there the source is taken that the unit's output is bent
    most like.

    Args:
        problems: the unit with each source, in the order of the lot; every one names the others in `other_networks`.

    Returns:
        The problem to calibrate; the first where no source allows a map, so that its reason is told.
    """
    ranked = []
    for index, problem in enumerate(problems):
        try:
            fit, _ = fit_unit(problem)
            if fit.correspondence.is_matched:
                ranked.append((0, fit.forecast.rmse, index))
            else:
                source, config = problem.source.source, problem.source.method.map
                ranked.append((1, shape_distance(source, problem.recording, config), index))
        except UnitRefused:
            continue
    return problems[min(ranked)[-1]] if ranked else problems[0]
