"""May this station run? One answer from facts, with every reason at once. No clock and no device here."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date, datetime, timedelta

from softcal.core.messages.reason import Reason, reason
from softcal.core.orders import Condition, OrderKind

MAX_QUALIFIED = timedelta(days=366)
"""A qualification holds no longer: one that seems to was stamped by a clock that was ahead."""


@dataclass(frozen=True)
class CellAtGate:
    """The load cell's certificate (a DCC or typed in): its last valid day, its range, and its U (k = 2)."""

    number: str
    valid_until: date
    capacity_N: float
    uncertainty_N: float


@dataclass(frozen=True)
class GoldenCheck:
    """The newest run of a golden unit, and whether it lay within its own control limits."""

    at: datetime
    serial: str
    is_in_control: bool


@dataclass(frozen=True)
class QualificationAtGate:
    """The newest qualification of the station: whether it passed, and the first day on which it holds no longer."""

    is_passed: bool
    due_on: date


@dataclass(frozen=True)
class Override:
    """An engineer's decision to run in spite of the gate; it is audited like any change."""

    actor: str
    reason: str
    until: datetime


@dataclass(frozen=True)
class RigStatus:
    """What the rig says of itself.

    Args:
        powered: how long the load cell is powered, by its own clock where it has one.
        is_homed: whether the stage knows where it is; a run homes first where it does not.
        homing_fault, zero_fault: what the last run died of, where it was homing or the load cell's zero; None else. A
            good self-test clears them.
        zero_return_N: change of the unloaded load cell over the newest run; 0 before the first.
    """

    powered: timedelta = timedelta(0)
    is_homed: bool = False
    homing_fault: Reason | None = None
    zero_fault: Reason | None = None
    zero_return_N: float = 0.0


@dataclass(frozen=True)
class StationStatus:
    """What is known when somebody wants to run.

    Args:
        certificate: of the load cell; None where none is on file.
        shift_began: the golden unit must have been pressed since then.
        qualification: None where the station was never qualified; one that is there counts, needed or not.
    """

    now: datetime
    certificate: CellAtGate | None
    largest_force_N: float
    shift_began: datetime
    golden: GoldenCheck | None
    qualification: QualificationAtGate | None = None
    rig: RigStatus = RigStatus()
    zero_return_limit_N: float = 0.2
    warm_up: timedelta = timedelta(minutes=15)
    has_cell: bool = True
    needs_certificate: bool = True
    needs_golden: bool = True
    needs_qualification: bool = False
    override: Override | None = None


@dataclass(frozen=True)
class Gate:
    """The answer, and whether an engineer lets it run in spite of what is not good."""

    conditions: tuple[Condition, ...] = ()
    is_overridden: bool = False

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """Everything that speaks against it, each with what to do; empty when all is well."""
        return tuple(condition.says for condition in self.conditions if not condition.is_good)

    @property
    def is_open(self) -> bool:
        """Whether the station may run."""
        return not self.reasons or self.is_overridden


def may_run(status: StationStatus, kind: OrderKind = OrderKind.UNIT) -> Gate:
    """Return whether a station may run, and every reason why not.

    A golden unit may be pressed while only its own check is missing, so that a station can be qualified again. A
    self-test may always run (the rule of SENAITE: an instrument out of control may still measure its reference). So may
    a reading at rest, which needs no load cell and moves nothing.
    """
    if kind in (OrderKind.CHECK, OrderKind.LOAD):
        return Gate()
    certificate = _certificate(status) if status.has_cell and status.needs_certificate else []
    cell = [*certificate, _warm_up(status), _zero(status)] if status.has_cell else []
    qualified = [_qualification(status)] if status.qualification is not None or status.needs_qualification else []
    conditions = [*cell, _homing(status.rig), *qualified]
    if kind is not OrderKind.GOLDEN and status.needs_golden:
        conditions.append(_golden(status))
    has_override = status.override is not None and status.now <= status.override.until
    return Gate(tuple(conditions), has_override and not all(condition.is_good for condition in conditions))


def quarantined_units(
    presses: Sequence[tuple[str, datetime]], checks: Sequence[GoldenCheck], now: datetime
) -> tuple[str, ...]:
    """Return the names of the units pressed since the last good check, once a check has failed (ISO/IEC 17025, 6.4.9).

    Units, (name, when), and checks of golden units may come in any order. What is stamped after `now` was stamped by
    a clock that was ahead: a failed check counts as one of now, a unit as pressed since, a good check does not count.
    Names come in the order they were pressed; none while the newest check is good.
    """
    relevant = sorted((c for c in checks if c.at <= now or not c.is_in_control), key=lambda check: check.at)
    if not relevant or relevant[-1].is_in_control:
        return ()
    # Between the last good and the first bad check nobody knows when the station went wrong: all of them are suspect.
    good = [check.at for check in relevant if check.is_in_control]
    since = good[-1] if good else datetime.min.replace(tzinfo=now.tzinfo)
    return tuple(serial for serial, at in sorted(presses, key=lambda unit: unit[1]) if since < at)


def _certificate(status: StationStatus) -> list[Condition]:
    certificate = status.certificate
    name = Reason("gate.name.certificate")
    if certificate is None:
        return [Condition(name, False, Reason("gate.no_certificate"))]
    is_valid = status.now.date() <= certificate.valid_until
    code = "gate.valid" if is_valid else "gate.ended"
    in_date = Condition(name, is_valid, reason(code, number=certificate.number, day=str(certificate.valid_until)))
    capacity_reason = reason("gate.reaches", force_N=status.largest_force_N, most_N=certificate.capacity_N)
    if status.largest_force_N > certificate.capacity_N:
        return [
            in_date,
            Condition(Reason("gate.name.force_range"), False, reason("gate.too_far", reaches=capacity_reason)),
        ]
    return [in_date, Condition(Reason("gate.name.force_range"), True, capacity_reason)]


def _warm_up(status: StationStatus) -> Condition:
    name, remaining = Reason("gate.name.warm_up"), status.warm_up - status.rig.powered
    if remaining > timedelta(0):
        # Rounded up: "0 more min" beside a closed gate would be a riddle.
        return Condition(name, False, reason("gate.warms", minutes=-(-int(remaining.total_seconds()) // 60)))
    return Condition(name, True, reason("gate.warm", minutes=int(status.rig.powered.total_seconds()) // 60))


def _zero(status: StationStatus) -> Condition:
    name, fault = Reason("gate.name.zero_return"), status.rig.zero_fault
    values = {"moved_N": status.rig.zero_return_N, "limit_N": status.zero_return_limit_N}
    if fault or abs(status.rig.zero_return_N) > status.zero_return_limit_N:
        cause = Reason.parse(fault) if fault else reason("gate.zero_moved", **values)
        return Condition(name, False, reason("gate.zero_fault", why=cause))
    return Condition(name, True, reason("gate.zero", **values))


def _homing(rig: RigStatus) -> Condition:
    name = Reason("gate.name.homing")
    if rig.homing_fault:
        return Condition(name, False, reason("gate.homing_fault", why=Reason.parse(rig.homing_fault)))
    return Condition(name, True, Reason("gate.homed") if rig.is_homed else Reason("gate.homes"))


def _qualification(status: StationStatus) -> Condition:
    name, qualification = Reason("gate.name.qualification"), status.qualification
    if qualification is None:
        return Condition(name, False, Reason("gate.no_qualification"))
    if not qualification.is_passed:
        return Condition(name, False, Reason("gate.not_qualified"))
    day, today = qualification.due_on, status.now.date()
    if day > today + MAX_QUALIFIED + timedelta(days=1):
        return Condition(name, False, reason("gate.qualified_ahead", day=str(day)))
    code = "gate.qualified" if today < day else "gate.qualification_ended"
    return Condition(name, today < day, reason(code, day=str(day)))


def _golden(status: StationStatus) -> Condition:
    name, golden = Reason("gate.name.golden"), status.golden
    if golden is None or golden.at < status.shift_began:
        return Condition(name, False, Reason("gate.no_golden"))
    if not golden.is_in_control:
        return Condition(name, False, reason("gate.golden_bad", serial=golden.serial))
    at = golden.at.isoformat(timespec="seconds")
    return Condition(name, True, reason("gate.golden", serial=golden.serial, at=at))
