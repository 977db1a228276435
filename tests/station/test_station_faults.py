"""Whatever breaks: one clear sentence, a standing stage, and nothing recorded as good."""

import math
from functools import partial

import pytest
from common.fault_trial import DISK_MOMENTS, run_with_dead_host, run_with_fault, run_with_full_disk

from softcal.app.texts.catalogue import text
from softcal.app.texts.reasons import render_reason
from softcal.core.errors import InputError
from softcal.core.twin.simulate import Twin
from softcal.station.tasks.durations import HOMING
from softcal.station.testing.faults import FAULTS
from softcal.station.testing.line import SimulatedLine

MAX_STOP_S = 0.5
QUICK, ALL = FAULTS[::8], [fault for k, fault in enumerate(FAULTS) if k % 8]


def check(fault, folder, english_in):
    outcome = run_with_fault(fault, folder)
    assert outcome.error not in ("", "hang")
    assert outcome.record == "none"
    assert outcome.spool.startswith("aborted: ")
    assert outcome.is_true, outcome.message
    assert "\n" not in outcome.message
    assert ";" in outcome.message  # what happened; what became of the stage
    assert outcome.reason is not None and outcome.message == str(outcome.reason)
    assert english_in(render_reason(outcome.reason, partial(text, "ko"))) == []
    # A controller homes by itself: whoever loses it in there can only wait for its end.
    if not fault.is_detected_late and fault.phase != HOMING:
        assert math.isnan(outcome.stopped_s) or outcome.stopped_s <= MAX_STOP_S
    assert outcome.largest_force_N < 14.0


@pytest.mark.parametrize("fault", QUICK, ids=lambda fault: fault.name)
def test_fault_stops_the_stage_and_records_nothing(fault, tmp_path, english_in):
    check(fault, tmp_path, english_in)


@pytest.mark.long
@pytest.mark.parametrize("fault", ALL, ids=lambda fault: fault.name)
def test_every_other_fault_does_so_too(fault, tmp_path, english_in):
    check(fault, tmp_path, english_in)


@pytest.mark.parametrize(
    "moment", [DISK_MOMENTS[0], *(pytest.param(m, marks=pytest.mark.long) for m in DISK_MOMENTS[1:])]
)
def test_a_disk_that_fills_up_stops_the_stage_and_records_nothing(moment, tmp_path):
    outcome = run_with_full_disk(tmp_path, moment)
    assert "No space left" in outcome.message
    assert (outcome.record, outcome.spool) == ("none", "cut off")
    assert math.isnan(outcome.stopped_s) or outcome.stopped_s <= MAX_STOP_S


def test_a_host_that_dies_in_mid_run_leaves_a_standing_stage_and_no_recording(tmp_path):
    outcome = run_with_dead_host(tmp_path)
    assert (outcome.record, outcome.spool) == ("none", "cut off")
    assert 0.0 < outcome.stopped_s <= MAX_STOP_S


def test_there_are_as_many_faults_as_promised():
    assert len(FAULTS) >= 80
    assert len({fault.name for fault in FAULTS}) == len(FAULTS)


def test_the_simulated_line_takes_no_fault_of_a_device_that_it_has_not():
    line = SimulatedLine(lambda serial: Twin(), seed=1)
    with pytest.raises(InputError, match="Zaber"):
        line.inject("Zaber stage stalls while pressing")
    assert str(line.inject("drive switched off while pressing"))
