"""The generated client of the REST interface: types for mypy, a method for every path, answers of a real server."""

import importlib.util
import inspect
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
import uvicorn

from softcal.app.cli.main import main
from softcal.app.rest.server import openapi_document, rest_app
from softcal.db.registry import Registry
from tests.wait import wait_until

pytestmark = pytest.mark.usefixtures("separate_data_folder")


@pytest.fixture
def client_file(tmp_path: Path) -> Path:
    assert main(["api", "client", "--out", str(tmp_path / "softcal_client.py")]) == 0
    return tmp_path / "softcal_client.py"


@pytest.fixture
def module(client_file: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("softcal_client", client_file)
    assert spec is not None and spec.loader is not None
    client_module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(client_module)
    return client_module


@pytest.fixture
def address(registry: Registry) -> Iterator[str]:
    """Where a real server answers, as long as the test runs."""
    server = uvicorn.Server(uvicorn.Config(rest_app(registry), port=0, log_level="warning"))
    thread = threading.Thread(target=server.run)
    thread.start()
    wait_until(lambda: server.started)
    yield f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
    server.should_exit = True
    thread.join()


def test_every_path_has_a_method_that_names_what_it_takes(module, registry):
    paths = openapi_document(rest_app(registry))["paths"]
    operations = [operation for methods in paths.values() for operation in methods.values()]
    assert len(operations) >= 18
    for operation in operations:
        method = getattr(module.Client, operation["operationId"].partition("_v1_")[0])
        # A client keeps no answers: it never asks whether one has changed.
        names = {one["name"] for one in operation.get("parameters", [])} - {"If-None-Match"}
        parameters = {name.replace("-", "_") for name in names}
        assert set(inspect.signature(method).parameters) - {"self", "body"} == parameters


@pytest.mark.long
@pytest.mark.usefixtures("jobs_at_once")
def test_a_real_server_answers_every_kind_of_question(module, registry, address):
    client = module.Client(address, registry.tokens.add("Erin", "a test", 1)[1])
    assert client.me()["role"] == "engineer"
    assert [lot["lot"] for lot in client.lots(limit=5)["lots"]] == ["small"]
    failed = client.units("small", verdict=["fail", "retest"], descending=True)
    assert [unit["serial"] for unit in failed["units"]] == ["A4"]
    assert client.files("small", "A1", "blob").startswith(b"PK")
    job = client.start({"lot": "small"}, idempotency_key="order-1")
    assert client.start({"lot": "small"}, idempotency_key="order-1")["job_id"] == job["job_id"]
    assert client.cancel(job["job_id"])["state"] in ("done", "cancelled")


def test_what_is_refused_is_one_clear_error(module, registry, address):
    with pytest.raises(module.SoftcalProblem, match="token") as refused:
        module.Client(address, "no token").me()
    assert refused.value.status == 401
    with pytest.raises(module.SoftcalProblem) as refused:
        module.Client(address, registry.tokens.add("Erin", "a test", 1)[1]).units_of_serial(serial="nobody %2F..%00b")
    assert refused.value.status == 404 and "\n" not in str(refused.value)
    with pytest.raises(ValueError, match="http:// or https:// was expected"):
        module.Client("file:///etc", "secret")


@pytest.mark.long
def test_its_types_hold_under_mypy(client_file):
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file=", str(client_file)]
    process = subprocess.run(command, capture_output=True, text=True, check=False, cwd=client_file.parent)
    assert process.returncode == 0, process.stdout
