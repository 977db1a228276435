"""The example effect of docs/own-effect.md, installed as a package: listed, diagnosed on a sealed rig, applied."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from softcal.app.cli.main import main
from softcal.app.gap.challenge import write_case
from softcal.core.challenge.case_generator import draw_case
from softcal.core.challenge.equations import OUTSIDE_FORM
from softcal.core.challenge.rig import Cause

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "softcal-example-effect"
MAIN = "import sys; from softcal.app.cli.main import main; sys.exit(main(sys.argv[1:]))"


@pytest.fixture(scope="module")
def installed(install_example: Callable[[Path], Path]) -> Path:
    """Folder into which pip has installed the example."""
    return install_example(EXAMPLE)


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sealed rig with adhesion, by the generator that shares no code with any effect."""
    sealed_case = draw_case(7, "case-1", "none")
    sticky = Cause("adhesion", OUTSIDE_FORM, {"pull_N": 0.25, "reach_mm": 0.25})
    folder = tmp_path_factory.mktemp("sticky") / "case-1"
    write_case(folder, replace(sealed_case, causes=(sticky,)))
    return folder


def softcal(site: Path, *arguments: str) -> str:
    environment = {**os.environ, "PYTHONPATH": str(site)}
    process = subprocess.run(
        [sys.executable, "-c", MAIN, *arguments], env=environment, check=True, capture_output=True, text=True
    )
    return process.stdout


def test_it_is_listed_last(installed: Path) -> None:
    effects = json.loads(softcal(installed, "gap", "effects", "--json", "-"))["effects"]
    assert effects[-1]["effect"] == "adhesion" and effects[-1]["is_plugin"]
    assert not any(effect["is_plugin"] for effect in effects[:-1])


def test_a_sealed_rig_that_sticks_is_explained_and_applied(installed: Path, case: Path, tmp_path: Path) -> None:
    softcal(installed, "gap", "diagnose", str(case), "--json", str(tmp_path / "r.json"))
    report = json.loads((tmp_path / "r.json").read_text())
    assert report["causes"][0]["effect"] == "adhesion" and report["causes"][0]["probability"] > 0.9
    assert report["verdict"] == "explained" and report["plugins"] == ["adhesion"]
    value = report["causes"][0]["parameters"]["Fa"]["value"]
    assert value == pytest.approx(0.25, rel=0.15)
    softcal(installed, "gap", "apply", "--report", str(tmp_path / "r.json"), "--out", str(tmp_path / "twin.json"))
    assert json.loads((tmp_path / "twin.json").read_text())["effects"][0]["effect"] == "adhesion"


def test_without_the_plug_in_nobody_names_a_cause(case: Path, tmp_path: Path) -> None:
    assert main(["gap", "diagnose", str(case), "--json", str(tmp_path / "r.json")]) == 0
    report = json.loads((tmp_path / "r.json").read_text())
    assert report["verdict"] == "unknown" and report["plugins"] == []


def test_its_own_tests_are_those_of_the_page(installed: Path, tmp_path: Path) -> None:
    page = (ROOT / "docs" / "own-effect.md").read_text()
    blocks = [block.split("```")[0] for block in page.split("```python\n")[1:]]
    effect, test = blocks
    assert effect == (EXAMPLE / "softcal_example_effect.py").read_text()
    assert len(effect.splitlines()) <= 40
    (tmp_path / "test_page.py").write_text(test)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(tmp_path / "test_page.py")]
    environment = {**os.environ, "PYTHONPATH": str(installed), "PYTEST_ADDOPTS": ""}
    process = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True)
    assert "7 passed" in process.stdout, process.stdout


def test_a_broken_plug_in_stops_with_one_line(tmp_path: Path) -> None:
    info = tmp_path / "worn-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: worn\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[softcal.effects]\nwear = no_such_module:WEAR\n")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    command = [sys.executable, "-c", MAIN, "gap", "effects"]
    process = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert process.returncode != 0 and "Traceback" not in process.stderr
    assert "'wear'" in process.stderr and "worn 1.0" in process.stderr
