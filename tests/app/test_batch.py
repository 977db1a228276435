"""`softcal batch`, `train` and `estimate` on a small lot: verdicts, resumption, isolation of bad units, exit codes."""

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.app.batch import lot_work, unit_work
from softcal.app.cli.main import main
from softcal.db.connection import open_registry

SMALL = ("--hidden", "16,8")


@pytest.fixture
def url(registry_url: str) -> str:
    return registry_url


@pytest.fixture
def other_url(trained_lot: Path, tmp_path: Path) -> str:
    shutil.copy(trained_lot / "registry.db", tmp_path / "other.db")
    return f"sqlite:///{tmp_path / 'other.db'}"


def _batch(folder: Path, url: str, *extra: str) -> tuple[int, dict]:
    report = folder.parent / "report.json"
    report.unlink(missing_ok=True)
    code = main(["batch", str(folder), "--registry", url, "--json", str(report), *SMALL, *extra])
    return code, json.loads(report.read_text()) if report.exists() else {}


def test_every_unit_gets_a_verdict_that_is_logged_and_the_audit_confirms_the_map(
    lot_folder: Path, url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SOFTCAL_LOGS", str(tmp_path / "logs"))
    code, report = _batch(lot_folder, url)
    assert code in (0, 1)
    assert [unit["serial"] for unit in report["units"]] == ["A1", "A2", "A3"]
    for unit in report["units"]:
        assert unit["after_rmse"] < 0.5 * unit["before_rmse"]
        assert unit["map"]["revision"] == 1
    (path,) = (tmp_path / "logs").glob("*.jsonl")
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert len({line["run"] for line in lines}) == 1
    assert [line["event"] for line in lines] == ["begun", *["unit"] * 3, "ended"] and lines[-1]["code"] == code
    verdicts = {line["serial"]: line["verdict"] for line in lines[1:-1]}
    assert verdicts == {unit["serial"]: unit["verdict"] for unit in report["units"]}


def test_a_second_run_fits_nothing_again(lot_folder: Path, url: str) -> None:
    first_code, first = _batch(lot_folder, url, "--no-own")
    second_code, second = _batch(lot_folder, url, "--no-own")
    assert second_code == first_code
    assert not second["network_is_new"]
    assert [unit["is_new"] for unit in second["units"]] == [False] * 3
    assert [unit["map"] for unit in second["units"]] == [unit["map"] for unit in first["units"]]


def test_units_fitted_again_from_the_same_files_are_the_same_calibrations(
    lot_folder: Path, url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    fit, fitted = unit_work._work_on_unit, []
    monkeypatch.setattr(unit_work, "_work_on_unit", lambda *work: fitted.append(work[1].serial) or fit(*work))
    _, first = _batch(lot_folder, url, "--no-own")
    for calls in (["A1", "A2", "A3"] * 2, ["A1", "A2", "A3"] * 2):
        _, again = _batch(lot_folder, url, "--no-own", "--refit")
        assert sorted(fitted) == sorted(calls), "a lot is fitted again once"
        assert [unit["map"] for unit in again["units"]] == [unit["map"] for unit in first["units"]]
        assert [unit["verdict"] for unit in again["units"]] == [unit["verdict"] for unit in first["units"]]
    with open_registry(url) as registry:
        assert all(len(registry.calibrations.history(serial)) == 1 for serial in ("A1", "A2", "A3"))


def test_neither_a_reference_column_in_units_nor_a_second_process_changes_a_map(
    lot_folder: Path, url: str, other_url: str
) -> None:
    _, report = _batch(lot_folder, url, "--no-own")
    for path in (lot_folder / "units").iterdir():
        pd.read_csv(path).assign(reference=9.99).to_csv(path, index=False)
    _, again = _batch(lot_folder, other_url, "--no-own", "--jobs", "2")
    assert [u["map"]["sha256"] for u in again["units"]] == [u["map"]["sha256"] for u in report["units"]]


def test_bad_units_get_their_reason_and_the_rest_is_done(lot_folder: Path, url: str) -> None:
    t_s = np.arange(1500) / 50
    (lot_folder / "units/A2.csv").write_text("t_s,output\n0,nan\n")
    pd.DataFrame({"t_s": t_s, "output": np.full(1500, 0.5)}).to_csv(lot_folder / "units/A3.csv", index=False)
    pd.DataFrame({"t_s": t_s[::-1], "output": t_s}).to_csv(lot_folder / "units/A4.csv", index=False)
    (lot_folder / "units/A5.csv").write_bytes(bytes(range(256)) * 9)
    code, report = _batch(lot_folder, url, "--no-own")
    units = {unit["serial"]: unit for unit in report["units"]}
    assert code == 1
    assert units["A1"]["after_rmse"] is not None
    assert {serial: (unit["verdict"], unit["reason_codes"]) for serial, unit in units.items() if serial != "A1"} == {
        "A2": ("retest", ["unreadable"]),
        "A3": ("fail", ["dead.constant"]),
        "A4": ("retest", ["unreadable"]),
        "A5": ("retest", ["unreadable"]),
    }


def test_a_lot_stopped_in_the_middle_goes_on_where_it_was(
    lot_folder: Path, url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    fit, fitted = unit_work._work_on_unit, []

    def interrupted(shared, task):
        fitted.append(task.serial)
        if len(fitted) == 2:
            raise KeyboardInterrupt
        return fit(shared, task)

    monkeypatch.setattr(unit_work, "_work_on_unit", interrupted)
    monkeypatch.setattr(lot_work, "FIRST_CHUNK", 1)
    monkeypatch.setattr(lot_work, "LARGEST_CHUNK", 1)
    assert _batch(lot_folder, url, "--no-own")[0] == 2
    assert _batch(lot_folder, url, "--no-own")[0] in (0, 1)
    assert fitted == ["A1", "A2", "A2", "A3"]


def test_a_lot_without_its_source_is_refused(lot_folder: Path, url: str, capsys: pytest.CaptureFixture[str]) -> None:
    (lot_folder / "source/A0.csv").unlink()
    assert _batch(lot_folder, url)[0] == 2
    assert "'A0'" in capsys.readouterr().err


def test_train_finds_the_network_it_trained_before(lot_folder: Path, tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'new.db'}"
    out = [lot_folder.parent / f"{k}.json" for k in range(2)]
    for path in out:
        assert main(["train", str(lot_folder), "--registry", url, "--json", str(path), *SMALL]) == 0
    first, second = (json.loads(path.read_text()) for path in out)
    assert first["network"] == second["network"]
    assert (first["is_new"], second["is_new"]) == (True, False)


def test_estimates_have_a_row_per_sample_inside_their_interval(lot_folder: Path, url: str, tmp_path: Path) -> None:
    _batch(lot_folder, url, "--no-own")
    recording, out = lot_folder / "audit/A1.csv", tmp_path / "estimate.csv"
    command = ["estimate", "--registry", url, "--serial", "A1", str(recording), "--out", str(out)]
    assert main(command) == 0
    truth, rows = pd.read_csv(recording), pd.read_csv(out)
    assert list(rows.columns) == ["t_s", "estimate", "lower", "upper", "flag"]
    assert len(rows) == len(truth)
    has_estimate = rows["estimate"].notna()
    assert (rows.lower <= rows.estimate)[has_estimate].all() and (rows.estimate <= rows.upper)[has_estimate].all()
    assert rows.flag[~has_estimate].eq("warm-up").all()
    assert np.sqrt(np.mean((rows.estimate - truth.reference)[has_estimate] ** 2)) < 0.3


BROKEN = (
    ("a,b\n0,1\n", "'output'"),
    ("t_s,output\n" + "".join(f"{k / 50},0.5\n" for k in range(10)), " 15"),
    ("t_s,output\n" + "".join(f"{k / 50},{'abc' if k == 40 else 0.5}\n" for k in range(99)), "line 42"),
    ("t_s,output\n" + "".join(f"{k % 50 / 50},0.5\n" for k in range(99)), "t_s"),
    ("t_s,output\n" + "".join(f"{k / 10},0.5\n" for k in range(99)), "10 Hz"),
)


def test_a_recording_that_cannot_be_used_leaves_no_estimate(
    lot_folder: Path, url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _batch(lot_folder, url, "--no-own")
    path, out = tmp_path / "in.csv", tmp_path / "o.csv"
    for content, text in BROKEN:
        capsys.readouterr()
        path.write_text(content)
        assert main(["estimate", "--registry", url, "--serial", "A1", str(path), "--out", str(out)]) == 2
        stderr = capsys.readouterr().err.strip()
        assert text in stderr and len(stderr.splitlines()) == 1
        assert not out.exists()


def test_a_registry_that_cannot_be_opened_ends_with_its_own_code(lot_folder: Path) -> None:
    assert main(["batch", str(lot_folder), "--registry", "sqlite:////nonexistent-folder/x.db"]) == 4


def test_anchors_of_a_unit_the_lot_does_not_have_are_refused(
    lot_folder: Path, url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "anchors.csv").write_text("serial,output,reference\nA1,0.54,0\nA9,0.6,1\n")
    assert _batch(lot_folder, url, "--anchors", str(tmp_path / "anchors.csv"))[0] == 2
    assert "'A9'" in capsys.readouterr().err


@pytest.mark.parametrize("rows", ["A1,0.54,0\nA1,0.9,203.9", "A1,0.54,2\nA1,0.9,0"], ids=["gf for N", "wrong order"])
def test_known_loads_that_cannot_be_true_cost_their_unit_a_retest(
    lot_folder: Path, url: str, tmp_path: Path, rows: str
) -> None:
    (tmp_path / "anchors.csv").write_text(f"serial,output,reference\n{rows}\n")
    _, report = _batch(lot_folder, url, "--no-own", "--anchors", str(tmp_path / "anchors.csv"))
    unit = next(unit for unit in report["units"] if unit["serial"] == "A1")
    assert unit["verdict"] == "retest" and not unit["released"]
    assert unit["reason_codes"] == ["wrong_loads"] and unit["map"] is None
    assert all(unit["verdict"] != "retest" for unit in report["units"] if unit["serial"] != "A1")


@pytest.mark.long
def test_known_loads_that_are_named_outrank_those_of_the_folder(lot_folder: Path, url: str, tmp_path: Path) -> None:
    (lot_folder / "anchors.csv").write_text("serial,output,reference\nA1,0.54,2\nA1,0.9,0\n")
    (tmp_path / "anchors.csv").write_text("serial,output,reference\nA2,0.54,2\nA2,0.9,0\n")
    wrong = {}
    for name, more in (("folder", ()), ("named", ("--anchors", str(tmp_path / "anchors.csv")))):
        _, report = _batch(lot_folder, url, "--no-own", *more)
        wrong[name] = [unit["serial"] for unit in report["units"] if unit["reason_codes"] == ["wrong_loads"]]
    assert wrong == {"folder": ["A1"], "named": ["A2"]}


def test_anchors_are_part_of_what_a_result_depends_on(lot_folder: Path, url: str, tmp_path: Path) -> None:
    _batch(lot_folder, url, "--no-own")
    (tmp_path / "anchors.csv").write_text("serial,output,reference\nA1,0.54,0\n")
    _, report = _batch(lot_folder, url, "--no-own", "--anchors", str(tmp_path / "anchors.csv"))
    assert [unit["is_new"] for unit in report["units"]] == [True, False, False]
