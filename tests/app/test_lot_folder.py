"""A lot folder: where the keys of lot.toml may stand, and what stops a lot."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.app.files.lot_folder import open_lot_folder
from softcal.app.files.lot_toml import write_lot_toml
from softcal.core.errors import InputError
from softcal.core.lot import Lot
from softcal.core.unit.budget import SIMULATED, Traceability

GOOD = 'sample_rate_Hz = 50.0\nsource = "A0"\n[lot]\nid = "x"\n[output]\nunit = "V"\n'


def _lot(folder: Path, toml: str = GOOD) -> Path:
    for name, serial in (("source", "A0"), ("units", "A1")):
        (folder / name).mkdir(parents=True)
        t_s = np.arange(40) / 50
        pd.DataFrame({"t_s": t_s, "output": t_s, "reference": t_s}).to_csv(folder / name / f"{serial}.csv", index=False)
    (folder / "lot.toml").write_text(toml)
    return folder


def test_the_bare_keys_may_follow_the_output_table(tmp_path: Path) -> None:
    toml = '[lot]\nid = "x"\n[output]\nunit = "V"\nsample_rate_Hz = 50.0\nsource = "A0"\n'
    assert open_lot_folder(_lot(tmp_path, toml)).lot.source == "A0"


def test_what_is_written_reads_back(tmp_path: Path) -> None:
    lot = Lot("x y", "A0", 48.9, "insole", "pressure", "bar", "count", 0.02)
    write_lot_toml(_lot(tmp_path), lot)
    assert open_lot_folder(tmp_path).lot == lot


def test_a_units_reference_column_is_not_read(tmp_path: Path) -> None:
    folder = open_lot_folder(_lot(tmp_path))
    assert not hasattr(folder.read_unit("A1"), "reference")


@pytest.mark.parametrize(
    ("toml", "message"),
    [
        (GOOD.replace("A0", "A7"), "'A7'.*A0"),
        (GOOD.replace('id = "x"\n', ""), r"\[lot\] id"),
        (GOOD.replace("50.0", '"fast"'), "'fast'"),
        (GOOD + 'source = "A5"\n', "source"),
        ("[lot\n", "TOML"),
        (GOOD.replace("50.0", "-1.0"), "-1.0"),
    ],
)
def test_a_lot_toml_that_cannot_be_used_is_refused(tmp_path: Path, toml: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        open_lot_folder(_lot(tmp_path, toml))


def test_a_unit_in_two_formats_is_read_from_neither(tmp_path: Path) -> None:
    _lot(tmp_path)
    pd.read_csv(tmp_path / "units/A1.csv").to_parquet(tmp_path / "units/A1.parquet")
    folder = open_lot_folder(tmp_path)
    assert list(folder.unit_paths) == ["A1"]
    with pytest.raises(InputError, match=r"A1\.csv, A1\.parquet"):
        folder.read_unit("A1")


def test_keys_that_are_not_known_are_remarked(tmp_path: Path) -> None:
    (remark,) = open_lot_folder(_lot(tmp_path, GOOD + 'colour = "red"\n')).remarks
    assert "colour" in remark


REFERENCE = """sample_rate_Hz = 50.0
source = "A0"
[lot]
id = "small"
[reference]
unit = "N"
cell = "LC-7"
certificate = "D-K-1"
issued_on = 2026-01-01
due_on = 2028-01-01
used_on = 2026-06-01
uncertainty = 0.012
temperature_K = 3
"""


def test_what_the_source_was_compared_with_is_read_and_written(lot_folder: Path) -> None:
    assert open_lot_folder(lot_folder).reference == SIMULATED
    (lot_folder / "lot.toml").write_text(REFERENCE)
    lot_folder_read = open_lot_folder(lot_folder)
    assert not lot_folder_read.remarks and lot_folder_read.reference is not None
    assert (
        lot_folder_read.reference.cell,
        lot_folder_read.reference.uncertainty,
        lot_folder_read.reference.temperature_K,
    ) == ("LC-7", 0.012, 3.0)
    assert lot_folder_read.reference.traceability is Traceability.VALID
    for reference in (lot_folder_read.reference, SIMULATED, None):
        write_lot_toml(lot_folder, lot_folder_read.lot, reference)
        assert open_lot_folder(lot_folder).reference == reference


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (("used_on = 2026-06-01", 'used_on = "June"'), "used_on"),
        (("uncertainty = 0.012", "uncertainty = 0"), "uncertainty"),
        (("uncertainty = 0.012", 'uncertainty = "small"'), "uncertainty"),
        (("due_on = 2028-01-01", "due_on = 2025-01-01"), "2025-01-01"),
        (('id = "small"', 'id = "small"\nsimulated = "yes"'), "simulated"),
    ],
)
def test_a_reference_that_cannot_be_is_refused(lot_folder: Path, changed: tuple[str, str], message: str) -> None:
    (lot_folder / "lot.toml").write_text(REFERENCE.replace(*changed))
    with pytest.raises(InputError, match=message):
        open_lot_folder(lot_folder)
