"""May this station run: every reason alone, all of them at once, and who is quarantined."""

from dataclasses import replace
from datetime import UTC, date, datetime, timedelta

import pytest

from softcal.core.orders import OrderKind
from softcal.core.quality.gate import (
    CellAtGate,
    GoldenCheck,
    Override,
    QualificationAtGate,
    RigStatus,
    StationStatus,
    may_run,
    quarantined_units,
)

NOW = datetime(2026, 3, 2, 9, 0, tzinfo=UTC)
GOOD = StationStatus(
    now=NOW,
    certificate=CellAtGate("K-17", date(2027, 1, 1), 20.0, 0.02),
    largest_force_N=12.0,
    shift_began=NOW - timedelta(hours=1),
    golden=GoldenCheck(NOW - timedelta(minutes=30), "G1", True),
    rig=RigStatus(timedelta(hours=2), is_homed=True),
)

WARM = RigStatus(timedelta(hours=2))

REASONS = {
    "no certificate": ({"certificate": None}, "no_certificate", ""),
    "out of date": ({"certificate": CellAtGate("K-17", date(2026, 3, 1), 20.0, 0.02)}, "ended", "2026-03-01"),
    "range": ({"largest_force_N": 25.0}, "too_far", " 20 N"),
    "warm-up": ({"rig": RigStatus(timedelta(minutes=5))}, "warms", " 10 "),
    "zero": ({"rig": replace(WARM, zero_return_N=-0.31)}, "zero_fault", "-0.31 N"),
    "homing": ({"rig": replace(WARM, homing_fault="ALARM:9")}, "homing_fault", "ALARM:9"),
    "no golden": ({"golden": None}, "no_golden", ""),
    "golden of the last shift": ({"golden": GoldenCheck(NOW - timedelta(hours=9), "G1", True)}, "no_golden", ""),
    "never qualified": ({"needs_qualification": True}, "no_qualification", ""),
    "not qualified": ({"qualification": QualificationAtGate(False, date(2027, 1, 1))}, "not_qualified", ""),
    "qualified too long ago": (
        {"qualification": QualificationAtGate(True, date(2026, 3, 2))},
        "qualification_ended",
        "2026-03-02",
    ),
    "qualified by a clock that was ahead": (
        {"qualification": QualificationAtGate(True, date(2031, 3, 2))},
        "qualified_ahead",
        "2031-03-02",
    ),
    "golden out": ({"golden": GoldenCheck(NOW, "G1", False)}, "golden_bad", "G1"),
}


@pytest.mark.parametrize(("change", "code", "message"), REASONS.values(), ids=REASONS)
def test_each_reason_alone_closes_the_gate(change, code, message):
    gate = may_run(replace(GOOD, **change))
    assert not gate.is_open
    (why,) = gate.reasons
    assert why.code == f"gate.{code}" and message in str(why)


def test_a_good_station_may_run_and_what_is_good_is_reported_too():
    assert may_run(GOOD).is_open and len(may_run(GOOD).conditions) == 6
    assert all(condition.is_good and str(condition.says) for condition in may_run(GOOD).conditions)


def test_a_rig_without_a_load_cell_is_not_asked_for_its_certificate():
    status = replace(GOOD, certificate=None, has_cell=False, rig=RigStatus())
    assert may_run(status).is_open and len(may_run(status).conditions) == 2


def test_a_bench_in_development_may_do_without_certificate_and_golden_unit():
    status = replace(GOOD, certificate=None, golden=None, needs_certificate=False, needs_golden=False)
    assert may_run(status).is_open


def test_all_reasons_are_reported_at_once():
    rig = replace(WARM, zero_fault="load cell: reads 3 N unloaded", homing_fault="ALARM:8")
    status = replace(GOOD, certificate=None, golden=None, rig=rig)
    assert len(may_run(status).reasons) == 4


def test_the_last_day_of_a_certificate_still_counts():
    assert may_run(replace(GOOD, certificate=CellAtGate("K", NOW.date(), 20.0, 0.02))).is_open


def test_a_golden_unit_may_qualify_a_station_again():
    status = replace(GOOD, golden=GoldenCheck(NOW, "G1", False))
    assert may_run(status, OrderKind.GOLDEN).is_open
    assert not may_run(replace(status, certificate=None), OrderKind.GOLDEN).is_open


def test_an_override_opens_the_gate_until_it_ends_and_keeps_the_reasons():
    override = Override("kim", "certificate is in the post", NOW + timedelta(hours=1))
    gate = may_run(replace(GOOD, certificate=None, override=override))
    assert gate.is_open and gate.is_overridden and gate.reasons
    assert not may_run(replace(GOOD, certificate=None, override=replace(override, until=NOW - timedelta(1)))).is_open


def test_units_since_the_last_good_check_are_quarantined():
    minutes = [NOW - timedelta(minutes=m) for m in (50, 40, 30, 20, 10)]
    checks = [GoldenCheck(minutes[0], "G1", True), GoldenCheck(minutes[2], "G1", True), GoldenCheck(NOW, "G1", False)]
    presses = [("A4", minutes[4]), ("A2", minutes[1]), ("A3", minutes[3])]
    assert quarantined_units(presses, checks, NOW) == ("A3", "A4")
    assert quarantined_units(presses, checks[:2], NOW) == ()
    assert quarantined_units(presses, checks[2:], NOW) == ("A2", "A3", "A4")


def test_a_failed_check_of_a_clock_that_was_ahead_is_not_forgotten():
    began, later = NOW - timedelta(hours=1), NOW + timedelta(days=300)
    good, failed = GoldenCheck(began, "G1", True), GoldenCheck(later, "G1", False)
    presses = [("A1", began - timedelta(hours=1)), ("A2", NOW - timedelta(minutes=5)), ("A3", later)]
    assert quarantined_units(presses, [failed, good], NOW) == ("A2", "A3")
    # A good check of such a clock says nothing of now.
    ahead = replace(failed, is_in_control=True)
    assert quarantined_units(presses, [good, replace(failed, at=NOW), ahead], NOW) == ("A2", "A3")
