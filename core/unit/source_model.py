"""Everything about the source unit that the calibration of its lot needs, computed once."""

from dataclasses import dataclass, field

import numpy as np

from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.network.training import validation_blocks
from softcal.core.recording import Array, Indices, LabelledRecording
from softcal.core.unit.method import Method
from softcal.core.unit.stage_check import StageDifference, source_difference
from softcal.core.unit.support import WindowShape
from softcal.core.unit.uncertainty import Interval, SourceResiduals, source_residuals


@dataclass(frozen=True, eq=False)
class SourceModel:
    """The source of a lot as its units are compared with it.

    Args:
        network: the shared network f trained on it.
        residuals: what f leaves open on the source.
        shape: of the source's windows.
        estimate: (n,) f on the source's windows.
        stage_floor: its own difference at equal stage histories, None where the stage position is unknown.
        method: the method all of this was computed with; the units of the lot are calibrated with it.
    """

    source: LabelledRecording
    network: Network
    residuals: SourceResiduals
    shape: WindowShape
    estimate: Array
    stage_floor: StageDifference | None
    method: Method = field(default_factory=Method)

    @property
    def interval(self) -> Interval:
        """The interval that would hold for the source itself."""
        return self.residuals.interval

    @property
    def held_out_rmse(self) -> float:
        """Error of f on the source's windows that never entered a gradient, in the reference unit."""
        return self.residuals.held_out_rmse


def make_source_model(
    source: LabelledRecording,
    network: Network,
    held_out: Indices | None = None,
    method: Method = Method(),  # noqa: B008 - frozen
) -> SourceModel:
    """Compare the source with itself once for the whole lot.

    Args:
        network: the shared network f trained on it.
        held_out: indices of the windows kept out of the training (`TrainedNetwork.validation_rows`); by default those
            that the default training keeps out of this recording.
    """
    windows = source.windows
    # A network that was stored has no list of them; the default split of the same recording is the same again.
    if held_out is None:
        held_out = np.flatnonzero(validation_blocks(len(windows), NetworkConfig().validation_share))
    residuals = source_residuals(network, windows, source.window_reference, held_out, method.source)
    shape = residuals.interval.support.shape(windows)
    estimate = network.evaluate(windows)
    floor = source_difference(source, estimate, method)
    return SourceModel(source, network, residuals, shape, estimate, floor, method)
