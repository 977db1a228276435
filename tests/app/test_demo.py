"""The demo in small: pressed over simulated serial lines, written as a lot folder, calibrated, scored."""

from pathlib import Path

import pandas as pd
import pytest

from softcal.app.batch.batch import run_batch
from softcal.app.batch.lot_work import BatchConfig
from softcal.app.cli.main import main
from softcal.app.line.demo import TABLE_HEADER, DemoConfig, PressTimes, press_demo_lot, table_row
from softcal.core.network.config import NetworkConfig
from softcal.db.connection import open_registry

SMALL = DemoConfig(
    units=1,
    times=PressTimes(source_s=60.0, unit_s=30.0, audit_s=30.0),
    batch=BatchConfig(network=NetworkConfig(hidden=(16, 8), max_epochs=60)),
)


@pytest.mark.long
def test_a_pressed_unit_comes_out_better_than_it_went_in(tmp_path: Path) -> None:
    said: list[str] = []
    folder = press_demo_lot(SMALL, tmp_path / "lot", said.append)
    source = pd.read_csv(folder.source_path)
    unit = pd.read_csv(folder.unit_paths["DEMO-01"])
    assert list(source.columns) == ["t_s", "output", "reference", "stage_mm"]
    assert list(unit.columns) == ["t_s", "output", "stage_mm"]
    with open_registry(f"sqlite:///{tmp_path / 'registry.db'}") as registry:
        (result,) = run_batch(folder, registry, SMALL.batch).units
        assert registry.verify() == []
    row = dict(zip(TABLE_HEADER, table_row(result), strict=True))
    assert row["after [N]"] < 0.5 * row["before [N]"]
    assert len(said) == 3


def test_a_lot_pressed_before_is_taken_as_it_is(lot_folder: Path) -> None:
    said: list[str] = []
    folder = press_demo_lot(SMALL, lot_folder, said.append)
    assert folder.lot.id == "small"
    assert len(said) == 1


def test_a_folder_that_is_no_lot_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "lot").mkdir()
    assert main(["demo", "--out", str(tmp_path)]) == 2
    assert "lot.toml" in capsys.readouterr().err
