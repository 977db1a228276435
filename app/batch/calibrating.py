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
    start_s = time.perf_counter()
    try:
        calibration = calibrate(problem)
    except UnitRefused as error:
        return Refusal(Verdict.FAIL, error.reason)
    fit_s = time.perf_counter() - start_s
    return calibration.to_record(problem.input_sha256, problem.recording.sha256, fit_s)
