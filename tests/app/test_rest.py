"""The REST interface: the answers of the commands, roles, pages, keys, and one clear line for every error."""

import importlib.util
import io
import json
import re
import shlex
import zipfile
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import httpx2
import pyarrow.parquet as pq
import pytest
from fastapi.testclient import TestClient

from softcal.app.calibration.results import RESULTS
from softcal.app.cli.main import main
from softcal.app.connect.alert_monitor import store_alert
from softcal.app.registry.listing import unit_json
from softcal.app.rest.routes import MAX_ROWS
from softcal.app.rest.server import openapi_document, rest_app
from softcal.app.rest.v1 import UnitAnswer
from softcal.core.lot import Lot
from softcal.core.messages.reason import plain
from softcal.core.orders import Heartbeat, Order, OrderKind, StationState
from softcal.db.entries import UnitEntry
from softcal.db.registry import Registry

pytestmark = pytest.mark.usefixtures("separate_data_folder")
EXAMPLES = 10
ACCOUNTS = {"operator": "Oh", "engineer": "Erin", "quality": "Quinn"}


@pytest.fixture
def client_of(registry: Registry) -> Callable[[str], httpx2.Client]:
    """`client_of(role)` asks as a program whose account has that role."""

    def signed_in(role: str) -> httpx2.Client:
        secret = registry.tokens.add(ACCOUNTS[role], "a test", 1)[1]
        return TestClient(rest_app(registry), headers={"Authorization": f"Bearer {secret}"})

    return signed_in


@pytest.fixture
def client(client_of) -> httpx2.Client:
    return client_of("engineer")


def listed(url: str, tmp_path: Path) -> list[dict[str, object]]:
    """What `softcal registry list --json` says of the target units."""
    assert main(["registry", "list", "--registry", url, "--json", str(tmp_path / "list.json")]) == 0
    return [unit for unit in json.loads((tmp_path / "list.json").read_text())["units"] if unit["role"] == "target"]


def test_units_are_what_the_command_says_page_by_page(client, calibrated, tmp_path):
    assert [lot["lot"] for lot in client.get("/v1/lots").json()["lots"]] == ["small"]
    expected_units, lot, after = listed(calibrated, tmp_path), [], ""
    while after is not None:
        answer = client.get("/v1/lots/small/units", params={"limit": 3, "after": after}).json()
        assert answer["total"] == len(expected_units)
        lot += answer["units"]
        after = answer["next"]
    assert lot == expected_units
    one = expected_units[0]["serial"]
    assert client.get(f"/v1/lots/small/units/{one}").json() == expected_units[0]
    assert client.get(f"/v1/units?serial={one}").json() == {"units": [expected_units[0]], "next": None}


def test_a_filter_lets_through_what_it_names(client, calibrated, tmp_path):
    failed = [unit["serial"] for unit in listed(calibrated, tmp_path) if unit["verdict"] == "fail"]
    answer = client.get("/v1/lots/small/units", params={"verdict": "fail"}).json()
    assert [unit["serial"] for unit in answer["units"]] == failed == ["A4"]
    assert client.get("/v1/lots").json()["lots"][0]["counts"]["fail"] == 1


def test_revisions_are_what_the_command_says(client, calibrated, tmp_path):
    path = str(tmp_path / "h.json")
    assert main(["registry", "history", "--serial", "A1", "--registry", calibrated, "--json", path]) == 0
    content = json.loads(Path(path).read_text())
    answer = client.get("/v1/lots/small/units/A1/revisions").json()
    assert {"schema": content["schema"], **answer} == content | {"next": None}


@pytest.mark.parametrize("limit", [1, 2, 5, 6, 7])
def test_every_list_comes_a_page_at_a_time_by_the_same_cursor(client, registry, limit):
    alert = {"kind": "station", "lot": None, "values": {}, "is_urgent": True, "text": {"en": "x"}}
    for number in range(6):
        registry.lots.add(Lot(f"X{number}", "S0", 50.0))
        registry.job_board.place("train", {}, "Erin")
        registry.calibrations.refuse(f"X{number}", "A1", "fail", (plain("dead"),))
        registry.order_queue.place(Order(f"{number}", f"line-{number}", OrderKind.CHECK))
        registry.order_queue.write_heartbeat(Heartbeat(f"line-{number}", StationState.OFF, datetime.now(UTC)))
        store_alert(registry, ("station", "", f"line-{number}"), alert, is_open=True)
    for path in ("lots", "units?serial=A1", "jobs", "orders", "stations", "alerts", "lots/small/units"):
        name = path.rpartition("/")[2].partition("?")[0]
        (whole, end), result, after = page_of(client, path, name, "", MAX_ROWS), [], ""
        while after is not None:
            rows, after = page_of(client, path, name, after, limit)
            assert len(rows) <= limit
            result += rows
        assert result == whole and end is None and len(whole) >= 4, path
    assert client.get("/v1/lots?after=nonsense").status_code == 400


def page_of(client, path: str, name: str, after: str, limit: int) -> tuple[list, str | None]:
    separator = "&" if "?" in path else "?"
    answer = client.get(f"/v1/{path}{separator}limit={limit}&after={after}").json()
    return answer[name], answer["next"]


def test_no_question_writes_anything(client, registry):
    operations = openapi_document(rest_app(registry))["paths"]
    values = {"{lot}": "small", "{serial}": "A1", "{job_id}": start_job(registry)}
    before = registry.outbox.end()
    for path in [path for path, methods in operations.items() if "get" in methods]:
        for name, value in values.items():
            path = path.replace(name, value)
        answer = client.get(path, params={"serial": "A1"} if path == "/v1/units" else None)
        assert answer.status_code == 200, (path, answer.text)
    assert registry.outbox.end() == before
    # A unit has no name without its lot.
    assert not [path for path in operations if "{serial}" in path and not path.startswith("/v1/lots/{lot}/units/")]


def test_files_are_those_of_the_export_and_who_took_them_is_kept(client, registry, calibrated, tmp_path):
    answer = client.post("/v1/lots/small/units/A1/files/blob")
    assert answer.status_code == 200, answer.text
    with zipfile.ZipFile(io.BytesIO(answer.content)) as archive:
        contents = {name: archive.read(name) for name in archive.namelist()}
    options = ["--serial", "A1", "--format", "blob", "--out", str(tmp_path / "out")]
    assert main(["export", "--registry", calibrated, *options]) == 0
    assert contents and contents == {name: (tmp_path / "out" / name).read_bytes() for name in contents}
    assert [row.actor for row in registry.trail.list_rows("units", ("small", "A1")) if row.action == "export"][
        0
    ] == "Erin"


def test_files_of_a_unit_that_is_no_longer_released_are_refused_with_the_reason(client, registry):
    registry.calibrations.refuse("small", "A1", "fail", (plain("its cable broke"),))
    answer = client.post("/v1/lots/small/units/A1/files/blob")
    assert (answer.status_code, answer.headers["content-type"]) == (409, "application/problem+json")
    assert "its cable broke" in answer.json()["detail"]


def test_results_as_parquet_are_those_of_the_lot(client, calibrated, tmp_path):
    table = pq.read_table(io.BytesIO(client.get("/v1/lots/small/results.parquet").content))
    assert table.schema.equals(RESULTS)
    units = listed(calibrated, tmp_path)
    for column in ("serial", "verdict", "predicted_rmse", "revision", "reasons"):
        assert table[column].to_pylist() == [unit[column] for unit in units]


@pytest.mark.usefixtures("jobs_at_once")
def test_a_job_calibrates_and_the_same_key_is_the_same_job(client):
    key = {"Idempotency-Key": "order-4711"}
    first = client.post("/v1/jobs", json={"lot": "small"}, headers=key)
    assert first.status_code == 202, first.text
    again = client.post("/v1/jobs", json={"lot": "small"}, headers=key)
    assert again.json()["job_id"] == first.json()["job_id"]
    finished_job = client.get(first.headers["location"]).json()
    assert finished_job["state"] == "done", finished_job["message"]
    assert finished_job["result"]["lot"] == "small" and finished_job["actor"] == "Erin"
    assert len(client.get("/v1/jobs").json()["jobs"]) == 1


def test_a_key_belongs_to_one_request_and_one_account(client, client_of, registry, monkeypatch):
    launched = []
    monkeypatch.setattr("softcal.app.jobs.launch.launch", lambda job_id, _: launched.append(job_id))
    registry.lots.add(Lot("other", "S0", 50.0))
    key = {"Idempotency-Key": "k"}
    mine = client.post("/v1/jobs", json={"lot": "small"}, headers=key).json()["job_id"]
    refused = client.post("/v1/jobs", json={"lot": "other"}, headers=key)
    assert refused.status_code == 409
    others = client_of("operator").post("/v1/jobs", json={"lot": "other"}, headers=key).json()["job_id"]
    assert launched == [mine, others] and mine != others
    assert client.post(f"/v1/jobs/{mine}/cancel").json()["state"] == "cancelled"


def test_events_are_read_on_from_where_the_last_answer_ended(client, registry):
    whole = client.get("/v1/events", params={"limit": MAX_ROWS}).json()
    assert whole["is_end"] and {event["type"] for event in whole["events"]} == {"softcal.verdict"}
    rows, after = [], ""
    while True:
        answer = client.get("/v1/events", params={"limit": 1, "after": after}).json()
        rows, after = rows + answer["events"], answer["next"]
        if answer["is_end"]:
            break
    assert rows == whole["events"]
    lot = whole["events"][0]["data"]["lot"]
    registry.calibrations.refuse(lot, "A1", "fail", (plain("broken"),))
    (new,) = client.get("/v1/events", params={"after": after}).json()["events"]
    assert (new["data"]["serial"], new["data"]["verdict"], new["data"]["reasons"]) == ("A1", "fail", ["broken"])


@pytest.mark.parametrize(
    ("role", "method", "path", "status"),
    [
        ("quality", "POST", "/v1/jobs", 403),
        ("operator", "GET", "/v1/events?kind=change", 403),
        ("engineer", "GET", "/v1/events?kind=change", 403),
        ("quality", "GET", "/v1/events?kind=change", 200),
        ("operator", "GET", "/v1/lots", 200),
    ],
)
def test_a_token_may_what_the_role_of_its_account_may(client_of, role, method, path, status):
    answer = client_of(role).request(method, path, json={"lot": "L"} if method == "POST" else None)
    assert answer.status_code == status, answer.text


def test_who_does_not_sign_in_sees_nothing(registry):
    app = rest_app(registry)
    operations = [(m, p) for p, ops in openapi_document(app)["paths"].items() for m in ops]
    assert len(operations) > 15
    for headers in ({}, {"Authorization": "Bearer softcal_wrong"}, {"Authorization": "Basic Zm9v"}):
        anonymous = TestClient(app, headers=headers)
        for method, path in operations:
            answer = anonymous.request(method, path.replace("{job_id}", "0" * 32), json={"lot": "L"})
            assert answer.status_code == 401, (method, path, answer.text)
            assert answer.headers["content-type"] == "application/problem+json"
    assert anonymous.get("/health").json() == {"status": "ok"}


@pytest.mark.parametrize(
    ("path", "status", "message"),
    [
        ("/v1/lots/none", 404, "none"),
        ("/v1/lots/none/units", 404, "none"),
        ("/v1/units?serial=none", 404, "none"),
        (f"/v1/jobs/{'0' * 32}", 404, "0" * 32),
        ("/v1/events?after=nonsense", 400, "cursor"),
        ("/v1/lots?limit=0", 422, "query.limit"),
        ("/v1/nothing", 404, ""),
    ],
)
def test_an_error_is_one_line(client, path, status, message):
    answer = client.get(path)
    assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json")
    problem = answer.json()
    assert message in problem["detail"] and "\n" not in problem["detail"] and problem["status"] == status


def test_another_name_of_the_server_is_refused(client):
    assert client.get("/v1/me", headers={"Host": "evil.example"}).status_code == 400


def test_the_model_of_a_unit_has_every_field_of_the_command():
    assert set(UnitAnswer.model_fields) == set(unit_json(UnitEntry("L", "A", "target")))


@pytest.mark.long
def test_the_document_is_valid_openapi(registry, tmp_path):
    from openapi_spec_validator import validate

    document = openapi_document(rest_app(registry))
    validate(document)
    assert main(["api", "openapi", "--out", str(tmp_path / "openapi.json")]) == 0
    assert json.loads((tmp_path / "openapi.json").read_text()) == document


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("mode", ["positive", "negative"])
def test_no_request_that_a_fuzzer_finds_is_a_defect(registry, require, monkeypatch, mode):
    """Schemathesis over every operation: valid and invalid requests, and none ends in a server error."""
    require(importlib.util.find_spec("schemathesis"), "no schemathesis")
    import hypothesis
    import schemathesis
    from hypothesis import strategies
    from schemathesis import GenerationMode, checks
    from schemathesis.specs.openapi import checks as of_openapi

    monkeypatch.setattr("softcal.app.jobs.launch.launch", lambda job_id, on_end: None)
    token = registry.tokens.add("Erin", "fuzz", 1)[1]
    values = {"lot": registry.lots.ids()[0], "serial": "A1", "format": "json", "job_id": start_job(registry)}
    schema = schemathesis.openapi.from_asgi("/openapi.json", rest_app(registry))
    checks_made = [
        checks.not_a_server_error,
        of_openapi.status_code_conformance,
        of_openapi.content_type_conformance,
        of_openapi.response_schema_conformance,
    ]
    requests = []
    for result in schema.get_all_operations():
        operation = result.ok()
        try:
            cases = operation.as_strategy(generation_mode=GenerationMode(mode))
        except schemathesis.errors.SchemathesisError:
            continue  # Nothing of it can be invalid.

        @hypothesis.settings(
            max_examples=EXAMPLES, deadline=None, database=None, derandomize=True,
            suppress_health_check=list(hypothesis.HealthCheck), phases=[hypothesis.Phase.generate],
        )  # fmt: skip
        @hypothesis.given(case=cases, is_signed_in=strategies.booleans())
        def ask(case, is_signed_in):
            if is_signed_in and mode == "positive":
                case.path_parameters = {name: values[name] for name in case.path_parameters or {}}
                if isinstance(case.body, dict):
                    case.body["lot"] = values["lot"]
            answer = case.call(headers={"Authorization": f"Bearer {token}"})
            requests.append((case.operation.label, answer.status_code))
            case.validate_response(answer, checks=checks_made)

        ask()
    statuses = {status for _, status in requests}
    assert max(statuses) < 500
    assert ({200, 202, 404} if mode == "positive" else {422}) <= statuses
    assert len({label for label, _ in requests}) > (15 if mode == "positive" else 10)


def start_job(registry: Registry) -> str:
    return registry.job_board.place("calibrate", {"lot": registry.lots.ids()[0]}, "Erin")


CONNECT = (Path(__file__).parents[2] / "docs" / "connect.md").read_text(encoding="utf-8")

PARAMETERS = {"LOT": "{lot}", "SERIAL": "{serial}", "FORMAT": "{format}", "ID": "{job_id}"}


def requests_of_the_page() -> list[list[str]]:
    """The calls of curl on the page, a list of words each."""
    fenced = re.findall(r"^```(\w*)\n(.*?)^```$", CONNECT, re.MULTILINE | re.DOTALL)
    blocks = "\n".join(text for language, text in fenced if not language).replace("\\\n", " ")
    return [shlex.split(line) for line in blocks.splitlines() if line.startswith("curl ")]


@pytest.mark.usefixtures("jobs_at_once")
def test_every_request_of_the_page_is_answered(client):
    requests = requests_of_the_page()
    assert len(requests) == 4
    for arguments in requests:
        headers = dict(arguments[k + 1].split(": ", 1) for k, word in enumerate(arguments) if word == "-H")
        assert headers.pop("Authorization") == "Bearer $TOKEN"
        body = arguments[arguments.index("-d") + 1].replace("lot-1", "small") if "-d" in arguments else None
        (address,) = [word for word in arguments if word.startswith("http://")]
        path = address.removeprefix("http://127.0.0.1:8600").replace("lot-1", "small")
        is_sent = body or arguments[arguments.index("-X") + 1 :][:1] == ["POST"] if "-X" in arguments else body
        answer = client.request("POST" if is_sent else "GET", path, content=body, headers=headers)
        assert answer.status_code in (200, 202), (address, answer.text)


def test_every_path_of_the_page_is_in_the_document_and_the_other_way_round(registry):
    table = CONNECT.split("## REST")[1].split("\n- **Document**")[0]
    paths_asked = set()
    for cell in [line.split("|")[1] for line in table.splitlines() if re.match(r"\| `(GET|POST)", line)]:
        for part in re.findall(r"`([^`]+)`", cell):
            method, _, path = part.rpartition(" ")
            path = re.sub(r"[A-Z]+", lambda match: PARAMETERS[match[0]], path)
            paths_asked.add((method or "GET", f"/v1{path}"))
    paths = openapi_document(rest_app(registry))["paths"]
    assert paths_asked == {(method.upper(), path) for path, methods in paths.items() for method in methods}
