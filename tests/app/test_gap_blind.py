"""The withheld check of the gap diagnosis on rigs of one fixed seed; `benchmarks/gap_rigs.py blind` draws others."""

import subprocess
import sys
from pathlib import Path

import pytest

RIGS = Path(__file__).parents[2] / "benchmarks/gap_rigs.py"


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_withheld_rigs_of_every_line_are_right_above_the_floors() -> None:
    process = subprocess.run([sys.executable, RIGS, "blind", "--seed", "20201900178"], capture_output=True, text=True)
    assert process.returncode == 0, process.stdout + process.stderr
