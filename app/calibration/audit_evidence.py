"""What audits of a lot and of earlier lots say about its other units: each audit read once."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import date, datetime, timedelta
from functools import cached_property, partial

import numpy as np

from softcal.app.calibration.audit import confirmed_audits, find_random_audits
from softcal.app.registry.limit import lot_limit
from softcal.app.registry.lot_recordings import newest_audits
from softcal.core.lot import Lot
from softcal.core.messages.reason import Reason
from softcal.core.quality.acceptance import min_units, tolerance_factor
from softcal.core.quality.audit_check import find_suspect_audits
from softcal.core.quality.interval_inflation import AuditedSamples, fit_interval_inflation
from softcal.core.quality.qualification import PastAudit, Qualification, qualify
from softcal.core.quality.release import AuditedUnit
from softcal.core.recording import LabelledRecording
from softcal.core.unit.estimate import estimate
from softcal.core.unit.line_spread import EstimatedGains, estimate_gains
from softcal.core.unit.lot_correction import AuditedLine
from softcal.core.unit.method import CONFIDENCE, Method, ReleaseConfig
from softcal.core.unit.output_level import load_line
from softcal.core.unit.state import UnitState
from softcal.core.unit.uncertainty import IntervalInflation
from softcal.core.unit.verdict import Limit, Verdict
from softcal.db.registry import Registry


@dataclass(frozen=True)
class AuditEvidence:
    """All that a decision on a lot's unmeasured units rests on, but their forecasts.

    Args:
        config: numbers of a release, of the method of the lot's calibrations.
        qualification: whether units may be released, and on which audits.
        samples: reads the residuals of these audits.
        gains: gains that the lot's audited units read their loads with; None where too few.
        day_gains: gains of the model's golden units on different days; None where too few.
        suspects: audits of the lot that are set aside, by serial, and why.
        lines: how the audited units of the lot read their loads by their maps as they were fitted.
    """

    config: ReleaseConfig
    qualification: Qualification
    limit: Limit
    samples: Callable[[], Iterable[AuditedSamples]] = tuple
    gains: EstimatedGains | None = None
    day_gains: EstimatedGains | None = None
    suspects: Mapping[str, Reason] = field(default_factory=dict)
    lines: Mapping[str, AuditedLine] = field(default_factory=dict)

    @cached_property
    def interval_inflation(self) -> IntervalInflation:
        """What becomes of the intervals of unmeasured units."""
        return (
            fit_interval_inflation(self.samples(), CONFIDENCE, self.config)
            if self.qualification.audits
            else IntervalInflation()
        )

    def day_rmse(self, load_rms: float | None) -> float:
        """Return the error that another day adds to a unit with this RMS load, in the same unit.
        Nine of ten days stay within it, at the promise's confidence (ISO 16269-6).
        """
        if self.day_gains is None or load_rms is None:
            return 0.0
        factor = tolerance_factor(
            self.day_gains.count, self.day_gains.count - 1, self.config.risk, self.config.confidence
        )
        return factor * self.day_gains.spread * load_rms


Audited = Mapping[str, tuple[AuditedUnit, datetime, UnitState]]


class AuditReader:
    """Reads what audits say, as the states of their units hold it.

    Args:
        method: of the lot's calibrations.
    """

    def __init__(self, registry: Registry, method: Method) -> None:
        self._registry, self._method, self._config = registry, method, method.release
        self._golden: dict[tuple[str, str], float] = {}

    def evidence(self, lot_id: str, now: datetime) -> AuditEvidence:
        registry, lot = self._registry, self._registry.lots.get(lot_id)
        audited = self._audited(lot)
        # A random draw speaks for the other units; the rest speak of their own, and of what all misread alike.
        random_serials = find_random_audits(registry, lot_id)
        suspects = self._suspects(lot_id, audited)
        audited = {serial: entry for serial, entry in audited.items() if serial not in suspects}
        same_method = {serial: entry for serial, entry in audited.items() if entry[2].fit.method.id == self._method.id}
        # The error of another map than the one in force is nobody's: it counts where it is a fail that stays. Nor does
        # one count that was decided on by another limit, before the unit is decided on again.
        limit = lot_limit(registry, lot_id)
        measured = {
            serial: entry
            for serial, entry in same_method.items()
            if entry[2].untrimmed.decision.measured is not None and entry[2].limit.stated_rmse == limit.stated_rmse
        }
        lot_audits = [audit for serial, (audit, _, _) in measured.items() if serial in random_serials]
        past: list[PastAudit] = []
        if len(lot_audits) < min_units(self._config.risk) and lot.sensor_model:
            # The drawn audits of all other lots of the sensor model
            past = [
                PastAudit(
                    audit,
                    other.sensor_model,
                    state.fit.method.id,
                    at,
                    state.verdict == Verdict.FAIL and state.decision.predicted.verdict == Verdict.PASS,
                )
                for other in registry.lots.all()
                if other.id != lot.id and other.sensor_model == lot.sensor_model
                for audit, at, state in self._audited(other).values()
                if state.untrimmed.decision.is_audited and audit.serial in find_random_audits(registry, other.id)
            ]
        # Audits of this lot under another method say as much as those of another lot: nothing.
        past += [
            PastAudit(audit, lot.sensor_model, state.fit.method.id, at)
            for serial, (audit, at, state) in audited.items()
            if serial not in same_method
        ]
        # How many units the lot has, or is planned to have where a line was told so
        planned = registry.lots.line_rules(lot).target or 0
        units = max(planned, sum(registry.pages.verdict_counts(lot.id).values()))
        golden_failed_at = self._golden_failed_at(lot)
        qualification = qualify(lot_audits, past, now, lot.sensor_model, self._method, golden_failed_at, units)
        gains = [state.audit.line.gain for _, _, state in measured.values() if state.audit is not None]
        lines = {
            serial: AuditedLine(state.audit.fitted_line, state.fit.output_level)
            for serial, (_, _, state) in same_method.items()
            if state.audit is not None and not state.fit.correspondence.is_anchored
        }
        samples = partial(self._samples, qualification, lot_id)
        observed, days = estimate_gains(gains, self._config.min_others), self._days(lot, now)
        return AuditEvidence(self._config, qualification, limit, samples, observed, days, suspects, lines)

    def suspects(self, lot_id: str) -> Mapping[str, Reason]:
        """Return the audits of a lot that are set aside, by serial, and why."""
        return self._suspects(lot_id, self._audited(self._registry.lots.get(lot_id)))

    def _suspects(self, lot_id: str, audited: Audited) -> Mapping[str, Reason]:
        confirmed = confirmed_audits(self._registry, lot_id)
        unconfirmed = {
            serial: state.audit
            for serial, (_, _, state) in audited.items()
            if state.audit is not None and confirmed.get(serial) != state.audit.output_sha256
        }
        return find_suspect_audits(unconfirmed, self._method)

    def _days(self, lot: Lot, now: datetime) -> EstimatedGains | None:
        """Return gains of golden units of this sensor model, one a day, each about its mean."""
        gains: list[float] = []
        since = now - timedelta(days=self._config.lasts_days)
        models = {one.id: one.sensor_model for one in self._registry.lots.all()}
        for lot_id, serial in sorted(
            {(run.lot_id, run.serial) for run in self._registry.stations.golden_runs(since=since)}
        ):
            if lot.sensor_model and models.get(lot_id) == lot.sensor_model:
                by_day = self._gains_by_day(lot_id, serial, now)
                gains += [gain / float(np.mean(by_day)) for gain in by_day]
        return estimate_gains(gains, self._config.min_others)

    def _gains_by_day(self, lot_id: str, serial: str, now: datetime) -> list[float]:
        registry, days = self._registry, dict[date, list[float]]()
        calibration: UnitState | None
        if serial == registry.lots.get(lot_id).source:
            released = registry.networks.released(lot_id)
            if released is None:
                return []
            reads_with, calibration = released.network.id, None
            network = registry.networks.get(reads_with)
        else:
            state = registry.calibrations.get(serial, lot_id=lot_id).state
            reads_with, calibration = state.map_id, state
            network = registry.networks.get(state.fit.network_id)
        for entry in registry.recordings.of_lot(lot_id, serial, "audit"):
            if now - entry.added_at > timedelta(days=self._config.lasts_days):
                continue
            key = entry.sha256, reads_with
            if key not in self._golden:
                recording = registry.recordings.get(entry.sha256)
                if not isinstance(recording, LabelledRecording):
                    continue
                if calibration is None:
                    # The source has no map: f alone reads its runs.
                    gain = load_line(network.evaluate(recording.windows), recording.window_reference).gain
                else:
                    read = estimate(network, calibration, recording.unlabelled).estimate
                    gain = load_line(read, recording.reference).gain
                self._golden[key] = gain
            days.setdefault(entry.added_at.astimezone().date(), []).append(self._golden[key])
        return [float(np.mean(gains)) for gains in days.values()]

    def _golden_failed_at(self, lot: Lot) -> datetime | None:
        """Return when a golden unit last failed; one of another model says nothing here."""
        registry = self._registry
        models = {one.id: one.sensor_model for one in registry.lots.all()}
        failed = [run for run in registry.stations.golden_runs() if not run.passed]
        instants = (run.made_at for run in failed if models.get(run.lot_id, lot.sensor_model) == lot.sensor_model)
        return max(instants, default=None)

    def _audited(self, lot: Lot) -> Audited:
        """Return the audited units of a lot that nothing was found against, when each was measured."""
        at = {serial: entry.observed_at for serial, entry in newest_audits(self._registry, lot.id).items()}
        audited = {}
        for serial, status in self._registry.pages.unit_statuses(lot.id, sorted(at), has_stale=True).items():
            state = status.state
            if state is None or state.audit is None or not state.fit.is_open:
                continue
            if state.trim_in_force is not None and state.audit.map_id == state.map_id:
                # What a trimmed map shows says nothing of units without a trim.
                continue
            part, after = state.fit.lot_fit, state.audit.scores.after.rmse
            unit = AuditedUnit(serial, state.fit.forecast.rmse, after, lot.id, part.sitting if part else "")
            audited[serial] = unit, at[serial], state
        return audited

    def _samples(self, qualification: Qualification, lot_id: str) -> Iterator[AuditedSamples]:
        """Yield the audits of a qualification, lot after lot: no more lots are read than are asked for."""
        serials: dict[str, list[str]] = {}
        for audit in qualification.audits:
            serials.setdefault(audit.lot_id or lot_id, []).append(audit.serial)
        for lot, audited in serials.items():
            unit_statuses = self._registry.pages.unit_statuses(lot, audited[: self._config.max_audits], has_stale=True)
            for serial in audited:
                state = unit_statuses[serial].state if serial in unit_statuses else None
                if state is not None and (result := state.audit) is not None:
                    yield AuditedSamples(np.array(result.residual), np.array(result.half))
