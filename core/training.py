"""Fit the shared network f to a labelled recording; the only module of core that needs torch."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from softcal.core.errors import InputError
from softcal.core.network import Network
from softcal.core.recording import Array, LabelledRecording
from softcal.core.windows import TAPS

Mask = NDArray[np.bool_]

MIN_WINDOWS = 10 * TAPS
"""Fewer windows leave nothing to validate on once the guards between the blocks are taken out."""


@dataclass(frozen=True)
class NetworkConfig:
    """How f is built and trained; the defaults are the paper's 15-120-70-35-1 (Kim et al. 2020).

    Args:
        hidden: widths of the hidden layers.
        seed: drives initial weights and batch order; equal seeds give equal networks on one machine.
        members: networks trained from consecutive seeds and merged into one whose estimate is their mean.
        max_epochs: passes over the training windows at most.
        patience: epochs without a better validation error before training stops.
        batch: windows per step at least; long recordings take larger ones.
        learning_rate: first step size of Adam; it is halved on every plateau of `patience / 3` epochs.
        validation_share: share of the recording kept for early stopping, in blocks spread over it.
    """

    hidden: tuple[int, ...] = (120, 70, 35)
    seed: int = 0
    members: int = 1
    max_epochs: int = 200
    patience: int = 15
    batch: int = 64
    learning_rate: float = 5e-3
    validation_share: float = 0.15


@dataclass(frozen=True)
class EpochReport:
    """Progress of a training; errors in the reference unit."""

    member: int
    epoch: int
    max_epochs: int
    train_rmse: float
    validation_rmse: float
    best_validation_rmse: float


@dataclass(frozen=True, eq=False)
class TrainedNetwork:
    """A network with what its training showed.

    Args:
        network: the shared network f.
        validation_rmse: error on the held-out blocks, in the reference unit.
        epochs: epochs trained, per member.
        validation_rows: window indices of the held-out blocks; they never entered a gradient.
    """

    network: Network
    validation_rmse: float
    epochs: tuple[int, ...]
    validation_rows: NDArray[np.int64]


def fit_network(
    source: LabelledRecording,
    config: NetworkConfig = NetworkConfig(),  # noqa: B008 - frozen
    on_epoch: Callable[[EpochReport], None] | None = None,
) -> TrainedNetwork:
    """Train f on a labelled recording with early stopping on time blocks; also gives a unit's own calibration.

    Args:
        source: output and reference of one unit.
        config: layer widths, seed and stopping rule.
        on_epoch: told the errors after every epoch.

    Raises:
        InputError: the recording is too short, constant or saturated, or output and reference have nothing in common.
    """
    check_trainable(source)
    inputs, reference = source.windows, source.window_reference
    output_mean, output_scale = float(source.unlabelled.output.mean()), float(source.unlabelled.output.std())
    reference_mean, reference_scale = float(reference.mean()), float(reference.std())
    validation = validation_blocks(len(inputs), config.validation_share)
    training = ~_near(validation, TAPS)
    x = torch.from_numpy(((inputs - output_mean) / output_scale).astype(np.float32))
    y = torch.from_numpy(((reference - reference_mean) / reference_scale).astype(np.float32))[:, None]
    with _single_thread():
        members = [
            _Training(x, y, training, validation, config, member, reference_scale).run(on_epoch)
            for member in range(config.members)
        ]
    weights, biases = merge_members([layers for layers, _ in members])
    unlabelled = source.unlabelled
    network = Network(
        weights,
        biases,
        output_mean,
        output_scale,
        reference_mean,
        reference_scale,
        unlabelled.output_unit,
        source.reference_unit,
    )
    error = network.evaluate(inputs[validation]) - reference[validation]
    rmse = float(np.sqrt(np.mean(error**2)))
    if rmse > 0.95 * float(reference[validation].std()) and rmse > 0.5 * reference_scale:
        raise InputError(
            f"source {source.serial}: f errs by {rmse:.4g} {source.reference_unit} on held-out parts, no better than "
            "the mean of the reference; check that output and reference belong together"
        )
    return TrainedNetwork(network, rmse, tuple(epochs for _, epochs in members), np.flatnonzero(validation))


def check_trainable(source: LabelledRecording) -> None:
    """Refuse a labelled recording that cannot teach a network.

    Raises:
        InputError: fewer than 150 windows, constant output or reference, or output saturated while the reference moves.
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
        if stuck.mean() > 0.02 and np.ptp(np.quantile(reference[stuck], [0.05, 0.95])) > 0.25 * np.ptp(reference):
            raise InputError(
                f"{where}: output stays at its {name} value {limit:.6g} {source.unlabelled.output_unit} in "
                f"{stuck.mean():.0%} of the samples while the reference moves; widen the range of the readout"
            )


def validation_blocks(count: int, share: float) -> Mask:
    """Mark the windows kept for validation: several blocks in time, spread evenly over the recording.

    Args:
        count: number of windows.
        share: share of them to keep.

    Returns:
        (count,) True where a window validates; a guard of TAPS windows beside each block belongs to neither side.
    """
    blocks = int(np.clip(count // (10 * TAPS), 2, 10))
    length = max(1, round(share * count / blocks))
    mask = np.zeros(count, dtype=bool)
    for middle in (np.arange(blocks) + 0.5) * count / blocks:
        start = int(middle) - length // 2
        mask[start : start + length] = True
    return mask


def merge_members(members: list[list[tuple[Array, Array]]]) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Merge networks of equal depth into one whose estimate is exactly their mean.

    The first layers stand side by side, hidden layers become block-diagonal, the last layers are stacked and divided
    by the number of members.

    Args:
        members: per member its layers (weight (inputs, outputs), bias (outputs,)).
    """
    if len(members) == 1:
        return tuple(w for w, _ in members[0]), tuple(b for _, b in members[0])
    weights, biases = [], []
    for depth, layers in enumerate(zip(*members, strict=True)):
        last = depth == len(members[0]) - 1
        parts = [w for w, _ in layers]
        joined = np.hstack(parts) if depth == 0 else np.vstack(parts) / len(parts) if last else _block_diagonal(parts)
        weights.append(joined)
        biases.append(np.mean([b for _, b in layers], axis=0) if last else np.concatenate([b for _, b in layers]))
    return tuple(weights), tuple(biases)


def _block_diagonal(parts: list[Array]) -> Array:
    joined = np.zeros((sum(p.shape[0] for p in parts), sum(p.shape[1] for p in parts)))
    row = column = 0
    for part in parts:
        joined[row : row + part.shape[0], column : column + part.shape[1]] = part
        row, column = row + part.shape[0], column + part.shape[1]
    return joined


def _near(mask: Mask, guard: int) -> Mask:
    return np.convolve(mask, np.ones(2 * guard + 1), mode="same") > 0.5


@contextmanager
def _single_thread() -> Iterator[None]:
    # Layers this small run slower on several threads, and one thread keeps the sums in one order.
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


class _Training:
    """One member's training: weights, optimiser and the best state so far."""

    def __init__(
        self,
        x: torch.Tensor,
        y: torch.Tensor,
        training: Mask,
        validation: Mask,
        config: NetworkConfig,
        member: int,
        reference_scale: float,
    ) -> None:
        self._config, self._member, self._scale = config, member, reference_scale
        self._x, self._y = x[torch.from_numpy(training)], y[torch.from_numpy(training)]
        self._vx, self._vy = x[torch.from_numpy(validation)], y[torch.from_numpy(validation)]
        # At most 100 steps an epoch keep a long recording affordable.
        self._batch = max(config.batch, len(self._x) // 100)
        self._random = torch.Generator().manual_seed(config.seed + member)
        sizes = [x.shape[1], *config.hidden, 1]
        self._layers = [self._layer(a, b) for a, b in zip(sizes[:-1], sizes[1:], strict=True)]
        parameters = [p for layer in self._layers for p in layer]
        self._optimiser = torch.optim.Adam(parameters, lr=config.learning_rate, fused=True)

    def _layer(self, inputs: int, outputs: int) -> tuple[torch.Tensor, torch.Tensor]:
        # He et al. 2015, eq. 10: keeps the variance through ReLU layers.
        weight = torch.randn(inputs, outputs, generator=self._random) * (2.0 / inputs) ** 0.5
        return weight.requires_grad_(), torch.zeros(outputs).requires_grad_()

    def run(self, on_epoch: Callable[[EpochReport], None] | None) -> tuple[list[tuple[Array, Array]], int]:
        best, best_epoch, plateau, kept = float("inf"), 0, 0, self._state()
        epoch = 0
        for epoch in range(1, self._config.max_epochs + 1):
            train = self._epoch()
            error = self._validation_rmse()
            if error < best:
                best, best_epoch, plateau, kept = error, epoch, 0, self._state()
            else:
                plateau += 1
                if plateau % max(1, self._config.patience // 3) == 0:
                    self._halve_rate()
            if on_epoch is not None:
                on_epoch(
                    EpochReport(
                        self._member,
                        epoch,
                        self._config.max_epochs,
                        train * self._scale,
                        error * self._scale,
                        best * self._scale,
                    )
                )
            if epoch - best_epoch >= self._config.patience:
                break
        return kept, epoch

    def _forward(self, x: torch.Tensor) -> torch.Tensor:
        for weight, bias in self._layers[:-1]:
            x = torch.relu(torch.addmm(bias, x, weight))
        weight, bias = self._layers[-1]
        return torch.addmm(bias, x, weight)

    def _epoch(self) -> float:
        total = 0.0
        order = torch.randperm(len(self._x), generator=self._random)
        for rows in torch.split(order, self._batch):
            self._optimiser.zero_grad()
            loss = torch.nn.functional.mse_loss(self._forward(self._x[rows]), self._y[rows])
            loss.backward()  # type: ignore[no-untyped-call]
            self._optimiser.step()
            total += float(loss.detach()) * len(rows)
        return float((total / len(self._x)) ** 0.5)

    def _validation_rmse(self) -> float:
        with torch.no_grad():
            return float(torch.nn.functional.mse_loss(self._forward(self._vx), self._vy) ** 0.5)

    def _halve_rate(self) -> None:
        for group in self._optimiser.param_groups:
            group["lr"] /= 2

    def _state(self) -> list[tuple[Array, Array]]:
        return [(w.detach().numpy().astype(np.float64), b.detach().numpy().astype(np.float64)) for w, b in self._layers]
