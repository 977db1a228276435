"""`softcal adapt --mode ot` and `ot-improved`: the paper's online method on files, causal and resumable."""

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.app.cli.main import main

MODES = ("ot", "ot-improved")
QUEUE = 200


@pytest.fixture(scope="module")
def bench(trained_lot: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a lot of one unit and a registry in which it is calibrated."""
    folder = tmp_path_factory.mktemp("adapt-ot") / "small"
    shutil.copytree(trained_lot, folder)
    shutil.rmtree(folder / "lot/audit")
    for serial in ("A2", "A3"):
        (folder / f"lot/units/{serial}.csv").unlink()
    assert main(["batch", str(folder / "lot"), "--registry", url(folder), "--hidden", "16,8"]) in (0, 1)
    return folder


def url(folder: Path) -> str:
    return f"sqlite:///{folder / 'registry.db'}"


def adapt(folder: Path, source: Path, target: Path, *more: str) -> int:
    return main(["adapt", "--registry", url(folder), "--serial", "A1", str(source), "--out", str(target), *more])


@pytest.fixture
def stream(bench: Path) -> Path:
    return bench / "lot/units/A1.csv"


@pytest.mark.parametrize("mode", MODES)
def test_one_row_for_each_row_and_the_maps_in_the_registry(
    bench: Path, stream: Path, tmp_path: Path, mode: str
) -> None:
    report = tmp_path / "report.json"

    assert adapt(bench, stream, tmp_path / "out.csv", "--mode", mode, "--queue", "200", "--json", str(report)) == 0

    rows, given = pd.read_csv(tmp_path / "out.csv"), pd.read_csv(stream)
    assert list(rows.columns) == ["t_s", "estimate", "lower", "upper", "flag"]
    np.testing.assert_allclose(rows["t_s"], given["t_s"])
    known = rows.dropna(subset=["estimate"])
    assert len(known) == len(given) - 14
    assert ((known["lower"] <= known["estimate"]) & (known["estimate"] <= known["upper"])).all()
    said = json.loads(report.read_text())
    assert said["mode"] == mode and said["verdicts"]["followed"] == (len(given) - 14) // QUEUE - 1
    assert said["method"]["numbers"]["online"]["queue"] == QUEUE


@pytest.mark.parametrize("mode", MODES)
def test_a_shorter_file_has_the_same_first_rows(bench: Path, stream: Path, tmp_path: Path, mode: str) -> None:
    more = ("--mode", mode, "--queue", "200")
    pd.read_csv(stream).head(700).to_csv(tmp_path / "half.csv", index=False)

    adapt(bench, stream, tmp_path / "whole-out.csv", *more)
    adapt(bench, tmp_path / "half.csv", tmp_path / "half-out.csv", *more)

    whole, half = ((tmp_path / f"{name}-out.csv").read_text().splitlines() for name in ("whole", "half"))
    assert half == whole[:701]


@pytest.mark.parametrize("mode", MODES)
def test_until_the_first_swap_the_rows_are_those_without_adaptation(
    bench: Path, stream: Path, tmp_path: Path, mode: str
) -> None:
    adapt(bench, stream, tmp_path / "ot.csv", "--mode", mode, "--queue", "200")
    adapt(bench, stream, tmp_path / "none.csv", "--mode", "none")

    ot, none = (pd.read_csv(tmp_path / f"{name}.csv")["estimate"] for name in ("ot", "none"))
    swap = 14 + 2 * QUEUE
    np.testing.assert_allclose(ot[:swap], none[:swap], rtol=1e-9)
    assert not np.allclose(ot[swap + 32 :], none[swap + 32 :])


@pytest.mark.parametrize("mode", MODES)
def test_next_file_goes_on_with_the_queue_of_the_last(bench: Path, stream: Path, tmp_path: Path, mode: str) -> None:
    rows = pd.read_csv(stream)
    rows.head(480).to_csv(tmp_path / "first.csv", index=False)
    rows.iloc[480:].to_csv(tmp_path / "second.csv", index=False)
    more = ("--mode", mode, "--queue", "200", "--stream", f"days-{mode}", "--resume")

    for name in ("first", "second"):
        assert adapt(bench, tmp_path / f"{name}.csv", tmp_path / f"{name}-out.csv", *more) == 0

    adapt(bench, tmp_path / "second.csv", tmp_path / "fresh.csv", "--mode", mode, "--queue", "200")
    second, fresh = (pd.read_csv(tmp_path / f"{name}.csv")["estimate"] for name in ("second-out", "fresh"))
    assert not np.allclose(second[20:150], fresh[20:150])


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--mode", "ot", "--queue", "14"), "15"),
        (("--mode", "ot-improved", "--queue", "100000"), "100014 rows"),
        (("--mode", "basic", "--queue", "200"), "--queue"),
    ],
)
def test_a_queue_that_cannot_be_is_refused_in_one_line(
    bench: Path, stream: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], more: tuple[str, ...], said: str
) -> None:
    assert adapt(bench, stream, tmp_path / "out.csv", *more) == 2

    error = capsys.readouterr().err
    (line,) = (line for line in error.splitlines() if line.startswith("softcal"))
    assert said in line
    assert not (tmp_path / "out.csv").exists()


def test_the_state_of_another_mode_is_refused(
    bench: Path, stream: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert adapt(bench, stream, tmp_path / "out.csv", "--mode", "ot", "--stream", "one-mode") == 0
    capsys.readouterr()

    for mode in ("ot-improved", "improved"):
        assert adapt(bench, stream, tmp_path / "more.csv", "--mode", mode, "--stream", "one-mode", "--resume") == 2
        assert "'one-mode'" in capsys.readouterr().err
