"""The commands of `softcal connect` and `softcal api`: files, alerts, one line for what cannot be, and a whole run."""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from softcal.app.calibration.results import RESULTS
from softcal.app.cli.main import main
from softcal.app.connect import alert_monitor
from softcal.app.connect.alert_monitor import AlertMonitor, open_alerts
from softcal.app.connect.events import events_after
from softcal.app.connect.service import run_connect
from softcal.app.connect.settings import ConnectSettings, OpcUaSettings, read_settings
from softcal.app.rest.server import ServingOptions
from softcal.core.errors import InputError
from softcal.core.lot import Lot
from softcal.core.maps.affine_map import AffineMap
from softcal.core.maps.interface import map_sha256
from softcal.core.messages.reason import plain
from softcal.db.connection import open_registry
from softcal.db.entries import GoldenRun
from softcal.db.maintenance.sync import synchronise
from tests.wait import wait_until

pytestmark = pytest.mark.usefixtures("separate_data_folder")
SOFTCAL = str(Path(sys.executable).with_name("softcal"))
NOW = datetime(2026, 5, 4, 8, 0, tzinfo=UTC)
DOCS = (Path(__file__).parents[2] / "docs" / "connect.md").read_text(encoding="utf-8")


@pytest.fixture
def url(tmp_path: Path) -> str:
    database_url = f"sqlite:///{tmp_path / 'registry.db'}"
    with open_registry(database_url) as registry:
        registry.lots.add(Lot("L1", "S0", 50.0))
        registry.people.set("MES", "engineer", "2580", actor="admin")
    return database_url


def run_command(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    code = main(arguments)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_a_token_is_shown_once_and_its_whole_life_is_in_the_trail(url, capsys):
    create = ["api", "token", "create", "--registry", url, "--account", "MES", "--purpose", "hall 3"]
    code, secret, note = run_command(create, capsys)
    assert code == 0 and secret.startswith("softcal_") and note
    code, out, _ = run_command(["api", "token", "list", "--registry", url, "--json", "-"], capsys)
    (token,) = json.loads(out)["tokens"]
    assert secret.strip() not in out and token["account"] == "MES"
    withdraw = ["api", "token", "withdraw", token["token_id"], "--registry", url, "--reason", "lost"]
    assert run_command(withdraw, capsys)[0] == 0
    with open_registry(url) as registry:
        actions = [(row.action, row.reason) for row in registry.trail.list_rows("tokens", (token["token_id"],))]
    assert actions == [("add", ""), ("withdraw", "lost")]
    code, _, error = run_command(withdraw, capsys)
    assert code == 2 and len(error.strip().splitlines()) == 1


def test_an_account_that_is_not_there_gets_no_token(url, capsys):
    create = ["api", "token", "create", "--registry", url, "--account", "eve", "--purpose", "x"]
    code, out, error = run_command(create, capsys)
    assert (code, out) == (2, "") and "eve" in error


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.7", "::", "plant.example"])
def test_the_api_listens_to_other_machines_only_with_a_certificate(host):
    with pytest.raises(InputError, match="--cert"):
        ServingOptions(host=host)


@pytest.mark.long
def test_the_api_answers_by_its_command_and_ends_by_a_signal(url, some_port):
    port = some_port()
    with open_registry(url) as registry:
        secret = registry.tokens.add("MES", "a test", 1)[1]
    command = [SOFTCAL, "api", "serve", "--registry", url, "--port", str(port)]
    server = subprocess.Popen(command, stderr=subprocess.DEVNULL, env=dict(os.environ))
    try:
        request = urllib.request.Request(
            f"http://127.0.0.1:{port}/v1/me", headers={"Authorization": f"Bearer {secret}"}
        )
        assert json.load(wait_for_answer(request, server))["account"] == "MES"
        # The same port again is one line.
        second = subprocess.run(command, capture_output=True, text=True, timeout=120)
        assert second.returncode == 2 and str(port) in second.stderr and "Traceback" not in second.stderr
    finally:
        server.send_signal(signal.SIGTERM)
        assert server.wait(timeout=60) in (0, -signal.SIGTERM)


def wait_for_answer(request, server):
    end_s = time.monotonic() + 120
    while True:
        assert server.poll() is None and time.monotonic() < end_s, "the server does not answer"
        try:
            return urllib.request.urlopen(request, timeout=5)
        except OSError:
            time.sleep(0.1)


WEBHOOK = """[[webhook]]
name = "mes"
url = "https://mes.example/softcal"
secret_file = "mes.secret"
"""


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[[webhok]]\n", "webhook"),
        (WEBHOOK + 'ulr = "x"\n', "url"),
        (WEBHOOK + WEBHOOK, "mes"),
        (WEBHOOK.replace("https", "http"), "https"),
        (WEBHOOK.replace('secret_file = "mes.secret"\n', ""), "secret_file"),
        (WEBHOOK + 'events = "verdict"\n', "events"),
        (WEBHOOK + 'events = ["verdicts"]\n', "verdict"),
        (WEBHOOK + "timeout_s = -1\n", "timeout_s"),
        (WEBHOOK + "timeout_s = true\n", "timeout_s"),
        (WEBHOOK.replace("[[webhook]]", "[webhook]"), "[[webhook]]"),
        ('[opcua]\nendpoint = "opc.tcp://0.0.0.0:4840"\n', "opcua"),
        ("[alerts]\nevery_s = -1\n", "every_s"),
        ("[[mail]\n", "plant.toml"),
        ("", "plant.toml"),
    ],
)
def test_a_file_that_cannot_be_is_one_line_that_says_where(url, tmp_path, capsys, text, message):
    (tmp_path / "plant.toml").write_text(text)
    code, _, error = run_command(["connect", "run", str(tmp_path / "plant.toml"), "--registry", url], capsys)
    assert code == 2 and message in error, error
    assert [line for line in error.splitlines() if line.startswith("softcal: ")] == error.splitlines()[-1:]


def test_the_file_of_the_documentation_is_read_as_it_stands(tmp_path):
    (block,) = [part.split("```")[0] for part in DOCS.split("```toml\n")[1:] if "[[webhook]]" in part]
    (tmp_path / "plant.toml").write_text(block)
    settings = read_settings(tmp_path / "plant.toml")
    assert len(settings.webhooks) == len(settings.mails) == len(settings.mqtts) == 1
    assert settings.opcua == OpcUaSettings() and settings.webhooks[0].secret_file == tmp_path / "mes.secret"


def test_a_secret_is_written_once_for_its_owner_alone(tmp_path, capsys):
    path = tmp_path / "mes.secret"
    assert run_command(["connect", "secret", "--out", str(path)], capsys)[0] == 0
    assert path.read_text().startswith("whsec_") and path.stat().st_mode & 0o777 == 0o600
    text = path.read_text()
    code, _, error = run_command(["connect", "secret", "--out", str(path)], capsys)
    assert code == 2 and str(path) in error and path.read_text() == text


def test_an_alert_is_an_event_when_it_begins_and_when_it_is_over(url):
    bad = GoldenRun("line-1", "L1", "G1", NOW, 0.3, "N", False)
    with open_registry(url) as registry:
        monitor = AlertMonitor(registry)
        assert monitor.update(NOW) == 0
        registry.stations.add_golden_run(bad)
        assert monitor.update(NOW) == 1
        # A second failure is the same alert; so it is for a watch that begins anew.
        registry.stations.add_golden_run(replace(bad, made_at=NOW + timedelta(minutes=1)))
        assert monitor.update(NOW) == AlertMonitor(registry).update(NOW) == 0
        (alert,) = open_alerts(registry).values()
        assert alert["is_urgent"] and "line-1" in alert["text"]["en"] and "line-1" in alert["text"]["ko"]
        registry.stations.add_golden_run(replace(bad, made_at=NOW + timedelta(hours=1), passed=True))
        assert monitor.update(NOW) == 1 and open_alerts(registry) == {}
        kinds = [event.kind for event in events_after(registry, {}, 99, ["alert"]).events]
        assert kinds == ["alert.raised", "alert.cleared"] and registry.verify() == []


def test_an_alert_that_two_processes_see_at_once_is_reported_once(url, monkeypatch):
    with open_registry(url) as registry, open_registry(url) as elsewhere:
        first, second = AlertMonitor(registry), AlertMonitor(elsewhere)
        registry.stations.add_golden_run(GoldenRun("line-1", "L1", "G1", NOW, 0.3, "N", False))
        monkeypatch.setattr(alert_monitor, "open_alerts", lambda seen: _meanwhile(seen, monkeypatch, second))
        assert first.update(NOW) == 0
        assert [event.kind for event in events_after(registry, {}, 99, ["alert"]).events] == ["alert.raised"]


def _meanwhile(registry, monkeypatch, second):
    """Return the open alerts as one process reads them just before the other one raises its own."""
    alerts = open_alerts(registry)
    monkeypatch.setattr(alert_monitor, "open_alerts", open_alerts)
    assert second.update(NOW) == 1
    return alerts


def test_a_yield_that_did_not_drop_is_no_alert(url):
    with open_registry(url) as registry:
        monitor = AlertMonitor(registry)
        monitor.update(NOW)
        with registry.transaction():
            for number in range(60):
                registry.calibrations.refuse("L1", f"U{number}", "retest", (plain("x"),))
        monitor.update(NOW)
        assert open_alerts(registry) == {}


def test_a_conflict_of_two_registries_is_reported_as_retest(calibrated, tmp_path):
    with open_registry(calibrated) as here:
        lot = here.lots.ids()[0]
        here.outbox.begin("x", {})
    other = tmp_path / "other.db"
    backup = tmp_path / "backup.db"
    assert main(["registry", "backup", str(backup), "--registry", calibrated]) == 0
    assert main(["registry", "restore", str(backup), "--registry", f"sqlite:///{other}"]) == 0
    with open_registry(calibrated) as here, open_registry(f"sqlite:///{other}") as there:
        for registry, reason in ((here, "here"), (there, "there")):
            newest = registry.calibrations.get("A1", lot_id=lot)
            scale = AffineMap(1.1 if reason == "here" else 1.2, 0.0)
            fitted = replace(newest.state.fit.fitted, unit_map=scale)
            fit = replace(newest.state.fit, fitted=fitted, family="affine", map_sha256=map_sha256(scale), id=reason)
            registry.calibrations.add(lot, replace(newest.state, fit=fit))
        synchronise(here, there)
        (unit,) = here.lots.units(lot, "A1")
        assert unit.is_conflict
        last = [e for e in events_after(here, {}, 999, ["verdict"]).events if e.data["serial"] == "A1"][-1]
        assert last.data["verdict"] == unit.verdict == "retest" and last.data["is_conflict"]


def test_a_run_delivers_what_waits_and_ends_by_a_signal(url, tmp_path, some_port):
    """The whole command: a mail server of the test gets the verdict, the OPC UA server answers, SIGTERM ends it."""
    from aiosmtpd.controller import Controller

    mails: list[bytes] = []

    class Box:
        async def handle_DATA(self, server, session, envelope):  # noqa: N802
            mails.append(envelope.content)
            return "250 taken"

    box = Controller(Box(), hostname="127.0.0.1", port=some_port())
    box.start()
    opcua = some_port()
    (tmp_path / "plant.toml").write_text(
        f'[[mail]]\nname = "people"\nserver = "smtp://127.0.0.1:{box.port}"\nsender = "a@plant.example"\n'
        f'to = ["b@plant.example"]\nevents = ["verdict"]\nbegin = "first"\n'
        f'[opcua]\nendpoint = "opc.tcp://127.0.0.1:{opcua}/softcal"\n'
    )
    file = str(tmp_path / "plant.toml")
    assert main(["connect", "check", file]) == 0
    with open_registry(url) as registry:
        registry.calibrations.refuse("L1", "U1", "fail", (plain("dead"),))
    process = subprocess.Popen([SOFTCAL, "connect", "run", file, "--registry", url], stderr=subprocess.PIPE, text=True)
    try:
        wait_until(lambda: mails or process.poll() is not None)
        assert process.poll() is None, "no mail came"
    finally:
        process.send_signal(signal.SIGTERM)
        _, error = process.communicate(timeout=60)
        box.stop()
    assert process.returncode == 0 and "Traceback" not in error
    assert b"U1" in mails[0]
    path = tmp_path / "status.json"
    assert main(["connect", "status", "--registry", url, "--json", str(path)]) == 0
    (state,) = json.loads(path.read_text())["destinations"]
    assert (state["destination"], state["sent"], state["waits"], state["failures"]) == ("people", 1, 0, 0)


@pytest.mark.long
def test_a_run_whose_port_is_taken_is_one_line(url, some_port):
    port = some_port()
    with socket.socket() as occupied, open_registry(url) as registry:
        occupied.bind(("127.0.0.1", port))
        occupied.listen()
        settings = ConnectSettings(opcua=OpcUaSettings(endpoint=f"opc.tcp://127.0.0.1:{port}/softcal"))
        with pytest.raises(InputError, match=str(port)):
            run_connect(registry, settings, threading.Event())


def documented_columns() -> list[tuple[str, str, bool]]:
    """Name, type and whether it may be null, of the table in docs/connect.md."""
    part = DOCS.split("## Results as Parquet")[1].split("\n## ")[0]
    rows = [[cell.strip(" `") for cell in line.split("|")[1:4]] for line in part.splitlines() if line.startswith("| `")]
    return [(name, kind, may_be_null == "yes") for name, kind, may_be_null in rows]


def test_the_columns_of_the_results_are_those_of_the_documentation():
    assert documented_columns() == [(field.name, str(field.type), field.nullable) for field in RESULTS]


def test_the_batch_writes_its_results_as_parquet(trained_lot, tmp_path):
    shutil.copytree(trained_lot / "lot", tmp_path / "lot")
    shutil.copy(trained_lot / "registry.db", tmp_path / "registry.db")
    (tmp_path / "lot/units/A4.csv").write_text("t_s,output\n" + "".join(f"{k / 50},0.5\n" for k in range(1500)))
    files = ["--parquet", str(tmp_path / "r.parquet"), "--json", str(tmp_path / "r.json")]
    lot, url = str(tmp_path / "lot"), f"sqlite:///{tmp_path / 'registry.db'}"
    assert main(["batch", lot, "--registry", url, "--hidden", "16,8", "--no-own", *files]) == 1
    table, report = pq.read_table(tmp_path / "r.parquet"), json.loads((tmp_path / "r.json").read_text())
    assert table.schema.equals(RESULTS)
    metadata = {key.decode(): value.decode() for key, value in table.schema.metadata.items()}
    assert (metadata["schema"], metadata["lot"], metadata["reference_unit"]) == (
        "softcal.results/1",
        report["lot"],
        "N",
    )
    for row, unit in zip(table.to_pylist(), report["units"], strict=True):
        errors = ("predicted_rmse", "before_rmse", "after_rmse", "own_rmse")
        texts = ("serial", "verdict", "reasons", "reason_codes", "released", "audited", "knowledge", "fit_s")
        for name in texts + errors:
            assert row[name] == unit[name], name
        assert (row["map_family"], row["map_sha256"], row["revision"], row["method_id"]) == (
            (unit["map"]["family"], unit["map"]["sha256"], unit["map"]["revision"], unit["method"])
            if unit["map"]
            else (None,) * 4
        )
    assert pa.types.is_timestamp(table.schema.field("made_at").type)


def test_results_go_to_parquet_alone(tmp_path, capsys):
    with pytest.raises(SystemExit) as end:
        main(["batch", str(tmp_path), "--parquet", "r.csv"])
    assert end.value.code == 2 and ".parquet" in capsys.readouterr().err
