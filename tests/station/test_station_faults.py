"""Whatever breaks: one clear sentence, a standing stage, and nothing recorded as good."""

import math

import pytest

from softcal.station.simulated.faults import FAULTS
from softcal.station.simulated.trial import run_with_fault

STANDS_WITHIN_S = 0.5

SEEN_LATE = {"load cell zero jumps", "readout loses every tenth line"}
"""Only the whole run shows these: a jump of the zero looks like force, and single lost lines are no danger."""


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_fault_stops_the_stage_and_records_nothing(fault, tmp_path):
    outcome = run_with_fault(fault, tmp_path)
    assert outcome.error
    assert outcome.record == "none"
    assert outcome.spool.startswith("aborted: ")
    assert "\n" not in outcome.message
    assert ";" in outcome.message  # what happened; what became of the stage
    if fault.name not in SEEN_LATE:
        assert math.isnan(outcome.stopped_s) or outcome.stopped_s <= STANDS_WITHIN_S
    assert outcome.largest_force_N < 14.0


def test_there_are_as_many_faults_as_promised():
    assert len(FAULTS) >= 25
    assert len({fault.name for fault in FAULTS}) == len(FAULTS)
