"""The simulator of docs/own-simulator.md, taken from the page as it is written, and diagnosed."""

import json
from pathlib import Path

import numpy as np
import pytest

from softcal.app.cli.main import main

PAGE = Path(__file__).parents[2] / "docs" / "own-simulator.md"


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize(("creep", "curvature", "expected"), [(0.012, 0.0, "creep"), (0.0, 0.004, "bottoming")])
def test_the_page_is_what_runs(
    creep: float, curvature: float, expected: str, count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocks = [block.split("```")[0] for block in PAGE.read_text().split("```python\n")[1:]]
    name = f"my_rig_{expected}_{count}"
    (tmp_path / f"{name}.py").write_text("\n".join(blocks[:count]))
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(3)
    for number, speed in ((1, 0.5), (2, 1.3)):
        t_s = np.arange(0.0, 20.0, 0.05)
        load_N = 12.0 * np.abs(np.sin(speed * t_s))
        height_mm = 22.0 - 0.13 * load_N - curvature * load_N**2 - creep * np.log1p(t_s) * load_N
        folder = tmp_path / "rig" / "runs" / str(number)
        folder.mkdir(parents=True)
        table = np.column_stack([t_s, load_N, height_mm + rng.normal(0.0, 0.01, len(t_s))])
        np.savetxt(folder / "recording.csv", table, delimiter=",", header="t_s,load_N,height_mm", comments="")
    command = ["gap", "diagnose", "rig", "--simulator", f"{name}:SIMULATOR", "--json", "r.json"]
    assert main(command) == 0
    report = json.loads((tmp_path / "r.json").read_text())
    assert (report["verdict"], report["causes"][0]["effect"]) == ("explained", expected)
    assert report["simulator"] == "rubber foot" and report["shrink"]["held_out"] > 0.9
    assert set(report["priors"]) == ({"softness"} if count == 2 else set())
