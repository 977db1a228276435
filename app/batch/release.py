"""Release the unmeasured units of a lot on its audits: read from the registry, decided, kept as revisions."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np

from softcal.app.batch.audit import lot_audit, lot_limit
from softcal.core.errors import InputError
from softcal.core.estimate import estimate
from softcal.core.identity import content_sha256
from softcal.core.quality.conformal import pooled_scale
from softcal.core.quality.lot_release import LotRelease, release_lot
from softcal.core.quality.qualification import PastAudit, Qualification, QualificationRules, qualify
from softcal.core.quality.release import AuditedUnit
from softcal.core.recording import Array, LabelledRecording
from softcal.core.unit.calibration import Calibration, CalibrationRecord
from softcal.core.unit.uncertainty import ErrorForecast
from softcal.core.unit.verdict import Verdict
from softcal.db.entries import MadeCalibration, StoredCalibration, UnitEntry
from softcal.db.registry import Registry

STATEMENT = "lot_release"
WHY = "decided on the audits of the lot"
RELEASABLE = (Verdict.PASS, Verdict.CONDITIONAL)
RULES = QualificationRules()
MOST_AUDITS = 40
"""Audited units whose recordings are read for the scale of the intervals."""


def update_release(
    registry: Registry, lot_id: str, actor: str | None = None, only: str | None = None, now: datetime | None = None
) -> LotRelease | None:
    """Decide on the unmeasured units of a lot, and keep what changed.

    Args:
        only: keep the decision on this unit alone, as the line does that has just pressed it.
        now: the time of the decision.

    Returns:
        None where the lot has no unit with a forecast yet.

    Raises:
        InputError: two audits are one recording; nothing was released.
    """
    decided = decide_release(registry, lot_id, now or datetime.now(UTC))
    if decided is None:
        return None
    with registry.transaction():
        for serial in decided.forecasts if only is None else [only] if only in decided.forecasts else []:
            _keep(registry, lot_id, serial, decided, actor)
        if only is None:
            _tell(registry, lot_id, decided, actor)
    return decided


def decide_release(registry: Registry, lot_id: str, now: datetime) -> LotRelease | None:
    """Decide on the unmeasured units of a lot; nothing is written."""
    units = dict(_units(registry, lot_id))
    if not units:
        return None
    here = _audits(registry, lot_id, units)
    _check_recordings(registry, lot_id, [audit.serial for audit in here])
    method_id = next(iter(units.values()))[1].method_id
    qualification = qualify(
        here,
        list(_past(registry, lot_id)),
        now,
        registry.lot(lot_id).sensor_model,
        method_id,
        _golden_failed(registry),
        RULES,
    )
    forecasts = {
        serial: made.forecast_rmse
        for serial, (_, made) in units.items()
        if not made.is_audited and made.decision.predicted.verdict in RELEASABLE and made.forecast_rmse
    }
    scale = _interval_scale(registry, qualification, lot_id)
    return release_lot(forecasts, qualification, lot_limit(registry, lot_id), RULES.promise, scale)


def _units(registry: Registry, lot_id: str) -> Iterator[tuple[str, tuple[UnitEntry, MadeCalibration]]]:
    """Yield target units with their newest calibration, where no later refusal stands against it."""
    targets = {unit.serial: unit for unit in registry.units(lot_id) if unit.role == "target"}
    for serial, standing in registry.standings(lot_id, list(targets)).items():
        if standing.made is not None:
            yield serial, (targets[serial], standing.made)


def _audits(
    registry: Registry, lot_id: str, units: Mapping[str, tuple[UnitEntry, MadeCalibration]]
) -> list[AuditedUnit]:
    """Return the audited units that speak for the others: a random draw, where one was written down."""
    plan = lot_audit(registry, lot_id)
    doubtful = () if plan is None else plan.plan.doubtful
    return [
        AuditedUnit(serial, made.forecast_rmse, made.after_rmse, lot_id)
        for serial, (_, made) in units.items()
        if serial not in doubtful and _is_audit(made) and made.forecast_rmse and made.after_rmse
    ]


def _is_audit(made: MadeCalibration) -> bool:
    return made.is_audited and made.decision.predicted.verdict in RELEASABLE


def _past(registry: Registry, lot_id: str) -> Iterator[PastAudit]:
    """Yield the audits of all other lots of the registry."""
    wanted = registry.lot(lot_id).sensor_model
    for lot in registry.lots():
        if lot.id == lot_id or not wanted or lot.sensor_model != wanted:
            continue
        units = dict(_units(registry, lot.id))
        for audit in _audits(registry, lot.id, units):
            unit, made = units[audit.serial]
            failed = made.verdict == Verdict.FAIL and made.decision.predicted.verdict == Verdict.PASS
            yield PastAudit(audit, lot.sensor_model, made.method_id, unit.made_at or datetime.now(UTC), failed)


def _golden_failed(registry: Registry) -> datetime | None:
    return max((run.made_at for run in registry.golden_runs() if not run.passed), default=None)


def _check_recordings(registry: Registry, lot_id: str, serials: Sequence[str]) -> None:
    """Refuse one recording that stands for two units."""
    owners: dict[str, str] = {}
    for entry in registry.recordings(lot_id, kind="audit"):
        if entry.serial not in serials:
            continue
        recording = registry.recording(entry.sha256)
        output = recording.unlabelled.output if isinstance(recording, LabelledRecording) else recording.output
        first = owners.setdefault(content_sha256({"output": output}, {}), entry.serial)
        if first != entry.serial:
            raise InputError(
                f"the audits of {first} and {entry.serial} are one recording; one is of another unit; nothing "
                "was released: put the right file into audit/ and run the batch again"
            )


def _interval_scale(registry: Registry, qualification: Qualification, lot_id: str) -> float:
    """Return the factor by which the intervals of the audited units would have covered 90 % of their samples."""
    groups = []
    for audit in qualification.audits[:MOST_AUDITS]:
        scores = _scores(registry, audit.serial, audit.lot_id or lot_id)
        if scores is not None:
            groups.append(scores)
    return pooled_scale(groups, 0.9) if groups else 1.0


def _scores(registry: Registry, serial: str, lot_id: str) -> Array | None:
    audits = registry.recordings(lot_id, serial, "audit")
    recording = registry.recording(audits[-1].sha256) if audits else None
    if not isinstance(recording, LabelledRecording):
        return None
    calibration = Calibration.from_record(registry.calibration(serial, lot_id=lot_id).record)
    found = estimate(registry.network(calibration.network_id), calibration, recording.unlabelled)
    rows = np.isfinite(found.estimate)
    half = np.maximum(found.upper - found.estimate, 1e-12)
    return np.asarray((np.abs(found.estimate - recording.reference) / half)[rows])


def _keep(registry: Registry, lot_id: str, serial: str, decided: LotRelease, actor: str | None) -> None:
    """Store what is decided on a unit as a revision of its own, where it is not what stands."""
    stored = registry.calibration(serial, lot_id=lot_id)
    if decided.found is None and stored.record.decision.sampled is None:
        return
    record = judged_record(_base(registry, lot_id, stored), decided)
    if record.input_sha256 == stored.record.input_sha256:
        return
    known = registry.find_calibration(serial, record.input_sha256, lot_id=lot_id)
    if known is None:
        registry.add_calibration(lot_id, record, actor=actor, reason=WHY, decided_by="release")
    else:
        registry.decide(known, "release", actor=actor, reason=WHY)


def _base(registry: Registry, lot_id: str, stored: StoredCalibration) -> CalibrationRecord:
    """Return the calibration as it was fitted, before audits of other units scaled it."""
    record = stored.record
    revision = record.evidence.get("base_revision")
    if revision is None:
        return replace(record, evidence={**record.evidence, "base_revision": float(stored.revision)})
    base = registry.calibration(record.serial, int(revision), lot_id=lot_id).record
    return replace(base, evidence={**base.evidence, "base_revision": revision})


def judged_record(base: CalibrationRecord, decided: LotRelease) -> CalibrationRecord:
    """Return a calibration with what the audits of its lot say: forecast and interval scaled, the judgement beside.

    Args:
        base: as it was fitted.
        decided: on its lot; the unit must be among `forecasts`.
    """
    judgement = decided.judgement(base.serial)
    decision = replace(base.decision, measured=None, sampled=judgement)
    scale, width = decided.forecast_scale, decided.interval_scale
    forecast = None
    if base.settings.get("forecast") is not None and base.predicted_rmse is not None:
        upper = base.predicted_rmse * (decided.found.factor if decided.found is not None else scale)
        old = ErrorForecast(**base.settings["forecast"])  # type: ignore[arg-type]
        rmse = base.predicted_rmse * scale
        # Beyond a finite factor nothing is known; the forecast keeps the end it had.
        forecast = vars(ErrorForecast(rmse, old.lower * scale, upper if np.isfinite(upper) else old.upper * scale))
    arrays = {**base.arrays, "interval.half_width": np.asarray(base.arrays["interval.half_width"]) * width}
    told = {"forecast_rmse": base.predicted_rmse, "forecast_scale": scale, "interval_scale": width}
    return replace(
        base,
        arrays=arrays,
        settings={**base.settings, "forecast": forecast, "decision": decision.to_json()},
        predicted_rmse=None if base.predicted_rmse is None else base.predicted_rmse * scale,
        verdict=str(decision.verdict),
        reasons=decision.reasons,
        evidence={**base.evidence, **told},
        input_sha256=content_sha256({}, {"base": base.input_sha256, "sampled": judgement.to_json(), **told}),
    )


def _tell(registry: Registry, lot_id: str, decided: LotRelease, actor: str | None) -> None:
    """Keep the statement, where it says something new."""
    told = registry.events(STATEMENT, (lot_id,))
    facts = json.loads(json.dumps(decided.to_json()))
    if not told or json.loads(told[-1].after or "{}") != facts:
        registry.add_event("release" if decided.released else "withhold", STATEMENT, (lot_id,), facts, actor=actor)
