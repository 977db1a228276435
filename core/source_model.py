"""Everything about the source unit that the calibration of its lot needs, computed once."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from softcal.core.network import Network
from softcal.core.recording import Array, Indices, LabelledRecording
from softcal.core.support import WindowShape
from softcal.core.uncertainty import Interval, SourceResiduals, source_residuals

STAGE_BINS = 60


@dataclass(frozen=True, eq=False)
class StageCurve:
    """The source's reference over the stage position, apart for loading, hold and unloading.

    Pads from one mould give about the same load at the same travel, so that a unit pressed on the same stage must show
    about this curve, whatever its channel does.

    Args:
        stage_mm: (k,) middles of the bins.
        reference: (3, k) mean reference, rows as `uncertainty.DIRECTIONS`.
        scatter_rms: RMS difference of f on the source's windows from the curve.
    """

    stage_mm: Array
    reference: Array
    scatter_rms: float

    def at(self, stage_mm: Array, direction: Indices) -> Array:
        """Return the reference the source showed at these positions, (n,); flat beyond its travel."""
        rows = np.stack([np.interp(stage_mm, self.stage_mm, row) for row in self.reference])
        return np.asarray(rows[direction, np.arange(len(stage_mm))])


@dataclass(frozen=True, eq=False)
class SourceModel:
    """The source of a lot as its units are compared with it.

    Args:
        source: labelled recording of the source unit.
        network: the shared network f trained on it.
        residuals: what f leaves open on the source.
        shape: of the source's windows.
        estimate: (n,) f on the source's windows.
        stage_curve: where the station knows the stage position, else None.
    """

    source: LabelledRecording
    network: Network
    residuals: SourceResiduals
    shape: WindowShape
    estimate: Array
    stage_curve: StageCurve | None

    @property
    def interval(self) -> Interval:
        """The interval that would hold for the source itself."""
        return self.residuals.interval

    @property
    def held_out_rmse(self) -> float:
        """Error of f on the source's windows that never entered a gradient, in the reference unit."""
        return self.residuals.held_out_rmse


def make_source_model(source: LabelledRecording, network: Network, held_out: Indices | None = None) -> SourceModel:
    """Compare the source with itself once for the whole lot.

    Args:
        source: labelled recording of the source unit.
        network: the shared network f trained on it.
        held_out: indices of the windows kept out of the training (`TrainedNetwork.validation_rows`); by default those
            that the default training keeps out of this recording.
    """
    windows = source.windows
    if held_out is None:
        from softcal.core.training import NetworkConfig, validation_blocks  # torch, only where it is needed

        held_out = np.flatnonzero(validation_blocks(len(windows), NetworkConfig().validation_share))
    residuals = source_residuals(network, windows, source.window_reference, held_out)
    shape = residuals.interval.support.shape(windows)
    estimate = network.evaluate(windows)
    direction = residuals.interval.direction(shape)
    return SourceModel(source, network, residuals, shape, estimate, _stage_curve(source, estimate, direction))


def _stage_curve(source: LabelledRecording, estimate: Array, direction: Indices) -> StageCurve | None:
    if source.unlabelled.stage_mm is None or np.ptp(source.unlabelled.stage_mm) == 0:
        return None
    stage_mm = source.unlabelled.stage_mm[source.unlabelled.window_rows]
    edges = np.linspace(stage_mm.min(), stage_mm.max(), STAGE_BINS + 1)
    index = np.clip(np.digitize(stage_mm, edges) - 1, 0, STAGE_BINS - 1)
    middles = (edges[:-1] + edges[1:]) / 2
    rows = [_binned_mean(source.window_reference, index, direction == d, middles) for d in range(3)]
    curve = StageCurve(middles, np.stack(rows), 0.0)
    scatter = estimate - curve.at(stage_mm, direction)
    return replace(curve, scatter_rms=float(np.sqrt(np.mean(scatter**2))))


def _binned_mean(values: Array, index: Indices, rows: NDArray[np.bool_], middles: Array) -> Array:
    """Return the mean per bin over some rows; empty bins are interpolated, over all rows where there are too few."""
    if np.count_nonzero(rows) < STAGE_BINS:
        rows = np.ones_like(rows)
    counts = np.bincount(index[rows], minlength=STAGE_BINS)
    sums = np.bincount(index[rows], weights=values[rows], minlength=STAGE_BINS)
    seen = counts > 0
    return np.asarray(np.interp(middles, middles[seen], sums[seen] / counts[seen]))
