"""Audits that may not be what they are said to be are named, one by one; audits of differing units are not."""

from dataclasses import replace

import pytest

from softcal.core.quality.audit_check import find_suspect_audits
from softcal.core.unit.method import Method
from tests.unit_states import audit_result


def with_gain(one, factor):
    return replace(one, line=replace(one.line, gain=factor * one.line.gain))


@pytest.fixture
def readings(rng):
    rest = {f"U{k}": 0.3 + 0.1 * k for k in range(8)}
    return {s: audit_result(s, 1 + 0.15 * rng.normal(), value, value + 0.02) for s, value in rest.items()}


def codes(readings):
    return {serial: why.code for serial, why in find_suspect_audits(readings, Method()).items()}


def test_audits_of_units_that_differ_and_of_a_day_with_another_zero_are_taken(readings):
    assert codes(readings) == codes({}) == {}


def test_one_recording_for_two_units_names_both(readings):
    readings["U3"] = replace(readings["U3"], output_sha256="U1")
    assert codes(readings) == dict.fromkeys(("U1", "U3"), "doubt.one_recording")


def exchanged(readings, first, second):
    one, other = readings[first], readings[second]
    moved = replace(one, audit_rest=other.audit_rest), replace(other, audit_rest=one.audit_rest)
    return {**readings, first: moved[0], second: moved[1]}


def test_exchanged_audits_are_named_and_no_other(readings):
    assert codes(exchanged(readings, "U2", "U6")) == dict.fromkeys(("U2", "U6"), "doubt.exchanged")


def test_rests_that_wander_overnight_by_as_much_as_units_differ_are_no_exchange(rng):
    """Eight-bit counts: units rest within a few counts of one another, and so do their own rests a day later."""
    for _ in range(200):
        unit_rest = rng.integers(238, 245, 12).astype(float)
        audit_rest = unit_rest + rng.integers(-3, 2, 12)
        lot = {
            f"R{k}": replace(audit_result(f"R{k}", unit_rest=u, audit_rest=a), span=38.0)
            for k, (u, a) in enumerate(zip(unit_rest, audit_rest, strict=True))
        }
        assert codes(lot) == {}


@pytest.mark.parametrize(("others", "is_named"), [(2, False), (3, True)])
def test_three_others_name_an_audit_in_another_unit_and_two_do_not(others, is_named):
    lot = {f"U{k}": audit_result(f"U{k}", 9.80665 if k == 0 else 1.0, 0.3 + 0.1 * k) for k in range(others + 1)}
    assert codes(lot) == ({"U0": "doubt.gain"} if is_named else {})


@pytest.mark.parametrize("factor", [1 / 101.97, 9.80665, -1.0], ids=["gf for N", "kgf for N", "pushed for pulled"])
def test_a_reference_in_another_unit_is_out_of_line(readings, factor):
    readings["U4"] = with_gain(readings["U4"], factor)
    assert codes(readings) == {"U4": "doubt.gain"}


def test_a_lot_that_misreads_as_a_whole_does_not_contradict_itself(readings):
    assert codes({s: with_gain(one, 5.0) for s, one in readings.items()}) == {}


def test_the_audit_of_a_unit_that_is_not_of_the_lot_is_named(readings):
    readings["U5"] = replace(readings["U5"], audit_rest=readings["U5"].unit_rest + 0.4)
    suspects = find_suspect_audits(readings, Method())
    assert {serial: why.code for serial, why in suspects.items()} == {"U5": "doubt.foreign_unit"}
    assert suspects["U5"].values["rest"] == pytest.approx(1.2) and suspects["U5"].values["unit_rest"] == pytest.approx(
        0.8
    )


def test_audits_that_all_rest_elsewhere_name_nobody(readings, rng):
    assert codes({s: replace(one, audit_rest=one.audit_rest + 0.3 * rng.normal()) for s, one in readings.items()}) == {}
