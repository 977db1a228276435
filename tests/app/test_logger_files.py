"""Files as loggers and test machines write them: read alike at every entry point, or refused with the cure."""

import re
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import tomlkit

import softcal
from softcal.app.calibration.audit_files import read_audit_files
from softcal.app.cli.main import main
from softcal.app.files.import_plan import Columns, ImportPlan
from softcal.app.files.importing import preview_import
from softcal.app.files.lot_folder import open_lot_folder
from softcal.app.files.recording_file import ColumnNames, inspect_recording
from softcal.app.files.stream_file import Stream
from softcal.app.tables.options import TableOptions
from softcal.core.errors import InputError
from softcal.core.lot import Lot
from tests.app import laboratory_files as written

CORPUS = Path(__file__).parent / "corpus"
FILES = tomllib.loads((CORPUS / "manifest.toml").read_text(encoding="utf-8"))["file"] + written.BINARY_FILES
READ, REFUSED = [each for each in FILES if "refused" not in each], [each for each in FILES if "refused" in each]
LAYOUT = ("delimiter", "decimal", "encoding", "header_row", "sheet", "time_format", "missing")
SERIAL = "S1"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Every file of the corpus, those of binary formats written now."""
    folder = tmp_path_factory.mktemp("corpus")
    for path in CORPUS.iterdir():
        shutil.copy(path, folder / path.name)
    written.write_corpus(folder)
    return folder


def declared(entry_declared):
    """Return what a person states of the layout, with one name for each option."""
    return {key: value for key, value in entry_declared.get("options", {}).items() if key in LAYOUT}


def options_of(entry_declared):
    layout = declared(entry_declared)
    return TableOptions(**layout | ({"missing": tuple(layout["missing"])} if "missing" in layout else {}))


def lot_of(entry_declared):
    return Lot("L", SERIAL, entry_declared.get("rate_Hz", 50.0))


def names_of(entry_declared):
    columns = entry_declared["columns"]
    rate_Hz = entry_declared.get("options", {}).get("sample_rate_Hz")
    reference = columns.get("reference", "reference")
    return ColumnNames(columns["output"], columns.get("time"), reference, None, rate_Hz, options_of(entry_declared))


def by_reader(path, entry_declared, _):
    file = inspect_recording(path, SERIAL, None, names=names_of(entry_declared))
    return file.recording.t_s, file.recording.output


def by_import(path, entry_declared, folder):
    columns, command = entry_declared["columns"], ["import", str(path), "--source", SERIAL, "--serial", SERIAL]
    command += ["--output-column", columns["output"], "--reference-column", columns["reference"]]
    command += ["--time-column", columns["time"]] if "time" in columns else []
    for key, value in entry_declared.get("options", {}).items():
        key = "sample-rate" if key == "sample_rate_Hz" else key.replace("_", "-")
        for each in value if isinstance(value, list) else [value]:
            command += [f"--{key}={each}"]
    if main([*command, "--out", str(folder / "lot")]):
        raise InputError(by_import.capture.readouterr().err.strip())
    by_import.capture.readouterr()
    table = pd.read_csv(folder / "lot" / "source" / f"{SERIAL}.csv")
    assert "reference" in table
    return table["t_s"].to_numpy(), table["output"].to_numpy()


def by_lot_folder(path, entry_declared, folder):
    for name in ("source", "units"):
        (folder / name).mkdir(parents=True)
    (folder / "source" / f"{SERIAL}.csv").write_text("t_s,output,reference\n", encoding="utf-8")
    shutil.copy(path, folder / "units" / f"U1{path.suffix}")
    keys = {name: value for name, value in entry_declared["columns"].items() if name in ("output", "time", "reference")}
    lot = {"lot": {"id": "L", "sample_rate_Hz": entry_declared.get("rate_Hz", 50.0), "source": SERIAL}}
    (folder / "lot.toml").write_text(
        tomlkit.dumps({**lot, "table": {**keys, **declared(entry_declared)}}), encoding="utf-8"
    )
    recording = open_lot_folder(folder).read_unit("U1")
    return recording.t_s, recording.output


def by_audit(path, entry_declared, folder):
    columns = entry_declared["columns"]
    path_of_unit = folder / f"{SERIAL}{path.suffix}"
    folder.mkdir()
    shutil.copy(path, path_of_unit)
    chosen = Columns(columns["output"], columns["reference"], columns.get("time"))
    audit = read_audit_files(lot_of(entry_declared), [SERIAL], [path_of_unit], chosen, options_of(entry_declared))[0]
    if audit.recording is None:
        raise InputError(audit.refusal)
    return audit.recording.unlabelled.t_s, audit.recording.unlabelled.output


def by_upload(path, entry_declared, _):
    columns = entry_declared["columns"]
    chosen = Columns(columns["output"], columns.get("reference"), columns.get("time"))
    plan = ImportPlan([path], chosen, lot_of(entry_declared), table=options_of(entry_declared), serials=[SERIAL])
    look = preview_import(plan)[0]
    if look.unit is None:
        raise InputError(look.problem)
    return look.unit.recording.t_s, look.unit.recording.output


def by_stream(path, entry_declared, _):
    pieces = list(Stream(path, names_of(entry_declared)).pieces())
    return np.concatenate([t_s for t_s, _ in pieces]), np.concatenate([output for _, output in pieces])


def by_python(path, entry_declared, _):
    columns, options = entry_declared["columns"], dict(entry_declared.get("options", {}))
    if "missing" in options:
        options["missing"] = tuple(options["missing"])
    recording = softcal.Recording.read(
        path, columns["output"], columns.get("reference"), columns.get("time"), **options, serial=SERIAL
    )
    return recording.unlabelled.t_s, recording.unlabelled.output


ENTRY_POINTS = {
    "reader, estimate": by_reader,
    "import": by_import,
    "lot folder": by_lot_folder,
    "lot audit": by_audit,
    "browser": by_upload,
    "adapt": by_stream,
    "Python": by_python,
}
"""Functions that commands and pages read a recording by; `softcal import` is run as a command."""


def test_the_corpus_is_complete(folder):
    names = [entry["file"] for entry in FILES]
    assert sorted(names) == sorted(path.name for path in folder.iterdir() if path.name != "manifest.toml")
    assert len(set(names)) == len(names) >= 80


@pytest.mark.parametrize("entry_declared", READ, ids=lambda each: each["file"])
def test_a_file_is_read_as_stated(entry_declared, folder):
    path, has_reference = folder / entry_declared["file"], "reference" in entry_declared
    file = inspect_recording(path, SERIAL, None, names=names_of(entry_declared), with_reference=has_reference)
    columns = file.columns
    t_s, output = columns["t_s"], columns["output"]
    assert len(t_s) == entry_declared["rows"], (file.table.layout, file.remarks)
    timed = np.isfinite(t_s)
    present = timed & np.isfinite(output)
    assert np.sum(~present) == entry_declared["missing"]
    assert t_s[timed][-1] - t_s[timed][0] == pytest.approx(entry_declared["duration_s"], abs=2e-5)
    steps = np.diff(t_s[timed])
    assert np.all(steps > 0) and 1 / np.median(steps) == pytest.approx(entry_declared["rate_Hz"], rel=1e-3)
    assert [output[present][0], output[present][-1]] == pytest.approx(entry_declared["output"], rel=1e-6)
    if has_reference:
        reference = columns["reference"][np.isfinite(columns["reference"])]
        assert [reference[0], reference[-1]] == pytest.approx(entry_declared["reference"], rel=1e-6)
    units = {column.name: column.unit for column in file.table.columns}
    assert {name: units[name] for name in entry_declared.get("units", {})} == entry_declared.get("units", {})


@pytest.mark.parametrize("entry", ENTRY_POINTS)
@pytest.mark.parametrize("entry_declared", FILES, ids=lambda each: each["file"])
def test_every_entry_point_reads_a_file_alike(entry, entry_declared, folder, tmp_path, capsys):
    if "reference" not in entry_declared["columns"] and entry in ("import", "lot audit"):
        return  # Both ask for a reference.
    if entry_declared["file"] == "coarse_stamps.csv" and entry == "adapt":
        return  # A stream goes on: its rows are flagged.
    by_import.capture = capsys
    read = ENTRY_POINTS[entry]
    # Of a lot the rate is known, which tells the unit of a time that nothing else tells.
    is_rate_given = entry_declared.get("told_by_rate") and entry in ("lot folder", "lot audit", "browser")
    if "refused" in entry_declared and not is_rate_given:
        with pytest.raises(InputError) as refusal:
            read(folder / entry_declared["file"], entry_declared, tmp_path / "lot")
        message = str(refusal.value)
        assert (
            re.search(entry_declared["refused"], message) and "\n" not in message and "measure again" not in message
        ), message
        return
    t_s, output = read(folder / entry_declared["file"], entry_declared, tmp_path / "lot")
    if is_rate_given:
        assert t_s[-1] - t_s[0] == pytest.approx(entry_declared["told_by_rate"])
        return
    present, count = np.isfinite(t_s) & np.isfinite(output), entry_declared["rows"] - entry_declared["missing"]
    # An overflow code is masked where a recording is built; files and tables hold it as it was written.
    is_built = entry in ("reader, estimate", "lot folder", "lot audit", "browser", "Python")
    assert np.sum(present) == count - (entry_declared.get("overflow", 0) if is_built else 0)
    assert [output[present][0], output[present][-1]] == pytest.approx(entry_declared["output"], rel=1e-6)
    assert t_s[present][-1] - t_s[present][0] == pytest.approx(
        entry_declared.get("sampled_s", entry_declared["duration_s"]), abs=2e-5
    )


@pytest.mark.parametrize("entry_declared", READ, ids=lambda each: each["file"])
def test_the_column_of_time_need_not_be_named(entry_declared, folder):
    columns = entry_declared["columns"]
    if not re.search("(?i)time|^zeit|temps|시간|時間|^t_|millis|micros", columns.get("time", "")):
        return  # No heading tells.
    if entry_declared["file"] == "campbell_toa5.dat":
        return  # Three rows of names: here the person names the column.
    names = ColumnNames(
        columns["output"], None, columns.get("reference", "reference"), None, None, options_of(entry_declared)
    )
    t_s = inspect_recording(folder / entry_declared["file"], SERIAL, None, names=names).recording.t_s
    assert 1 / np.median(np.diff(t_s)) == pytest.approx(entry_declared["rate_Hz"], rel=1e-3)
