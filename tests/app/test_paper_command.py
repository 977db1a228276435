"""`softcal paper` computes what the paper published again, and says by its exit code whether it holds."""

import json

import pandas as pd
import pytest

from softcal.app.cli.main import main
from softcal.app.operation.paper import COURSE_PARTS, COURSES, PaperTables, compute_tables
from softcal.core.maps.plan import EXACT, JOINT
from softcal.core.network.config import NetworkConfig

SMALL = ("--hidden", "16,8")


@pytest.fixture(scope="module")
def pair(tmp_path_factory, trained_lot):
    root = tmp_path_factory.mktemp("pair")
    source, unit = (pd.read_csv(trained_lot / "lot" / name) for name in ("source/A0.csv", "audit/A1.csv"))
    source.to_csv(root / "S1.csv", index=False)
    unit.to_csv(root / "S2.csv", index=False)
    longer = pd.concat([source.assign(t_s=source["t_s"] + k * 30.0) for k in range(4)])
    longer.rename(columns={"output": "R", "reference": "strain"}).to_csv(root / "long.csv", index=False)
    return root


def test_tables_and_courses_by_the_papers_method_and_by_the_default(pair, capsys, tmp_path):
    report = tmp_path / "paper.json"
    stream = ("--stream", str(pair / "long.csv"), "--stream-output", "R", "--stream-reference", "strain")
    code = main(["paper", str(pair / "S1.csv"), str(pair / "S2.csv"), *stream, *SMALL, "--json", str(report)])
    content = json.loads(report.read_text())
    assert code == (0 if all(content["goals"].values()) else 1)
    assert {EXACT, JOINT, "auto", "own calibration", "ot.da.EMDTransport"} <= content["errors"].keys()
    assert content["errors"]["auto"] < content["errors"]["before (no map)"]
    # The same solver on the same windows; they differ by the rule for unseen ones.
    assert content["errors"][EXACT] == pytest.approx(content["errors"]["ot.da.EMDTransport"], rel=0.3)
    assert content["shares"][EXACT][-1] == pytest.approx(content["errors"][EXACT])
    assert {mode: len(parts) for mode, parts in content["courses"].items()} == dict.fromkeys(COURSES, COURSE_PARTS)
    printed = capsys.readouterr().out
    assert all(f"Table {k}" in printed for k in (1, 2, 3)) and "Figures 8 and 9" in printed


def test_a_row_that_does_not_hold_is_no_success():
    errors = {EXACT: 0.4, "ot.da.EMDTransport": 0.4}
    tables = PaperTables(errors, {EXACT: [0.4, 0.4]}, {"network": 34.0, "auto": 1.0}, {})
    assert all(tables.goals.values())
    for worse in (
        PaperTables({**errors, EXACT: 0.45}, tables.shares, tables.seconds, {}),
        PaperTables(errors, {EXACT: [0.45, 0.4]}, tables.seconds, {}),
        PaperTables(errors, tables.shares, {"network": 32.0, "auto": 1.0}, {}),
    ):
        assert sum(worse.goals.values()) == 2


def test_no_reference_of_the_target_reaches_a_map(pair):
    from dataclasses import replace

    from softcal.app.files.recording_file import inspect_recording

    source, target = (
        inspect_recording(pair / f"{name}.csv", name, 50.0, with_reference=True).labelled("N") for name in ("S1", "S2")
    )
    config = NetworkConfig(hidden=(8,), max_epochs=5)
    rows = round(2 / 3 * len(target))
    wrong = target.reference.copy()
    wrong[:rows] *= 1.5
    one, other = (compute_tables(source, unit, None, config) for unit in (target, replace(target, reference=wrong)))
    assert one.errors["own calibration"] != other.errors["own calibration"]
    for each in (one, other):
        del each.errors["own calibration"]
    assert one.errors == other.errors and one.shares[EXACT] == other.shares[EXACT]


@pytest.mark.parametrize("message", [("S1.csv",), ("S1.csv", "missing.csv"), ("S1.csv", "short.csv")])
def test_a_pair_that_cannot_be_used_is_one_line(pair, capsys, message):
    table = pd.read_csv(pair / "S2.csv")
    table.iloc[:60].to_csv(pair / "short.csv", index=False)
    assert main(["paper", *(str(pair / name) for name in message), *SMALL]) == 2
    assert "Traceback" not in (stderr := capsys.readouterr().err) and len(stderr.strip().splitlines()[-1]) > 20
