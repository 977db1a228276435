"""The result of calibrating one unit: what the registry keeps, what estimates and exports start from."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from softcal.core.identity import Settings

VERDICTS = ("pass", "conditional", "fail", "retest")


@dataclass(frozen=True, eq=False)
class CalibrationRecord:
    """One calibration of one unit as plain values: arrays, JSON settings and numbers. The registry stores it whole.

    Args:
        serial: the unit's serial.
        network_id: content hash of the shared network f it belongs to.
        family: family of the map γ (`maps.catalogue`).
        map_sha256: content hash of the map alone.
        arrays: parameters of the map (names `map.*`), of the interval and support model (names `interval.*`).
        settings: JSON values beside the arrays, grouped as {"map": {...}, "interval": {...}, "config": {...}}.
        predicted_rmse: forecast of the error against the reference, in the reference unit; None where none can be made.
        before_rmse, after_rmse, own_rmse: scores on an audit recording, in the reference unit; None without an audit.
        verdict: pass, conditional, fail or retest.
        reasons: why, in words, most important first.
        evidence: numbers the verdict rests on.
        input_sha256: content hash of everything that went in (recording, network, configuration): equal input, equal
            result, so that finished work is found again.
        recording_sha256: content hash of the unit's recording.
        fit_s: seconds the fit took.
    """

    serial: str
    network_id: str
    family: str
    map_sha256: str
    arrays: Mapping[str, NDArray[np.generic]]
    settings: Settings
    predicted_rmse: float | None
    verdict: str
    reasons: tuple[str, ...]
    input_sha256: str
    recording_sha256: str
    before_rmse: float | None = None
    after_rmse: float | None = None
    own_rmse: float | None = None
    fit_s: float | None = None
    evidence: Mapping[str, float | str | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.verdict not in VERDICTS:
            raise ValueError(f"verdict {self.verdict!r} is none of {', '.join(VERDICTS)}")
