"""The demo in small: pressed over simulated serial lines, written as a lot folder, calibrated, scored."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.app.batch.batch import run_batch
from softcal.app.batch.engine import EngineChoice
from softcal.app.batch.lot_work import BatchConfig
from softcal.app.cli.main import main
from softcal.app.extras import MODULES_OF
from softcal.app.line.demo import TABLE_HEADER, DemoConfig, PressTimes, press_demo_lot, press_simulated_lot, table_row
from softcal.app.output import ProgressBar
from softcal.core.network.config import NetworkConfig
from softcal.core.simulated_lot import draw_twins
from softcal.db.connection import open_registry

SMALL = DemoConfig(
    units=1,
    times=PressTimes(source_s=60.0, unit_s=30.0, audit_s=30.0),
    batch=BatchConfig(network=NetworkConfig(hidden=(16, 8), max_epochs=60)),
)


@pytest.mark.long
def test_a_pressed_unit_comes_out_better_than_it_went_in(tmp_path: Path) -> None:
    messages: list[str] = []
    folder = press_demo_lot(SMALL, tmp_path / "lot", messages.append)
    source = pd.read_csv(folder.source_path)
    unit = pd.read_csv(folder.unit_paths["DEMO-01"])
    assert list(source.columns) == ["t_s", "output", "reference", "stage_mm"]
    assert list(unit.columns) == ["t_s", "output", "stage_mm"]
    with open_registry(f"sqlite:///{tmp_path / 'registry.db'}") as registry:
        (result,) = run_batch(folder, registry, SMALL.batch).units
        assert registry.verify() == []
    row = dict(zip(TABLE_HEADER, table_row(result), strict=True))
    assert row["after [N]"] < 0.5 * row["before [N]"]
    assert len(messages) == 3


def test_a_lot_pressed_before_is_taken_as_it_is(lot_folder: Path) -> None:
    messages: list[str] = []
    folder = press_demo_lot(SMALL, lot_folder, messages.append)
    assert folder.lot.id == "small"
    assert len(messages) == 1


def test_a_folder_that_is_no_lot_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "lot").mkdir()
    assert main(["demo", "--out", str(tmp_path)]) == 2
    assert "lot.toml" in capsys.readouterr().err


def test_units_are_pressed_alike_however_many_workers_press() -> None:
    twins, times = draw_twins(np.random.default_rng(1), 2), PressTimes(source_s=8.0, unit_s=5.0, audit_s=5.0)
    shares: list[float] = []
    alone, shared = (
        press_simulated_lot(twins, ["A", "B"], 3, times, None, EngineChoice("local", jobs), shares.append)
        for jobs in (1, 2)
    )
    assert alone.source.reference.tobytes() == shared.source.reference.tobytes()
    assert alone.units["B"].output.tobytes() == shared.units["B"].output.tobytes()
    assert alone.audits["B"].reference.tobytes() == shared.audits["B"].reference.tobytes()
    assert len(set(shares)) > 4 and 0.5 < max(shares) <= 1.0


def test_a_bar_begins_at_once_and_says_how_long_it_will_take(monkeypatch, capsys: pytest.CaptureFixture[str]) -> None:
    now_s = [10.0]
    monkeypatch.setattr("softcal.app.output.time.monotonic", lambda: now_s[0])
    bar = ProgressBar("loading")
    (first,) = capsys.readouterr().err.splitlines()
    for share in (0.25, 0.5, 0.75, 1.0):
        now_s[0] += 10.0
        bar.show_progress(share, "unit S2")
    lines = capsys.readouterr().err.splitlines()
    assert "loading" in first and " left" not in first
    assert [line.partition("about ")[2].partition(" left")[0] for line in lines] == ["30.0 s", "20.0 s", "10.0 s", ""]
    assert [line.count("#") for line in lines] == [6, 12, 18, 24]
    assert all("\x1b" not in line for line in (first, *lines))


def test_the_demo_says_where_its_lot_is(lot_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lot_folder.rename(tmp_path / "lot")
    main(["demo", "--out", str(tmp_path), "--jobs", "1", "--hidden", "8"])
    out = capsys.readouterr().out
    assert f"softcal ui --registry sqlite:///{tmp_path / 'registry.db'}" in out


MISSING = """
import importlib.machinery

find = importlib.machinery.PathFinder.find_spec
importlib.machinery.PathFinder.find_spec = lambda name, *more: None if name in {libraries!r} else find(name, *more)
from softcal.app.cli.main import main
assert main(["demo", "--units", "1", "--hidden", "8", "--out", {out!r}]) in (0, 1)
"""


@pytest.mark.long
def test_the_demo_needs_no_more_than_make_installs_for_it(tmp_path: Path) -> None:
    makefile = (Path(__file__).parents[2] / "Makefile").read_text()
    (extras,) = (line for line in makefile.splitlines() if line.startswith("\t$(call install,") and "twin" in line)
    installed = re.findall(r"--extra (\w+)", extras)
    assert "twin" in installed
    libraries = [library for extra, names in MODULES_OF.items() if extra not in installed for library in names]
    code = MISSING.format(libraries=libraries, out=str(tmp_path))
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr
    assert (tmp_path / "registry.db").is_file()
