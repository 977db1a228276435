"""Whatever breaks: one clear sentence, a standing stage, and nothing recorded as good."""

import math
from dataclasses import replace
from functools import partial

import pytest

from softcal.app.texts.catalogue import text
from softcal.app.texts.reasons import said
from softcal.core.errors import BadReply
from softcal.station.acquisition import record
from softcal.station.bench import open_simulated_bench
from softcal.station.simulated.faults import FAULTS, PRESS
from softcal.station.simulated.trial import PROFILE, run_with_dead_host, run_with_fault, run_with_full_disk

STANDS_WITHIN_S = 0.5

SEEN_LATE = {
    "load cell zero moves while pressing",
    "readout loses every tenth line",
    "load cell's gain halves between two presses",
    "load cell's line 0.1 s late",
    "load cell's readings become 0.6 s old",
    "load cell stuck but noisy",
    "readout stuck but noisy",
    "motor without supply while pressing",
}
"""Only the whole run, or a millimetre of it, shows these: a zero that moves while the stage moves looks like force,
single lost lines are no danger, and a channel that lies smoothly is found by what it should have done meanwhile."""


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_fault_stops_the_stage_and_records_nothing(fault, tmp_path, english_in):
    outcome = run_with_fault(fault, tmp_path)
    assert outcome.error
    assert outcome.record == "none"
    assert outcome.spool.startswith("aborted: ")
    assert "\n" not in outcome.message
    assert ";" in outcome.message  # what happened; what became of the stage
    assert outcome.reason is not None and outcome.message == str(outcome.reason)
    assert english_in(said(outcome.reason, partial(text, "ko"))) == []
    if fault.name not in SEEN_LATE:
        assert math.isnan(outcome.stopped_s) or outcome.stopped_s <= STANDS_WITHIN_S
    assert outcome.largest_force_N < 14.0


def test_a_full_disk_in_mid_run_stops_the_stage_and_records_nothing(tmp_path):
    outcome = run_with_full_disk(tmp_path)
    assert "No space left" in outcome.message
    assert (outcome.record, outcome.spool) == ("none", "cut off")
    assert outcome.stopped_s <= STANDS_WITHIN_S


def test_a_host_that_dies_in_mid_run_leaves_a_standing_stage_and_no_recording(tmp_path):
    outcome = run_with_dead_host(tmp_path)
    assert (outcome.record, outcome.spool) == ("none", "cut off")
    assert 0.0 < outcome.stopped_s <= STANDS_WITHIN_S


def test_there_are_as_many_faults_as_promised():
    assert len(FAULTS) >= 50
    assert len({fault.name for fault in FAULTS}) == len(FAULTS)


def test_a_motor_without_supply_is_noticed_without_a_load_cell(tmp_path):
    with open_simulated_bench(seed=2) as (bench, station):
        config = replace(bench.config, force=None, safety=replace(bench.config.safety, without_cell=True))

        def cut(progress):
            if progress.phase == PRESS and progress.stage_mm > station.rig.clearance_mm + 1.0:
                station.rig.cut_motor()

        with pytest.raises(BadReply, match="sensor readout: .* while the stage moves"):
            record(replace(bench, force=None, config=config), "A1", PROFILE, False, cut)
