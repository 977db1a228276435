"""A LabJack through a library that stands in the place of its own: settings, readings, and every way it can fail."""

import inspect
import sys
import time

import pytest

from softcal.core.errors import CommandRefused, InputError, NoReply
from softcal.core.profiles import moves
from softcal.station.bench.bench import open_simulated_bench
from softcal.station.bench.catalogue import driver_of
from softcal.station.bench.station_file import device_section
from softcal.station.clock import HostClock
from softcal.station.devices.driver import Opening
from softcal.station.drivers.labjack import LabjackConfig
from softcal.station.simulated.labjack import SimulatedLjm
from softcal.station.tasks.acquisition import record
from softcal.station.testing import DriverRig

DRIVER = driver_of("readout", "labjack")


def test_range_and_resolution_are_set_as_the_file_says():
    with DriverRig(DRIVER) as rig:
        rig.open(full_scale_V=1.0, resolution=4).close()
        assert rig.simulated.far_end.registers == {"AIN0_RANGE": 1.0, "AIN0_RESOLUTION_INDEX": 4.0}


def test_a_range_that_the_device_does_not_have_is_refused():
    with DriverRig(DRIVER) as rig:
        rig.simulated.far_end._value = lambda name, now_s: 10.0
        with pytest.raises(CommandRefused, match="AIN0_RANGE.* 0.1 .* 10"):
            rig.open(full_scale_V=0.1)


def test_further_channels_are_the_next_inputs():
    assert LabjackConfig("ANY", channels=3, first_input=4).inputs == ["AIN4", "AIN5", "AIN6"]


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [("full_scale_V", 5.0, "10, 1, 0.1, 0.01"), ("first_input", 300, r"\[0, 254\]"), ("resolution", 13, r"\[0, 12\]")],
)
def test_a_setting_that_cannot_be_is_refused_when_the_file_is_read(key, value, message):
    with pytest.raises(InputError, match=f"readout.{key} is .*{message}"):
        device_section("readout", {"kind": "labjack", "port": "ANY", key: value})


def test_without_the_library_both_parts_are_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "labjack.ljm", None)
    with pytest.raises(NoReply, match=r"LJM.*pip install 'softcal\[labjack\]'") as caught:
        DRIVER.open(LabjackConfig("470012345"), Opening(HostClock()))
    assert "\n" not in str(caught.value)


def test_a_voltage_that_is_no_number_is_no_reading():
    with DriverRig(DRIVER) as rig:
        reader = rig.open()
        reader.start()
        rig.level = float("nan")
        assert "nan" in str(rig.fault_within(1.0, reader.poll)[1])


@pytest.mark.long
def test_a_unit_is_pressed_and_recorded_through_it():
    profile = moves("short", [0.0, 2.0, 0.0], [2.0, 2.0, 2.0], [0.5, 0.5, 0.5])
    with open_simulated_bench(seed=3, readout_kind="labjack") as (bench, _):
        recording = record(bench, "A1", profile, with_reference=True)
    assert (recording.output_unit, recording.sample_rate_Hz) == ("V", 50.0)
    assert recording.force_N is not None and recording.force_N.max() > 1.0


@pytest.mark.long
def test_a_computer_with_other_work_is_no_fault_of_a_simulated_rig():
    profile = moves("short", [0.0, 2.0, 0.0], [2.0, 2.0, 2.0], [0.5, 0.5, 0.5])
    phases = set()

    def stand_still_once_a_phase(progress):
        if progress.phase not in phases:
            phases.add(progress.phase)
            time.sleep(0.5)

    with open_simulated_bench(seed=3, readout_kind="labjack") as (bench, _):
        recording = record(bench, "A1", profile, with_reference=True, on_progress=stand_still_once_a_phase)
    assert len(phases) > 2 and recording.lost == 0


def test_softcal_calls_the_library_as_it_is(monkeypatch):
    import ctypes

    # The module loads LJM, which no package index has, when it is imported.
    monkeypatch.setattr(ctypes.CDLL, "__init__", lambda self, *_, **__: None, raising=True)
    ljm = pytest.importorskip("labjack.ljm")
    for name in ("openS", "close", "eReadName", "eReadNames", "eWriteName"):
        simulated_parameters = list(inspect.signature(getattr(SimulatedLjm, name)).parameters)[1:]
        assert simulated_parameters == list(inspect.signature(getattr(ljm, name)).parameters), name
    assert issubclass(ljm.LJMError, Exception)
