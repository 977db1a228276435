"""What the registry knows of a station, as facts for its gate; and the check of a golden unit that opens it."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np

from softcal.app.workflow.estimate import calibrated_unit
from softcal.core.control_chart import control_chart
from softcal.core.errors import InputError
from softcal.core.estimate import estimate
from softcal.core.orders import OrderKind
from softcal.core.recording import LabelledRecording
from softcal.core.station_gate import (
    CellCertificate,
    Gate,
    GoldenCheck,
    Override,
    StationFacts,
    may_run,
    quarantined,
)
from softcal.db.entries import GoldenRun
from softcal.db.registry import Registry
from softcal.station.config import StationConfig

FIRST_RUNS = 8
"""So many runs of a golden unit make its control limits; until then the lot's limit judges it."""


@dataclass(frozen=True)
class GateRules:
    """How strict this line is.

    Args:
        warm_up: how long the load cell must be powered.
        shift: a golden unit must have been pressed within this time.
    """

    warm_up: timedelta = timedelta(minutes=15)
    shift: timedelta = timedelta(hours=8)


def gate_from_registry(
    registry: Registry,
    station: str,
    config: StationConfig,
    switched_on: datetime,
    rules: GateRules,
    override: Override | None = None,
) -> Callable[[OrderKind], Gate]:
    """Return the gate of a station: asked anew for every order, from what the registry holds then.

    Args:
        switched_on: since when the load cell is powered; the start of the service where nobody knows better.
        override: an engineer's decision, already in the audit trail.
    """

    def gate(kind: OrderKind) -> Gate:
        now = datetime.now(UTC)
        golden = registry.golden_runs(station)
        facts = StationFacts(
            now=now,
            switched_on=switched_on,
            certificate=_certificate(registry, config),
            largest_force_N=config.safety.force_N,
            shift_began=now - rules.shift,
            golden=_check(golden[-1]) if golden else None,
            warm_up=rules.warm_up,
            override=override,
        )
        return may_run(facts, kind)

    return gate


def check_golden(registry: Registry, station: str, recording: LabelledRecording, actor: str = "") -> GoldenRun:
    """Judge a run of a golden unit against its own history, and store it.

    The value is the error of the unit's estimates against the load cell; once it has run often enough, it must lie
    within three sigma of its own control chart, before that below the limit of its lot.

    Raises:
        InputError: the unit has no calibration in the registry, or its lot no limit.
    """
    lot, network, calibration = calibrated_unit(registry, recording.serial)
    found = estimate(network, calibration, recording.unlabelled).estimate
    value = float(np.sqrt(np.nanmean((found - recording.reference) ** 2)))
    earlier = [run.value for run in registry.golden_runs(station, recording.serial) if run.passed]
    limit = registry.limit(lot.id)
    if len(earlier) >= FIRST_RUNS:
        largest, what = control_chart(np.array(earlier)).upper, "its control limit"
    elif limit is not None and limit.rmse is not None:
        largest, what = limit.rmse, "the limit of its lot"
    else:
        raise InputError(f"lot {lot.id!r} has no limit: it is needed for the first {FIRST_RUNS} runs of a golden unit")
    passed = value <= largest
    unit = recording.reference_unit
    reasons = () if passed else (f"error {value:.3g} {unit} is above {what}, {largest:.3g} {unit}",)
    run = GoldenRun(station, recording.serial, datetime.now(UTC), value, unit, passed, reasons, actor)
    registry.add_golden_run(run)
    return run


def quarantine(registry: Registry, station: str, now: datetime) -> tuple[str, ...]:
    """Return the serials a station pressed since its last good golden unit, once one has failed."""
    pressed = [
        (order.serial, order.created)
        for order, progress in registry.order_queue.runs(station, 10_000)
        if order.kind is OrderKind.UNIT and progress.recording_sha256 and order.created is not None
    ]
    return quarantined(pressed, [_check(run) for run in registry.golden_runs(station)], now)


def _certificate(registry: Registry, config: StationConfig) -> CellCertificate | None:
    if config.force is None:
        return None
    entries = registry.certificates(config.force.serial)
    if not entries:
        return None
    newest = entries[-1]
    last_day = newest.due_on - timedelta(days=1)
    return CellCertificate(newest.number, last_day, newest.capacity_N, newest.uncertainty_N)


def _check(run: GoldenRun) -> GoldenCheck:
    return GoldenCheck(run.made_at, run.serial, run.passed)
