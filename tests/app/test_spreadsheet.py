"""Workbooks: which sheet is meant, what formulas hold, where the table lies on its sheet."""

from pathlib import Path

import numpy as np
import pytest
from openpyxl import Workbook

from softcal.app.tables.options import TableOptions
from softcal.app.tables.read import read_table
from softcal.core.errors import InputError

TIME = np.arange(30) / 50
VALUE = np.round(0.5 + 0.3 * np.sin(np.arange(30)), 4)
ROWS = [("t_s", "output"), *zip(TIME.tolist(), VALUE.tolist(), strict=True)]


def _workbook(path: Path, **sheets: list[tuple[object, ...]]) -> Path:
    book = Workbook()
    book.remove(book.active)
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(row)
    book.save(path)
    return path


def test_the_only_sheet_with_a_table_is_read_and_reported(tmp_path: Path) -> None:
    path = _workbook(tmp_path / "a.xlsx", Notes=[("operator", "Kim"), ("pressed by hand",)], Data=ROWS)
    table = read_table(path)
    np.testing.assert_array_equal(table.numbers("output"), VALUE)
    assert table.layout == "sheet 'Data'" and "'Data'" in table.remarks[0]


def test_several_sheets_with_tables_are_asked_about_and_an_option_answers(tmp_path: Path) -> None:
    other = [("t_s", "force"), *zip(TIME.tolist(), (VALUE * 2).tolist(), strict=True)]
    path = _workbook(tmp_path / "a.xlsx", First=ROWS, Second=ROWS, Third=other)
    with pytest.raises(InputError, match="'First', 'Second'.*--sheet"):
        read_table(path, is_requested={"t_s", "output"}.__contains__)
    assert len(read_table(path, TableOptions(sheet="Second"))) == 30
    np.testing.assert_array_equal(read_table(path, is_requested={"force"}.__contains__).numbers("force"), VALUE * 2)
    with pytest.raises(InputError, match="no sheet 'Fourth'.*'First'"):
        read_table(path, TableOptions(sheet="Fourth"))


def test_a_formula_without_a_stored_value_is_named_by_its_cell(tmp_path: Path) -> None:
    rows = [*ROWS]
    rows[5] = (rows[5][0], "=B5*2")
    path = _workbook(tmp_path / "a.xlsx", Data=rows)
    with pytest.raises(InputError, match="cell B6 is a formula without a stored value.*save"):
        read_table(path)


def test_a_table_below_a_preamble_keeps_its_rows_of_the_sheet(tmp_path: Path) -> None:
    units = [("Time", "Load"), ("(s)", "(N)"), *ROWS[1:]]
    path = _workbook(tmp_path / "a.xlsx", Data=[("Specimen", 7), (), *units, ("Max", None)])
    table = read_table(path)
    assert table.names == ("Time", "Load") and [column.unit for column in table.columns] == ["s", "N"]
    assert table.lines[[0, -1]].tolist() == [5, 34]
    assert table.layout == "header in line 3; units in line 4" and "'Max'" in table.remarks[0]


def test_a_summary_below_the_samples_is_left_out_and_reported(tmp_path: Path) -> None:
    below = [(), ("Mean", 0.55), (None, "SD:")]
    table = read_table(_workbook(tmp_path / "a.xlsx", Data=[*ROWS, *below]))
    assert len(table) == 30 and "'Mean'" in table.remarks[0]


def test_a_text_file_that_is_called_a_workbook_is_read_and_named(tmp_path: Path) -> None:
    path = tmp_path / "a.xls"
    path.write_text("t_s\toutput\n0\t0.5\n0.02\t0.6\n")
    table = read_table(path)
    assert table.numbers("output").tolist() == [0.5, 0.6]
    assert any("text file, whatever its name says" in remark for remark in table.remarks)


def test_empty_cells_are_missing_and_texts_are_named_by_their_row(tmp_path: Path) -> None:
    rows = [*ROWS]
    rows[3] = (rows[3][0], None)
    path = _workbook(tmp_path / "a.xlsx", Data=rows)
    assert np.flatnonzero(np.isnan(read_table(path).numbers("output"))).tolist() == [2]
    rows[4] = (rows[4][0], "broken")
    path = _workbook(tmp_path / "b.xlsx", Data=rows)
    with pytest.raises(InputError, match="line 5, column 'output': 'broken'"):
        read_table(path).numbers("output")


def test_numbers_that_are_texts_read_with_a_decimal_comma(tmp_path: Path) -> None:
    rows = [("t_s", "output"), *((f"{t:.2f}".replace(".", ","), f"{v}".replace(".", ",")) for t, v in ROWS[1:])]
    table = read_table(_workbook(tmp_path / "a.xlsx", Data=rows))
    np.testing.assert_array_equal(table.numbers("output"), VALUE)
    assert table.layout == "decimal comma"
