"""Calibrate one unit and keep the result: what the line, a batch, its workers and a watched folder share."""

import time
from dataclasses import dataclass

from softcal.core.errors import UnitRefused
from softcal.core.unit.calibrate import UnitProblem, calibrate
from softcal.core.unit.calibration import CalibrationRecord
from softcal.core.unit.verdict import Verdict
from softcal.core.words.reason import Reason


@dataclass(frozen=True)
class Refusal:
    """A unit that got no map, and why."""

    verdict: Verdict
    reason: Reason


def calibrated(problem: UnitProblem) -> CalibrationRecord | Refusal:
    """Calibrate a unit; one that allows no map gets its reason.

    Raises:
        InputError: the lot's limit is stated in another unit than the reference.
    """
    start_s, mapped_s = time.perf_counter(), list[float]()
    try:
        calibration = calibrate(problem, lambda: mapped_s.append(time.perf_counter()))
    except UnitRefused as error:
        return Refusal(Verdict.FAIL, error.reason)
    # What an audited unit's own network takes to train is no part of what its map took.
    return calibration.to_record(problem.input_sha256, problem.recording.sha256, mapped_s[0] - start_s)
