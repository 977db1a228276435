"""Release the unmeasured units of a lot on its audits: read from the registry, decided, kept as revisions."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np

from softcal.app.batch.audit_evidence import PROMISE, RELEASABLE, AuditEvidence, AuditReader
from softcal.core.identity import content_sha256
from softcal.core.quality.lot_release import LotRelease, release_lot
from softcal.core.quality.release import least_passing
from softcal.core.unit.calibration import CalibrationRecord
from softcal.core.unit.uncertainty import ErrorForecast
from softcal.db.entries import MadeCalibration, StoredCalibration, UnitStanding
from softcal.db.registry import Registry

STATEMENT = "lot_release"
WHY = "decided on the audits of the lot"


def update_release(
    registry: Registry, lot_id: str, actor: str | None = None, now: datetime | None = None
) -> LotRelease | None:
    """Decide on the unmeasured units of a lot, and keep what changed.

    Args:
        now: the time of the decision.

    Returns:
        None where the lot has no unit with a forecast yet.

    Raises:
        InputError: the audits cannot all be true; nothing was released.
    """
    standing = _standing(registry, lot_id, now or datetime.now(UTC))
    if standing is None:
        return None
    decided = standing.decided()
    with registry.transaction():
        for serial in decided.forecasts:
            _keep(registry, lot_id, standing.units[serial], decided, actor)
        _tell(registry, lot_id, decided, actor)
    return decided


def decide_release(registry: Registry, lot_id: str, now: datetime) -> LotRelease | None:
    """Decide on the unmeasured units of a lot; nothing is written. None where it has no unit with a forecast yet."""
    standing = _standing(registry, lot_id, now)
    return None if standing is None else standing.decided()


def _standing(registry: Registry, lot_id: str, now: datetime) -> "_Standing | None":
    units = _whole_lot(registry, lot_id)
    made = _made(units)
    if not made:
        return None
    evidence = AuditReader(registry).evidence(lot_id, made[0].method_id, now)
    return _Standing(evidence, _open(made), _least(units))


@dataclass(frozen=True)
class _Standing:
    """What is known of a lot: the evidence it is decided on, and its units as they were then or came since.

    Args:
        units: unmeasured ones, by serial.
        least: number of them that must pass.
    """

    evidence: AuditEvidence
    units: Mapping[str, MadeCalibration]
    least: float = 0.0

    def decided(self) -> LotRelease:
        """Decide on its units."""
        return _decided(self.evidence, self.units, self.least)


class LineRelease:
    """Decides on units one by one as a line presses them.

    The other units of the lot are read again only where the audits say something new; units that another station
    presses meanwhile count from then on. `update_release` decides on the whole lot.

    Args:
        registry: of the line.
    """

    def __init__(self, registry: Registry) -> None:
        self._registry, self._reader = registry, AuditReader(registry)
        self._standing: dict[str, _Standing] = {}

    def press(self, lot_id: str, serial: str, actor: str | None = None, now: datetime | None = None) -> None:
        """Decide on a unit that was calibrated just now, and keep what changed.

        Raises:
            InputError: the audits cannot all be true; nothing was released.
        """
        registry = self._registry
        pressed = _made(registry.standings(lot_id, [serial]))
        if not pressed:
            self._standing.pop(lot_id, None)
            return
        evidence = self._reader.evidence(lot_id, pressed[0].method_id, now or datetime.now(UTC))
        known = self._standing.get(lot_id, _Standing(evidence, {}))
        if known.evidence != evidence or lot_id not in self._standing:
            known = self._look(lot_id, evidence)
        others = {other: made for other, made in known.units.items() if other != serial}
        known = replace(known, units={**others, **_open(pressed)})
        self._standing[lot_id] = known
        decided = known.decided()
        if serial in decided.forecasts:
            with registry.transaction():
                _keep(registry, lot_id, known.units[serial], decided, actor)

    def _look(self, lot_id: str, evidence: AuditEvidence) -> _Standing:
        """Return where the other units of a lot stand; without a qualification none of them matters."""
        if not evidence.qualification.is_given:
            return _Standing(evidence, {})
        units = _whole_lot(self._registry, lot_id)
        return _Standing(evidence, _open(_made(units)), _least(units))


def _whole_lot(registry: Registry, lot_id: str) -> Mapping[str, UnitStanding]:
    return registry.standings(lot_id, [unit.serial for unit in registry.units(lot_id) if unit.role == "target"])


def _made(units: Mapping[str, UnitStanding]) -> list[MadeCalibration]:
    """Return the calibrations in use, where no later refusal stands against them."""
    return [standing.made for standing in units.values() if standing.made is not None]


def _least(units: Mapping[str, UnitStanding]) -> float:
    """Return how many units must pass unmeasured so that half of the lot does."""
    held = [made for made in _made(units) if made.is_audited and made.verdict in RELEASABLE]
    return least_passing(len(units), len(held))


def _open(units: Sequence[MadeCalibration]) -> dict[str, MadeCalibration]:
    """Return the units that nobody measured and no finding stands against, by serial."""
    return {
        made.serial: made
        for made in units
        if not made.is_audited and made.decision.predicted.verdict in RELEASABLE and made.forecast_rmse
    }


def _decided(evidence: AuditEvidence, units: Mapping[str, MadeCalibration], least: float) -> LotRelease:
    forecasts = {serial: made.forecast_rmse for serial, made in units.items() if made.forecast_rmse}
    days = {} if evidence.days is None else {s: evidence.day_rmse(made.load_rms) for s, made in units.items()}
    return release_lot(
        forecasts,
        evidence.qualification,
        evidence.limit,
        PROMISE,
        widening=evidence.widening,
        least=least,
        seen=evidence.seen,
        days=days,
    )


def _keep(registry: Registry, lot_id: str, made: MadeCalibration, decided: LotRelease, actor: str | None) -> None:
    """Store what is decided on a unit as a revision of its own, where it is not what stands."""
    # Asked first: most lots have no audits, and reading a calibration whole costs more than most of the batch's writes.
    if decided.found is None and made.decision.sampled is None:
        return
    serial = made.serial
    stored = registry.calibration(serial, lot_id=lot_id)
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
    scale, widening = decided.forecast_scale, decided.widening
    forecast = None
    if base.settings.get("forecast") is not None and base.predicted_rmse is not None:
        upper = base.predicted_rmse * (decided.found.factor if decided.found is not None else scale)
        old = ErrorForecast(**base.settings["forecast"])  # type: ignore[arg-type]
        rmse = base.predicted_rmse * scale
        # Beyond a finite factor nothing is known; the forecast keeps the end it had.
        forecast = vars(ErrorForecast(rmse, old.lower * scale, upper if np.isfinite(upper) else old.upper * scale))
    arrays = {**base.arrays, "interval.half_width": widening(np.asarray(base.arrays["interval.half_width"]))}
    told = {"forecast_rmse": base.predicted_rmse, "forecast_scale": scale}
    told |= {"interval_scale": widening.scale, "interval_added": widening.added}
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
