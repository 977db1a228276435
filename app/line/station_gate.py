"""State of a station for its gate, from the registry; and the golden check that opens the gate."""

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np

from softcal.app.line.qualification import newest_qualification
from softcal.app.registry.unit import calibrated_unit
from softcal.core.errors import InputError
from softcal.core.lot import UnitKey
from softcal.core.messages.reason import Reason, reason
from softcal.core.metrics import rmse
from softcal.core.orders import OrderKind
from softcal.core.quality.control_chart import control_chart
from softcal.core.quality.gate import (
    CellAtGate,
    Gate,
    GoldenCheck,
    Override,
    RigStatus,
    StationStatus,
    may_run,
    quarantined_units,
)
from softcal.core.recording import LabelledRecording
from softcal.core.unit.day_correction import fit_day_correction
from softcal.core.unit.estimate import estimate
from softcal.core.unit.source_model import SourceModel
from softcal.core.unit.verdict import default_limit
from softcal.db.entries import GoldenRun
from softcal.db.registry import Registry
from softcal.db.schema.deadline import MAX_CLOCK_ERROR, has_passed
from softcal.station.devices.config import StationConfig

FIRST_RUNS = 8
"""So many runs of a golden unit make its control limits; until then the lot's limit judges it."""

SHIFT = timedelta(hours=8)


@dataclass(frozen=True)
class GateRules:
    """Strictness of the gate of this line.

    A golden unit must have been pressed within `shift`. A bench in development may omit certificate and golden unit; a
    line may not.
    """

    warm_up: timedelta = timedelta(minutes=15)
    shift: timedelta = SHIFT
    needs_certificate: bool = True
    needs_golden: bool = True
    needs_qualification: bool = False


RIG_ONLY = GateRules(timedelta(0), needs_certificate=False, needs_golden=False)
"""What the rig alone shows; all that a simulated station can be asked for."""


class StationGate:
    """Gate of one station, evaluated for every order from registry and rig."""

    def __init__(self, registry: Registry, station: str, config: StationConfig, rules: GateRules) -> None:
        self._registry, self._station, self._config, self._rules = registry, station, config, rules
        self._override: Override | None = None

    def __call__(self, kind: OrderKind, rig: RigStatus) -> Gate:
        """Return whether an order of this kind may run now."""
        now, rules, config = datetime.now(UTC), self._rules, self._config
        golden = golden_checks(self._registry, self._station, now, now - rules.shift)
        entries = () if config.force is None else self._registry.stations.certificates(config.force.serial)
        certificate = None
        if entries:
            newest = entries[-1]
            last_day = newest.due_on - timedelta(days=1)
            certificate = CellAtGate(newest.number, last_day, newest.capacity_N, newest.uncertainty_N)
        is_over = self._override is None or has_passed(self._override.until, now, rules.shift)
        status = StationStatus(
            now=now,
            certificate=certificate,
            largest_force_N=config.safety.force_N,
            shift_began=now - rules.shift,
            golden=golden[-1] if golden else None,
            qualification=newest_qualification(self._registry, self._station),
            rig=rig,
            zero_return_limit_N=config.safety.zero_return_N,
            warm_up=rules.warm_up,
            has_cell=config.force is not None,
            needs_certificate=rules.needs_certificate,
            needs_golden=rules.needs_golden,
            needs_qualification=rules.needs_qualification,
            override=None if is_over else self._override,
        )
        return may_run(status, kind)

    def override(self, actor: str, reason: str) -> None:
        """Open the gate for a shift in spite of its reasons, with an entry in the audit trail."""
        if not reason.strip():
            raise InputError(Reason("gate.needs_reason"))
        until = datetime.now(UTC) + self._rules.shift
        details = {"until": until.isoformat()}
        self._registry.trail.add(
            "override", "station_gate", (self._station,), details, reason=reason, actor=actor or None
        )
        self._override = Override(actor, reason, until)


def check_golden(
    registry: Registry,
    station: str,
    recording: LabelledRecording,
    actor: str = "",
    *,
    recording_sha256: str | None = None,
    source: SourceModel | None = None,
    lot_id: str | None = None,
) -> GoldenRun:
    """Decide a run of a golden unit by its control chart, and store the check.

    The value is the error of the unit's estimates against the load cell; once it has run often enough, it must lie
    within three sigma of its own control chart, before that below the limit of its lot.

    Args:
        source: where the golden unit is the source of a lot itself, which f reads without a map.
        lot_id: of the unit; required if several lots have its serial.

    Raises:
        InputError: the unit is no source and has no calibration in the registry.
    """
    unit, serial = recording.reference_unit, recording.serial
    lot_id = registry.calibrations.unit_key(serial, lot_id).lot_id
    if source is None:
        stored = registry.calibrations.get(serial, lot_id=lot_id)
        lot, network, calibration = calibrated_unit(registry, serial, lot_id=lot_id)
        estimates = estimate(network, calibration, recording.unlabelled).estimate
        value = float(np.sqrt(np.nanmean((estimates - recording.reference) ** 2)))
        # Without a limit of its lot, the one that its own verdict was given by.
        widest = lot.limit_rmse or stored.state.limit.maximum_rmse
    else:
        value = rmse(source.network.evaluate(recording.windows), recording.window_reference)
        default = default_limit(unit, source.held_out_rmse, source.full_range, source.method.decision).maximum_rmse
        widest = registry.lots.get(lot_id).limit_rmse or default
    earlier = [run.value for run in registry.stations.golden_runs(station, serial, lot_id=lot_id) if run.passed]
    has_history = len(earlier) >= FIRST_RUNS
    largest = control_chart(np.array(earlier)).upper if has_history else widest
    limit_kind = Reason("golden.own_limit" if has_history else "golden.lot_limit")
    reasons = (
        () if value <= largest else (reason("golden.error", error=value, unit=unit, what=limit_kind, limit=largest),)
    )
    if source is not None:
        # What units are to be fitted to must be readable when they come.
        try:
            fit_day_correction(source, recording)
        except InputError as error:
            reasons = (*reasons, error.reason)
    run = GoldenRun(
        station, lot_id, serial, datetime.now(UTC), value, unit, not reasons, reasons, actor, recording_sha256
    )
    registry.stations.add_golden_run(run)
    return run


def quarantine(registry: Registry, station: str, now: datetime) -> tuple[str, ...]:
    """Return the units, as LOT/SERIAL, that a station pressed since its last good golden unit, once one has failed."""
    presses = [
        (str(UnitKey(order.lot_id, order.serial)).removeprefix("/"), order.created)
        for order, progress in registry.order_queue.runs(station, 10_000)
        if order.kind is OrderKind.UNIT and progress.recording_sha256 and order.created is not None
    ]
    return quarantined_units(presses, golden_checks(registry, station, now), now)


def golden_checks(registry: Registry, station: str, now: datetime, since: datetime | None = None) -> list[GoldenCheck]:
    """Return the checks of a station that count, oldest first; of those stamped `since` or later.

    One that is stamped after `now`, or after a check that was stored later, was stamped by a clock that was ahead. When
    it was made nobody knows: a good one says nothing, a failed one counts until the next one that was stored.
    """
    checks: list[GoldenCheck] = []
    for runs in registry.stations.stored_checks(station, since).values():
        latest = now
        for run in reversed(runs):
            is_ahead = run.made_at > latest + MAX_CLOCK_ERROR
            latest = min(latest, run.made_at)
            if not is_ahead or not run.passed:
                checks.append(GoldenCheck(latest, run.serial, run.passed))
    return sorted(reversed(checks), key=lambda check: check.at)
