"""Files from elsewhere are never trusted: bombs, pickles, shifted or doubled columns, names that leave the folder."""

import pickle
import random
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet
import pytest

from softcal.app.cli.main import main
from softcal.app.files.recording_file import inspect_recording
from softcal.app.tables.options import TableOptions
from softcal.app.tables.read import read_table
from softcal.core.errors import InputError

BENCHMARKS = str(Path(__file__).parents[2] / "benchmarks")
BOMB = "unpack"


@pytest.mark.parametrize(("kind", "files"), [("csv", 150), ("bytes", 150), ("xlsx", 10), ("parquet", 40)])
def test_broken_files_are_refused_or_read_as_they_stand(kind, files, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    from fuzz import Fuzz

    fuzz = Fuzz(kind, tmp_path, random.Random(f"7 {kind}"))
    for _ in range(files):
        fuzz.one()
    assert sum(fuzz.counts[what] for what in ("refused", "made")) == files, fuzz.examples
    assert not fuzz.examples and fuzz.counts["refused"] > files / 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t_s,output\n0,1,2\n0.02,1,2\n", "header"),
        ("t_s,output,output\n0,1,2\n0.02,1,2\n", "'output'"),
        ("\n\nt_s,t_s,output\n0,1,2\n0.02,1,2\n", "'t_s'"),
        ("t_s,output\n0,True\n0.02,False\n", "'True'"),
    ],
)
def test_ambiguous_columns_are_refused(text, message, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        inspect_recording(path, "a", 50.0)


def test_a_control_character_in_a_header_is_shown_and_not_obeyed(tmp_path, capsys):
    path = tmp_path / "A1.csv"
    path.write_text("t_s,\x1b[2Jout\x0bput\n0,1\n")
    command = ["import", str(path), "--source", "A1", "--output-column", "V", "--sample-rate", "50"]
    assert main([*command, "--out", str(tmp_path / "lot")]) == 2
    stderr = capsys.readouterr().err
    assert "\\x1b[2Jout\\x0bput" in stderr
    assert all(letter.isprintable() for letter in stderr.rstrip("\n"))


def test_doubled_columns_of_a_spreadsheet_are_refused(tmp_path):
    pd.DataFrame([[0.0, 1.0, 2.0]], columns=["t_s", "output", "output"]).to_excel(tmp_path / "a.xlsx", index=False)
    with pytest.raises(InputError, match="'output'"):
        read_table(tmp_path / "a.xlsx")


@pytest.mark.parametrize(("kind", "max_cells"), [("xlsx", 10_000_000), ("parquet", 2_000_000)])
def test_a_file_that_unpacks_to_gigabytes_is_not_opened(tmp_path, kind, max_cells):
    path = tmp_path / f"bomb.{kind}"
    if kind == "parquet":
        pyarrow.parquet.write_table(pa.table({name: np.zeros(2_000_000) for name in ("t_s", "output")}), path)
    else:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("sheet1.xml", bytes(21_000_000))
    assert path.stat().st_size < 100_000
    with pytest.raises(InputError, match=BOMB):
        read_table(path, TableOptions(max_cells=max_cells))


def test_a_parquet_footer_that_ends_pyarrow_s_process_is_refused_in_one_line(tmp_path):
    # Found by the fuzzer: sizes of a column that contradict its schema.
    broken = Path(__file__).parent / "damaged_files" / "footer.parquet"
    code = "import sys; from softcal.app.cli.main import main; sys.exit(main(sys.argv[1:]))"
    command = ["import", str(broken), "--source", "S0", "--output-column", "output", "--reference-column", "reference"]
    command += ["--sample-rate", "50", "--out", str(tmp_path / "lot")]
    process = subprocess.run([sys.executable, "-c", code, *command], capture_output=True, text=True, check=False)
    assert (process.returncode, process.stderr.count("\n")) == (2, 1), process.stderr
    assert "footer.parquet" in process.stderr


class _Bomb:
    def __reduce__(self):
        return (sys.exit, ("a pickle was run",))


@pytest.mark.parametrize("name", ["a.pkl", "a.csv", "a.xlsx", "a.parquet", "a.npy"])
def test_a_pickle_is_never_run(name, tmp_path, capsys):
    path = tmp_path / name
    path.write_bytes(pickle.dumps(_Bomb()))
    command = ["import", str(path), "--out", str(tmp_path / "lot"), "--source", "a", "--sample-rate", "50"]
    assert main(command) == 2
    assert "a pickle was run" not in capsys.readouterr().err and not (tmp_path / "lot").exists()


@pytest.mark.parametrize("serial", ["../../x", "..", "/etc/passwd", "a/b", "a\\b", "con\0", "", ".hidden", "a" * 65])
def test_a_serial_never_leaves_its_folder(serial, tmp_path):
    table = pd.DataFrame({"output": np.linspace(0, 1, 40), "reference": np.linspace(0, 3, 40)})
    table.to_csv(tmp_path / "a.csv", index=False)
    # Deep enough that what climbs out of the lot would still be seen.
    deep = tmp_path / "of" / "the" / "line"
    deep.mkdir(parents=True)
    before = sorted(tmp_path.rglob("*"))
    command = ["import", str(tmp_path / "a.csv"), "--out", str(deep / "lot"), "--sample-rate", "50"]
    assert main([*command, "--source", serial, "--serial", serial, "--reference-column", "reference"]) == 2
    assert sorted(tmp_path.rglob("*")) == before


def _sheet(path: Path, rows: str) -> Path:
    """Write a spreadsheet by hand: a program that wishes no good does not use a library either."""
    pd.DataFrame({"t_s": [0.0], "output": [0.0]}).to_excel(path, index=False)
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    spreadsheet = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    header = '<row r="1"><c r="A1" t="inlineStr"><is><t>output</t></is></c></row>'
    parts["xl/worksheets/sheet1.xml"] = (
        f'<worksheet xmlns="{spreadsheet}"><sheetData>{header}{rows}</sheetData></worksheet>'.encode()
    )
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in parts.items():
            archive.writestr(name, content)
    return path


@pytest.mark.parametrize(
    "rows",
    [
        '<row r="999999999"><c r="A999999999"><v>1</v></c></row>',
        "".join(f'<row r="{k}"><c r="ZZZ{k}"><v>1</v></c></row>' for k in range(2, 400)),
        "<row/>" * 110_000,
    ],
)
def test_a_sheet_whose_cells_stand_far_out_is_refused_while_it_is_counted(tmp_path, rows):
    with pytest.raises(InputError, match=BOMB):
        read_table(_sheet(tmp_path / "far.xlsx", rows), TableOptions(max_cells=1_000_000))


def test_of_a_sheet_only_the_columns_asked_for_are_kept(tmp_path):
    path = tmp_path / "wide.xlsx"
    pd.DataFrame({"t_s": [0.0, 0.1], "output": [1, 2], "note": ["x", "y"], "more": [None, 3.5]}).to_excel(
        path, index=False
    )
    table = read_table(path, is_requested={"output", "more"}.__contains__)
    assert [c.name for c in table.columns] == ["output", "more"] and table.numbers("output").tolist() == [1, 2]
    with pytest.raises(InputError, match="'gone'.*t_s, output, note, more"):
        read_table(path, is_requested={"gone"}.__contains__).numbers("gone")


def test_of_a_parquet_file_only_the_columns_asked_for_count(tmp_path):
    path = tmp_path / "wide.parquet"
    pyarrow.parquet.write_table(pa.table({name: np.arange(100_000.0) for name in ("t_s", "output", "a", "b")}), path)
    with pytest.raises(InputError, match=BOMB):
        read_table(path, TableOptions(max_cells=300_000))
    table = read_table(path, TableOptions(max_cells=300_000), is_requested={"t_s", "output"}.__contains__)
    assert [c.name for c in table.columns] == ["t_s", "output"] and len(table) == 100_000
    with pytest.raises(InputError, match="'gone'.*t_s, output, a, b"):
        read_table(path, is_requested={"gone"}.__contains__).numbers("gone")


@pytest.mark.parametrize("what", ["text", "lists"])
def test_a_parquet_column_that_holds_no_numbers_does_not_unpack(tmp_path, what):
    path = tmp_path / "bomb.parquet"
    # A few kB: one long text, or one long list, over and over.
    text = pa.DictionaryArray.from_arrays(pa.array([0] * 100_000, pa.int32()), ["7" * 100_000])
    table = pa.table({"output": text if what == "text" else pa.array([[0.0] * 1000] * 100)})
    pyarrow.parquet.write_table(table, path, store_schema=False)
    assert path.stat().st_size < 200_000
    with pytest.raises(InputError, match=f"{BOMB}|lists"):
        read_table(path)


def test_numbers_that_parquet_keeps_as_text_read_as_before(tmp_path):
    path = tmp_path / "text.parquet"
    pyarrow.parquet.write_table(pa.table({"output": ["1.5", "2.5", "1.5"]}), path)
    assert read_table(path).numbers("output").tolist() == [1.5, 2.5, 1.5]


def test_a_text_file_of_too_many_cells_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "long.csv"
    path.write_text("t_s,output\n" + "0,1\n" * 1000)
    assert len(read_table(path, TableOptions(max_cells=2100))) == 1000
    with pytest.raises(InputError, match=BOMB):
        read_table(path, TableOptions(max_cells=1500))
    path.write_text("output\n" + "1" * 60_000)
    with pytest.raises(InputError, match=BOMB):
        read_table(path, TableOptions(max_cells=2000))
