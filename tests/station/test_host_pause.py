"""A host that stands still says so of itself: a moving stage is stopped, devices are judged by what they send then."""

import pickle
import re
import signal
import subprocess
import sys
import time
from contextlib import closing

import numpy as np
import pytest

from softcal.core.errors import DeviceError
from softcal.core.profiles import moves
from softcal.core.twin.simulate import Twin
from softcal.station.bench.bench import open_simulated_bench, simulated_config
from softcal.station.bench.simulated_station import SimulatedStation
from softcal.station.tasks.acquisition import record

PROFILE = moves("short", [0.0, 2.0, 0.0], [2.0, 2.0, 2.0], [1.0, 0.5, 0.5])


def press_with_pause(pause_s, is_due, at_pause=lambda station: None):
    """Press with a host that does nothing for so long, the first time that `is_due(station, progress)`."""
    newest, pending = [], [True]
    with open_simulated_bench(seed=3) as (bench, station):

        def on_wait():
            if pending and newest and is_due(station, newest[-1]):
                pending.clear()
                at_pause(station)
                station.world.sleep_s(pause_s)

        try:
            recording = record(bench, "A1", PROFILE, True, newest.append, None, on_wait)
        except DeviceError as error:
            station.world.sleep_s(1.0)
            assert not station.axis.is_moving and not pending
            return error.reason.values["why"], station
        assert not pending
        return recording, station


def is_pressing_down(station, progress):
    return progress.phase == "pressing" and station.axis.velocity_mm_s > 1.0 and progress.force_N > 0.2


def is_standing_before_press(station, progress):
    return progress.phase == "pressing" and not station.axis.is_moving and progress.force_N < 0.1


@pytest.mark.parametrize("pause_s", [0.3, 0.4, 1.0, 3.0, 20.0])
def test_a_host_that_stands_still_in_a_press_says_so_and_lifts(pause_s):
    why, station = press_with_pause(pause_s, is_pressing_down)
    assert why.code == "rig.host_paused"
    assert why.values["seconds"] == pytest.approx(pause_s, abs=0.1)
    assert station.rig.carriage_mm < station.rig.clearance_mm  # Lifted, and it goes nowhere by itself.


@pytest.mark.parametrize("pause_s", [0.1, 0.2])
def test_a_moment_is_no_pause(pause_s):
    recording, _ = press_with_pause(pause_s, is_pressing_down)
    assert recording.lost == 0


@pytest.mark.parametrize("pause_s", [0.4, 1.0, 3.0])
def test_a_pause_while_the_stage_stands_loses_nothing(pause_s):
    recording, _ = press_with_pause(pause_s, is_standing_before_press)
    assert recording.lost == 0


@pytest.mark.parametrize(("wire", "device"), [("force_wire", "device.cell"), ("readout_wire", "device.readout")])
def test_a_device_that_is_gone_after_a_pause_is_named(wire, device):
    why, _ = press_with_pause(0.4, is_standing_before_press, lambda station: getattr(station, wire).unplug())
    assert why.code == "rig.gone" and why.values["device"].values["device"].code == device


@pytest.mark.parametrize(("wire", "device"), [("force_wire", "device.cell"), ("readout_wire", "device.readout")])
def test_a_device_that_is_silent_after_a_pause_is_named(wire, device):
    def silence(station):
        station.world.at(station.world.now_s() + 0.4, lambda: setattr(getattr(station, wire), "is_silent", True))

    why, _ = press_with_pause(0.4, is_standing_before_press, silence)
    assert why.code == "rig.silent" and why.values["device"].code == device


@pytest.mark.parametrize("wire", ["force_wire", "readout_wire"])
def test_lines_that_were_full_meanwhile_are_the_hosts_doing(wire):
    """While the host stands still, the line takes nothing of a device; then it goes on."""

    def fill(station):
        line, back_s = getattr(station, wire), station.world.now_s() + 1.0
        line.is_silent = True
        station.world.at(back_s, lambda: setattr(line, "is_silent", False))

    why, _ = press_with_pause(1.0, is_standing_before_press, fill)
    assert why.code == "rig.host_paused"


def test_an_overload_that_was_read_late_is_an_overload():
    why, _ = press_with_pause(
        0.4, is_pressing_down, lambda station: setattr(station.rig, "force_fault", lambda now_s, force_N: 100.0)
    )
    assert why.code == "rig.force"


HOST = """
import pickle, sys
from softcal.core.errors import DeviceError
from softcal.station.clock import HostClock
from softcal.station.bench.bench import open_bench
from softcal.station.tasks.acquisition import record

config, profile = pickle.load(sys.stdin.buffer)
with open_bench(config, HostClock()) as bench:
    show = lambda progress: print(progress.phase, progress.stage_mm, flush=True)
    try:
        record(bench, "A1", profile, True, show)
    except DeviceError as error:
        print("refused", error.reason.values["why"].code, str(error), flush=True)
"""


@pytest.mark.long
@pytest.mark.parametrize("pause_s", [0.4, 1.0, 3.0])
def test_a_process_that_is_stopped_and_goes_on_says_that_it_stood_still(pause_s):
    """The rig lives in this process and goes on in real time; the host is another, stopped by its system."""
    station = SimulatedStation(Twin(), np.random.default_rng(3))
    slow = moves("slow", [0.0, 2.5, 0.0], [2.0, 1.0, 2.0], [0.5, 0.5, 0.5])
    python = [sys.executable, "-c", HOST]
    pipe = subprocess.PIPE
    with (
        closing(station),
        station.world.in_background(),
        subprocess.Popen(python, stdin=pipe, stdout=pipe, stderr=subprocess.STDOUT) as host,
    ):
        host.stdin.write(pickle.dumps((simulated_config(station), slow)))
        host.stdin.close()
        lines = []
        for line in host.stdout:
            lines.append(line.decode())
            if line.startswith(b"pressing") and station.axis.velocity_mm_s > 0.5:
                break
        host.send_signal(signal.SIGSTOP)
        time.sleep(pause_s)
        stopped_mm = station.axis.position_mm
        host.send_signal(signal.SIGCONT)
        lines += host.stdout.read().decode().splitlines()
    # On a machine that is busy the host may have stood still before it was stopped.
    assert "refused rig.host_paused" in lines[-1], lines[-5:]
    (reported_s,) = re.findall(r"stood still for ([0-9.]+) s", lines[-1])
    assert 0.25 <= float(reported_s) <= pause_s + 0.2
    assert (
        station.axis.position_mm <= stopped_mm and not station.axis.is_moving
    )  # Lifted, and it goes nowhere by itself.
