"""What a person gave that was not used is named with why; so is one recording under two serials, at every door."""

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from sqlalchemy import event

from softcal.app.batch.lot_intake import preview_lot, store_lot
from softcal.app.cli.main import main
from softcal.app.files.import_plan import Columns, ImportPlan
from softcal.app.files.lot_folder import open_lot_folder
from softcal.app.texts.catalogue import catalogue
from softcal.core.lot import Lot
from softcal.core.quality.duplicate_recordings import RecordedOutput, same_recordings
from softcal.db.connection import open_registry
from tests.conftest import SMALL_NETWORK

OPTIONS = ["--output-column", "volts", "--reference-column", "force_N", "--sample-rate", "50"]


def table(path: Path, seed: int, rows: int = 60, **renamed: str) -> Path:
    force_N = 1 + np.sin(np.arange(rows) / 5)
    volts = 0.5 + 0.1 * force_N + np.random.default_rng(seed).normal(0, 0.01, rows)
    pd.DataFrame({"volts": volts, "force_N": force_N}).rename(columns=renamed).to_csv(path, index=False)
    return path


def imported(folder: Path, *extra: str, files: list[Path] | None = None) -> dict[str, object]:
    answer = folder / "answer.json"
    paths = map(str, files or sorted((folder / "tables").iterdir()))
    out = ["--out", str(folder / "lot"), "--json", str(answer)]
    assert main(["import", *paths, "--source", "S1", *OPTIONS, *out, *extra]) == 0
    return json.loads(answer.read_text())


@pytest.fixture
def tables(tmp_path: Path) -> Path:
    folder = tmp_path / "tables"
    folder.mkdir()
    for number, name in enumerate(("S1", "S2", "S3")):
        table(folder / f"{name}.csv", number)
    return folder


def unused_items(answer: dict[str, object]) -> set[tuple[str, str]]:
    return {(item["kind"], item["name"]) for item in answer["not_used"]}


@pytest.mark.parametrize("column", ["Force_N", "force N", "FORCE_n"])
def test_a_reference_under_another_name_is_counted_and_both_names_are_reported(
    tables, tmp_path, capsys, column
) -> None:
    table(tables / "S2.csv", 1, force_N=column)
    answer = imported(tmp_path, "--audit")
    assert answer["audits"] == ["S3"] and ("audit", "S2") in unused_items(answer)
    (why,) = [item["why"] for item in answer["not_used"] if item["kind"] == "audit"]
    assert all(text in why for text in ("S2.csv", "'force_N'", repr(column)))
    stderr = capsys.readouterr().err
    assert "audits: 1 of 2" in stderr and why in stderr


def test_all_that_is_used_leaves_an_empty_list(tables, tmp_path) -> None:
    answer = imported(tmp_path, "--audit")
    assert answer["not_used"] == [] and answer["remarks"] == [] and answer["audits"] == ["S2", "S3"]


def test_a_lot_without_a_unit_is_reported(tables, tmp_path, capsys) -> None:
    remarks = imported(tmp_path, files=[tables / "S1.csv"])["remarks"]
    assert remarks == ["the lot has no unit beside its source"] and remarks[0] in capsys.readouterr().err


def test_columns_that_no_option_names_and_references_nobody_asked_for_are_listed(tables, tmp_path) -> None:
    frame = pd.read_csv(tables / "S3.csv").assign(temp_C=21.0)
    frame.to_csv(tables / "S3.csv", index=False)
    assert unused_items(imported(tmp_path)) == {("column", "temp_C"), ("column", "force_N")}


@pytest.mark.parametrize(
    ("rows", "audit_rows", "unused"), [("0:40", None, 20), ("0:40", "44:60", 4), ("0:20", "15:35", 25)]
)
def test_rows_outside_what_was_asked_for_are_counted(tables, tmp_path, rows, audit_rows, unused) -> None:
    parts = ["--rows", rows, *(["--audit", "--audit-rows", audit_rows] if audit_rows else [])]
    items = [item for item in imported(tmp_path, *parts)["not_used"] if item["kind"] == "rows"]
    of_targets = [item for item in items if item["name"] != "S1"]
    assert {item["name"] for item in of_targets} == {"S2", "S3"}
    assert all(f"rows: {unused}, in all: 60" in item["why"] for item in of_targets)


def test_files_of_a_folder_that_are_no_tables_are_named(tables, tmp_path) -> None:
    (tables / "notes.doc").write_text("pressed on Monday")
    (tables / "old").mkdir()
    shutil.copy(tables / "S2.csv", tables / "old")
    (tables / ".hidden.csv").write_text("nothing")
    assert unused_items(imported(tmp_path, "--audit", files=[tables])) == {("file", "notes.doc"), ("file", "old/")}


def test_files_of_a_lot_folder_that_no_batch_reads_are_named(tables, tmp_path) -> None:
    imported(tmp_path, "--audit")
    lot = tmp_path / "lot"
    shutil.copy(lot / "audit/S2.csv", lot / "audit/S9.csv")
    shutil.copy(lot / "source/S1.csv", lot / "source/S8.csv")
    (lot / "audits").mkdir()
    shutil.copy(lot / "audit/S2.csv", lot / "audits")
    (lot / "units/S2.doc").write_bytes(b"notes")
    (lot / "README.txt.md").write_text("about this lot")
    items = {(item.kind, item.name, item.why.code) for item in open_lot_folder(lot).not_used}
    assert items == {
        ("audit", "S9", "unused.foreign_unit"),
        ("file", "source/S8.csv", "unused.source"),
        ("file", "audits/", "unused.place"),
        ("file", "units/S2.doc", "unused.format"),
    }


def test_an_audit_that_is_not_taken_is_named_with_why(tables, tmp_path, capsys) -> None:
    imported(tmp_path, "--audit")
    table(tables / "S2.csv", 1, force_N="Force_N")
    table(tables / "S7.csv", 7)
    capsys.readouterr()
    audit_paths = [str(tables / name) for name in ("S2.csv", "S3.csv", "S7.csv")]
    assert main(["lot", "audit", str(tmp_path / "lot"), *audit_paths, *OPTIONS, "--json", "-"]) == 2
    printed = capsys.readouterr()
    answer = json.loads(printed.out)
    assert answer["audited"] == ["S3"] and unused_items(answer) == {("audit", "S2"), ("audit", "S7")}
    assert "not used: audit S7" in printed.err


def test_a_batch_lists_what_it_did_not_use_and_what_stands_twice_across_lots(
    small_calibrated, tmp_path, calibrated, capsys
) -> None:
    lot = tmp_path / "second"
    shutil.copytree(small_calibrated.parent / "lot", lot)
    text = (lot / "lot.toml").read_text()
    (lot / "lot.toml").write_text(text.replace('id = "small"', 'id = "second"'))
    (lot / "units/A1.csv").rename(lot / "units/B1.csv")
    for audit in (lot / "audit").glob("A1.*"):
        audit.rename(audit.with_name("B7.csv"))
    frame = pd.read_csv(lot / "units/A2.csv").assign(reference=1.0)
    frame.to_csv(lot / "units/A2.csv", index=False)
    code = main(["batch", str(lot), "--registry", calibrated, *SMALL_NETWORK, "--no-own", "--json", "-"])
    printed = capsys.readouterr()
    answer = json.loads(printed.out)
    assert code == 1 and {("audit", "B7"), ("column", "reference")} <= unused_items(answer)
    (remark,) = [one for one in answer["remarks"] if "B1" in one]
    assert all(name in remark for name in ("A1 (small)", "B1 (second)")) and remark in printed.err
    assert not [one for one in answer["remarks"] if "A2" in one], "one serial may stand in two lots"
    for extra in ([], ["--lot", "second"], ["--lot", "small"]):
        assert main(["registry", "list", "--registry", calibrated, "--json", "-", *extra]) == 0
        assert remark in json.loads(capsys.readouterr().out)["remarks"]


def test_the_page_of_a_new_lot_knows_what_is_not_used_and_what_the_registry_has(
    tables, tmp_path, separate_data_folder
) -> None:
    url = f"sqlite:///{tmp_path / 'registry.db'}"
    columns = Columns("volts", "force_N")
    files = sorted(tables.iterdir())
    table(tables / "S2.csv", 1, force_N="Force_N")
    with open_registry(url) as registry:
        first = ImportPlan(files, columns, Lot("first", "S1", 50.0), audit=True)
        expected = preview_lot(first, registry)
        assert expected.audits == ("S3",) and not expected.remarks
        assert [(item.kind, item.name) for item in expected.not_used] == [("column", "Force_N"), ("audit", "S2")]
        store_lot(registry, first, "kim")
        folder = open_lot_folder(tmp_path / "data/softcal/lots/first")
        registry.recordings.add("first", folder.read_unit("S3"), "unit")
        (tables / "S3.csv").rename(tables / "T3.csv")
        again = ImportPlan(sorted(tables.iterdir()), columns, Lot("again", "S1", 50.0), audit=True)
        (remark,) = preview_lot(again, registry).remarks
    assert all(name in str(remark) for name in ("S3 (first)", "T3 (again)"))


def test_why_something_is_not_used_is_rendered_in_korean_too() -> None:
    codes = [key for key in catalogue()["en"] if key.startswith(("reason.unused.", "reason.lot."))]
    assert len(codes) > 10 and all(catalogue()["ko"][code] != catalogue()["en"][code] for code in codes)


def parse_press(text: str) -> RecordedOutput:
    serial, lot, output, kind = text.split()
    return RecordedOutput(serial, lot, output, kind)


@pytest.mark.parametrize(
    ("recordings", "message"),
    [
        (("A1 L1 x unit", "A2 L1 x unit"), [{"A1 (L1)", "A2 (L1)"}]),
        (("A1 L1 x unit", "B1 L2 x unit"), [{"A1 (L1)", "B1 (L2)"}]),
        (("S0 L1 x source", "A1 L1 x unit"), [{"S0 (L1)", "A1 (L1)"}]),
        (("A1 L1 x unit", "A1 L1 x audit"), []),
        (("S0 L1 x source", "S0 L2 x source"), []),
        (("A1 L1 x unit", "A1 L2 x unit"), []),
        (("S0 L1 x source", "S0 L1 x audit"), [{"S0", "L1"}]),
        (("S0 L1 x source", "S0 L2 x audit"), [{"S0", "L1", "L2"}]),
        (("A1 L1 x unit", "A2 L1 x unit", "A1 L1 y audit", "A2 L1 y audit"), [{"A1 (L1)", "A2 (L1)"}]),
        (("A1 L1 x unit", "A2 L1 y unit"), []),
    ],
)
def test_one_recording_is_one_press_of_one_serial(recordings, message) -> None:
    remarks = same_recordings(map(parse_press, recordings))
    assert len(remarks) == len(message)
    assert all(name in str(remark) for remark, names in zip(remarks, message, strict=True) for name in names)


def test_outputs_are_compared_by_an_index(query_plan) -> None:
    assert "ix_recordings_output_sha256" in query_plan and "SCAN recordings" not in query_plan


@pytest.fixture
def query_plan(tmp_path) -> str:
    """How SQLite looks for the recordings that have an output of a lot."""
    statements: list[str] = []
    with open_registry(f"sqlite:///{tmp_path / 'r.db'}") as registry:
        registry.lots.add(Lot("L1", "S0", 50.0))
        event.listen(
            registry.database.engine, "before_cursor_execute", lambda *given: statements.append((given[2], given[3]))
        )
        registry.recordings.shared_outputs("L1")
        registry.recordings.same_outputs({"a" * 64})
        queries = [one for one in statements if "output_sha256" in one[0]]
        with registry.database.outside_transactions() as connection:
            plans = [connection.execute(f"EXPLAIN QUERY PLAN {text}", values).fetchall() for text, values in queries]
    return "\n".join(str(row) for plan in plans for row in plan)
