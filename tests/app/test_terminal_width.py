"""Tables, reasons and progress fit the terminal, lose no text, and a pipe gets whole lines."""

import io
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace

import pytest

from softcal.app import output
from softcal.app.batch.report import TABLE_HEADER, audit_lines, table_row
from softcal.app.cli.main import main
from softcal.app.output import ProgressLine, print_reasons, print_table
from softcal.app.registry import listing
from softcal.app.registry.listing import HISTORY_HEADER, UNIT_HEADER, first_reasons
from softcal.app.texts.reason_groups import reasons_by_verdict
from softcal.core.messages.reason import Reason, plain, reason
from softcal.core.unit.verdict import VERDICTS
from softcal.db.connection import open_registry
from softcal.db.entries import UnitEntry, UnitResult

LONG = (
    "its predicted error is within the limit (RMSE 0.0322 N, 95 %: 0.0227 to 0.0457, limit 0.0772 N, 3 x the source's "
    "own error of 0.0257 N, since no limit was stated)"
)
KOREAN = "예측 오차는 한계 안에 있음; 로드셀로 측정하십시오 " * 6
INSTANT = "2026-11-27 21:09:09 UTC+09:00"
UNITS = [
    ["lot-2", "A1", "target", "conditional", 12, "synchronous", 0.03218, 1.051, 0.02863, 0.02411, INSTANT, LONG],
    [
        "2026-48-압력",
        "센서-0001-가나다라",
        "target",
        "retest",
        1,
        "two_point",
        1.234e-5,
        12340.0,
        None,
        None,
        INSTANT,
        KOREAN,
    ],
    ["L" * 64, "S" * 64, "source", None, None, None, None, None, None, None, None, ""],
]
HISTORY = [
    [104, "7d02dd0b7613", "yes", INSTANT, "김민수 (engineer)", "2026-48", "conditional", "averaged", 0.1, None, LONG],
    [1, "7d02dd0b7613", "", INSTANT, "root", "2026-48", "pass", "two_point", 0.1, 0.12, "batch"],
]


def terminal_width(text: str) -> int:
    """Return the places a text takes in a terminal, by the Unicode database."""
    return sum(2 if unicodedata.east_asian_width(c) in "WF" else 1 for c in text)


def squeezed(text: str) -> str:
    return re.sub(r"\s", "", text)


@pytest.mark.parametrize(("header", "rows"), [(UNIT_HEADER, UNITS), (HISTORY_HEADER, HISTORY)])
@pytest.mark.parametrize("columns", [40, 80, 100, 120, 200])
def test_a_table_fits_and_nothing_of_it_is_cut_off(monkeypatch, capsys, columns, header, rows) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    print_table(header, rows)
    stdout = capsys.readouterr().out
    assert max(map(terminal_width, stdout.splitlines())) <= columns
    for row in rows:
        for cell in row:
            if isinstance(cell, str):
                assert squeezed(cell) in squeezed(stdout)


def test_columns_stand_under_one_another_whatever_their_letters(monkeypatch, capsys) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    print_table(("serial", "verdict"), [["센서-1", "pass"], ["A1", "fail"]])
    lines = capsys.readouterr().out.splitlines()
    cells = zip(lines, ("verdict", "-------", "pass", "fail"), strict=True)
    starts = {terminal_width(line[: line.rindex(word)]) for line, word in cells}
    assert starts == {8}


def test_a_pipe_gets_one_whole_line_a_row(monkeypatch, capsys) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    print_table(UNIT_HEADER, UNITS)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(UNITS) + 2 and LONG in lines[2] and KOREAN.strip() in lines[3]


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_terminal_is_written_in_its_width_and_verdicts_keep_their_colour(monkeypatch) -> None:
    screen = Terminal()
    monkeypatch.setattr("sys.stdout", screen)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    print_table(UNIT_HEADER, UNITS[:2])
    plainly = re.sub(r"\x1b\[[0-9;]*m", "", screen.getvalue())
    assert plainly != screen.getvalue() and max(map(terminal_width, plainly.splitlines())) <= 80


@pytest.mark.parametrize("columns", [60, 80, 120])
def test_reasons_fit(monkeypatch, capsys, columns) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    print_reasons(", ".join(f"UNIT-{k:04}" for k in range(40)), [LONG, KOREAN])
    stdout = capsys.readouterr().out
    assert max(map(terminal_width, stdout.splitlines())) <= columns and squeezed(KOREAN) in squeezed(stdout)


@pytest.mark.parametrize("columns", [30, 80])
def test_progress_is_one_line_of_a_terminal(monkeypatch, columns) -> None:
    screen = Terminal()
    monkeypatch.setattr("sys.stderr", screen)
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setattr(output.time, "monotonic", iter(range(10_000)).__next__)
    progress = ProgressLine("units", 12_000)
    for _ in range(50):
        progress.step("압력센서-0001-가나다라마바사아자차카타파하-가나다라마바사 conditional")
    lines = [line.removeprefix("\x1b[K") for line in screen.getvalue().split("\r") if line]
    assert len(lines) > 10 and all(terminal_width(line) < columns and "/12000 units" in line for line in lines)


def unit(serial: str, verdict: str, *reasons: Reason) -> UnitResult:
    return UnitResult(serial, verdict, reasons)


def dead(samples: int) -> Reason:
    return reason("unused.rows", count=samples, total=1500, rows="0:10")


def listed(units: Sequence[UnitResult]) -> list[tuple[str, list[str]]]:
    return reasons_by_verdict(units, reversed(VERDICTS[1:]))


def test_equal_reasons_are_one_line_with_their_units() -> None:
    measure = Reason("forecast_only")
    units = [unit(f"A{k:02}", "conditional", measure) for k in range(15)]
    ((subject, reasons),) = listed([*units, unit("B1", "pass", plain("fine"))])
    assert subject.startswith("15 units conditional: A00, A01") and "and 7 more" in subject
    assert reasons == [str(measure)]


def test_a_reason_whose_numbers_differ_is_reported_once_with_their_range() -> None:
    units = [unit(f"A{count}", "retest", dead(count)) for count in (3, 88, 7)]
    ((_, (line,)),) = listed(units)
    assert "rows: 3 to 88, in all: 1500" in line


def test_reasons_with_other_reasons_inside_are_lines_of_their_own() -> None:
    units = [unit(f"A{k}", "retest", reason("inspect.of_unit", serial="S", what=dead(k))) for k in (3, 5)]
    other = reason("inspect.of_unit", serial="S", what=Reason("forecast_only"))
    ((_, (joined, alone)),) = listed([*units, unit("A7", "retest", other)])
    assert joined.startswith("A3, A5: ") and "rows: 3 to 5, in all: 1500" in joined and joined.count("1500") == 1
    assert alone == f"A7: {other}"


def test_audited_units_with_equal_verdicts_are_one_line() -> None:
    decision = SimpleNamespace(predicted=SimpleNamespace(verdict="conditional"))
    units = [
        SimpleNamespace(serial=f"A{k:02}", verdict="pass", is_audited=True, state=SimpleNamespace(decision=decision))
        for k in range(10)
    ]
    changes = SimpleNamespace(withdrawn=())
    report = SimpleNamespace(units=units, changes=changes, lot_fit=None, decided=None, audit=None)
    (line,) = audit_lines(report)
    assert line.startswith("A00, A01, ") and line.endswith(" and 2 more audited: pass, were predicted conditional")


def test_intervals_that_differ_are_one_that_holds_them_all() -> None:
    def predicted(rmse: float) -> Reason:
        return reason(
            "no_limit",
            source=Reason("part.predicted"),
            rmse=rmse,
            unit="N",
            share=0.004,
            lower=rmse / 2,
            upper=2 * rmse,
        )

    units = [unit(f"A{rmse}", "conditional", predicted(rmse)) for rmse in (0.2, 0.4)]
    ((_, (line,)),) = listed(units)
    assert "0.2 to 0.4 N, 0.4% of the range (95 %: 0.1 to 0.8)" in line


def test_what_is_to_be_done_next_comes_first_and_a_reason_of_some_names_them() -> None:
    some, other = Reason("forecast_only"), plain("pressed upside down")
    units = [
        unit("C1", "conditional", some),
        unit("F1", "fail", other),
        unit("R1", "retest", some),
        unit("R2", "retest", some, other),
        unit("R3", "retest", some),
    ]
    subjects, reasons = zip(*listed(units), strict=True)
    assert subjects == ("3 units retest: R1, R2, R3", "F1 fail", "C1 conditional")
    assert reasons[0] == [str(some), f"R2: {other}"]


def test_a_lot_of_equal_units_is_reported_in_few_lines(monkeypatch, capsys) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    for subject, reasons in listed([unit(f"A{k:04}", "conditional", Reason("forecast_only")) for k in range(500)]):
        print_reasons(subject, reasons)
    assert len(capsys.readouterr().out.splitlines()) < 8


def test_the_list_of_the_registry_fits(calibrated, monkeypatch, capsys) -> None:
    for columns in (80, 120):
        monkeypatch.setenv("COLUMNS", str(columns))
        assert main(["registry", "list", "--registry", calibrated]) == 0
        assert main(["registry", "history", "--serial", "A1", "--registry", calibrated]) == 0
        assert max(map(terminal_width, capsys.readouterr().out.splitlines())) <= columns


def entry(serial: str, verdict: str | None, *reasons: Reason, **flags: bool) -> UnitEntry:
    return UnitEntry("lot-1", serial, "target", verdict, reasons, **flags)


def test_a_list_has_the_first_reason_of_each_unit_and_equal_ones_once() -> None:
    within, why = Reason("forecast_only"), plain("why the limit is what it is")
    units = [entry(f"센서-{k:02}", "pass", within, why) for k in range(15)]
    units += [entry("B1", "retest", dead(3), why), entry("B2", "retest", dead(9)), entry("B3", None, plain("no row"))]
    units += [entry("C1", "pass", within, is_stale=True), entry("S", None)]
    assert tuple(reversed(VERDICTS)) == listing.VERDICTS
    (again, again_lines), (passed, passed_lines), (none, none_lines) = first_reasons(units)
    assert again == "2 units retest: B1, B2" and len(again_lines) == 1 and "rows: 3 to 9" in again_lines[0]
    assert passed.startswith("16 units pass: 센서-00, 센서-01, ") and len(passed_lines) == 2
    assert passed_lines[0].endswith(str(within)) and passed_lines[1].startswith("C1: stale: ")
    assert (none, none_lines) == ("B3 without verdict", ["no row"])
    units.append(replace(units[0], lot_id="lot-2"))
    assert "센서-00 of lot-1" in first_reasons(units)[1][0]


@pytest.mark.parametrize("columns", [80, 120])
def test_a_long_list_of_korean_units_has_a_line_or_two_a_unit(calibrated, monkeypatch, capsys, columns) -> None:
    with open_registry(calibrated) as registry:
        unit = next(unit for unit in registry.lots.units() if len(unit.reasons) > 1)
        repository = type(registry.lots)
    many = [replace(unit, serial=f"압력센서-{k:04}", lot_id="2026-48-압력") for k in range(40)]
    monkeypatch.setattr(repository, "units", lambda *_: many)
    monkeypatch.setenv("COLUMNS", str(columns))
    assert main(["registry", "list", "--registry", calibrated]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(terminal_width, lines)) <= columns and len(lines) < 2 * len(many) + 10
    assert main(["registry", "list", "--verbose", "--registry", calibrated]) == 0
    verbose = squeezed(capsys.readouterr().out)
    assert all(verbose.count(squeezed(str(why))) == len(many) for why in unit.reasons)


def test_a_list_as_csv_has_every_reason(calibrated, tmp_path, capsys) -> None:
    with open_registry(calibrated) as registry:
        reasons = [str(why) for unit in registry.lots.units() for why in unit.reasons]
    assert main(["registry", "list", "--registry", calibrated, "--csv", "-"]) == 0
    csv_text = capsys.readouterr().out
    assert len(reasons) > 2 and all(why in csv_text.replace('""', '"') for why in reasons)


def test_the_table_of_a_batch_has_a_line_a_unit_at_80_columns(monkeypatch, capsys) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    print_table(TABLE_HEADER, [table_row(unit(f"EG-{k:04}", "retest", plain("dead"))) for k in range(3)])
    assert len(capsys.readouterr().out.splitlines()) == 5
