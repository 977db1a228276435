"""Audit plans: drawn once, kept with the lot, and the lot judged when every drawn unit has been measured."""

import json
from pathlib import Path

import pytest

from softcal.app.cli.main import main
from softcal.db.connection import open_registry

SMALL = ("--hidden", "16,8", "--no-own")


def _json(tmp_path: Path, *arguments: str) -> tuple[int, dict]:
    file = tmp_path / "answer.json"
    file.unlink(missing_ok=True)
    code = main([*arguments, "--json", str(file)])
    return code, json.loads(file.read_text()) if file.exists() else {}


@pytest.fixture
def unaudited(lot_folder: Path) -> tuple[Path, dict[str, str]]:
    """The small lot with its audit recordings set aside."""
    audits = {path.name: path.read_text() for path in sorted((lot_folder / "audit").iterdir())}
    for name in audits:
        (lot_folder / "audit" / name).unlink()
    return lot_folder, audits


def test_the_lot_is_decided_once_every_drawn_unit_was_measured(unaudited, registry_url, tmp_path):
    folder, audits = unaudited
    batch = ("batch", str(folder), "--registry", registry_url, *SMALL)
    plan = ("lot", "audit-plan", str(folder), "--registry", registry_url)
    main(["train", str(folder), "--registry", registry_url, "--hidden", "16,8"])
    main(["lot", "limit", "small", "--registry", registry_url, "--rmse", "5", "--reason", "test", "--yes"])
    assert _json(tmp_path, *batch)[1]["audit"] is None
    _, plan_report = _json(tmp_path, *plan, "--doubtful", "1", "--random", "1")
    serials = [*plan_report["plan"]["doubtful"], *plan_report["plan"]["random"]]
    assert len(set(serials)) == 2 and plan_report["missing"] == serials and plan_report["verdict"] is None
    for serial in serials:
        (folder / "audit" / f"{serial}.csv").write_text(audits[f"{serial}.csv"])
    _, report = _json(tmp_path, *batch)
    scored = {unit["serial"]: unit["after_rmse"] for unit in report["units"]}
    assert report["audit"]["measured_rmse"] == {serial: scored[serial] for serial in serials}
    # One of two random units, none failed: nothing firm can be said of the other.
    assert report["audit"]["verdict"] == "conditional"
    assert all(unit["audited"] and unit["verdict"] == "pass" for unit in report["units"] if unit["serial"] in serials)
    assert _json(tmp_path, *plan)[1]["statement"] == report["audit"]["statement"]


def test_an_audit_that_was_measured_before_the_draw_says_nothing_of_the_lot(lot_folder, registry_url, tmp_path):
    _json(tmp_path, "batch", str(lot_folder), "--registry", registry_url, *SMALL)
    plan = ("lot", "audit-plan", str(lot_folder), "--registry", registry_url)
    code, drawn = _json(tmp_path, *plan, "--random", "2")
    chosen = drawn["plan"]["random"]
    assert code == 0 and drawn["verdict"] is None and drawn["missing"] == chosen and drawn["measured_rmse"] == {}
    assert sorted(drawn["measured_before"]) == sorted(chosen)
    # What is measured again afterwards counts.
    for serial in chosen:
        file = lot_folder / "audit" / f"{serial}.csv"
        file.write_text("\n".join(file.read_text().splitlines()[:-1]) + "\n")
    _, report = _json(tmp_path, "batch", str(lot_folder), "--registry", registry_url, *SMALL)
    assert report["audit"]["missing"] == [] and sorted(report["audit"]["measured_rmse"]) == sorted(chosen)
    assert report["audit"]["verdict"] is not None


def test_without_a_stated_limit_nothing_is_said_of_the_lot(unaudited, registry_url, tmp_path, capsys):
    folder, audits = unaudited
    toml = folder / "lot.toml"
    toml.write_text(toml.read_text().replace("[limit]\nrmse = 0.16\n", ""))
    url = f"sqlite:///{tmp_path / 'unlimited.db'}"
    batch = ("batch", str(folder), "--registry", url, *SMALL)
    _json(tmp_path, *batch)
    _json(tmp_path, "lot", "audit-plan", str(folder), "--registry", url, "--random", "3")
    for name, text in audits.items():
        (folder / "audit" / name).write_text(text)
    _, report = _json(tmp_path, *batch)
    assert len(report["audit"]["measured_rmse"]) == 3 and report["audit"]["limit_rmse"] is None
    assert report["audit"]["verdict"] is None and report["audit"]["statement"] is None
    # A limit that is stated later decides on what was measured since.
    main(["lot", "limit", "small", "--registry", url, "--rmse", "5", "--reason", "drawing", "--yes"])
    assert _json(tmp_path, "lot", "audit-plan", "small", "--registry", url)[1]["verdict"] == "pass"


def test_a_measured_unit_beyond_the_limit_fails_the_lot(unaudited, registry_url, tmp_path):
    folder, audits = unaudited
    batch = ("batch", str(folder), "--registry", registry_url, *SMALL)
    _json(tmp_path, *batch)
    plan = ("lot", "audit-plan", str(folder), "--registry", registry_url, "--doubtful", "1", "--random", "0")
    serial = _json(tmp_path, *plan)[1]["plan"]["doubtful"][0]
    head, *rows = audits[f"{serial}.csv"].splitlines()
    column = head.split(",").index("reference")
    cells = [row.split(",") for row in rows]
    for row in cells:
        row[column] = str(10 + 3 * float(row[column]))
    (folder / "audit" / f"{serial}.csv").write_text("\n".join([head, *map(",".join, cells)]) + "\n")
    _, report = _json(tmp_path, *batch)
    assert report["audit"]["verdict"] == "fail" and report["audit"]["statement"]["failed"] == [serial]
    assert main(["lot", "audit-plan", str(folder), "--registry", registry_url]) == 1


def test_a_plan_is_not_drawn_again_without_a_reason(lot_folder, registry_url, tmp_path):
    plan = ("lot", "audit-plan", str(lot_folder), "--registry", registry_url)
    main(["train", str(lot_folder), "--registry", registry_url, "--hidden", "16,8"])
    assert main([*plan]) == 2, "no unit is calibrated"
    _json(tmp_path, "batch", str(lot_folder), "--registry", registry_url, *SMALL)
    _, first = _json(tmp_path, *plan, "--random", "1", "--doubtful", "1")
    assert _json(tmp_path, *plan, "--seed", "9")[1]["plan"] == first["plan"]
    assert main([*plan, "--new"]) == 2
    assert main([*plan, "--new", "--reason", "unit lost", "--random", "2"]) in (0, 1)
    with open_registry(registry_url) as registry:
        rows = registry.trail.of_kind("draws")
    assert [row.reason for row in rows] == ["", "unit lost"]


def test_an_impossible_plan_is_refused_in_one_line(lot_folder, registry_url, tmp_path, capsys):
    _json(tmp_path, "batch", str(lot_folder), "--registry", registry_url, *SMALL)
    for option, value in (("--random", "-1"), ("--allowed-share", "1.5")):
        capsys.readouterr()
        assert main(["lot", "audit-plan", str(lot_folder), "--registry", registry_url, option, value]) == 2
        assert capsys.readouterr().err.count("\n") == 1
