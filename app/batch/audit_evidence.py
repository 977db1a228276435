"""What audits of a lot and of earlier lots say about its other units: each audit read once."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date, datetime, timedelta

import numpy as np

from softcal.app.batch.audit import confirmed_audits, lot_audit
from softcal.app.registry.limit import lot_limit
from softcal.app.registry.lot_recordings import audit_of, newest_audits, unlabelled
from softcal.core.lot import Lot
from softcal.core.quality.acceptance import Promise, least_units, tolerance_factor
from softcal.core.quality.audit_check import doubtful_audits
from softcal.core.quality.qualification import THIS_LOT, PastAudit, Qualification, qualify
from softcal.core.quality.release import AuditedUnit
from softcal.core.quality.widening import AuditedSamples, Widening, fit_widening
from softcal.core.recording import LabelledRecording
from softcal.core.unit.audit_reading import AuditReading, line_of
from softcal.core.unit.audited import read_gain, with_audit
from softcal.core.unit.calibration import Calibration
from softcal.core.unit.common_misreading import CommonMisreading, LoadLine, common_misreading, without
from softcal.core.unit.knowledge import ANCHORED
from softcal.core.unit.line_spread import SeenGains, seen_gains
from softcal.core.unit.method import CONFIDENCE, Method
from softcal.core.unit.verdict import Limit, Verdict
from softcal.core.words.reason import Reason
from softcal.db.entries import MadeCalibration
from softcal.db.registry import Registry

RELEASABLE = (Verdict.PASS, Verdict.CONDITIONAL)
RULES = Method().release
PROMISE = Promise(RULES.risk, RULES.confidence)


@dataclass(frozen=True)
class AuditEvidence:
    """All that a decision on a lot's unmeasured units rests on, but their forecasts.

    Args:
        qualification: whether units may be released, and on which audits.
        seen: gains that the lot's audited units read their loads with; None where too few.
        days: gains of the model's golden units on different days; None where too few.
        doubts: audits of the lot that are set aside, by serial, and why.
        lines: how the audited units of the lot read their loads, as their maps were fitted.
        common: what they misread alike; None where chance explains it.
    """

    qualification: Qualification
    limit: Limit
    widening: Widening
    seen: SeenGains | None = None
    days: SeenGains | None = None
    doubts: Mapping[str, Reason] = field(default_factory=dict)
    lines: Mapping[str, LoadLine] = field(default_factory=dict)
    common: CommonMisreading | None = None

    def common_of(self, made: MadeCalibration) -> CommonMisreading | None:
        """Return what is taken off a unit's map: of an audited one, what the others misread."""
        if self.common is None or ANCHORED in made.knowledge:
            return None
        return without(self.lines, made.serial, self.common).of(made.output_level)

    def day_rmse(self, load_rms: float | None) -> float:
        """Return the error that another day adds to a unit with this RMS load, in the same unit.
        Nine of ten days stay within it, at the promise's confidence (ISO 16269-6).
        """
        if self.days is None or load_rms is None:
            return 0.0
        return tolerance_factor(self.days.count, self.days.count - 1, PROMISE) * self.days.spread * load_rms


Audited = Mapping[str, tuple[AuditedUnit, datetime, MadeCalibration]]


class AuditReader:
    """Reads what audits say: calibrations keep it; of an older one the recording is read."""

    def __init__(self, registry: Registry) -> None:
        self._registry = registry
        self._older: dict[tuple[str, str, int], AuditReading | None] = {}
        self._golden: dict[tuple[str, str], float] = {}

    def evidence(self, lot_id: str, method_id: str, now: datetime) -> AuditEvidence:
        registry, lot = self._registry, self._registry.lots.get(lot_id)
        audited = self._audited(lot)
        readings = {serial: self._reading(lot_id, made) for serial, (_, _, made) in audited.items()}
        confirmed = confirmed_audits(registry, lot_id)
        doubts = doubtful_audits(
            {
                serial: reading
                for serial, reading in readings.items()
                if reading is not None and confirmed.get(serial) != reading.output_sha256
            }
        )
        audited = {serial: known for serial, known in audited.items() if serial not in doubts}
        here = [audit for audit, _, made in audited.values() if made.method_id == method_id]
        past: list[PastAudit] = []
        if len(here) < least_units(PROMISE.risk) and lot.sensor_model:
            # The audits of all other lots of the sensor model
            past = [
                PastAudit(
                    audit,
                    other.sensor_model,
                    made.method_id,
                    at,
                    made.verdict == Verdict.FAIL and made.decision.predicted.verdict == Verdict.PASS,
                )
                for other in registry.lots.all()
                if other.id != lot.id and other.sensor_model == lot.sensor_model
                for audit, at, made in self._audited(other).values()
                if made.is_audited
            ]
        # Audits of this lot under another method say as much as those of another lot: nothing.
        past += [
            PastAudit(audit, lot.sensor_model, made.method_id, at)
            for audit, at, made in audited.values()
            if made.method_id != method_id
        ]
        # How many units the lot has, or is planned to have where a line was told so
        planned = registry.lots.line_rules(lot).target or 0
        units = max(planned, sum(registry.pages.verdict_counts(lot.id).values()))
        golden_failed_at = self._golden_failed_at(lot)
        qualification = qualify(here, past, now, lot.sensor_model, method_id, golden_failed_at, units)
        gains = [reading.gain for audit in here if (reading := readings[audit.serial]) is not None]
        widening = self._widening(qualification, lot_id)
        limit = lot_limit(registry, lot_id)
        lines = {
            made.serial: LoadLine(*made.audit_line, made.output_level)
            for _, _, made in audited.values()
            if made.audit_line is not None and ANCHORED not in made.knowledge
        }
        common = common_misreading(lines) if qualification.source == THIS_LOT else None
        seen, days = seen_gains(gains), self._days(lot, now)
        return AuditEvidence(qualification, limit, widening, seen, days, doubts, lines, common)

    def _days(self, lot: Lot, now: datetime) -> SeenGains | None:
        """Return gains of golden units of this sensor model, one a day, each about its mean."""
        gains: list[float] = []
        since = now - timedelta(days=RULES.lasts_days)
        for serial in sorted({run.serial for run in self._registry.stations.golden_runs(since=since)}):
            for known in self._registry.calibrations.lots_of(serial):
                if lot.sensor_model and self._registry.lots.get(known).sensor_model == lot.sensor_model:
                    by_day = self._gains_by_day(known, serial, now)
                    gains += [gain / float(np.mean(by_day)) for gain in by_day]
        return seen_gains(gains)

    def _gains_by_day(self, lot_id: str, serial: str, now: datetime) -> list[float]:
        registry, days = self._registry, dict[date, list[float]]()
        calibration: Calibration | None
        if serial == registry.lots.get(lot_id).source:
            state = registry.networks.released(lot_id)
            if state is None:
                return []
            reads_with, calibration = state.network.id, None
            network = registry.networks.get(reads_with)
        else:
            record = registry.calibrations.get(serial, lot_id=lot_id).record
            reads_with, calibration = record.input_sha256, Calibration.from_record(record)
            network = registry.networks.get(record.network_id)
        for entry in registry.recordings.of_lot(lot_id, serial, "audit"):
            if now - entry.added_at > timedelta(days=RULES.lasts_days):
                continue
            key = entry.sha256, reads_with
            if key not in self._golden:
                recording = registry.recordings.get(entry.sha256)
                if not isinstance(recording, LabelledRecording):
                    continue
                if calibration is None:
                    # The source has no map: f alone reads its runs.
                    gain = line_of(network.evaluate(recording.windows), recording.window_reference)[0]
                else:
                    gain = read_gain(network, calibration, recording)
                self._golden[key] = gain
            days.setdefault(entry.added_at.astimezone().date(), []).append(self._golden[key])
        return [float(np.mean(gains)) for gains in days.values()]

    def _golden_failed_at(self, lot: Lot) -> datetime | None:
        """Return when a golden unit last failed; one of another model says nothing here."""
        registry = self._registry
        failed = [run for run in registry.stations.golden_runs() if not run.passed]
        models = {
            run.serial: {registry.lots.get(known).sensor_model for known in registry.calibrations.lots_of(run.serial)}
            for run in failed
        }
        mine = (run.made_at for run in failed if not models[run.serial] or lot.sensor_model in models[run.serial])
        return max(mine, default=None)

    def _audited(self, lot: Lot) -> Audited:
        """Return the audited units that speak for the others: a random draw, where there is one."""
        plan = lot_audit(self._registry, lot.id)
        at = {serial: entry.added_at for serial, entry in newest_audits(self._registry, lot.id).items()}
        doubtful = set() if plan is None else set(plan.plan.doubtful)
        audited = {}
        for serial, standing in self._registry.pages.standings(lot.id, sorted(set(at) - doubtful)).items():
            made = standing.made
            if made is None or made.decision.measured is None or not made.is_open:
                continue
            if made.forecast_rmse and made.after_rmse:
                audited[serial] = AuditedUnit(serial, made.forecast_rmse, made.after_rmse, lot.id), at[serial], made
        return audited

    def _widening(self, qualification: Qualification, lot_id: str) -> Widening:
        serials: dict[str, list[str]] = {}
        for audit in qualification.audits[: RULES.most_audits]:
            serials.setdefault(audit.lot_id or lot_id, []).append(audit.serial)
        readings = []
        for lot, audited in serials.items():
            standings = self._registry.pages.standings(lot, audited)
            made = [standings[serial].made for serial in audited if serial in standings]
            readings += [self._reading(lot, one) for one in made if one is not None]
        units = [AuditedSamples(np.array(r.residual), np.array(r.half)) for r in readings if r is not None]
        return fit_widening(units, CONFIDENCE) if units else Widening()

    def _reading(self, lot_id: str, made: MadeCalibration) -> AuditReading | None:
        key = lot_id, made.serial, made.revision
        if made.audit is not None or key in self._older:
            return made.audit or self._older[key]
        registry, reading = self._registry, None
        audit = audit_of(registry, newest_audits(registry, lot_id, made.serial).get(made.serial))
        if audit is not None:
            record = registry.calibrations.get(made.serial, lot_id=lot_id).record
            recording = unlabelled(registry.recordings.get(record.recording_sha256))
            network, calibration = registry.networks.get(record.network_id), Calibration.from_record(record)
            reading = with_audit(network, calibration, audit, recording).audit
        self._older[key] = reading
        return reading
