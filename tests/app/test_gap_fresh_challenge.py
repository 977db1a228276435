"""The withheld check with a seed that nobody chose: new rigs at every run of the tests."""

import json
from pathlib import Path

import pytest

from softcal.app.cli.main import main


@pytest.mark.parametrize(("line", "cases"), [("usual", 4), ("none", 3)])
def test_new_rigs_are_diagnosed_blind(line: str, cases: int, tmp_path: Path) -> None:
    sealed, reports, seal = tmp_path / "sealed", tmp_path / "reports", tmp_path / "labels.json"
    reports.mkdir()
    assert (
        main(["gap", "challenge", "--cases", str(cases), "--line", line, "--out", str(sealed), "--seal", str(seal)])
        == 0
    )
    for case in sorted(sealed.glob("case-*")):
        assert main(["gap", "diagnose", str(case), "--json", str(reports / f"{case.name}.json")]) == 0
    command = ["gap", "score", str(sealed), "--reports", str(reports), "--seal", str(seal)]
    assert main([*command, "--json", str(tmp_path / "score.json")]) == 0
    judged = json.loads((tmp_path / "score.json").read_text())["cases"]
    astray = [c for c in judged if c["outcome"] not in ("right", "set", "below noise", "abstained")]
    # One in a hundred may go astray; two of four would be no accident.
    assert len(judged) == cases and len(astray) < 2, f"seed {json.loads(seal.read_text())['seed']}: {astray}"
