"""What a test run could not prove is counted at its end, and continuous integration proves it."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.system_packages import ARDUINO, NO_POSTGRESQL, PACKAGES

ROOT = Path(__file__).parents[2]
NEEDS_A_PROGRAM = "tests/core/test_export_files.py::test_a_foreign_tool_reads_the_hex_back"


@pytest.mark.parametrize(
    ("environment", "code"), [({}, 0), pytest.param({"CI": "true"}, 1, marks=pytest.mark.long)], ids=["desk", "CI"]
)
def test_a_missing_program_is_counted_in_one_line_and_a_failure_in_ci(
    environment: dict[str, str], code: int, tmp_path: Path
) -> None:
    bare = {name: value for name, value in os.environ.items() if name != "CI"} | {"PATH": str(tmp_path)} | environment
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", NEEDS_A_PROGRAM]
    process = subprocess.run(command, cwd=ROOT, env=bare, capture_output=True, text=True)
    assert process.returncode == code, process.stdout
    counted = [line for line in process.stdout.splitlines() if line.startswith("NOT PROVEN HERE")]
    if code == 0:
        (line,) = counted
        assert "skipped 1," in line and PACKAGES["objcopy"] in line


def test_ci_installs_all_that_a_test_may_miss() -> None:
    listed = re.search(r"^packages=\((.*)\)$", (ROOT / ".ci/run").read_text(), re.MULTILINE)
    assert listed is not None
    needed = {name for names in (*PACKAGES.values(), ARDUINO) for name in names.split()}
    assert needed | {NO_POSTGRESQL.split()[-1]} <= set(listed[1].split())
