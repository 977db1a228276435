"""The withheld check of the gap diagnosis on rigs of one fixed seed; `benchmarks/gap_blind.py` draws fresh ones."""

import subprocess
import sys
from pathlib import Path

import pytest

BLIND = Path(__file__).parents[2] / "benchmarks/gap_blind.py"


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_withheld_rigs_of_every_line_are_right_above_the_floors() -> None:
    found = subprocess.run([sys.executable, BLIND, "--seed", "20201900178"], capture_output=True, text=True)
    assert found.returncode == 0, found.stdout + found.stderr
