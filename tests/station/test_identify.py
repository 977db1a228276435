"""What answers at a port, and a self-test that names every fault at once."""

import re
import subprocess
import sys
from functools import partial

import pytest

from softcal.app.line import rig
from softcal.app.texts.catalogue import text
from softcal.app.texts.reasons import render_reason
from softcal.core.errors import CommandRefused, NoReply
from softcal.core.profiles import ramps
from softcal.core.twin.simulate import Twin
from softcal.station.bench.bench import open_simulated_bench
from softcal.station.bench.simulated_station import SimulatedStation
from softcal.station.drivers.grbl import GrblStage
from softcal.station.tasks.acquisition import record
from softcal.station.tasks.identify import identify
from softcal.station.tasks.self_test import self_test
from softcal.station.wire import link

QUICK = ramps([2.0], 4.0, rest_s=0.3, name="quick")


@pytest.fixture
def station(rng):
    station = SimulatedStation(Twin(), rng)
    yield station
    station.close()


def test_each_device_is_known_by_what_it_says(station):
    wires = (station.stage_wire, station.force_wire, station.readout_wire)
    devices = {device.role: device for device in (identify(wire.port, station.world) for wire in wires)}
    assert (devices["stage"].kind, devices["force"].kind, devices["readout"].kind) == ("grbl", "hx711", "arduino")
    assert devices["force"].rate_Hz == pytest.approx(80.0, rel=0.1)
    assert devices["readout"].rate_Hz == pytest.approx(50.0)


@pytest.mark.parametrize(
    ("wire", "answer"),
    [("stage_wire", "Grbl|GRBL"), ("force_wire", "softcal load cell"), ("readout_wire", "softcal readout")],
)
def test_every_port_says_what_it_answered_in_both_languages(station, wire, answer):
    reply = identify(getattr(station, wire).port, station.world).says
    in_korean = render_reason(reply, partial(text, "ko"))
    assert re.search(answer, str(reply)) and re.search(answer, in_korean) and in_korean != str(reply)


def test_a_port_that_another_program_has_open_without_a_lock_is_named_and_left_alone(station, monkeypatch):
    monkeypatch.setattr(link, "PSEUDO_TERMINALS", "/nowhere/")  # This pty stands for hardware.
    monkeypatch.setattr(rig, "available_ports", lambda: [station.force_wire.port])
    hold = "import os, sys, time; os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY); print(flush=True); time.sleep(60)"
    with subprocess.Popen([sys.executable, "-c", hold, station.force_wire.port], stdout=subprocess.PIPE) as other:
        assert other.stdout.readline()
        (device,) = rig.find_devices([])
        other.kill()
    assert device.role == ""
    assert re.search(rf"\b{other.pid}\b", str(device.says))
    with pytest.raises(NoReply, match=rf"\b{other.pid}\b"):
        rig.station_of([device])


def test_a_controller_that_cannot_home_is_told_every_setting_that_is_unsafe(station):
    station.stage.settings |= {1: 25.0, 20: 0.0, 22: 0.0, 122: 10.0}
    with pytest.raises(CommandRefused) as refused:
        GrblStage(link.Link(station.stage_wire.port, station.world))
    for command in ("$22=1", "$1=255", "$20=1", "$122=200"):
        assert command in str(refused.value)


def test_a_device_that_says_nothing_is_no_device(station):
    station.stage_wire.is_silent = True
    assert identify(station.stage_wire.port, station.world).role == ""


def boots(station, wire, seconds):
    wire.is_silent = True
    station.world.at(station.world.now_s() + seconds, lambda: setattr(wire, "is_silent", False))


@pytest.mark.parametrize("boot_s", [1.6, 2.5])
def test_a_board_that_boots_when_its_port_is_opened_is_known(station, boot_s):
    boots(station, station.readout_wire, boot_s)
    assert identify(station.readout_wire.port, station.world).kind == "arduino"


@pytest.mark.parametrize("board", ["readout_wire", "force_wire"])
def test_a_run_waits_for_a_board_that_boots_and_moves_nothing_meanwhile(board):
    with open_simulated_bench(seed=1) as (bench, station):
        record(bench, "A1", QUICK, True)
        at_mm, began_s, moved = station.axis.position_mm, station.world.now_s(), []
        boots(station, getattr(station, board), 2.5)
        station.world.at(began_s + 2.4, lambda: moved.append(station.axis.position_mm - at_mm))
        assert record(bench, "A2", QUICK, True).serial == "A2"
        assert moved == [0.0]


def test_a_board_that_never_speaks_ends_the_run_before_anything_moves():
    with open_simulated_bench(seed=1) as (bench, station):
        at_mm, station.readout_wire.is_silent = station.axis.position_mm, True
        with pytest.raises(NoReply) as silent:
            record(bench, "A1", QUICK, True)
        assert silent.value.reason.values["why"].code == "rig.silent"
        assert station.axis.position_mm == at_mm


def test_a_good_station_has_only_good_findings():
    with open_simulated_bench(seed=1) as (bench, _):
        assert all(finding.is_good for finding in self_test(bench))


def test_all_faults_are_named_at_once():
    with open_simulated_bench(seed=1) as (bench, station):
        station.stage.switch = "stuck"
        station.readout.rate_factor = 0.5
        station.rig.force_fault = lambda now_s, force_N: force_N + 5.0
        bad = [finding for finding in self_test(bench) if not finding.is_good]
    assert {str(finding.device) for finding in bad} == {"stage", "load cell", "sensor readout"} and len(bad) == 3
    assert any("50 Hz" in str(finding.cure) for finding in bad)


def test_without_motion_nothing_moves():
    with open_simulated_bench(seed=1) as (bench, station):
        at_mm = station.axis.position_mm
        self_test(bench, may_move=False)
        assert station.axis.position_mm == at_mm


@pytest.mark.parametrize(
    ("stage_kind", "force_kind"),
    [("zaber", "mark10"), ("grbl", "indicator"), ("grbl", "loadstar"), ("esm", "mark10")],
    ids=lambda kind: kind,
)
def test_other_dialects_are_known_too(rng, stage_kind, force_kind):
    station = SimulatedStation(Twin(), rng, stage_kind=stage_kind, force_kind=force_kind)
    station.axis.position_mm = 0.0
    assert identify(station.stage_wire.port, station.world).kind == stage_kind
    assert identify(station.force_wire.port, station.world).kind == force_kind
    station.close()
