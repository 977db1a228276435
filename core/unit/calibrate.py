"""One unit from its recording to map, interval, forecast error and verdict. No reference of the unit is ever seen."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from softcal.core.errors import InputError, UnitRefused
from softcal.core.maps.affine import Identity
from softcal.core.maps.choose import ChosenMap, MapConfig, choose_map
from softcal.core.maps.interface import FitProblem, UnitMap
from softcal.core.maps.paired import fit_pairs
from softcal.core.maps.phase import Phase
from softcal.core.maps.synchronous import Synchronous
from softcal.core.maps.synchrony import paired_rows
from softcal.core.recording import OutputRecording
from softcal.core.unit.calibration import Calibration
from softcal.core.unit.findings import map_findings, opening_findings
from softcal.core.unit.forecast import MapEvidence, Trial, forecast_error, gather_evidence, variance_table
from softcal.core.unit.health import check_alive, health_findings, output_limits
from softcal.core.unit.own_forecast import forecast_own, own_terms
from softcal.core.unit.source_model import SourceModel, make_source_model
from softcal.core.unit.verdict import Limit, decide, default_limit
from softcal.core.windows import TAPS

OPENING_PARTS = 4
"""Parts of an opening, each left out once."""

STRETCHES = 4
"""Stretches of the recording per left-out share."""


@dataclass(frozen=True)
class CalibrationConfig:
    """How a unit is calibrated; one configuration for every sensor and data set.

    Args:
        map: how the map is chosen.
        parts: shares of the recording left out in turn while the chosen family is fitted again: how firm it stands.
            Not done where the stage position or a common load is known, which tells more.
    """

    map: MapConfig = field(default_factory=MapConfig)
    parts: int = 3


def calibrate_unit(
    problem: FitProblem,
    limit: Limit | None = None,
    config: CalibrationConfig = CalibrationConfig(),  # noqa: B008 - frozen
    source_model: SourceModel | None = None,
) -> Calibration:
    """Fit the unit's map and say how far it can be trusted.

    Args:
        problem: source, network and the unit's unlabelled recording.
        limit: tolerance limit of the lot; None derives one from the source's own error and says so.
        config: method parameters.
        source_model: what `make_source_model` made of the same source; made here when None. Make it once per lot.

    Raises:
        UnitRefused: the recording allows no map at all; the message says why and what to do.
        InputError: the limit is stated in another unit than the reference.
    """
    model = source_model or make_source_model(problem.source, problem.network)
    limit = limit or default_limit(problem.source.reference_unit, model.held_out_rmse)
    if limit.unit != problem.source.reference_unit:
        raise InputError(
            f"limit is in {limit.unit}, the reference in {problem.source.reference_unit}; state it in that"
        )
    target, source = problem.target, problem.source.unlabelled
    check_alive(target, source)
    limits = output_limits(target, source, is_rising=model.interval.slope_limit > 0)
    chosen = choose_map(problem, config.map)
    trials = _trials(problem, chosen)
    is_measured = bool(trials) or chosen.family == Phase.name
    refitted = [] if is_measured else _refitted(problem, chosen, config.parts)
    gain_error = float(chosen.evidence.get("gain_error", 0.0))
    evidence = gather_evidence(model, target, chosen.unit_map, _rivals(chosen), refitted, limits, trials, gain_error)
    forecast = forecast_error(evidence.budget)
    own = own_terms(model, target, chosen.unit_map, evidence.budget)
    findings = (
        *health_findings(target, source, limits),
        *map_findings(model, target, evidence),
        *opening_findings(chosen.evidence),
    )
    return Calibration(
        serial=target.serial,
        network_id=problem.network.id,
        unit_map=chosen.unit_map,
        interval=model.interval.widened(variance_table(model, evidence)),
        output_limits=limits,
        forecast=forecast,
        verdict=decide(forecast, limit, findings),
        evidence={
            **_numbers(evidence, chosen, limit, tuple(f.kind for f in findings)),
            **{f"own_{name}": value for name, value in own.items()},
            "own_rmse_forecast": forecast_own(own, evidence.budget),
        },
        config=asdict(config),
    )


def _trials(problem: FitProblem, chosen: ChosenMap) -> list[Trial]:
    """Return maps with the windows under one load at once to judge them by, where the map rests on such windows.

    An opening holds few presses, which the map has been bent to: there, each map has not seen the windows it is
    judged by.
    """
    if chosen.family != Synchronous.name:
        return []
    synchrony = problem.synchrony
    source_rows, target_rows = paired_rows(problem.source.unlabelled, problem.target, synchrony)
    if not np.isfinite(synchrony.until_s):
        return [Trial(chosen.unit_map, source_rows, target_rows)]
    part = np.arange(len(target_rows)) * OPENING_PARTS // len(target_rows)
    trials = []
    for held in (part == k for k in range(OPENING_PARTS)):
        unit_map = fit_pairs(problem, source_rows[~held], target_rows[~held], Synchronous.name)
        trials.append(Trial(unit_map, source_rows[held], target_rows[held]))
    return trials


def _rivals(chosen: ChosenMap) -> list[UnitMap]:
    return [other for name, other in chosen.alternatives.items() if name != Identity.name]


def _refitted(problem: FitProblem, chosen: ChosenMap, parts: int) -> list[UnitMap]:
    """Fit the chosen family again with one share of the recording left out at a time."""
    refits = []
    for part in range(parts):
        target = _without_share(problem.target, part, parts)
        try:
            refits.append(choose_map(replace(problem, target=target), MapConfig(chosen.family)).unit_map)
        except UnitRefused:
            continue
    return refits


def _without_share(target: OutputRecording, part: int, parts: int) -> OutputRecording:
    """Leave out every parts-th of many stretches, so that what is left still covers the whole programme."""
    length = max(len(target) // (parts * STRETCHES), TAPS)
    keep = (np.arange(len(target)) // length) % parts != part
    stage_mm = None if target.stage_mm is None else target.stage_mm[keep]
    return replace(target, t_s=target.t_s[keep], output=target.output[keep], stage_mm=stage_mm)


def _numbers(
    evidence: MapEvidence, chosen: ChosenMap, limit: Limit, kinds: tuple[str, ...]
) -> Mapping[str, float | str | None]:
    return {
        **{f"map_{name}": value for name, value in chosen.evidence.items()},
        **{f"u_{name}": value for name, value in evidence.budget.items()},
        "correction_rms": evidence.correction_rms,
        "limit_rmse": limit.maximum_rmse,
        "limit_origin": limit.origin,
        "findings": ", ".join(kinds),
    }
