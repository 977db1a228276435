"""May this station run? One answer from facts, with every reason at once. No clock and no device here."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date, datetime, timedelta

from softcal.core.orders import OrderKind


@dataclass(frozen=True)
class CellCertificate:
    """The load cell's calibration, from its certificate (a DCC or typed in).

    Args:
        number: of the certificate.
        valid_until: last day on which it holds.
        capacity_N: upper end of the calibrated range.
        uncertainty_N: expanded uncertainty, k = 2.
    """

    number: str
    valid_until: date
    capacity_N: float
    uncertainty_N: float


@dataclass(frozen=True)
class GoldenCheck:
    """The newest run of a golden unit.

    Args:
        at: when, with time zone.
        serial: of the golden unit.
        is_in_control: whether it lay within its own control limits.
    """

    at: datetime
    serial: str
    is_in_control: bool


@dataclass(frozen=True)
class Override:
    """An engineer's decision to run in spite of the gate; it is audited like any change."""

    actor: str
    reason: str
    until: datetime


@dataclass(frozen=True)
class StationFacts:
    """What is known when somebody wants to run.

    Args:
        now: this instant, with time zone.
        switched_on: since when the load cell is powered.
        warm_up: how long it must be powered first.
        certificate: of the load cell; None where none is on file.
        largest_force_N: that the profile may reach: the station's force limit.
        zero_return_N, zero_return_limit_N: of the newest run; 0 before the first.
        shift_began: the golden unit must have been pressed since then.
        golden: its newest run; None where there is none.
        is_homing_possible: whether the last homing succeeded, or none was tried.
        override: an engineer's decision, where there is one.
    """

    now: datetime
    switched_on: datetime
    certificate: CellCertificate | None
    largest_force_N: float
    shift_began: datetime
    golden: GoldenCheck | None
    zero_return_N: float = 0.0
    zero_return_limit_N: float = 0.2
    is_homing_possible: bool = True
    warm_up: timedelta = timedelta(minutes=15)
    override: Override | None = None


@dataclass(frozen=True)
class Gate:
    """The answer.

    Args:
        reasons: everything that speaks against it, each with what to do; empty when all is well.
        is_overridden: whether an engineer lets it run in spite of them.
    """

    reasons: tuple[str, ...]
    is_overridden: bool = False

    @property
    def is_open(self) -> bool:
        return not self.reasons or self.is_overridden


def may_run(facts: StationFacts, kind: OrderKind = OrderKind.UNIT) -> Gate:
    """Return whether a station may run, and every reason why not.

    A golden unit may be pressed while only its own check is missing, so that a station can be qualified again; a
    self-test may always run (the rule of SENAITE: an instrument out of control may still measure its reference).
    """
    reasons = [*_certificate_reasons(facts), *_rig_reasons(facts)]
    if kind is not OrderKind.GOLDEN:
        reasons += _golden_reasons(facts)
    if kind is OrderKind.CHECK:
        reasons = []
    is_overridden = bool(reasons) and facts.override is not None and facts.now <= facts.override.until
    return Gate(tuple(reasons), is_overridden)


def quarantined(
    pressed: Sequence[tuple[str, datetime]], checks: Sequence[GoldenCheck], now: datetime
) -> tuple[str, ...]:
    """Return the serials pressed since the last good check, once a check has failed (ISO/IEC 17025, 6.4.9).

    Args:
        pressed: (serial, when) of every unit, in any order.
        checks: runs of golden units, in any order.
        now: checks and units after it do not count.

    Returns:
        Serials in the order they were pressed; empty while the newest check is good.
    """
    known = sorted((check for check in checks if check.at <= now), key=lambda check: check.at)
    if not known or known[-1].is_in_control:
        return ()
    good = [check.at for check in known if check.is_in_control]
    since = good[-1] if good else datetime.min.replace(tzinfo=now.tzinfo)
    return tuple(serial for serial, at in sorted(pressed, key=lambda unit: unit[1]) if since < at <= now)


def _certificate_reasons(facts: StationFacts) -> list[str]:
    certificate = facts.certificate
    if certificate is None:
        return ["the load cell has no certificate on file; import it or type it in"]
    reasons = []
    if facts.now.date() > certificate.valid_until:
        reasons.append(
            f"the load cell's certificate {certificate.number} ended on {certificate.valid_until}; have it calibrated"
        )
    if facts.largest_force_N > certificate.capacity_N:
        reasons.append(
            f"the profile reaches {facts.largest_force_N:g} N, the certificate ends at {certificate.capacity_N:g} N; "
            "use another cell or a lower force limit"
        )
    return reasons


def _rig_reasons(facts: StationFacts) -> list[str]:
    reasons = []
    left = facts.warm_up - (facts.now - facts.switched_on)
    if left > timedelta(0):
        minutes = -(-int(left.total_seconds()) // 60)
        reasons.append(f"the load cell warms up for {minutes} more min; wait")
    if abs(facts.zero_return_N) > facts.zero_return_limit_N:
        reasons.append(
            f"the load cell's zero moved by {facts.zero_return_N:.3g} N, {facts.zero_return_limit_N:g} N is allowed; "
            "check its mounting, then press the golden unit"
        )
    if not facts.is_homing_possible:
        reasons.append("the stage could not be homed; check its switch, then acknowledge")
    return reasons


def _golden_reasons(facts: StationFacts) -> list[str]:
    golden = facts.golden
    if golden is None or golden.at < facts.shift_began:
        return ["no golden unit was pressed in this shift; press one"]
    if not golden.is_in_control:
        return [
            f"golden unit {golden.serial} lies outside its control limits; units since the last good check are "
            "quarantined; call the engineer"
        ]
    return []
