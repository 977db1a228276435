"""`softcal registry`, `quality` and `doctor` from the command line: what they print, and their exit codes."""

import csv
import json
import zipfile
from dataclasses import replace

import numpy as np
import openpyxl
import pytest

from softcal.app import logs
from softcal.app.cli.main import main
from softcal.app.files.spreadsheet import write_table
from softcal.core.errors import InputError
from softcal.core.lot import Lot
from softcal.core.messages.reason import plain
from softcal.core.network.network import Network
from softcal.core.unit.uncertainty import ErrorForecast
from softcal.db.connection import open_registry
from tests.unit_states import state_of


@pytest.fixture
def url(tmp_path, monkeypatch):
    """A registry with a lot of 30 units, A7 calibrated twice and B1 refused."""
    monkeypatch.setenv("SOFTCAL_LOGS", str(tmp_path / "logs"))
    url = f"sqlite:///{tmp_path / 'registry.db'}"
    errors = np.random.default_rng(9).normal(0.1, 0.01, 31)
    with open_registry(url) as registry, registry.transaction():
        registry.lots.add(Lot("L1", "S0", 50.0, limit_rmse=0.2))
        network = Network((np.zeros((15, 1)),), (np.zeros(1),), 0.0, 1.0, 0.0, 1.0)
        network_id = registry.networks.add("L1", network, {}, {}, "a" * 64)
        for number, serial in enumerate([*(f"A{k}" for k in range(30)), "A7"]):
            state = state_of(serial, network_id, "c" * 64, number, limit_rmse=0.2)
            forecast = ErrorForecast(float(errors[number]), 0.0, 1.0)
            state = replace(state, fit=replace(state.fit, forecast=forecast))
            registry.calibrations.add("L1", state, actor="kim")
        registry.calibrations.refuse("L1", "B1", "retest", (plain("=cmd|calc"),))
    return url


def run(capsys, *arguments):
    code = main([str(argument) for argument in arguments])
    output = capsys.readouterr()
    return code, output.out, output.err


def test_list_as_json_and_csv(url, capsys, tmp_path):
    table = tmp_path / "units.csv"
    code, out, _ = run(capsys, "registry", "list", "--registry", url, "--json", "-", "--csv", table)
    units = {unit["serial"]: unit for unit in json.loads(out)["units"]}
    assert code == 0 and units["A7"]["revision"] == 2 and units["B1"]["verdict"] == "retest"
    reasons = [row[-1] for row in csv.reader(table.read_text().splitlines())]
    assert "'=cmd|calc" in reasons, "a spreadsheet must not run what a file said"


def test_history_names_every_revision(url, capsys):
    run(capsys, "registry", "rollback", "--registry", url, "--serial", "A7", "--to", 1, "--reason", "remounted")
    code, out, _ = run(capsys, "registry", "history", "--registry", url, "--serial", "A7", "--json", "-")
    revisions = json.loads(out)["revisions"]
    assert code == 0 and [r["rolled_back_to"] for r in revisions] == [None, None, 1]
    assert revisions[2]["reason"] == "remounted" and revisions[2]["is_current"]


def test_verify_tells_a_whole_registry_from_an_edited_one(url, capsys):
    assert run(capsys, "registry", "verify", "--registry", url)[0] == 0
    with open_registry(url) as registry, registry.database.writing() as connection:
        connection.exec_driver_sql("DROP TRIGGER calibrations_no_update")
        connection.exec_driver_sql("UPDATE calibrations SET verdict = 'fail' WHERE serial = 'A3'")
    code, _, err = run(capsys, "registry", "verify", "--registry", url)
    assert code == 4 and "calibrations" in err and "A3" in err


def test_backup_restore_and_sync_go_round(url, capsys, tmp_path):
    copy = f"sqlite:///{tmp_path / 'copy.db'}"
    assert run(capsys, "registry", "backup", tmp_path / "b.db", "--registry", url)[0] == 0
    assert run(capsys, "registry", "restore", tmp_path / "b.db", "--registry", copy)[0] == 0
    run(capsys, "registry", "rollback", "--registry", copy, "--serial", "A7", "--to", 1, "--reason", "x")
    code, out, _ = run(capsys, "registry", "sync", "--registry", url, "--with", copy, "--json", "-")
    expected = {"schema": "softcal.registry.sync/1", "sent": 0, "received": 3, "conflicts": [], "clocks": []}
    assert code == 0 and json.loads(out) == expected, "the restore, the revision, and that it is in use"
    assert run(capsys, "registry", "verify", "--registry", url)[0] == 0


def test_upgrade_of_today_s_registry_is_no_error(url, capsys):
    assert run(capsys, "registry", "upgrade", "--registry", url)[0] == 0


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["list", "--registry", "sqlite:////nonexistent-folder/x.db"], 4),
        (["list", "--lot", "nowhere"], 2),
        (["history", "--serial", "nobody"], 2),
        (["rollback", "--serial", "A7", "--to", "9", "--reason", "x"], 2),
        (["restore", "/nonexistent/backup.db"], 4),
    ],
)
def test_what_cannot_be_done_is_one_line_and_its_code(url, capsys, arguments, expected):
    if "--registry" not in arguments:
        arguments = [*arguments, "--registry", url]
    code, _, err = run(capsys, "registry", *arguments)
    assert code == expected and err.count("\n") == 1


def test_yields_and_capability_of_a_lot(url, capsys):
    code, out, _ = run(capsys, "quality", "yield", "--registry", url, "--lot", "L1", "--json", "-")
    assert code == 0 and json.loads(out)["first_pass"]["count"] == 30 and json.loads(out)["first_pass"]["of"] == 31
    code, out, _ = run(capsys, "quality", "capability", "--registry", url, "--lot", "L1", "--json", "-")
    assert code == 0 and 2.0 < json.loads(out)["capability"]["cpk"] < 6.0


def test_a_gauge_study_with_a_hole_names_it(tmp_path, capsys):
    study = tmp_path / "study.csv"
    study.write_text("unit,station,trial,value\na,s,1,0.1\na,s,2,0.2\na,t,1,0.1\n")
    code, _, err = run(capsys, "quality", "grr", study)
    assert code == 2 and {"a", "t"} <= set(err.split()) and "trial 2" in err


def test_doctor_collects_without_secrets(url, capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("SOFTCAL_REGISTRY", "postgresql://line:hush@127.0.0.1:1/softcal")
    log = logs.start_logging(command="test")
    # As long as no time, size or version of the bundle holds it by chance.
    pin = "2580147036914725"
    log.info("opened", url="postgresql://line:hush@db/x", pin=pin)
    logs.end_run(log, 0, "")
    bundle = tmp_path / "support.zip"
    code, out, err = run(capsys, "doctor", "--out", bundle)
    with zipfile.ZipFile(bundle) as content:
        everything = out + err + "".join(content.read(name).decode() for name in content.namelist())
        assert code == 0 and any(name.startswith("logs/") for name in content.namelist())
    assert "hush" not in everything and pin not in everything and "line:***@" in everything


@pytest.mark.parametrize(
    "secret",
    [
        "postgresql://line:hu:s@hush@db/softcal",
        "postgresql://db/softcal?user=line&password=hush",
        "connection to 'postgresql+psycopg://line:hush@db/softcal' failed",
    ],
)
def test_a_password_never_reaches_the_log(secret, tmp_path, monkeypatch):
    monkeypatch.setenv("SOFTCAL_LOGS", str(tmp_path))
    log = logs.begin_run("test", ["batch", "--registry", secret], lot=secret)
    log.info("event", text=secret, parts=[secret], pin="hush")
    logs.log_crash(ValueError(secret), "test")
    logs.end_run(log, 2, secret)
    log_text = next(tmp_path.glob("*.jsonl")).read_text()
    assert "hush" not in log_text and log_text.count("***") >= 6
    assert {json.loads(line)["command"] for line in log_text.splitlines()} == {"test"}


def test_a_log_that_grew_too_large_is_set_aside(tmp_path, monkeypatch):
    monkeypatch.setenv("SOFTCAL_LOGS", str(tmp_path))
    monkeypatch.setattr(logs, "LARGEST_BYTES", 2_000)
    log = logs.begin_run("test", [])
    for k in range(40):
        log.info("event", number=k)
    logs.end_run(log, 0, "")
    files = list(tmp_path.glob("softcal-*.jsonl"))
    assert len(files) > 2 and sum(len(path.read_text().splitlines()) for path in files) == 42


def test_work_goes_on_where_no_log_can_be_written(url, capsys, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("SOFTCAL_LOGS", str(tmp_path / "file" / "logs"))
    assert run(capsys, "lot", "limit", "L1", "--registry", url)[0] == 0


def test_a_defect_is_one_line_and_its_traceback_is_in_the_log(url, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("softcal.app.cli.registry.print_table", lambda *_: 1 / 0)
    code, _, err = run(capsys, "registry", "list", "--registry", url)
    assert code == 2 and err.count("\n") == 1
    (log,) = (tmp_path / "logs").glob("*.jsonl")
    assert "ZeroDivisionError" in json.loads(log.read_text())["traceback"]


def test_excel_cells_cannot_run(tmp_path):
    write_table(tmp_path / "t.xlsx", ["name", "value"], [["=1+1", -3.5], ["@x", None], ["fine", 2]])
    rows = list(openpyxl.load_workbook(tmp_path / "t.xlsx").active.iter_rows(values_only=True))
    assert rows == [("name", "value"), ("'=1+1", -3.5), ("'@x", None), ("fine", 2)]
    with pytest.raises(InputError, match="'.ods'"):
        write_table(tmp_path / "t.ods", [], [])
