"""Audits that cannot all be true are refused, each with its line; audits of differing units are not."""

from dataclasses import replace

import pytest

from softcal.core.errors import InputError
from softcal.core.quality.audit_check import check_audits
from softcal.core.unit.audit_reading import AuditReading


def reading(name, gain=1.0, rest=0.5, audit_rest=None):
    return AuditReading(
        name, f"loads of {name}", gain, rest, rest if audit_rest is None else audit_rest, 1.0, (0.0, 1.0), (1.0, 1.0)
    )


@pytest.fixture
def readings(rng):
    rest = {f"U{k}": 0.3 + 0.1 * k for k in range(8)}
    return {s: reading(s, 1 + 0.15 * rng.normal(), value, value + 0.02) for s, value in rest.items()}


def test_audits_of_units_that_differ_and_of_a_day_with_another_zero_are_taken(readings):
    check_audits(readings)
    check_audits({})


def test_one_recording_for_two_units_is_refused(readings):
    readings["U3"] = replace(readings["U3"], output_sha256="U1")
    with pytest.raises(InputError, match="U1.*U3"):
        check_audits(readings)


def test_exchanged_audits_are_named(readings):
    one, other = readings["U2"], readings["U6"]
    readings["U2"] = replace(one, audit_rest=other.unit_rest + 0.002)
    readings["U6"] = replace(other, audit_rest=one.unit_rest - 0.002)
    with pytest.raises(InputError, match="U2.*U6"):
        check_audits(readings)


@pytest.mark.parametrize("factor", [1 / 101.97, 9.80665, -1.0], ids=["gf for N", "kgf for N", "pushed for pulled"])
def test_a_reference_in_another_unit_contradicts_the_others(readings, factor):
    readings["U4"] = replace(readings["U4"], gain=readings["U4"].gain * factor)
    with pytest.raises(InputError, match="U4"):
        check_audits(readings)


def test_a_lot_that_misreads_as_a_whole_does_not_contradict_itself(readings):
    check_audits({s: replace(one, gain=5 * one.gain) for s, one in readings.items()})


def test_the_audit_of_a_unit_that_is_not_of_the_lot_is_named(readings):
    readings["U5"] = replace(readings["U5"], audit_rest=readings["U5"].unit_rest + 0.4)
    with pytest.raises(InputError, match=r"U5 .* 1\.2 .* 0\.8"):
        check_audits(readings)


def test_audits_that_all_rest_elsewhere_name_nobody(readings, rng):
    check_audits({s: replace(one, audit_rest=one.audit_rest + 0.3 * rng.normal()) for s, one in readings.items()})


def test_an_audit_is_kept_as_json_and_what_an_older_version_kept_is_read_again(readings):
    assert AuditReading.of(readings["U1"].to_json()) == readings["U1"]
    assert AuditReading.of({**reading("U1").to_json(), "ratios": [0.0, 1.0]}) is not None
    older = {name: value for name, value in reading("U1").to_json().items() if name not in ("residual", "half")}
    assert AuditReading.of({**older, "ratios": [0.0, 1.0]}) is None
