"""Decide on a lot as a whole: on the limit in force, on its audits, and on the units that nobody measured.

A sample release and a correction are decisions of the lot, numbered and stored. A batch or a person makes the next one;
whatever else happens, to the lot or to one of its units, can only withdraw units that they released.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from datetime import UTC, datetime

import msgspec
import numpy as np

from softcal.app.bootstrap import current_user
from softcal.app.calibration.audit_evidence import AuditEvidence, AuditReader
from softcal.app.calibration.lot_decision import LotDecision, decision_in_force, next_number
from softcal.app.registry.limit import limit_or_none, lot_limit
from softcal.app.registry.lot_recordings import audit_of, measure_unit, newest_audits, source_recording, target_serials
from softcal.core.messages.reason import reason
from softcal.core.quality.lot_release import LotRelease, release_lot
from softcal.core.quality.lot_status import LotStatus, UnitInLot
from softcal.core.quality.qualification import NONE
from softcal.core.quality.release import min_passing
from softcal.core.unit.adjustments import SampleRelease
from softcal.core.unit.lot_correction import LotCorrection
from softcal.core.unit.state import UnitState
from softcal.db.entries import UnitResult
from softcal.db.provenance import Provenance, record_provenance
from softcal.db.registry import Registry

AUDIT_REASON = "decided on the audits of the lot"
FEW = 20
"""So many units are read to learn the method of a lot."""


def decide_lot(
    registry: Registry, lot_id: str, actor: str | None = None, now: datetime | None = None
) -> LotRelease | None:
    """Decide on a lot anew: correction, and release of the units that nobody measured. None without calibrated units.

    Called by a batch, and by whoever releases a lot.
    """
    with registry.transaction():
        lot = _Lot.read(registry, lot_id, actor, now)
        if not lot.states:
            return None
        before, number = decision_in_force(registry, lot_id), next_number(registry, lot_id)
        evidence = lot.evidence()
        correction = LotCorrection(number, evidence.lines)
        if correction.lines == before.correction.lines:
            correction = before.correction
        if lot.correct(correction):
            evidence = lot.evidence()
        release = lot.decided(evidence, correction)
        following = release.next_unit(number)
        decision = lot.following(before, release, next_unit=following, released=release.released)
        decision = replace(decision, correction=correction)
        if decision.is_as(before):
            number = before.next_unit.number if before.next_unit else number
        elif decision.next_unit or before.next_unit or correction is not before.correction:
            action = "release" if release.released else "withhold"
            registry.decisions.add(
                lot_id, msgspec.to_builtins(decision), action=action, actor=actor, reason=AUDIT_REASON
            )
        lot.put_all_in_use(
            {s: replace(one, release=_unit_release(release, one, number)) for s, one in lot.open().items()},
            AUDIT_REASON,
        )
        return release


def redecide_lot(registry: Registry, lot_id: str, actor: str | None = None) -> None:
    """Decide on the units of a lot again after something changed that they rest on: limit, audits, golden runs.

    Nothing is released by sample that was not before, and no correction is made; units are withdrawn where the audits
    no longer carry them. A stated limit that changes is the one exception: the statement in force is made for it anew.
    """
    with registry.transaction():
        lot = _Lot.read(registry, lot_id, actor)
        in_force = decision_in_force(registry, lot_id)
        if not lot.states or in_force.source in ("", NONE):
            return
        evidence = lot.evidence()
        is_new_limit = in_force.limit_rmse != evidence.limit.stated_rmse
        spoken_of = {serial: one.release for serial, one in lot.open().items() if one.release is not None}
        before = {serial for serial, release in spoken_of.items() if release.is_released}
        among = (None, None) if is_new_limit else (spoken_of, before)
        decided = lot.decided(evidence, in_force.correction, *among)
        is_upheld = before <= set(decided.released) and decided.qualification.is_given
        if is_upheld and not is_new_limit:
            return
        number = next_number(registry, lot_id)
        following = decided.next_unit(number)
        decision = lot.following(in_force, decided, next_unit=following, released=decided.released)
        registry.decisions.add(
            lot_id, msgspec.to_builtins(decision), action="withhold", actor=actor, reason=AUDIT_REASON
        )
        units = {s: one for s, one in lot.open().items() if is_new_limit or s in spoken_of}
        lot.put_all_in_use(
            {s: replace(one, release=_unit_release(decided, one, number)) for s, one in units.items()}, AUDIT_REASON
        )


def decide_unit(registry: Registry, lot_id: str, serial: str, actor: str | None = None) -> None:
    """Hold a unit that was calibrated just now against the decisions in force; no other unit changes."""
    with registry.transaction():
        in_force = decision_in_force(registry, lot_id)
        lot = _Lot.read(registry, lot_id, actor, only=serial)
        if not lot.states:
            return
        lot.correct(in_force.correction)
        state = lot.open().get(serial)
        if state is None or in_force.next_unit is None:
            return
        release, limit, part = in_force.next_unit, state.limit, state.fit.lot_fit
        if release.sitting not in ("", part and part.sitting):
            return
        evidence = AuditReader(registry, state.fit.method).evidence(lot_id, datetime.now(UTC))
        day = evidence.day_rmse(state.fit.load_rms)
        error = (
            float("inf") if release.factor is None else float(np.hypot(state.fit.forecast.rmse * release.factor, day))
        )
        release = replace(release, day_rmse=day, is_released=error <= limit.acceptance_rmse)
        lot.put_in_use(serial, replace(state, release=release), AUDIT_REASON)


def roll_back(
    registry: Registry,
    serial: str,
    to: int,
    *,
    reason: str,
    lot_id: str,
    origin: str | None = None,
    actor: str | None = None,
) -> int:
    """Bring an older revision of a unit back into use, and hold it against the decisions in force; return the new one.

    Raises:
        InputError: as `CalibrationTables.rollback`.
    """
    with registry.transaction():
        which = {"lot_id": lot_id, "origin": origin}
        revision = registry.calibrations.rollback(serial, to, reason=reason, actor=actor, **which)
        decide_unit(registry, lot_id, serial, actor)
        return revision


def read_lot_status(registry: Registry, lot_id: str) -> LotStatus:
    """Return where a lot stands, and what a release would be decided on now; nothing is written.

    Raises:
        InputError: the lot is not in the registry.
    """
    registry.lots.get(lot_id)
    serials = target_serials(registry, lot_id)
    units, limit = registry.pages.unit_statuses(lot_id, serials), limit_or_none(registry, lot_id)
    lot = _Lot(registry, lot_id, _states(units), len(units))
    decided = lot.decided(lot.evidence(), decision_in_force(registry, lot_id).correction) if lot.states else None
    return LotStatus(lot_id, _rows(registry, lot_id, serials, units), limit, decided)


def outline_lot(registry: Registry, lot_id: str) -> LotStatus:
    """Return where a lot stands without what a release would be decided on: forecasts of audited units alone are read.

    Where the audits of a lot may release other units, those are decided on: then as `read_lot_status`.
    """
    targets = [unit for unit in registry.lots.units(lot_id) if unit.role == "target"]
    serials = [unit.serial for unit in targets]
    some = _states(registry.pages.unit_statuses(lot_id, [unit.serial for unit in targets if unit.revision][:FEW]))
    lot = _Lot(registry, lot_id, some, len(targets))
    if some and lot.evidence().qualification.is_given:
        return read_lot_status(registry, lot_id)
    units = {
        unit.serial: UnitResult(unit.serial, unit.verdict, unit.reasons, unit.made_at)
        for unit in targets
        if unit.verdict is not None and unit.made_at is not None
    }
    units |= registry.pages.unit_statuses(lot_id, sorted(newest_audits(registry, lot_id)))
    return LotStatus(lot_id, _rows(registry, lot_id, serials, units), limit_or_none(registry, lot_id), None)


def _rows(registry: Registry, lot_id: str, serials: Sequence[str], units: Mapping[str, UnitResult]) -> list[UnitInLot]:
    audits, passed = newest_audits(registry, lot_id), registry.calibrations.passed_once(lot_id)
    # By another limit a unit is decided on anew, but what its audit may be of stays the same.
    audited = _states(registry.pages.unit_statuses(lot_id, sorted(audits), has_stale=True))
    rows = []
    for serial in serials:
        unit, audit, had_passed = units.get(serial), audits.get(serial), serial in passed
        at = None if audit is None else audit.observed_at
        if unit is None:
            rows.append(UnitInLot(serial, had_passed=had_passed, audited_at=at))
            continue
        state, suspect = unit.state, audited[serial].suspect_audit if serial in audited else None
        measured = None if state is None or state.scores is None else state.scores.after.rmse
        forecast = None if state is None else state.fit.forecast.rmse
        is_measured = state is not None and state.decision.is_audited
        errors = {"forecast_rmse": forecast, "measured_rmse": measured}
        rows.append(
            UnitInLot(serial, unit.verdict, unit.reasons, is_measured, had_passed, at, **errors, suspect_reason=suspect)
        )
    return rows


def statement_provenance(registry: Registry, status: LotStatus) -> Provenance:
    """Return what the statement on a lot with calibrated units rests on: the stored one, else one that is made now."""
    stored = decision_in_force(registry, status.lot_id).provenance
    if stored is not None and is_decided(registry, status):
        return stored
    states = _states(
        registry.pages.unit_statuses(status.lot_id, [unit.serial for unit in status.units], has_stale=True)
    )
    return _Lot(registry, status.lot_id, states, len(states), current_user()).provenance()


def is_decided(registry: Registry, status: LotStatus) -> bool:
    """Return whether the decision in force on a lot says what would be decided now; nothing is written."""
    in_force, decided = decision_in_force(registry, status.lot_id), status.decided
    return decided is None or (in_force.released, in_force.statement) == (decided.released, decided.statement)


@dataclass
class _Lot:
    """The units of a lot while it is decided on, each without its arrays until they are needed."""

    registry: Registry
    lot_id: str
    states: dict[str, UnitState]
    units: int
    actor: str | None = None
    now: datetime = field(default_factory=lambda: datetime.now(UTC))

    @classmethod
    def read(
        cls, registry: Registry, lot_id: str, actor: str | None, now: datetime | None = None, only: str | None = None
    ) -> "_Lot":
        """Read the units of a lot, held against the limit in force and the newest audits."""
        serials = target_serials(registry, lot_id) if only is None else [only]
        unit_statuses = registry.pages.unit_statuses(lot_id, serials, has_stale=True)
        lot = cls(registry, lot_id, _states(unit_statuses), len(unit_statuses), actor, now or datetime.now(UTC))
        if lot.states:
            lot._update(only)
        return lot

    def audits(self) -> AuditReader:
        return AuditReader(self.registry, next(iter(self.states.values())).fit.method)

    def evidence(self) -> AuditEvidence:
        return self.audits().evidence(self.lot_id, self.now)

    def following(
        self, before: LotDecision, decided: LotRelease, *, next_unit: SampleRelease | None, released: tuple[str, ...]
    ) -> LotDecision:
        """Return the decision that follows one, with the statement that is made now."""
        limit, source = decided.limit.stated_rmse, decided.qualification.source
        decision = replace(before, limit_rmse=limit, source=source, statement=decided.statement)
        return replace(decision, next_unit=next_unit, released=released, provenance=self.provenance())

    def provenance(self) -> Provenance:
        """Return what a statement that is made now rests on."""
        networks = sorted({state.fit.network_id for state in self.states.values()})
        audits = sorted(newest_audits(self.registry, self.lot_id).items())
        inputs = {f"network {one[:12]}": one for one in networks}
        inputs |= {f"audit of {serial}": entry.sha256 for serial, entry in audits}
        method = next(iter(self.states.values())).fit.method.id
        return record_provenance(method, inputs, self.actor or self.registry.settings.actor)

    def open(self) -> dict[str, UnitState]:
        """Return the units that audits of others may release: not measured, and nothing stands against them."""
        return {
            serial: state
            for serial, state in self.states.items()
            if state.decision.measured is None and state.fit.is_open and not state.blocking_reasons
        }

    def decided(
        self,
        evidence: AuditEvidence,
        correction: LotCorrection,
        among: Collection[str] | None = None,
        candidates: Collection[str] | None = None,
    ) -> LotRelease:
        """Return what is decided on unmeasured units: on all, or among some on those that may be released."""
        open_units, limit_rmse = self.open(), evidence.limit.stated_rmse
        # Rules of other packages hold a unit to the limit of its fit: by another one nothing is decided on it.
        units = {
            serial: one
            for serial, one in open_units.items()
            if one.limit.stated_rmse == limit_rmse and (among is None or serial in among)
        }
        audited = [s for s in self.states.values() if s.decision.is_audited and s.verdict.is_open]
        days = (
            {} if evidence.day_gains is None else {s: evidence.day_rmse(one.fit.load_rms) for s, one in units.items()}
        )
        return release_lot(
            {serial: state.fit.forecast.rmse for serial, state in units.items()},
            evidence.qualification,
            evidence.limit,
            evidence.config,
            inflation=evidence.interval_inflation,
            min_count=min_passing(self.units - len(open_units) + len(units), len(audited), evidence.config),
            gains=evidence.gains,
            day_errors=days,
            suspects=evidence.suspects,
            sittings={serial: one.fit.lot_fit.sitting for serial, one in units.items() if one.fit.lot_fit is not None},
            corrected_by=len(correction.lines) if any(one.correction for one in self.states.values()) else 0,
            candidates=candidates,
        )

    def correct(self, correction: LotCorrection) -> bool:
        """Take a correction off the maps of the lot, and measure the audited units by their maps of then.

        Returns whether a map or an audit changed.
        """
        rules = next(iter(self.states.values())).fit.method.release
        if len(correction.lines) < rules.min_correction_audits and not any(s.correction for s in self.states.values()):
            return False
        audits, is_changed = newest_audits(self.registry, self.lot_id), False
        networks = {state.fit.network_id for state in self.states.values()}
        sources = {network_id: source_recording(self.registry, network_id) for network_id in networks}
        self._read_arrays(self.states)
        for serial, state in list(self.states.items()):
            corrected = correction.apply(state, sources[state.fit.network_id])
            if corrected.line_behind == state.line_behind:
                continue
            if corrected.audit is not None and corrected.audit.map_id != corrected.map_id:
                audit = audit_of(self.registry, audits.get(serial))
                if audit is None or audit.sha256 != corrected.audit.recording_sha256:
                    continue
                corrected = measure_unit(self.registry, corrected, audit)
            self.put_in_use(serial, corrected, AUDIT_REASON)
            is_changed = True
        return is_changed

    def put_all_in_use(self, states: Mapping[str, UnitState], reason: str) -> None:
        """Put states into use where they are not, after one look at what is there of all."""
        self.registry.calibrations.read_ahead(self.lot_id, list(states))
        self._read_arrays(serial for serial, state in states.items() if state.line_behind is not None)
        for serial, state in states.items():
            self.put_in_use(serial, state, reason)

    def put_in_use(self, serial: str, state: UnitState, reason: str) -> None:
        """Put a state into use where it is not."""
        before = self.states[serial]
        if all(getattr(before, one.name) == getattr(state, one.name) for one in fields(state) if one.name != "fit"):
            return
        if state.fit.fitted is None and state.line_behind is not None:
            self._read_arrays([serial])
            state = replace(state, fit=self.states[serial].fit)
        self.states[serial] = state
        self.registry.calibrations.put_state(self.lot_id, state, "release", actor=self.actor, reason=reason)

    def _update(self, only: str | None) -> None:
        registry, limit = self.registry, lot_limit(self.registry, self.lot_id)
        audits = newest_audits(registry, self.lot_id, only)
        # Rules of other packages have to see the recording again: only a new fit decides on such a unit.
        free = {serial: state for serial, state in self.states.items() if not state.fit.rules}
        stale = {serial: replace(state, limit=limit) for serial, state in free.items() if state.limit != limit}
        self.put_all_in_use(stale, "held against another limit")
        for serial in free:
            entry, audit_state = audits.get(serial), self.states[serial].audit
            if entry is None or (audit_state is not None and audit_state.recording_sha256 == entry.sha256):
                continue
            audit = audit_of(registry, entry)
            if audit is not None:
                self._read_arrays([serial])
                complete = replace(self.states[serial], unreadable_audit=None)
                self.put_in_use(serial, measure_unit(registry, complete, audit), "scored on a newer audit")
        suspects = self.audits().suspects(self.lot_id)
        for serial, state in list(self.states.items()):
            if state.suspect_audit != suspects.get(serial):
                note = "its audit is set aside" if serial in suspects else "its audit counts again"
                self.put_in_use(serial, replace(state, suspect_audit=suspects.get(serial)), note)

    def _read_arrays(self, serials: Iterable[str]) -> None:
        """Read the fits of units with their arrays, of all at once."""
        listed = [serial for serial in serials if self.states[serial].fit.fitted is None]
        stored = self.registry.pages.unit_statuses(self.lot_id, listed, has_stale=True, has_arrays=True)
        for serial, state in _states(stored).items():
            self.states[serial] = replace(self.states[serial], fit=state.fit)


def _unit_release(decided: LotRelease, state: UnitState, number: int) -> SampleRelease | None:
    """Return what a decision says of a unit; of one that another spoke for before, why it does so no more."""
    release, before = decided.sample_release(state.serial, number), state.release
    if release is not None or before is None:
        return release
    cause = decided.qualification.reason if decided.limit.is_stated else reason("part.no_limit")
    return replace(before, is_released=False, limit_rmse=decided.limit.maximum_rmse, withdrawn=cause)


def _states(unit_statuses: Mapping[str, UnitResult]) -> dict[str, UnitState]:
    states = {serial: one.state for serial, one in unit_statuses.items()}
    return {serial: state for serial, state in states.items() if state is not None}
