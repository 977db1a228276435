"""`softcal station` as a person uses it: files, exit codes, one clear line."""

import io
import json
import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from softcal.app.cli.main import command_parser
from softcal.app.files.lot_folder import open_lot_folder
from softcal.app.files.recording_file import inspect_recording
from softcal.core.errors import InputError, NoReply
from softcal.core.messages.reason import Reason
from softcal.core.twin.simulate import Twin
from softcal.station.bench.bench import simulated_config
from softcal.station.bench.simulated_station import SimulatedStation
from softcal.station.bench.station_file import read_station_file, station_toml
from softcal.station.interfaces import Sample, StagePosition
from softcal.station.record.spool import Spool, read_spool
from tests.wait import wait_until

SOFTCAL = Path(sys.executable).with_name("softcal")


@pytest.fixture
def softcal():
    """Run `softcal station ...` as the command line does, and give its exit code."""
    parser = command_parser(["station"])

    def call(*arguments: object) -> int:
        options = parser.parse_args(["station", *map(str, arguments)])
        return int(options.run(options) or 0)

    return call


def test_check_of_the_simulated_station_is_good(softcal, tmp_path):
    report = tmp_path / "check.json"
    assert softcal("check", "--simulated", "--json", report) == 0
    content = json.loads(report.read_text())
    assert content["is_good"]
    assert {finding["device"] for finding in content["findings"]} == {"stage", "load cell", "sensor readout"}


def test_check_names_every_port_that_is_missing(softcal):
    with pytest.raises(NoReply, match=r"^.*nowhere-1.*nowhere-2.*$"):
        softcal("check", "--port", "/dev/nowhere-1", "--port", "/dev/nowhere-2")


@pytest.mark.long
def test_source_and_unit_end_in_a_lot_folder_as_it_is_read(softcal, tmp_path):
    for kind, path, seconds in (("source", "lot-1/source/A0.csv", 20), ("unit", "lot-1/units/A1.csv", 6)):
        arguments = ("--serial", path[-6:-4], "--out", tmp_path / path, "--seconds", seconds, "--spool", tmp_path)
        assert softcal(kind, "--simulated", 4, *arguments) == 0
    folder = open_lot_folder(tmp_path / "lot-1")
    assert (folder.lot.id, folder.lot.source, folder.lot.sample_rate_Hz) == ("lot-1", "A0", 50.0)
    labelled = folder.read_source()
    assert labelled.reference.max() > 3.0 and labelled.unlabelled.stage_mm is not None
    # A unit has no reference.
    unit = tmp_path / "lot-1/units/A1.csv"
    assert unit.read_text().splitlines()[0] == "t_s,output,stage_mm"
    assert len(inspect_recording(unit, "A1", 50.0).recording) > 250


def test_a_serial_that_cannot_be_a_file_name_moves_nothing(softcal, tmp_path):
    with pytest.raises(InputError):
        softcal("unit", "--simulated", "--serial", "../A1", "--out", tmp_path / "A1.csv")
    assert not list(tmp_path.iterdir())


def test_no_station_is_a_clear_line(softcal, tmp_path):
    with pytest.raises(InputError, match="--station"):
        softcal("unit", "--serial", "A1", "--out", tmp_path / "A1.csv")


def test_a_station_file_with_an_unknown_key_lists_the_known_ones(softcal, tmp_path):
    path = tmp_path / "station.toml"
    path.write_text('[stage]\nport = "/dev/x"\nspeed = 3\n[readout]\nport = "/dev/y"\n')
    with pytest.raises(InputError, match=r"'speed'.* port, kind"):
        softcal("check", "--station", path)


def test_recover_writes_what_a_run_that_was_cut_off_had_read(softcal, tmp_path):
    with Spool(tmp_path / "spool" / "A1-1.spool", {"serial": "A1", "profile": "unit"}) as spool:
        cell = [Sample(0.01 * k, 0.01 * k, (0.1 * k,)) for k in range(100)]
        polls = [StagePosition(0.1 * k, 2.0 * k) for k in range(11)]
        spool.append([Sample(0.02 * k, 0.02 * k, (0.5,)) for k in range(50)], cell, polls)
    (tmp_path / "spool" / "A0-0.spool").write_bytes(b"")  # what a full disk leaves
    content = (tmp_path / "spool" / "A1-1.spool").read_bytes()
    (tmp_path / "spool" / "A1-1.spool").write_bytes(content[: content.rindex(b"\n", 0, -1) + 1])
    assert softcal("recover", "--spool", tmp_path / "spool", "--out", tmp_path / "out") == 0
    lines = (tmp_path / "out" / "A1-1.aborted.csv").read_text().splitlines()
    assert lines[0] == "device_s,host_s,output_0,force_N,stage_mm,aborted"
    assert len(lines) == 51
    assert [float(value) for value in lines[26].split(",")[:5]] == pytest.approx([0.5, 0.5, 0.5, 5.0, 10.0])
    assert lines[1].endswith("cut off")


@pytest.mark.long
def test_calibrate_cell_writes_the_scale_into_the_station_file(softcal, tmp_path, monkeypatch):
    station = SimulatedStation(Twin(), np.random.default_rng(3))
    station.axis.position_mm = 0.0
    weights_kg = iter((0.0, 0.5))

    class Enter(io.StringIO):
        """Presses Enter after putting the next weight on."""

        def readline(self, *_: object) -> str:
            mass_kg = next(weights_kg)
            station.rig.force_fault = lambda now_s, force_N: force_N + mass_kg * 9.80665
            return "\n"

    path = tmp_path / "station.toml"
    path.write_text(station_toml(simulated_config(station)).replace("9870.0", "1234.0"))
    monkeypatch.setattr("sys.stdin", Enter())
    with station.world.in_background():
        assert softcal("calibrate-cell", "--station", path, "--weights", 0, 0.5) == 0
    station.close()
    assert read_station_file(path).force.counts_per_N == pytest.approx(station.counts_per_N, rel=0.01)


@pytest.mark.long
def test_a_rig_on_serial_ports_is_found_and_written_down_in_real_time(tmp_path):
    rig, path = SimulatedStation(Twin(), np.random.default_rng(3)), tmp_path / "station.toml"
    wires = (rig.readout_wire, rig.force_wire, rig.stage_wire)
    ports = [word for wire in wires for word in ("--port", wire.port)]
    with rig.world.in_background():
        command = [sys.executable, "-m", "softcal.app.cli.main", "station", "check", *ports, "--write", str(path)]
        process = subprocess.run(command, capture_output=True, text=True, check=False)
    rig.close()
    # The scale of the cell is not known yet: the check writes the rest.
    assert process.returncode == 3, process.stderr
    config = read_station_file(path)
    assert config.force is not None
    assert [config.readout.port, config.force.port, config.stage.port] == [wire.port for wire in wires]
    assert (config.stage.kind, config.force.kind) == ("grbl", "hx711")


@pytest.mark.long
def test_a_killed_process_leaves_its_samples_and_no_recording(tmp_path):
    arguments = ["station", "unit", "--simulated", "--serial", "A1", "--out", str(tmp_path / "A1.csv")]
    arguments += ["--seconds", "3000", "--spool", str(tmp_path / "spool")]
    code = (
        "from softcal.app.cli.main import command_parser; "
        f"options = command_parser(['station']).parse_args({arguments!r}); options.run(options)"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL)
    wait_until(lambda: process.poll() is not None or sum(p.stat().st_size for p in tmp_path.glob("spool/*")) >= 20_000)
    process.send_signal(signal.SIGKILL)
    process.wait()
    (spool,) = tmp_path.glob("spool/*.spool")
    run = read_spool(spool)
    assert len(run.output) > 20
    assert not (tmp_path / "A1.csv").exists()


def test_drivers_are_listed_with_their_keys_and_their_origin(softcal, tmp_path, capsys):
    assert softcal("drivers", "--json", tmp_path / "drivers.json") == 0
    listed = json.loads((tmp_path / "drivers.json").read_text())["drivers"]
    (grbl,) = [driver for driver in listed if (driver["role"], driver["kind"]) == ("stage", "grbl")]
    assert grbl["package"] == "softcal" and grbl["keys"]["axis"] == "Z" and grbl["keys"]["port"] is None
    capsys.readouterr()
    assert softcal("drivers", "--kind", "zaber") == 0
    assert "microstep_mm" in "".join(capsys.readouterr())
    with pytest.raises(InputError, match="'nothing'"):
        softcal("drivers", "--kind", "nothing")


PRESS = ("unit", "--serial", "A1", "--out", "A1.csv")


@pytest.mark.parametrize(
    ("command", "wait_for", "name"),
    [
        pytest.param(PRESS, "homing", "SIGINT", marks=pytest.mark.long),
        pytest.param(PRESS, "searching for contact", "SIGHUP", marks=pytest.mark.long),
        (("source", *PRESS[1:]), "pressing", "SIGTERM"),
    ],
)
def test_a_signal_in_a_command_that_moves_lifts_the_stage_and_says_so(tmp_path, command, wait_for, name):
    arguments = [SOFTCAL, "station", *command, "--simulated", "--spool", str(tmp_path / "spool")]
    environment = os.environ | {"SOFTCAL_LOGS": str(tmp_path / "logs"), "PYTHONUNBUFFERED": "1"}
    # Tests that a shell runs in the background inherit that Ctrl-C is ignored.
    restore_interrupt = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    with subprocess.Popen(
        arguments, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True, preexec_fn=restore_interrupt
    ) as process:
        for line in process.stderr:
            if wait_for in line:
                process.send_signal(getattr(signal, name))
                break
        rest = process.stderr.read()
    (last,) = [line for line in rest.splitlines() if line.startswith("softcal: ")]
    assert process.returncode == 3
    assert str(Reason("left.must_home" if wait_for == "homing" else "left.lifted")) in last
    assert not (tmp_path / "A1.csv").exists()
