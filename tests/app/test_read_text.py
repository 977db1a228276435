"""Text files as loggers write them: what is unambiguous is read, what is not is asked about."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softcal.app.files.recording_file import ColumnNames, inspect_recording
from softcal.app.tables.options import DETECT, TableOptions
from softcal.app.tables.read import read_table, table_pieces
from softcal.core.errors import InputError

TIME = np.round(np.arange(40) * 0.02, 2)
VALUE = np.round(0.5 + 0.3 * np.sin(np.arange(40)), 4)


def _rows(delimiter: str = ",", decimal: str = ".", end: str = "") -> list[str]:
    cells = [
        (f"{t:.2f}".replace(".", decimal), f"{v:.4f}".replace(".", decimal)) for t, v in zip(TIME, VALUE, strict=True)
    ]
    return [f"{t}{delimiter}{v}{end}" for t, v in cells]


def _text(*head: str, **form: str) -> str:
    return "\n".join([*head, *_rows(**form)]) + "\n"


LVM = """LabVIEW Measurement
Writer_Version\t2
Reader_Version\t2
Separator\tTab
Decimal_Separator\t,
Multi_Headings\tNo
X_Columns\tOne
Time_Pref\tRelative
Operator\tKim
Date\t2026/03/04
Time\t10:11:12,5
***End_of_Header***\t

Channels\t1\t
Samples\t40\t
Date\t2026/03/04\t
Time\t10:11:12,5\t
Y_Unit_Label\tVolts\t
X_Dimension\tTime\t
X0\t0,0E+0\t
Delta_X\t0,02\t
***End_of_Header***\t
X_Value\tVoltage\tComment"""

VARIANTS = {
    "plain": (_text("t_s,output"), ("t_s", "output"), ""),
    "tabs": (_text("t_s\toutput", delimiter="\t"), ("t_s", "output"), "tabs"),
    "semicolons": (_text("t_s;output", delimiter=";"), ("t_s", "output"), "semicolons"),
    "decimal comma": (_text("t_s;output", delimiter=";", decimal=","), ("t_s", "output"), "semicolons; decimal comma"),
    "tabs, comma": (_text("t_s\toutput", delimiter="\t", decimal=","), ("t_s", "output"), "tabs; decimal comma"),
    "bars": (_text("t_s|output", delimiter="|"), ("t_s", "output"), "bars"),
    "blanks": (_text("  t_s   output", delimiter="   "), ("t_s", "output"), "blanks"),
    "blanks, comma": (_text("t_s output", delimiter=" ", decimal=","), ("t_s", "output"), "blanks; decimal comma"),
    "sep": (_text("sep=;", "t_s;output", delimiter=";"), ("t_s", "output"), "semicolons; header in line 2"),
    "blank after comma": (_text("t_s, output", delimiter=", "), ("t_s", "output"), ""),
    "quotes": (_text('"t_s","output"', delimiter=","), ("t_s", "output"), ""),
    "quoted cells": (_text("t_s,output").replace("0.02,", '"0.02",'), ("t_s", "output"), ""),
    "quoted decimal comma": (
        "t_s,output\n" + "\n".join('"{}","{}"'.format(*row.split(";")) for row in _rows(";", ",")) + "\n",
        ("t_s", "output"),
        "decimal comma",
    ),
    "no header": (_text(), ("column_1", "column_2"), "no header"),
    "units row": (_text("t_s,output", "(s),(V)"), ("t_s", "output"), "units in line 2"),
    "two units rows": (_text("t_s,output", "s,V", "-,-"), ("t_s", "output"), "2 units rows"),
    "preamble": (
        _text("MESUR gauge Plus", "Sample rate,50", "Operator,Kim", "", "t_s,output"),
        ("t_s", "output"),
        "header in line 5",
    ),
    "preamble and units": (
        _text('"Method";"press"', '"Specimen";"7"', "", '"Time";"Load"', '"(s)";"(N)"', delimiter=";", decimal=","),
        ("Time", "Load"),
        "semicolons; decimal comma; header in line 4; units in line 5",
    ),
    "comment header": (
        _text("# made by numpy", "# t_s output", delimiter=" "),
        ("t_s", "output"),
        "blanks; header in line 2",
    ),
    "comma at line ends": (_text("t_s,output,", end=","), ("t_s", "output"), ""),
    "comma at row ends": (_text("t_s,output", end=","), ("t_s", "output"), ""),
    "empty rows": (_text("t_s,output") + ",\n,\n,\n", ("t_s", "output"), ""),
    "footer": (_text("t_s,output") + "\nMax,0.8\nMin,0.2\n", ("t_s", "output"), ""),
    "end mark": (_text("t_s,output") + "*** end of test ***\n", ("t_s", "output"), ""),
    "carriage returns": (_text("t_s,output").replace("\n", "\r\n"), ("t_s", "output"), ""),
    "old mac": (_text("t_s,output").replace("\n", "\r"), ("t_s", "output"), ""),
    "blank lines": (_text("t_s,output").replace("\n", "\n\n"), ("t_s", "output"), ""),
    "plus signs": (_text("t_s,output").replace(",0", ",+0"), ("t_s", "output"), ""),
    "lvm": (
        "\n".join([LVM, *_rows("\t", ",", "\t")]) + "\n",
        ("X_Value", "Voltage"),
        "tabs; decimal comma; header in line 23",
    ),
}


@pytest.mark.parametrize("name", VARIANTS)
def test_what_is_unambiguous_is_read(name: str, tmp_path: Path) -> None:
    text, names, layout = VARIANTS[name]
    path = tmp_path / ("a.lvm" if name == "lvm" else "a.csv")
    path.write_bytes(text.encode())
    table = read_table(path)
    assert table.names[:2] == names
    np.testing.assert_array_equal(table.numbers(names[0]), TIME)
    np.testing.assert_array_equal(table.numbers(names[1]), VALUE)
    assert table.layout == layout
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    assert all(str(v) in lines[k - 1].replace(",", ".") for k, v in zip(table.lines, VALUE, strict=True))


FRAMES = [f"{int(200 * value):02X}" for value in VALUE]
PAIRS = [{"t_s": t, "output": v} for t, v in zip(TIME.tolist(), VALUE.tolist(), strict=True)]
OTHER_TEXTS = {
    "candump log": ("".join(f"({t:.6f}) can0 123#{b}00\n" for t, b in zip(TIME, FRAMES, strict=True)), "candump.*DBC"),
    "candump screen": ("".join(f"  vcan1  18FF0123   [2]  {b} 00\n" for b in FRAMES), "candump.*DBC"),
    "candump times": (
        "".join(f" ({t:010.6f})  can0  123   [2]  {b} 00   '..'\n" for t, b in zip(TIME, FRAMES, strict=True)),
        "candump.*DBC",
    ),
    "Vector": (
        "date Mon Mar 2 10:00:00 2026\nbase hex  timestamps absolute\n"
        + "".join(f"   {t:.6f} 1  123             Rx   d 2 {b} 00\n" for t, b in zip(TIME, FRAMES, strict=True)),
        "Vector.*DBC",
    ),
    "JSON lines": ("".join(f"{json.dumps(pair)}\n" for pair in PAIRS), r"JSON lines.*lines=True\).to_csv"),
    "JSON lists": ("".join(f"{json.dumps(list(pair.values()))}\n" for pair in PAIRS), "JSON lines"),
    "JSON records": (json.dumps(PAIRS, indent=1), r"JSON, no table.*'a\.log'\)\.to_csv"),
    "JSON rows": (",\n".join(json.dumps(PAIRS).split(", {")), "JSON"),
    "JSON columns": (json.dumps({"t_s": TIME.tolist(), "output": VALUE.tolist()}), "JSON, no table"),
    "JSON object": (json.dumps({"unit": "V", "data": PAIRS}, indent=2), "JSON, no table"),
}


@pytest.mark.parametrize("kind", OTHER_TEXTS)
def test_a_text_that_is_no_table_is_named_with_what_makes_one(kind: str, tmp_path: Path) -> None:
    text, line = OTHER_TEXTS[kind]
    path = tmp_path / "a.log"
    path.write_text(text)
    for read in (lambda: read_table(path), lambda: list(table_pieces(path, DETECT, None, 100))):
        with pytest.raises(InputError, match=line) as refused:
            read()
        assert "\n" not in str(refused.value)


def test_a_line_of_json_above_a_table_and_stamps_in_brackets_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    stamped = "".join(f"[10:00:{t:06.3f}] {v}\n" for t, v in zip(TIME, VALUE, strict=True))
    for text in (_text('{"unit": "V"}', "t_s,output"), stamped):
        path.write_text(text)
        assert len(read_table(path)) == len(VALUE)


def lvm_without_times(*changes: tuple[str, str], has_column: bool = True, values: Sequence[float] = ()) -> str:
    head = LVM if has_column else LVM.replace("X_Value\t", "")
    for old, new in (("X_Columns\tOne", "X_Columns\tNo"), *changes):
        assert old in head
        head = head.replace(old, new)
    cells = [str(value).replace(".", ",") for value in values or VALUE]
    return "\n".join([head, *(f"\t{cell}\t" if has_column else f"{cell}\t" for cell in cells)]) + "\n"


@pytest.mark.parametrize("has_column", [True, False])
def test_a_labview_file_without_times_has_those_of_its_step(has_column: bool, tmp_path: Path) -> None:
    path = tmp_path / "a.lvm"
    path.write_text(lvm_without_times(("X0\t0,0E+0", "X0\t1,5"), has_column=has_column))
    table = read_table(path)
    np.testing.assert_allclose(table.numbers("t_s"), 1.5 + 0.02 * np.arange(len(VALUE)), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(table.numbers("Voltage"), VALUE)
    assert table.layout.endswith("time from X0 1.5 s and Delta_X 0.02 s")
    long = tmp_path / "long.lvm"
    long.write_text(lvm_without_times(has_column=has_column, values=50 * tuple(VALUE)))
    pieces = [piece.numbers("t_s") for piece in table_pieces(long, DETECT, None, 7)]
    assert len(pieces) > 2
    np.testing.assert_allclose(np.concatenate(pieces), 0.02 * np.arange(2000), rtol=0, atol=1e-9)
    # The rate that somebody states is a check, as of every file that has times.
    names = ColumnNames(output="Voltage", rate_Hz=50.0)
    assert inspect_recording(path, "S1", None, names=names).recording.sample_rate_Hz == 50
    with pytest.raises(InputError, match="show 50 Hz, the declared sample rate is 100 Hz"):
        inspect_recording(path, "S1", None, names=replace(names, rate_Hz=100.0))


def test_a_step_of_labview_that_is_no_time_of_one_recording_is_no_clock(tmp_path: Path) -> None:
    path = tmp_path / "a.lvm"
    path.write_text(lvm_without_times(("X_Dimension\tTime", "X_Dimension\tFrequency")))
    assert not read_table(path).has("t_s")
    path.write_text(lvm_without_times(("Delta_X\t0,02", "Delta_X\t0,02\t0,01")))
    with pytest.raises(InputError, match=r"Delta_X.*0\.02, 0\.01.*export"):
        read_table(path)
    segment = "Channels\t1\t\nDelta_X\t0,02\t\n***End_of_Header***\t\nX_Value\tVoltage\tComment\n"
    path.write_text(lvm_without_times() + segment + "\t0,5\t\n\t0,6\t\n")
    with pytest.raises(InputError, match="segments.*X_Value"):
        read_table(path)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1", "cp949"])
def test_encodings_are_detected(encoding: str, tmp_path: Path) -> None:
    name = "출력 전압" if encoding == "cp949" else "Spannung µV"
    path = tmp_path / "a.csv"
    path.write_bytes(_text(f"t_s;{name}", delimiter=";", decimal=",").encode(encoding))
    table = read_table(path)
    np.testing.assert_array_equal(table.numbers(name), VALUE)
    assert bool(table.remarks) == (encoding in ("latin-1", "cp949"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0,512\n0,513\n0,514\n", "--delimiter"),
        ("t_s;output\n0;1,234\n1;1,235\n2;1,236\n", "--decimal"),
        ("a,b,c\n0,02,1,5,6,7\n0,04,1,6,7,8\n", "more cells than the header"),
        ("0,1,2\n3,4,5\n6,7,8\n", "--header-row"),
        ("t_s,output\n0,1\n0.02,1,2\n0.04,2\n", "line 3 has 3 cells"),
        ("t_s,output\n0,1\n0.02\n0.04,2\n", "line 3 has 1 cell"),
        ("t_s,output\n0,1\n0.02,x\n0.04,2\n", "line 3, column 'output': 'x'"),
        ("t_s,output\n0,x\n0.02,1\n0.04,2\n0.06,2\n", "line 2, column 'output': 'x'"),
        ("t_s\toutput\n0\t1,234\n1\t1,235\n2\t6\n", "thousands"),
        ("t_s,output\n0,1\n0.02,\0\n0.04,2\n", "line 3"),
        ("t_s,output\n0,True\n0.02,False\n", "'True'"),
        ("t_s,output\n", "no row of data"),
    ],
)
def test_ambiguous_text_is_refused_with_its_line_or_option(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        table = read_table(path)
        for name in table.names:
            table.numbers(name)


def test_empty_cells_and_words_for_no_sample_are_missing_and_other_texts_only_if_declared(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("t_s,output\n0,1\n1,\n2,NaN\n3,1.#QNAN\n4,inf\n5,2\n")
    np.testing.assert_array_equal(read_table(path).numbers("output"), [1, np.nan, np.nan, np.nan, np.nan, 2])
    path.write_text("t_s,output\n0,1\n1,OL\n2,#N/A\n3,<na>\n4,OL\n")
    table = read_table(path)
    np.testing.assert_array_equal(table.numbers("output"), [1, np.nan, np.nan, np.nan, np.nan])
    assert table.remarks == (
        "column 'output': 'OL' (rows: 2), '#N/A' (rows: 1), '<na>' (rows: 1) read as missing samples",
    )
    path.write_text('"t_s","output"\n"0","1"\n"1","OL"\n')
    assert read_table(path).remarks == ("column 'output': 'OL' (rows: 1) read as missing samples",)
    path.write_text("t_s,output\n0,1\n1,<broken>\n2,-9999\n")
    with pytest.raises(InputError, match="line 3.*'<broken>'.*--missing '<broken>'"):
        read_table(path).numbers("output")
    table = read_table(path, TableOptions(missing=("<broken>", "-9999")))
    np.testing.assert_array_equal(table.numbers("output"), [1, np.nan, np.nan])
    assert not table.remarks


def test_options_decide_where_two_readings_are_possible(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("0,512\n0,513\n0,514\n")
    assert read_table(path, TableOptions(delimiter=",")).names == ("column_1", "column_2")
    one = read_table(path, TableOptions(decimal=","))
    np.testing.assert_array_equal(one.numbers("column_1"), [0.512, 0.513, 0.514])
    path.write_text("t_s;output\n0;1,234\n1;1,235\n")
    table = read_table(path, TableOptions(decimal=","))
    np.testing.assert_array_equal(table.numbers("output"), [1.234, 1.235])
    path.write_text("0,1,2\n3,4,5\n6,7,8\n")
    assert len(read_table(path, TableOptions(header_row=0))) == 3
    assert read_table(path, TableOptions(header_row=1)).names == ("0", "1", "2")


def test_a_million_rows_keep_their_lines(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    rows = [f"{k // 1000},{k % 1000:03};{k % 977},{k % 10}" for k in range(200_000)]
    path.write_text("\n".join(["Logger", "t_s;output", *rows[:1000], "", *rows[1000:]]))
    table = read_table(path)
    assert len(table) == 200_000 and table.lines[[0, 999, 1000, -1]].tolist() == [3, 1002, 1004, 200_003]
    np.testing.assert_array_equal(table.numbers("output")[[5, -1]], [5.5, 199_999 % 977 + 0.9])
