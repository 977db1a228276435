"""Release the unmeasured units of a lot on its audits: decided, kept as revisions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np

from softcal.app.batch.audit_evidence import PROMISE, RELEASABLE, AuditEvidence, AuditReader
from softcal.app.registry.limit import judged_limit, limit_or_none, lot_limit
from softcal.app.registry.lot_recordings import audit_of, newest_audits, source_recording, target_serials, unlabelled
from softcal.app.registry.stated import is_stated, state
from softcal.core.identity import content_sha256
from softcal.core.quality.lot_release import LotRelease, release_lot
from softcal.core.quality.lot_standing import LotStanding, UnitInLot
from softcal.core.quality.release import least_passing
from softcal.core.unit.audited import judged, measured
from softcal.core.unit.calibration import AUDIT_GAIN, AUDIT_ZERO, CalibrationRecord
from softcal.core.unit.common_misreading import CommonMisreading, corrected
from softcal.core.unit.uncertainty import ErrorForecast
from softcal.core.unit.verdict import Decision, Limit
from softcal.core.words.reason import Reason
from softcal.db.entries import MadeCalibration, StoredCalibration, UnitEntry, UnitStanding
from softcal.db.registry import Registry
from softcal.db.truth.in_use import STALE

STATEMENT = "lot_release"
BASE = "base_revision"
"""Number in a calibration's evidence: the revision that was fitted, before audits spoke."""
WHY = "decided on the audits of the lot"


def judge_lot(
    registry: Registry, lot_id: str, actor: str | None = None, now: datetime | None = None
) -> LotRelease | None:
    """Judge every unit by the limit in force and by the audits, and keep what changed. None where
    the lot has no unit with a forecast yet.
    """
    # Units judged against another limit come first; one that has to be fitted for it stays stale.
    if stale := [unit.serial for unit in registry.lots.units(lot_id) if is_stale(unit)]:
        limit = lot_limit(registry, lot_id)
        with registry.transaction():
            for serial in stale:
                base = _base(registry, lot_id, registry.calibrations.get(serial, lot_id=lot_id))
                if record := judged(base, limit):
                    _put(registry, lot_id, record, "judged against another limit", actor)
    # Then units of which another audit, or none, was scored
    entries = newest_audits(registry, lot_id)
    for serial, unit in registry.pages.standings(lot_id, list(entries)).items():
        made, entry = unit.made, entries[serial]
        if made is None or (made.audit is not None and made.audit.recording_sha256 in ("", entry.sha256)):
            continue
        audit = audit_of(registry, entry)
        base = _base(registry, lot_id, registry.calibrations.get(serial, lot_id=lot_id))
        if audit is None or base.grounds is None or base.grounds.rules:
            continue
        recording = unlabelled(registry.recordings.get(base.recording_sha256))
        record = measured(registry.networks.get(base.network_id), base, audit, recording, lot_limit(registry, lot_id))
        # It is fitted as it was; what others say is asked again.
        evidence = {name: value for name, value in record.evidence.items() if name != BASE}
        _put(registry, lot_id, replace(record, evidence=evidence), "scored on a newer audit", actor)
    at = now or datetime.now(UTC)
    standing = _standing(registry, lot_id, at)
    if standing is None:
        return None
    # What audited units misread alike comes off first; their errors then speak for the lot.
    moved = [made for made in standing.made if made.decision.measured and _is_to_correct(made, standing.evidence)]
    if moved:
        with registry.transaction():
            for made in moved:
                _keep(registry, lot_id, made, None, standing.evidence, actor)
        standing = _standing(registry, lot_id, at) or standing
    decided = standing.decided()
    with registry.transaction():
        for made in standing.moved():
            _keep(registry, lot_id, made, decided, standing.evidence, actor)
        action = "release" if decided.released else "withhold"
        state(registry, STATEMENT, (lot_id,), decided.to_json(), action=action, actor=actor)
    return decided


def _is_to_correct(made: MadeCalibration, evidence: AuditEvidence) -> bool:
    common = evidence.common_of(made)
    wanted = None if common is None else (common.line.gain, common.line.zero)
    if wanted is None or made.common_line is None:
        return wanted != made.common_line
    return not np.allclose(wanted, made.common_line, rtol=1e-9, atol=1e-12)


def lot_standing(registry: Registry, lot_id: str) -> LotStanding:
    """Return where a lot stands; nothing is written.

    Raises:
        InputError: the lot is not in the registry.
    """
    registry.lots.get(lot_id)
    units, limit = _whole_lot(registry, lot_id), limit_or_none(registry, lot_id)
    standing = _standing(registry, lot_id, datetime.now(UTC), units)
    audits, passed = newest_audits(registry, lot_id), registry.calibrations.passed_once(lot_id)
    rows = []
    for serial in target_serials(registry, lot_id):
        unit, audit, had_passed = units.get(serial), audits.get(serial), serial in passed
        at = None if audit is None else audit.added_at
        if unit is None:
            rows.append(UnitInLot(serial, had_passed=had_passed, audited_at=at))
            continue
        made = unit.made
        errors = (None, None) if made is None else (made.forecast_rmse, made.after_rmse)
        is_measured = made is not None and made.is_audited
        rows.append(UnitInLot(serial, unit.verdict, unit.reasons, is_measured, had_passed, at, *errors))
    return LotStanding(lot_id, rows, limit, None if standing is None else standing.decided())


def is_stale(unit: UnitEntry) -> bool:
    """Return whether a unit was judged against another limit than the one in force."""
    return bool(unit.reasons) and unit.reasons[0].code in STALE


def _standing(
    registry: Registry, lot_id: str, now: datetime, units: Mapping[str, UnitStanding] | None = None
) -> "_Standing | None":
    units = _whole_lot(registry, lot_id) if units is None else units
    made = _made(units)
    return _Standing.of(AuditReader(registry).evidence(lot_id, made[0].method_id, now), units) if made else None


@dataclass(frozen=True)
class _Standing:
    """What is known of a lot: the evidence it is decided on, its units, and how many unmeasured
    ones must pass.
    """

    evidence: AuditEvidence
    made: Sequence[MadeCalibration]
    least: float = 0.0

    @classmethod
    def of(cls, evidence: AuditEvidence, units: Mapping[str, UnitStanding]) -> "_Standing":
        """Return where these units stand; half of the lot must pass."""
        made = _made(units)
        held = [one for one in made if one.is_audited and one.verdict in RELEASABLE]
        return cls(evidence, made, least_passing(len(units), len(held)))

    @property
    def open(self) -> dict[str, MadeCalibration]:
        """Unmeasured units that audits of others may release: nothing found, and nothing that bars a pass."""
        return {
            made.serial: made
            for made in self.made
            if made.decision.measured is None and made.is_open and made.forecast_rmse and not made.decision.bars
        }

    def decided(self) -> LotRelease:
        evidence, units = self.evidence, self.open
        days = {} if evidence.days is None else {s: evidence.day_rmse(made.load_rms) for s, made in units.items()}
        return release_lot(
            {serial: made.forecast_rmse for serial, made in units.items() if made.forecast_rmse},
            evidence.qualification,
            evidence.limit,
            PROMISE,
            widening=evidence.widening,
            least=self.least,
            seen=evidence.seen,
            days=days,
            doubts=evidence.doubts,
            common=evidence.common,
        )

    def moved(self) -> list[MadeCalibration]:
        """Return the units that audits may move: open ones, audited ones, those in doubt."""
        doubts = self.evidence.doubts
        return [
            made
            for made in self.made
            if made.serial in self.open
            or made.serial in doubts
            or made.decision.doubt is not None
            or (made.decision.measured is not None and _is_to_correct(made, self.evidence))
        ]


class LineRelease:
    """Decides on units one by one as a line presses them; `judge_lot` decides on the whole lot.

    The other units are read again only where the audits say something new; units that another
    station presses meanwhile count from then on.
    """

    def __init__(self, registry: Registry) -> None:
        self._registry, self._reader = registry, AuditReader(registry)
        self._standing: dict[str, _Standing] = {}

    def press(self, lot_id: str, serial: str, actor: str | None = None, now: datetime | None = None) -> None:
        """Decide on a unit that was calibrated just now, and keep what changed."""
        registry = self._registry
        pressed = _made(registry.pages.standings(lot_id, [serial]))
        if not pressed:
            self._standing.pop(lot_id, None)
            return
        evidence = self._reader.evidence(lot_id, pressed[0].method_id, now or datetime.now(UTC))
        known = self._standing.get(lot_id, _Standing(evidence, ()))
        if known.evidence != evidence or lot_id not in self._standing:
            known = _Standing(evidence, ())
            # Without a qualification none of the other units of the lot matters.
            if evidence.qualification.is_given:
                known = _Standing.of(evidence, _whole_lot(registry, lot_id))
        known = replace(known, made=[*(made for made in known.made if made.serial != serial), *pressed])
        self._standing[lot_id] = known
        decided = known.decided()
        for made in known.moved():
            if made.serial == serial:
                with registry.transaction():
                    _keep(registry, lot_id, made, decided, evidence, actor)


def _whole_lot(registry: Registry, lot_id: str) -> Mapping[str, UnitStanding]:
    return registry.pages.standings(lot_id, target_serials(registry, lot_id))


def _made(units: Mapping[str, UnitStanding]) -> list[MadeCalibration]:
    return [standing.made for standing in units.values() if standing.made is not None]


def _keep(
    registry: Registry,
    lot_id: str,
    made: MadeCalibration,
    decided: LotRelease | None,
    evidence: AuditEvidence,
    actor: str | None,
) -> None:
    """Store what is decided on a unit as a revision of its own, where it is not what stands."""
    doubt, known = evidence.doubts.get(made.serial), made.decision
    is_released = decided is not None and decided.found is not None and made.serial in decided.forecasts
    # Asked first: most lots have no audits, and reading a calibration whole is dear.
    is_as_it_was = doubt is None and known.sampled is None and known.doubt is None
    if not is_released and is_as_it_was and not _is_to_correct(made, evidence):
        return
    base = _base(registry, lot_id, registry.calibrations.get(made.serial, lot_id=lot_id))
    record = _corrected(registry, lot_id, base, evidence.common_of(made), evidence.limit)
    if doubt is not None:
        record = doubted_record(record, doubt)
    elif decided is not None and known.measured is None and (is_released or known.sampled is not None):
        record = judged_record(record, decided)
    _put(registry, lot_id, record, WHY, actor)


def _corrected(
    registry: Registry, lot_id: str, base: CalibrationRecord, common: CommonMisreading | None, limit: Limit
) -> CalibrationRecord:
    """Return a calibration without what audited units misread alike, by the limit in force."""
    is_open = base.grounds is not None and not base.grounds.rules
    record = base
    if common is not None and is_open:
        record = corrected(base, source_recording(registry, base.network_id), common)
    elif _is_judged_by(base, limit):
        return base
    audit = None
    if record is not base and base.decision.measured is not None:
        audit = audit_of(registry, newest_audits(registry, lot_id, base.serial).get(base.serial))
    if audit is None:
        return judged(record, limit) or base
    recording = unlabelled(registry.recordings.get(base.recording_sha256))
    network = registry.networks.get(base.network_id)
    own = None if base.scores is None or base.scores.own is None else base.scores.own.own
    scored = measured(network, record, audit, recording, limit, is_newer=False, own=own)
    # What its audit says of the map as it was fitted is what the others are corrected by.
    lines = {name: base.evidence[name] for name in (AUDIT_GAIN, AUDIT_ZERO) if name in base.evidence}
    return replace(scored, evidence={**scored.evidence, **lines})


def _is_judged_by(record: CalibrationRecord, limit: Limit) -> bool:
    by = judged_limit(record, limit.unit)
    return by is not None and (by.maximum_rmse, by.is_stated) == (limit.maximum_rmse, limit.is_stated)


def _put(registry: Registry, lot_id: str, record: CalibrationRecord, why: str, actor: str | None) -> None:
    """Put a judgement into use, as a revision of its own where it was not kept before."""
    known = registry.calibrations.find(record.serial, record.input_sha256, lot_id=lot_id)
    if known is None:
        registry.calibrations.add(lot_id, record, actor=actor, reason=why, decided_by="release")
    elif not known.is_current:
        registry.calibrations.decide(known, "release", actor=actor, reason=why)


def _base(registry: Registry, lot_id: str, stored: StoredCalibration) -> CalibrationRecord:
    """Return the calibration as it was fitted, before audits of other units scaled it."""
    record = stored.record
    revision = record.evidence.get(BASE)
    if revision is None:
        return replace(record, evidence={**record.evidence, BASE: float(stored.revision)})
    base = registry.calibrations.get(record.serial, int(revision), lot_id=lot_id).record
    return replace(base, evidence={**base.evidence, BASE: revision})


def doubted_record(base: CalibrationRecord, doubt: Reason) -> CalibrationRecord:
    """Return a calibration whose audit is in doubt: nothing is decided before that is known."""
    return _with_decision(base, replace(base.decision, doubt=doubt), {"doubt": doubt.to_json()})


def judged_record(base: CalibrationRecord, decided: LotRelease) -> CalibrationRecord:
    """Return a calibration with what the audits of its lot say: all scaled, judgement beside."""
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
    numbers = {"forecast_rmse": base.predicted_rmse, "forecast_scale": scale}
    numbers |= {"interval_scale": widening.scale, "interval_added": widening.added}
    changed = replace(
        base,
        arrays=arrays,
        settings={**base.settings, "forecast": forecast},
        predicted_rmse=None if base.predicted_rmse is None else base.predicted_rmse * scale,
        evidence={**base.evidence, **numbers},
    )
    return _with_decision(changed, decision, {"sampled": judgement.to_json(), **numbers})


def _with_decision(base: CalibrationRecord, decision: Decision, facts: Mapping[str, object]) -> CalibrationRecord:
    """Return a calibration with another decision, and an input of its own: the base's and what led to it."""
    return replace(
        base,
        settings={**base.settings, "decision": decision.to_json()},
        verdict=str(decision.verdict),
        reasons=decision.reasons,
        input_sha256=content_sha256({}, {"base": base.input_sha256, **facts}),
    )


def is_told(registry: Registry, lot_id: str, decided: LotRelease) -> bool:
    """Return whether this very decision is the last that was kept."""
    return is_stated(registry, STATEMENT, (lot_id,), decided.to_json())
