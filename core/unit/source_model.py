"""Everything about the source unit that the calibration of its lot needs, computed once."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from softcal.core.errors import UnitRefused
from softcal.core.maps.paired import paired_by_stage, stage_histories
from softcal.core.metrics import rms
from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.network.training import validation_blocks
from softcal.core.recording import Array, Indices, LabelledRecording, OutputRecording
from softcal.core.unit.method import CONFIDENCE, LEVELS, Method, SourceConfig
from softcal.core.unit.uncertainty import DIRECTIONS, Interval, Support, WindowShape


@dataclass(frozen=True)
class StageDifference:
    """RMS of estimates less the source's reference at equal stage histories, and of its means over a second or so
    (`SynchronyConfig.settled_s`), in the reference unit.
    """

    rms: float
    slow_rms: float

    def beyond(self, scatter: "StageDifference") -> "StageDifference":
        """Return what exceeds a floor, in quadrature."""
        return StageDifference(
            float(np.sqrt(max(self.rms**2 - scatter.rms**2, 0.0))),
            float(np.sqrt(max(self.slow_rms**2 - scatter.slow_rms**2, 0.0))),
        )


@dataclass(frozen=True, eq=False)
class SourceModel:
    """The source of a lot as its units are compared with it.

    Args:
        interval: 90 % interval that would hold for the source itself.
        rmse_table: (3, LEVELS) RMS error of f on the source, in the cells of the interval.
        held_out_rmse: error of f on the source's windows that never entered a gradient, in the reference unit.
        stage_scatter: its own difference at equal stage histories, None where the stage position is unknown.
        method: the method all of this was computed with; the units of the lot are calibrated with it.
    """

    source: LabelledRecording
    network: Network
    interval: Interval
    rmse_table: Array
    held_out_rmse: float
    shape: WindowShape
    estimate: Array
    stage_scatter: StageDifference | None
    method: Method = field(default_factory=Method)

    @property
    def full_range(self) -> float:
        """Range of the source's reference, in its unit."""
        return self.interval.high - self.interval.low


def make_source_model(
    source: LabelledRecording,
    network: Network,
    held_out: Indices | None = None,
    *,
    method: Method,
) -> SourceModel:
    """Compare the source with itself once for the whole lot.

    `held_out` are indices of the windows kept out of the training (`TrainedNetwork.validation_rows`); by default those
    that the default training keeps out of this recording.
    """
    windows = source.windows
    # A network that was stored has no list of them; the default split of the same recording is the same again.
    if held_out is None:
        held_out = np.flatnonzero(validation_blocks(len(windows), NetworkConfig().validation_share))
    residuals = source_residuals(network, windows, source.window_reference, held_out, method.source)
    shape = residuals[0].support.shape(windows)
    estimate = network.evaluate(windows)
    return SourceModel(
        source, network, *residuals, shape, estimate, source_difference(source, estimate, method), method
    )


def source_residuals(
    network: Network, windows: Array, reference: Array, held_out: Indices, config: SourceConfig
) -> tuple[Interval, Array, float]:
    """Tabulate what f leaves open on the (n, TAPS) windows of its source, beside its (n,) reference.

    All windows give the pattern over bands and directions, those that were held out of the training alone its size.

    Returns:
        The normalised split-conformal 90 % interval (Lei et al. 2018, section 5.2), the (3, LEVELS) RMS error in its
        cells, and the RMS error on the held-out windows.
    """
    estimate = network.evaluate(windows)
    # The pattern needs many rows, its size honest ones: trained rows give the first, held-out rows the second.
    residual = estimate - reference
    support = fit_support(windows, network.output_mean, network.output_scale, config)
    shape = support.shape(windows)
    blank = Interval(
        support,
        np.zeros((len(DIRECTIONS), LEVELS)),
        float(reference.min()),
        float(reference.max()),
        # On a sensor that falls under load a falling output is loading.
        slope_limit=(1.0 if np.corrcoef(shape.level, reference)[0, 1] >= 0 else -1.0)
        * max(config.slope_share * float(np.quantile(np.abs(shape.slope), config.slope_quantile)), 1e-9),
        sensitivity=_sensitivity(network, windows),
        familiar_distance=float(support.step.max()),
    )
    cells = blank.direction(shape), blank.column(estimate)
    rmse_table = np.sqrt(_tabulate(residual**2, *cells, np.mean, config))
    spread = _tabulate(np.abs(residual), *cells, lambda values: float(np.quantile(values, CONFIDENCE)), config)
    held_out_direction, held_out_column = cells[0][held_out], cells[1][held_out]
    # Divided by the local spread, so that one quantile serves quiet and noisy bands alike.
    scores = np.abs(residual[held_out]) / spread[held_out_direction, held_out_column]
    held_out_rmse = rms(residual[held_out])
    expected_rmse = rms(rmse_table[held_out_direction, held_out_column])
    interval = replace(blank, half_width=spread * conformal_quantile(scores))
    return interval, rmse_table * held_out_rmse / expected_rmse, held_out_rmse


def fit_support(windows: Array, output_mean: float, output_scale: float, config: SourceConfig) -> Support:
    """Return where (n, TAPS) windows of the source lie, standardised as the network does."""
    blank = Support(output_mean, output_scale, np.zeros(2), np.ones(2), np.zeros((1, 1)), np.inf, np.inf)
    shape = blank.shape(windows)
    position = np.stack([shape.level, shape.slope], axis=1)
    low, span = position.min(axis=0), np.maximum(np.ptp(position, axis=0), 1e-6)
    # The grid reaches half of the source's span beyond it on every side.
    origin, cells = low - 0.5 * span, np.array(config.cells)
    step = 2 * span / cells
    index = ((position - origin) / step).astype(np.int64)
    empty = np.ones(cells, dtype=bool)
    empty[index[:, 0], index[:, 1]] = False
    # scipy.ndimage takes a second to load: a registry that lists calibrations needs none of it.
    slack = config.slack_cells * float(step.max())
    # Cells beside visited ones are familiar too: samples never fill every cell.
    distance = np.maximum(scipy.ndimage.distance_transform_edt(empty, sampling=step) - slack, 0)
    # A factor on a quantile: the maximum of a recording is set by its worst sample.
    curvature_limit = config.tail_factor * float(np.quantile(np.abs(shape.curvature), 0.999))
    roughness_limit = config.tail_factor * float(np.quantile(shape.roughness, 0.999))
    return Support(output_mean, output_scale, origin, step, distance, curvature_limit, roughness_limit)


def conformal_quantile(scores: Array) -> float:
    """Return the ceil((n + 1) 0.9)-th smallest of n scores (Lei et al. 2018, algorithm 2); the largest where n < 9."""
    rank = min(int(np.ceil((len(scores) + 1) * CONFIDENCE)), len(scores))
    return float(np.sort(scores)[rank - 1])


def _sensitivity(network: Network, windows: Array) -> float:
    # A finite step: the slope of a ReLU network at a point says nothing of its neighbourhood.
    share = 0.05
    step = share * network.output_scale
    rise = network.evaluate(windows + step) - network.evaluate(windows - step)
    return rms(rise / (2 * share))


def _tabulate(
    values: Array, direction: Indices, column: Indices, statistic: Callable[[Array], float], config: SourceConfig
) -> Array:
    """Return the statistic per direction and band on the (3, LEVELS) grid, sparse cells drawn to their neighbours."""
    bands, prior = config.bands, config.cell_prior
    band = column * bands // LEVELS
    overall = float(statistic(values))
    table = np.empty((len(DIRECTIONS), bands))
    for b in range(bands):
        in_band = band == b
        # From the whole to the band to the cell: a cell with few rows says what its neighbours say.
        level = _shrunk(values[in_band], overall, statistic, prior)
        for d in range(len(DIRECTIONS)):
            table[d, b] = _shrunk(values[in_band & (direction == d)], level, statistic, prior)
    centres = (np.arange(bands) + 0.5) * LEVELS / bands
    # Residuals are divided by the table: no cell of it is 0.
    table = np.maximum(table, 1e-3 * overall + 1e-12)
    return np.stack([np.interp(np.arange(LEVELS) + 0.5, centres, row) for row in table])


def _shrunk(values: Array, expected: float, statistic: Callable[[Array], float], prior: float) -> float:
    if not len(values):
        return expected
    return float((len(values) * statistic(values) + prior * expected) / (len(values) + prior))


def unit_difference(
    source: LabelledRecording, target: OutputRecording, estimate: Array, method: Method
) -> StageDifference | None:
    """Compare (m,) estimates of a unit with its source's loads at equal stage histories; None where none are known."""
    try:
        source_rows, target_rows = paired_by_stage(source.unlabelled, target, method.map)
    except UnitRefused:
        return None
    difference = estimate[target_rows] - source.window_reference[source_rows]
    return _summed_up(difference, target.t_s[target.window_rows[target_rows]], method.map.synchrony.settled_s)


def source_difference(source: LabelledRecording, estimate: Array, method: Method) -> StageDifference | None:
    """Compare (n,) estimates of the source with itself at other times: what is left is no fault of a unit."""
    recording, slow_s = source.unlabelled, method.map.synchrony.settled_s
    if recording.stage_mm is None or np.ptp(recording.stage_mm) == 0:
        return None
    # Most lots have no stage: they need not load it.
    histories = stage_histories(recording, recording.stage_mm, method.map.stage_matched)
    t_s = recording.t_s[recording.window_rows]
    near = method.map.stage_matched.near_share * float(np.ptp(recording.stage_mm))
    differences, times = [], []
    for block in np.array_split(np.arange(len(t_s)), method.map.ends.stretches):
        # A window must not be compared with itself or its neighbours: they agree whatever the source repeats.
        first_s, last_s = t_s[block[0]] - 2 * slow_s, t_s[block[-1]] + 2 * slow_s
        others = np.flatnonzero((t_s < first_s) | (t_s > last_s))
        if not len(others):
            continue
        distance, nearest = scipy.spatial.cKDTree(histories[others]).query(histories[block])
        alike = distance <= near
        differences.append((estimate[block] - source.window_reference[others[nearest]])[alike])
        times.append(t_s[block][alike])
    if not sum(map(len, differences)):
        return None
    return _summed_up(np.concatenate(differences), np.concatenate(times), slow_s)


def _summed_up(difference: Array, t_s: Array, slow_s: float) -> StageDifference:
    # Means over a second leave level and gain and take the noise off: both are wanted apart.
    _, second = np.unique((t_s // slow_s).astype(np.int64), return_inverse=True)
    counts = np.bincount(second)
    means = np.bincount(second, difference) / counts
    return StageDifference(rms(difference), float(np.sqrt(np.average(means**2, weights=counts))))
