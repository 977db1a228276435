"""The live form of `softcal adapt`: pipes, sockets, a simulated sensor over its serial protocol, and their faults."""

import io
import os
import pty
import shutil
import socket
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.app.cli.main import main
from softcal.app.operation.live import WIDTH, draw_level_bar
from softcal.app.operation.sink import open_sink
from softcal.app.operation.source import (
    RECONNECT_TIMEOUT_S,
    SILENCE_S,
    lines_of,
    on_one_clock,
    readings,
    reconnecting_samples,
)
from softcal.core.errors import BadReply, NoReply
from softcal.core.lot import UnitKey
from softcal.db.connection import open_registry
from softcal.station.interfaces import Sample
from softcal.station.wire.frames.text_stream import StreamLine, format_line
from tests.wait import wait_until


@pytest.fixture(scope="module")
def bench(trained_lot: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("live") / "small"
    shutil.copytree(trained_lot, folder)
    return folder


def adapt(bench: Path, source: str, target: str, *more: str) -> int:
    registry = f"sqlite:///{bench / 'registry.db'}"
    return main(["adapt", "--registry", registry, "--serial", "A0", source, "--out", target, *more])


@pytest.fixture
def piped(bench: Path, monkeypatch: pytest.MonkeyPatch) -> pd.DataFrame:
    """The source's recording on standard input, one line damaged, the last one cut off."""
    table = pd.read_csv(bench / "lot/source/A0.csv").head(400)
    lines = table[["t_s", "output"]].to_csv(index=False).splitlines()
    lines[100] = "gar\x00bage"
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n".join(lines) + "\n7.9"))
    return table


def test_lines_from_a_pipe_become_lines_on_standard_output(
    bench: Path, piped: pd.DataFrame, capsys: pytest.CaptureFixture[str]
) -> None:
    assert adapt(bench, "-", "-", "--stream", "pipe") == 0

    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "t_s,estimate,lower,upper,flag"
    assert len(lines) == 1 + len(piped) + 1
    assert "invalid" in lines[100] and "invalid" in lines[-1]
    assert float(lines[300].split(",")[1]) == pytest.approx(piped["reference"][299], abs=0.4)


def test_estimates_go_to_whoever_listens(bench: Path, piped: pd.DataFrame) -> None:
    received: list[bytes] = []
    with socket.create_server(("127.0.0.1", 0)) as server:

        def listen() -> None:
            connection, _ = server.accept()
            with connection:
                while content := connection.recv(65536):
                    received.append(content)

        listener = threading.Thread(target=listen)
        listener.start()
        assert adapt(bench, "-", f"tcp://127.0.0.1:{server.getsockname()[1]}", "--stream", "socket") == 0
        listener.join(10)

    assert b"".join(received).count(b"\n") == 1 + len(piped) + 1


def test_simulated_sensor_is_read_over_its_serial_protocol(bench: Path, tmp_path: Path) -> None:
    target = tmp_path / "live.csv"

    assert adapt(bench, "simulated:40", str(target), "--duration", "8", "--view", "--stream", "sim") == 0

    rows = pd.read_csv(target)
    assert len(rows) > 300
    assert np.median(np.diff(rows["t_s"])) == pytest.approx(0.02, rel=0.05)
    with open_registry(f"sqlite:///{bench / 'registry.db'}") as registry:
        adaptation = registry.adaptations.last(UnitKey("small", "A0"), 1, "sim")
    assert adaptation is not None and adaptation["event"] == "checkpoint"


def test_a_live_file_is_not_overwritten(bench: Path, tmp_path: Path, piped: pd.DataFrame) -> None:
    target = tmp_path / "live.csv"
    target.write_text("precious\n")

    assert adapt(bench, "-", str(target)) == 2
    assert target.read_text() == "precious\n"


@pytest.mark.parametrize("source", ["serial:/dev/nowhere", "serial:"])
def test_port_that_does_not_exist_is_the_rigs_fault(
    bench: Path, tmp_path: Path, source: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert adapt(bench, source, str(tmp_path / "live.csv")) == 3
    # What the first use of a unit wrote to the registry is said as well.
    assert sum(line.startswith("softcal: ") for line in capsys.readouterr().err.splitlines()) == 1


@pytest.mark.parametrize("target", ["tcp://127.0.0.1:1", "tcp://nothing", "tcp://", "live.xlsx"])
def test_target_that_cannot_be_used_is_refused(bench: Path, target: str, piped: pd.DataFrame) -> None:
    assert adapt(bench, "-", target) == 2


def test_listener_that_goes_loses_rows_but_not_the_stream(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        with open_sink(f"tcp://127.0.0.1:{server.getsockname()[1]}", append=False) as sink:
            server.accept()[0].close()
            for _ in range(2000):
                sink.write("1,2,3,4,\n")

    assert capsys.readouterr().err.count("\n") == 1


class Clock:
    """Time that passes when it is waited for."""

    def __init__(self) -> None:
        self.now = 0.0

    def now_s(self) -> float:
        return self.now

    def sleep_s(self, seconds: float) -> None:
        self.now += max(seconds, 0.5)


class ScriptedReadout:
    """Answers a list of polls, then is silent."""

    name, unit, rate_Hz, channels, range = "sensor readout", "V", 50.0, 1, (0.0, 5.0)

    def __init__(self, polls: Sequence[object]) -> None:
        self.polls = list(polls)
        self.starts = 0

    def start(self) -> None:
        self.starts += 1

    def poll(self) -> list[Sample]:
        answer = self.polls.pop(0) if self.polls else []
        if isinstance(answer, Exception):
            raise answer
        return answer  # type: ignore[return-value]

    def close(self) -> None: ...


def test_silent_sensor_ends_the_stream_with_what_to_do() -> None:
    clock = Clock()
    stream = readings(ScriptedReadout([[Sample(0.0, 0.02, (1.0,))]]), clock)

    assert next(stream) == [(0.02, 1.0)]
    with pytest.raises(NoReply, match="--resume"):
        for _ in stream:
            pass
    assert clock.now > SILENCE_S


def test_device_that_starts_again_is_listened_to_again() -> None:
    readout = ScriptedReadout([BadReply("started again"), [Sample(1.0, 0.02, (1.5,))]])

    pieces = [piece for _, piece in zip(range(2), readings(readout, Clock()), strict=False)]

    assert pieces == [[], [(0.02, 1.5)]]
    assert readout.starts == 2


def test_readout_that_is_unplugged_is_listened_to_again_when_it_is_back() -> None:
    plugs: list[object] = [
        ScriptedReadout([[Sample(0.0, 7.0, (1.0,))], NoReply("gone")]),
        NoReply("no such port"),
        NoReply("no such port"),
        ScriptedReadout([[Sample(0.0, 0.02, (1.5,)), Sample(0.0, 0.04, (1.6,))]]),
    ]

    def plug() -> ScriptedReadout:
        plug = plugs.pop(0)
        if isinstance(plug, NoReply):
            raise plug
        return plug  # type: ignore[return-value]

    clock = Clock()
    pieces = on_one_clock(reconnecting_samples(plug, clock), clock)

    samples = [next(s for s in pieces if s) for _ in range(2)]
    assert samples[0] == [(7.0, 1.0)]
    assert [output for _, output in samples[1]] == [1.5, 1.6]
    assert 7.0 < samples[1][0][0] < samples[1][1][0] < 20.0
    with pytest.raises(NoReply):
        for _ in pieces:
            plugs[:] = [NoReply("no such port")]
    assert clock.now > RECONNECT_TIMEOUT_S


@pytest.mark.long
def test_serial_port_is_read_over_an_unplugging(bench: Path, tmp_path: Path) -> None:
    port, target = tmp_path / "ttyUSB0", tmp_path / "live.csv"
    device = threading.Thread(target=plug_twice, args=(port,))
    device.start()
    wait_until(port.exists)

    assert adapt(bench, f"serial:{port}", str(target), "--duration", "4.5", "--stream", "plugged") == 0

    device.join(20)
    rows = pd.read_csv(target)
    assert rows["t_s"].is_monotonic_increasing
    flags = rows["flag"].str.split("; ").str[0].tolist()
    assert flags[:14] == ["warm-up"] * 14
    assert flags.count("gap") >= 14
    assert rows["estimate"].notna().sum() > 100


def plug_twice(port: Path) -> None:
    """A readout at a pseudo-terminal that is pulled after a while and comes back under the same name, started anew."""
    for _ in range(2):
        master, slave = pty.openpty()
        port.unlink(missing_ok=True)
        port.symlink_to(os.ttyname(slave))
        with suppress(OSError):
            for k in range(150):
                counts = int(150 + 40 * np.sin(2 * np.pi * k / 60))
                os.write(master, format_line(StreamLine(1000 + 20 * k, (counts,))))
                time.sleep(0.02)
        port.unlink()
        os.close(slave)
        os.close(master)
        time.sleep(0.5)


def test_header_of_a_pipe_says_which_columns_count() -> None:
    file = io.StringIO("force,output,t_s\n9,0.5,1.0\n9,,1.02\n")

    samples = [sample for piece in lines_of(file) for sample in piece]

    assert samples[0] == (1.0, 0.5)
    assert samples[1][0] == 1.02 and np.isnan(samples[1][1])


def test_bar_shows_interval_and_estimate() -> None:
    line = draw_level_bar(1.0, 0.5, 1.5, (0.0, 2.0))

    assert len(line) == WIDTH
    assert line.index("-") == WIDTH // 4 and line[WIDTH // 2] == "█"
    assert draw_level_bar(float("nan"), 0, 0, (0, 1)).strip() == ""


def test_live_source_must_be_of_a_known_kind(bench: Path, tmp_path: Path) -> None:
    assert adapt(bench, "simulated:fast", str(tmp_path / "live.csv")) == 2
