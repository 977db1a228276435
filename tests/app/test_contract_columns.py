"""Tables with the columns `t_s`, `output` and `reference` need no option that names them, whatever their format."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import softcal
from softcal.app.cli.main import main
from softcal.app.files.lot_folder import open_lot_folder

FORMATS = (".csv", ".xlsx", ".parquet")


def write_table(table: pd.DataFrame, path: Path) -> Path:
    """Write a table in the format of its suffix."""
    if path.suffix == ".csv":
        table.to_csv(path, index=False)
    elif path.suffix == ".xlsx":
        table.to_excel(path, index=False)
    else:
        table.to_parquet(path)
    return path


def recorded(phase: float = 0.0, **more: object) -> pd.DataFrame:
    t_s = np.arange(60) / 50
    wave = np.sin(2 * np.pi * t_s + phase)
    return pd.DataFrame({"t_s": t_s, "output": 0.5 + 0.1 * wave, "reference": 1 + wave} | more)


@pytest.mark.parametrize("suffix", FORMATS)
def test_an_import_finds_them(tmp_path: Path, suffix: str) -> None:
    source = write_table(recorded(), tmp_path / f"S1{suffix}")
    audited = write_table(recorded(0.3, stage_mm=np.linspace(0, 1, 60)), tmp_path / f"S2{suffix}")
    bare = write_table(recorded(0.5).drop(columns="reference"), tmp_path / f"S3{suffix}")
    files = map(str, (source, audited, bare))
    assert main(["import", *files, "--source", "S1", "--audit", "--out", str(tmp_path / "lot")]) == 0
    lot = open_lot_folder(tmp_path / "lot")
    assert lot.lot.sample_rate_Hz == 50 and list(lot.unit_paths) == ["S2", "S3"]
    np.testing.assert_allclose(lot.read_source().reference, recorded()["reference"])
    np.testing.assert_allclose(lot.read_audit("S2").reference, recorded(0.3)["reference"])
    assert lot.read_audit("S3") is None
    np.testing.assert_allclose(lot.read_unit("S2").stage_mm, np.linspace(0, 1, 60))
    assert lot.read_unit("S3").stage_mm is None


def test_a_wide_table_needs_its_pattern_alone(tmp_path: Path) -> None:
    wide = recorded().rename(columns={"output": "A0"}).assign(A1=recorded(0.2)["output"])
    path = write_table(wide, tmp_path / "wide.parquet")
    assert main(["import", str(path), "--source", "A0", "--output-column", "*", "--out", str(tmp_path / "lot")]) == 0
    assert list(open_lot_folder(tmp_path / "lot").unit_paths) == ["A1"]


def test_a_reference_that_nobody_asked_for_is_not_looked_at(tmp_path: Path) -> None:
    files = [
        write_table(recorded(), tmp_path / "S1.csv"),
        write_table(recorded(0.3, reference="–"), tmp_path / "S2.csv"),
    ]
    assert main(["import", *map(str, files), "--source", "S1", "--out", str(tmp_path / "lot")]) == 0


@pytest.mark.parametrize("missing", ["t_s", "output", "reference"])
def test_a_table_without_one_of_them_is_refused_by_its_name(tmp_path: Path, missing: str, capsys) -> None:
    files = [write_table(recorded().drop(columns=missing), tmp_path / f"{serial}.csv") for serial in ("S1", "S2")]
    assert main(["import", *map(str, files), "--source", "S1", "--out", str(tmp_path / "lot")]) == 2
    assert repr(missing) in capsys.readouterr().err and not (tmp_path / "lot").exists()


@pytest.mark.parametrize("suffix", FORMATS)
def test_estimate_adapt_audit_and_trim_find_them(
    trained_lot: Path, calibrated: str, tmp_path: Path, suffix: str
) -> None:
    audit = pd.read_csv(next((trained_lot / "lot" / "audit").glob("*.csv")))
    serial = next((trained_lot / "lot" / "audit").glob("*.csv")).stem
    stream = write_table(audit, tmp_path / f"{serial}{suffix}")
    options = ["--serial", serial, "--registry", calibrated]
    assert main(["estimate", *options, str(stream), "--out", str(tmp_path / "estimate.csv")]) == 0
    assert main(["adapt", *options, str(stream), "--out", str(tmp_path / "followed.csv")]) == 0
    assert main(["lot", "audit", "small", str(stream), "--registry", calibrated]) == 0
    estimate = pd.read_csv(tmp_path / "estimate.csv").assign(output=audit["output"])
    ends = estimate[estimate["flag"].isna()].sort_values("estimate").iloc[[0, -1]]
    loads = write_table(
        ends.assign(reference=1.05 * ends["estimate"])[["output", "reference"]], tmp_path / f"loads{suffix}"
    )
    assert main(["trim", *options, "--loads", str(loads), "--yes"]) == 0


@pytest.mark.parametrize("suffix", FORMATS)
def test_python_finds_them(tmp_path: Path, suffix: str) -> None:
    recording = softcal.Recording.read(write_table(recorded(), tmp_path / f"S1{suffix}"))
    assert recording.unlabelled.sample_rate_Hz == 50
    np.testing.assert_allclose(recording.labelled.reference, recorded()["reference"])
