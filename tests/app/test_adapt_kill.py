"""`softcal adapt` killed in mid-stream: no row twice or lost, every map kept, the same rows to the last bit."""

import io
import os
import shutil
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.app.cli.main import main
from softcal.app.operation.adapt import AdaptOptions, Follower
from softcal.app.registry.unit import unit_in_use
from softcal.core.lot import UnitKey
from softcal.db.connection import open_registry
from tests.wait import wait_until

pytestmark = pytest.mark.long

RUN = (sys.executable, "-m", "softcal.app.cli.main")


@pytest.fixture(scope="module")
def bench(trained_lot: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("kill") / "small"
    shutil.copytree(trained_lot, folder)
    return folder


@pytest.fixture(scope="module")
def log(bench: Path) -> list[str]:
    """Presses within the source's range, of which each is a little different; the sensor is re-seated half way."""
    low, high = pd.read_csv(bench / "lot/source/A0.csv")["output"].quantile([0.02, 0.9])
    rng = np.random.default_rng(0)
    lengths = rng.integers(90, 110, 66)
    waves = [(1 + 0.03 * rng.normal()) * np.sin(np.pi * np.arange(n) / n) ** 2 for n in lengths]
    load = np.concatenate(waves)
    output = low + (high - low) * (0.6 * load + 0.15 * (np.arange(len(load)) > 0.5 * len(load)))
    output += 0.001 * rng.normal(size=len(load))
    table = pd.DataFrame({"t_s": np.arange(len(load)) / 50.0, "output": output})
    return table.to_csv(index=False).splitlines(keepends=True)


def command_of(bench: Path, target: Path, stream: str, *more: str) -> list[str]:
    options = ["--registry", url(bench), "--serial", "A0", "-", "--out", str(target)]
    return ["adapt", *options, "--stream", stream, *more]


def start(bench: Path, target: Path, stream: str, *more: str) -> "subprocess.Popen[str]":
    command = command_of(bench, target, stream, *more)
    return subprocess.Popen([*RUN, *command], stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def url(bench: Path) -> str:
    return f"sqlite:///{bench / 'registry.db'}"


def rows_of(target: Path) -> int:
    return target.read_text().count("\n") if target.exists() else 0


def maps(bench: Path, stream: str) -> list[dict[str, object]]:
    with open_registry(url(bench)) as registry:
        return [
            dict(step)
            for step in registry.adaptations.all(UnitKey("small", "A0"), stream)
            if step["event"] != "checkpoint"
        ]


def run_whole(bench: Path, target: Path, stream: str, log: list[str], *more: str) -> int:
    command = command_of(bench, target, stream, *more)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "stdin", io.StringIO("".join(log)))
        return main(command)


def kill_after(process: "subprocess.Popen[str]", target: Path, log: list[str], rows: int) -> None:
    assert process.stdin is not None
    process.stdin.writelines(log[:rows])
    process.stdin.flush()
    wait_until(lambda: rows_of(target) >= rows - 200)
    os.kill(process.pid, signal.SIGKILL)
    process.wait(10)
    assert process.stderr is not None
    process.stderr.close()
    with suppress(BrokenPipeError):
        process.stdin.close()


def test_log_sent_again_after_a_kill_gives_the_rows_and_maps_of_one_run(
    bench: Path, log: list[str], tmp_path: Path
) -> None:
    assert run_whole(bench, tmp_path / "whole.csv", "whole", log) == 0
    target = tmp_path / "killed.csv"
    kill_after(start(bench, target, "killed"), target, log, 2 * len(log) // 3)
    with target.open("a") as file:
        file.write("17.3,0.2")

    assert run_whole(bench, target, "killed", log, "--resume") == 0

    assert target.read_bytes() == (tmp_path / "whole.csv").read_bytes()
    whole_steps = [step | {"stream": "whole"} for step in maps(bench, "killed")]
    assert whole_steps == maps(bench, "whole")
    assert len({step["offset"] for step in whole_steps}) > 1


def test_stream_that_went_on_meanwhile_is_gone_on_with_from_the_kept_map(
    bench: Path, log: list[str], tmp_path: Path
) -> None:
    target, cut = tmp_path / "live.csv", 2 * len(log) // 3
    kill_after(start(bench, target, "live"), target, log, cut)
    rows_before, before = rows_of(target), maps(bench, "live")

    assert run_whole(bench, target, "live", [log[0], *log[cut + 500 :]], "--resume") == 0

    rows = pd.read_csv(target)
    assert rows_of(target) == rows_before + len(log) - cut - 500
    assert rows["t_s"].is_monotonic_increasing and not rows["t_s"].duplicated().any()
    after = maps(bench, "live")
    assert after[: len(before)] == before
    samples = [int(str(step["sample"])) for step in after]
    assert samples == sorted(samples)


def test_log_that_does_not_fit_the_rows_written_is_refused(
    bench: Path, log: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "twice.csv"
    assert run_whole(bench, target, "twice", log[:900]) == 0
    assert run_whole(bench, target, "twice", [log[0], *log[1000:1900]], "--resume") == 0
    content = target.read_bytes()
    capsys.readouterr()

    assert run_whole(bench, target, "twice", log, "--resume") == 2

    error = capsys.readouterr().err
    assert "OUT" in error and error.count("\n") == 1
    assert target.read_bytes() == content


def test_stream_that_has_begun_is_not_begun_again_without_being_asked(
    bench: Path, log: list[str], tmp_path: Path
) -> None:
    assert run_whole(bench, tmp_path / "first.csv", "once", log[:900]) == 0
    assert run_whole(bench, tmp_path / "second.csv", "once", log[:900]) == 2


def test_file_that_was_broken_off_is_begun_again(bench: Path, log: list[str], tmp_path: Path) -> None:
    (tmp_path / "in.csv").write_text("".join(log))
    with open_registry(url(bench)) as registry:
        unit = unit_in_use(registry, "A0")
        broken = Follower(registry, unit, "file", AdaptOptions(stream="file"), is_repeatable=True)
        broken.advance(*pd.read_csv(tmp_path / "in.csv").to_numpy(dtype=float)[:5000].T)
        broken.store_maps()
    half = maps(bench, "file")

    command = ["adapt", "--registry", url(bench), "--serial", "A0", str(tmp_path / "in.csv"), "--stream", "file"]
    assert main([*command, "--out", str(tmp_path / "out.csv")]) == 0

    assert len(half) > 1
    assert maps(bench, "file")[: len(half)] == half
    samples = [int(str(step["sample"])) for step in maps(bench, "file")]
    assert samples == sorted(set(samples))
