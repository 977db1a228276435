"""The notebooks run as they are written, and show what they say."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2]
NOTEBOOKS = ROOT / "examples" / "notebooks"
RESULT_EXPRESSIONS = {
    "paper_tables": "table_1.after_own.max(), (table_1.before_N / table_1.after_N).min(), "
    "list(table_2.index), table_3.min()",
    "own_data": "unit.rmse(audit), unit.predicted_rmse, audited.verdict, inside",
    "new_map_family": "wrong, errors.groupby(['load', 'family']).after_N.mean().unstack().to_dict()",
    "gap": "report['verdict'], report['causes'][0]['effect'], report['shrink']['held_out']",
    "drift": "errors['none'].tolist(), errors['improved'].tolist(), last.alarm",
}
"""What a test wants to know of the names that a notebook leaves behind."""


@pytest.fixture
def left_by(tmp_path: Path) -> Callable[..., list]:  # type: ignore[type-arg]
    """`left_by(name)`: values that a notebook leaves behind, run by a Python of its own in an empty folder."""

    def run(name: str, site: Path | None = None) -> list:  # type: ignore[type-arg]
        code = f"import json, runpy; globals().update(runpy.run_path({str(NOTEBOOKS / name)!r} + '.py'))\n"
        code += f"print(json.dumps([{RESULT_EXPRESSIONS[name]}], default=float))"
        environment = {**os.environ, "PYTHONPATH": str(site or ""), "OMP_NUM_THREADS": "1"}
        process = subprocess.run(
            [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True
        )
        assert process.returncode == 0, process.stderr
        return list(json.loads(process.stdout.splitlines()[-1]))

    return run


def test_every_notebook_is_a_script_of_cells_that_a_page_names_and_a_test_runs():
    files = sorted(NOTEBOOKS.glob("*"))
    assert {path.stem for path in files} == set(RESULT_EXPRESSIONS)
    listed = re.findall(r"^\| `(\w+)\.py`", (ROOT / "docs/notebooks.md").read_text("utf-8"), re.MULTILINE)
    assert sorted(listed) == [path.stem for path in files]
    for path in files:
        text = path.read_text("utf-8")
        assert text.startswith("# %% [markdown]\n# # ") and text.count("\n# %%\n") >= 2, path.name


def test_the_papers_tables(left_by):
    after_own, gained, shares, min_s = left_by("paper_tables")
    assert after_own < 1.2 and gained > 3
    assert shares == ["100%", "50%", "25%", "10%"] and min_s > 0


def test_own_data(left_by, tmp_path):
    measured_N, predicted_N, verdict, inside = left_by("own_data")
    assert verdict == "pass" and 0.5 < predicted_N / measured_N < 2 and 0.85 < inside < 0.97
    assert (tmp_path / "estimates.csv").is_file()


def test_a_new_map_family(left_by, install_example):
    wrong, errors_N = left_by("new_map_family", install_example(ROOT / "examples" / "softcal-example-map"))
    assert wrong == []
    assert errors_N["moments"]["half range"] > 2 * errors_N["moments"]["none"]


def test_a_gap(left_by):
    assert left_by("gap")[:2] == ["explained", "channel_creep"]


def test_drift(left_by):
    untouched_N, followed_N, alarm = left_by("drift")
    assert untouched_N[-1] > 5 * untouched_N[0] and followed_N[-1] < 0.2 * untouched_N[-1]
    assert alarm == ""
