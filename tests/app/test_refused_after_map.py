"""A unit whose newest result is a refusal still has the map it had before: no command, file or page says it passed."""

import json
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest

from softcal.app.cli.main import main
from softcal.app.jobs import jobs
from softcal.app.jobs.jobs import JobProgress
from softcal.app.texts.catalogue import text
from softcal.core.messages.reason import plain
from softcal.core.unit.verdict import Finding, Verdict
from softcal.db.connection import open_registry

pytestmark = pytest.mark.usefixtures("separate_data_folder")
WHY, PASS = "its cable broke", text("en", "verdict.pass")


@pytest.fixture
def refused(calibrated: str) -> str:
    """URL of a registry in which A1 passed and was refused since; A3 stands as it was calibrated."""
    with open_registry(calibrated) as registry:
        (unit,) = registry.lots.units("small", "A1")
        assert unit.verdict == "pass"
        registry.calibrations.refuse("small", "A1", "retest", (plain(WHY),))
    return calibrated


@pytest.fixture
def two_lots(calibrated: str) -> str:
    """URL of a registry in which another lot has a refused A1 as well."""
    with open_registry(calibrated) as registry:
        registry.lots.add(replace(registry.lots.get("small"), id="other"))
        registry.calibrations.refuse("other", "A1", "retest", (plain(WHY),))
    return calibrated


def files_of(folder: Path, serial: str) -> list[str]:
    return sorted(path.name for path in folder.glob(f"*{serial}*"))


def warned(capsys, verdict: str) -> None:
    error = capsys.readouterr().err
    assert "A1" in error and verdict in error and WHY in error


@pytest.mark.parametrize("name", ["json", "blob", "dcc"])
def test_export_writes_no_file_of_it_and_says_why(refused, tmp_path, capsys, name):
    out = tmp_path / "files"
    assert main(["export", "--registry", refused, "--serial", "A1", "--format", name, "--out", str(out)]) == 2
    assert files_of(out, "A1") == []
    warned(capsys, "retest")
    assert json.loads((out / "manifest.json").read_text())["units"]["A1"]["verdict"] == "retest"


def test_not_even_for_the_laboratory_unless_its_revision_is_named(refused, tmp_path, capsys):
    command = ["export", "--registry", refused, "--serial", "A1", "--format", "blob", "--out", str(tmp_path / "files")]
    assert main([*command, "--failed-too"]) == 2
    assert files_of(tmp_path / "files", "A1") == []
    capsys.readouterr()
    assert main([*command, "--revision", "1"]) == 0
    assert files_of(tmp_path / "files", "A1") == ["unit-A1.ssc"]
    warned(capsys, "retest")


def test_the_files_it_had_are_taken_back_and_other_units_go_on(calibrated, tmp_path):
    out = tmp_path / "files"
    command = ["export", "--registry", calibrated, "--serial", "A1", "--serial", "A3", "--format", "json"]
    command += ["--format", "pdf", "--failed-too", "--out", str(out)]
    assert main(command) == 0 and len(files_of(out, "A1")) == 2
    with open_registry(calibrated) as registry:
        registry.calibrations.refuse("small", "A1", "fail", (plain(WHY),))
    assert main([*command, "--check"]) == 1
    assert files_of(out, "A1") == [] and len(files_of(out, "A3")) == 2


def test_an_archive_of_the_lot_has_no_file_of_it(refused, monkeypatch, tmp_path):
    monkeypatch.setattr(jobs, "archives_folder", lambda: tmp_path)
    with open_registry(refused) as registry:
        request = {"lot": "small", "serials": None, "formats": ["json", "pdf"], "release": "pass"}
        registry.job_board.place("archive", request, "Erin")
        (job,) = registry.job_board.jobs()
        archive_result = jobs.archive(registry, job, JobProgress(registry.job_board, job.job_id)).result
    with zipfile.ZipFile(jobs.archive_path(job)) as pack_reasons:
        assert not [name for name in pack_reasons.namelist() if "A1" in name]
    assert [serial for serial, why in archive_result["refused"] if WHY in why] == ["A1"]


def test_who_takes_an_older_revision_of_a_unit_that_fails_now_is_warned(calibrated, tmp_path, capsys):
    with open_registry(calibrated) as registry:
        state = registry.calibrations.get("A1").state
        # Without its audit: a measured fail would be the verdict of this recording, whichever revision is named.
        fit = replace(state.fit, findings=(Finding(plain(WHY), Verdict.FAIL),))
        registry.calibrations.add("small", replace(state, fit=fit, audit=None))
        (unit,) = registry.lots.units("small", "A1")
        assert unit.verdict == "fail" and registry.calibrations.get("A1", 1).state.verdict == "pass"
    command = ["export", "--registry", calibrated, "--serial", "A1", "--revision", "1", "--format", "json"]
    assert main([*command, "--out", str(tmp_path / "files")]) == 0
    warned(capsys, "fail")


@pytest.mark.parametrize("command", ["estimate", "adapt", "explain"])
def test_who_uses_its_map_is_warned(refused, trained_lot, tmp_path, capsys, command):
    files = [] if command == "explain" else [str(trained_lot / "lot/units/A1.csv")]
    out = tmp_path / ("out.html" if command == "explain" else "out.csv")
    assert main([command, "--registry", refused, "--serial", "A1", *files, "--out", str(out)]) == 0
    warned(capsys, "retest")


def test_a_page_shows_how_it_stands_and_gives_no_file(refused, show):
    screen = show(refused, "unit", tab="files", unit="A1")
    page_text = " ".join(element.proto.body for element in screen.get("html"))
    assert text("en", "verdict.retest") in page_text and PASS not in page_text
    assert any(WHY in note.value for note in screen.markdown)
    screen.segmented_control(key="format-small/A1").set_value("pdf").run()
    assert WHY in screen.warning[-1].value and not screen.get("download_button")


def test_a_calibration_made_since_is_what_counts(refused, tmp_path):
    with open_registry(refused) as registry:
        registry.calibrations.add("small", registry.calibrations.get("A1").state, input_sha256="f" * 64)
    out = tmp_path / "files"
    assert main(["export", "--registry", refused, "--serial", "A1", "--format", "blob", "--out", str(out)]) == 0
    assert files_of(out, "A1") == ["unit-A1.ssc"]


def test_a_page_of_a_serial_in_two_lots_asks_for_the_lot(two_lots, show):
    screen = show(two_lots, "unit", unit="other/A1")
    assert not screen.error and any(WHY in note.value for note in (*screen.info, *screen.markdown))
    screen = show(two_lots, "unit", unit="small/A1")
    assert not screen.error and not screen.exception
    assert PASS in " ".join(element.proto.body for element in screen.get("html"))


def test_a_method_is_explained_of_the_lot_that_was_named(two_lots, capsys):
    assert main(["explain", "--registry", two_lots, "--serial", "A1", "--lot", "small", "--method"]) == 0
    assert capsys.readouterr().out
