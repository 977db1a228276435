"""A map family that matches mean and standard deviation, and an export format that an old controller reads."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softcal.app.export.calibrated_unit import CalibratedUnit
from softcal.core.errors import UnitRefused
from softcal.core.identity import Settings
from softcal.core.maps.affine_map import AffineMap
from softcal.core.maps.interface import FitProblem
from softcal.core.messages.reason import reason


@dataclass(frozen=True)
class Moments:
    """Match mean and standard deviation of the two outputs: right where both units spent their time alike."""

    name: str = "moments"

    def fit(self, problem: FitProblem) -> AffineMap:
        """Return gain = σ_source / σ_target and the offset that joins the means."""
        source, target = problem.source.unlabelled.output, problem.target.output
        if not np.ptp(target):
            raise UnitRefused(reason("still", level=float(target[0]), unit=problem.target.output_unit))
        gain = float(source.std() / target.std())
        return AffineMap(gain, float(source.mean() - gain * target.mean()), self.name)

    def from_arrays(self, arrays: Mapping[str, NDArray[np.generic]], settings: Settings) -> AffineMap:
        """Rebuild a map from its arrays."""
        return AffineMap(float(arrays["gain"]), float(arrays["offset"]), self.name)


MOMENTS = Moments()


def ini_files(unit: CalibratedUnit) -> dict[str, bytes]:
    """Return the file of one unit, by name; softcal asks only for units whose verdict releases files."""
    state = unit.stored.state
    lines = (
        "[unit]",
        f"serial = {unit.escaped_serial}",
        f"verdict = {state.verdict}",
        f"error_{unit.network.reference_unit} = {state.predicted_rmse:.6g}",
    )
    return {f"unit-{unit.escaped_serial}.ini": ("\r\n".join(lines) + "\r\n").encode("ascii")}
