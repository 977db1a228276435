"""The method that is passed in decides whether a run is a recording: its numbers, and no others."""

import ast
from dataclasses import replace
from pathlib import Path

import pytest
from common.proof_trial import draw_good_rig, press_good_rig

from softcal.core.errors import BadReply
from softcal.core.settings import rebuild_config
from softcal.station.record.method import METHOD
from softcal.station.record.recording import assemble, restore
from softcal.station.record.spool import read_spool

RECORD = Path(__file__).parents[2] / "station" / "record"

STRICT = {
    "rig.behind": {"lag": {"late_s": -1.0}},
    "rig.gain": {"press": {"gain": 0.5}},
    "rig.odd_force": {"hang": {"share": 0.0, "least": 0.0}},
    "rig.follows": {"output": {"follows": 1.1}},
    "rig.low_pass": {"response": {"share": -1.0}},
    "rig.distorted": {"response": {"max_unexplained": -1.0}},
    "rig.dropout": {"dropout": {"range_share": 0.0, "noises": 0.0, "counts": 0.0, "edge_steps": 1.0}},
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    path = tmp_path_factory.mktemp("proof") / "run.spool"
    press_good_rig(draw_good_rig(12), path)
    run = read_spool(path)
    return replace(run, metadata=run.metadata | {"is_latency_declared": True})


@pytest.mark.parametrize("code", STRICT)
def test_a_number_that_changes_changes_what_is_refused_and_the_identity(run, code):
    method = rebuild_config(METHOD, STRICT[code])
    assert method.id != METHOD.id
    restore(run)
    with pytest.raises(BadReply) as bad:
        restore(run, method)
    assert bad.value.reason.code == code
    assert assemble.__defaults__ == (METHOD,)


def test_no_module_of_the_proof_reads_a_number_when_it_is_imported():
    for path in RECORD.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            is_read = isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
            assert not (is_read and node.value.id == "METHOD"), f"{path.name}:{node.lineno}"  # type: ignore[attr-defined]
