"""The example rule, installed as a package: it holds a unit back in a batch, and without it the unit is judged anew."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

EXAMPLE = Path(__file__).parents[2] / "examples" / "softcal-example-rule"
SOFTCAL = "import sys; from softcal.app.cli.main import main; sys.exit(main(sys.argv[1:]))"


@pytest.fixture(scope="module")
def installed(install_example: Callable[[Path], Path]) -> Path:
    """Folder into which pip has installed the example."""
    return install_example(EXAMPLE)


def _python(site: Path | None, code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, **({} if site is None else {"PYTHONPATH": str(site)})}
    return subprocess.run([sys.executable, "-c", code, *arguments], env=environment, capture_output=True, text=True)


def _batch(site: Path | None, folder: Path, registry_url: str, out: Path) -> dict[str, dict[str, object]]:
    arguments = ["batch", str(folder), "--registry", registry_url, "--hidden", "16,8"]
    process = _python(site, SOFTCAL, *arguments, "--out", str(out), "--json", "-")
    assert process.returncode in (0, 1), process.stderr
    return {unit["serial"]: unit for unit in json.loads(process.stdout)["units"]}


def test_the_example_rule_conforms(installed):
    code = """
from softcal.core.unit.rule_conformance import faults
from softcal.core.unit.rules import RULES
print([(name, faults(rule)) for name, rule in RULES.items()])
"""
    assert _python(installed, code).stdout.strip() == "[('rest band 1', [])]"


def test_a_unit_that_a_rule_objects_to_is_blocked_and_decided_anew_without_the_rule(
    installed, lot_folder, registry_url, tmp_path
):
    out = tmp_path / "files"
    free = _batch(None, lot_folder, registry_url, out)
    assert {unit["verdict"] for unit in free.values()} == {"pass"} and any(out.glob("unit-A3*"))
    units = _batch(installed, lot_folder, registry_url, out)
    assert {serial: unit["verdict"] for serial, unit in units.items()} == {"A1": "pass", "A2": "pass", "A3": "fail"}
    assert [one for one in units["A3"]["reasons"] if "rest band" in one and "0.62 V" in one]  # type: ignore[attr-defined]
    assert not any(out.glob("unit-A3*")), "the file of a unit that is held back stays in the folder"
    again = _batch(None, lot_folder, registry_url, out)
    assert {unit["verdict"] for unit in again.values()} == {"pass"} and any(out.glob("unit-A3*"))
