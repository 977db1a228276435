"""Fit the shared network f to a labelled recording."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from softcal.core.errors import InputError
from softcal.core.network.config import EpochReport, NetworkConfig
from softcal.core.network.network import Network
from softcal.core.recording import Array, Indices, LabelledRecording, Mask
from softcal.core.windows import TAPS

MIN_WINDOWS = 10 * TAPS
"""Fewer windows leave nothing to validate on once the guards between the blocks are taken out."""


@dataclass(frozen=True, eq=False)
class TrainedNetwork:
    """A network with what its training showed.

    Args:
        validation_rmse: error on the held-out blocks, in the reference unit.
        epochs: epochs trained, per member.
        validation_rows: window indices of the held-out blocks; they never entered a gradient.
    """

    network: Network
    validation_rmse: float
    epochs: tuple[int, ...]
    validation_rows: Indices


def fit_network(
    source: LabelledRecording,
    config: NetworkConfig = NetworkConfig(),  # noqa: B008 - frozen
    on_epoch: Callable[[EpochReport], None] | None = None,
) -> TrainedNetwork:
    """Train f on a labelled recording, with early stopping on time blocks.

    Raises:
        InputError: too short, constant or saturated, or output and reference share nothing.
    """
    check_trainable(source)
    inputs, reference = source.windows, source.window_reference
    # One mean and one scale for all taps: scaled each by itself they would bend a window.
    output_mean, output_scale = float(source.unlabelled.output.mean()), float(source.unlabelled.output.std())
    reference_mean, reference_scale = float(reference.mean()), float(reference.std())
    validation = validation_blocks(len(inputs), config.validation_share)
    # Windows that share samples with a validating one would let it be learnt by heart.
    training = np.convolve(validation, np.ones(2 * TAPS + 1), mode="same") < 0.5
    x = ((inputs - output_mean) / output_scale).astype(np.float32)
    y = ((reference - reference_mean) / reference_scale).astype(np.float32)[:, None]
    # torch takes seconds and 100 MB to load: only who trains pays.
    from softcal.core.network.training_steps import train_members  # noqa: PLC0415

    members = train_members(x, y, training, validation, config, reference_scale, on_epoch)
    weights, biases = merge_members([layers for layers, _ in members])
    unlabelled = source.unlabelled
    scales = (output_mean, output_scale, reference_mean, reference_scale)
    network = Network(weights, biases, *scales, unlabelled.output_unit, source.reference_unit)
    rmse = float(np.sqrt(np.mean((network.evaluate(inputs[validation]) - reference[validation]) ** 2)))
    # Both scales: where the load of the held-out blocks hardly moves, the mean is a good estimate.
    if rmse > 0.95 * float(reference[validation].std()) and rmse > 0.5 * reference_scale:
        raise InputError(
            f"source {source.serial}: f errs by {rmse:.4g} {source.reference_unit} on held-out parts, no better than "
            "the mean of the reference; check that output and reference belong together"
        )
    return TrainedNetwork(network, rmse, tuple(epochs for _, epochs in members), np.flatnonzero(validation))


def check_trainable(source: LabelledRecording) -> None:
    """Refuse a labelled recording that cannot teach a network.

    Raises:
        InputError: fewer than 150 windows, a constant column, or output saturated under load.
    """
    output, reference = source.unlabelled.output, source.reference
    where = f"source {source.serial}"
    count = len(source.windows)
    if count < MIN_WINDOWS:
        raise InputError(f"{where}: {count} full windows; at least {MIN_WINDOWS} are needed to train and validate f")
    for name, values, unit in (
        ("output", output, source.unlabelled.output_unit),
        ("reference", reference, source.reference_unit),
    ):
        if np.ptp(values) == 0:
            raise InputError(f"{where}: {name} is constant at {values[0]:.6g} {unit}; record the source again")
    for name, limit in (("highest", output.max()), ("lowest", output.min())):
        stuck = output == limit
        # A sensor at rest is flat as well; clipped is what stays flat while the load goes on.
        if stuck.mean() > 0.02 and np.ptp(np.quantile(reference[stuck], [0.05, 0.95])) > 0.25 * np.ptp(reference):
            raise InputError(
                f"{where}: output stays at its {name} value {limit:.6g} {source.unlabelled.output_unit} in "
                f"{stuck.mean():.0%} of the samples while the reference moves; widen the range of the readout"
            )


def validation_blocks(count: int, share: float) -> Mask:
    """Return the mask of held-out windows: blocks in time, spread evenly over the recording.

    Returns:
        (count,) True where a window validates; TAPS windows beside each block guard it.
    """
    # Blocks in time, never single windows: neighbours share fourteen of fifteen samples.
    blocks = int(np.clip(count // (10 * TAPS), 2, 10))
    length = max(1, round(share * count / blocks))
    mask = np.zeros(count, dtype=bool)
    for middle in (np.arange(blocks) + 0.5) * count / blocks:
        start = int(middle) - length // 2
        mask[start : start + length] = True
    return mask


def merge_members(members: list[list[tuple[Array, Array]]]) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Merge networks of layers, weight (inputs, outputs) and bias, into one that returns their mean.

    The first layers are stacked, hidden layers become block-diagonal, the last layers are
    stacked and divided by the number of members.
    """
    # Imported here: whoever reads a calibration must not wait for scipy.
    if len(members) == 1:
        return tuple(w for w, _ in members[0]), tuple(b for _, b in members[0])
    weights, biases = [], []
    for depth, layers in enumerate(zip(*members, strict=True)):
        last = depth == len(members[0]) - 1
        parts = [w for w, _ in layers]
        if depth == 0:
            merged = np.hstack(parts)
        else:
            merged = np.vstack(parts) / len(parts) if last else scipy.linalg.block_diag(*parts)
        weights.append(merged)
        biases.append(np.mean([b for _, b in layers], axis=0) if last else np.concatenate([b for _, b in layers]))
    return tuple(weights), tuple(biases)
