"""docs/station-drivers.md as written: its files are those of the example, its code runs, its package installs."""

import importlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "softcal-example-driver"
PAGE = (ROOT / "docs" / "station-drivers.md").read_text()
BLOCKS = re.findall(r"<!-- (file|run)(?:: (\S+))? -->\n```\w+\n(.*?)```", PAGE, re.DOTALL)
SHORT = (
    "opens, closes twice",
    "closes although",
    "port that is not there",
    "every level",
    "in time",
    "silent device it",
    "gone is said",
)
"""What is looked at of the driver behind a thread, which takes real time."""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder into which pip has installed the example package, from a copy of its sources."""
    folder = tmp_path_factory.mktemp("site")
    source = shutil.copytree(EXAMPLE, tmp_path_factory.mktemp("source") / "example")
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    process = subprocess.run(
        [*command, "--target", str(folder), str(source)], capture_output=True, text=True, check=False
    )
    assert process.returncode == 0, process.stderr
    return folder


def run(site, *arguments, cwd):
    environment = os.environ | {"PYTHONPATH": str(site), "OMP_NUM_THREADS": "1", "PYTEST_ADDOPTS": ""}
    return subprocess.run(
        [sys.executable, *map(str, arguments)], capture_output=True, text=True, check=False, env=environment, cwd=cwd
    )


@pytest.mark.parametrize(("name", "text"), [(name, text) for mark, name, text in BLOCKS if mark == "file"])
def test_the_page_shows_the_files_of_the_example(name, text):
    assert text == (ROOT / name).read_text()


def test_every_code_of_the_page_is_one_that_a_test_looks_at():
    assert len(re.findall(r"^```(?:python|toml)$", PAGE, re.MULTILINE)) == len(BLOCKS) == 4


def test_the_installed_package_is_listed_with_its_origin_and_its_keys(site, tmp_path):
    listed = run(site, "-m", "softcal.app.cli.main", "station", "drivers", "--kind", "lab_meter", cwd=tmp_path)
    assert listed.returncode == 0, listed.stderr
    assert "softcal-example-driver 0.1.0" in listed.stdout
    assert "averages: " in listed.stderr


def test_the_kit_of_the_example_passes_where_it_is_installed(site, tmp_path):
    shutil.copy(EXAMPLE / "test_lab_meter.py", tmp_path)
    tested = run(site, "-m", "pytest", "-q", "-p", "no:cacheprovider", tmp_path, cwd=tmp_path)
    assert tested.returncode == 0, tested.stdout
    assert "17 passed" in tested.stdout


def test_the_page_presses_a_unit_with_it(site, tmp_path):
    (code,) = [text for mark, _, text in BLOCKS if mark == "run"]
    (tmp_path / "press.py").write_text(code)
    process = run(site, "press.py", cwd=tmp_path)
    assert process.returncode == 0, process.stderr
    match = re.fullmatch(r"(\d{3}) samples in pF, (\d+) lost\n", process.stdout)
    assert match, process.stdout
    # A bench instrument has no clock of its own: a busy host asks a little late now and then, and says so.
    assert int(match[2]) <= 0.05 * int(match[1])


@pytest.fixture(scope="module")
def blocking(site):
    """The example that calls a blocking library."""
    shutil.copy(EXAMPLE / "blocking_meter.py", site)
    sys.path.insert(0, str(site))
    try:
        yield importlib.import_module("blocking_meter").DRIVER
    finally:
        sys.path.remove(str(site))
        for name in ("blocking_meter", "lab_meter"):
            sys.modules.pop(name, None)


@pytest.mark.parametrize("part", SHORT)
def test_the_driver_behind_a_thread_passes_the_kit(blocking, part):
    from softcal.station.testing import checks

    (check,) = [check for check in checks(blocking) if part in check.sentence]
    check()
