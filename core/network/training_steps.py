"""Weights, optimiser, early stopping of a training. The only module of core that needs torch."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray

from softcal.core.network.config import EpochReport, NetworkConfig
from softcal.core.recording import Array, Mask

Layers = list[tuple[Array, Array]]
"""Weight (inputs, outputs) and bias (outputs,) of every layer."""


def train_members(
    inputs: NDArray[np.float32],
    labels: NDArray[np.float32],
    training: Mask,
    validation: Mask,
    config: NetworkConfig,
    reference_scale: float,
    on_epoch: Callable[[EpochReport], None] | None,
) -> list[tuple[Layers, int]]:
    """Train from consecutive seeds on standardised rows; return best state and epochs of each."""
    x, y = torch.from_numpy(inputs), torch.from_numpy(labels)
    # Layers this small run slower on several threads, and one thread keeps the sums in one order.
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        return [
            _Training(x, y, training, validation, config, member, reference_scale).run(on_epoch)
            for member in range(config.members)
        ]
    finally:
        torch.set_num_threads(threads)


class _Training:
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
        self._layers = []
        for inputs, outputs in pairwise(sizes):
            # He et al. 2015, eq. 10: keeps the variance through ReLU layers.
            weight = torch.randn(inputs, outputs, generator=self._random) * (2.0 / inputs) ** 0.5
            self._layers.append((weight.requires_grad_(), torch.zeros(outputs).requires_grad_()))
        parameters = [p for layer in self._layers for p in layer]
        self._optimiser = torch.optim.Adam(parameters, lr=config.learning_rate, fused=True)

    def run(self, on_epoch: Callable[[EpochReport], None] | None) -> tuple[Layers, int]:
        best, best_epoch, plateau, layers = float("inf"), 0, 0, self._state()
        epoch = 0
        for epoch in range(1, self._config.max_epochs + 1):
            train = self._epoch()
            with torch.no_grad():
                error = float(torch.nn.functional.mse_loss(self._forward(self._vx), self._vy) ** 0.5)
            if error < best:
                best, best_epoch, plateau, layers = error, epoch, 0, self._state()
            else:
                plateau += 1
                # Three smaller rates are tried before training stops.
                if plateau % max(1, self._config.patience // 3) == 0:
                    for group in self._optimiser.param_groups:
                        group["lr"] /= 2
            if on_epoch is not None:
                errors = (train * self._scale, error * self._scale, best * self._scale)
                on_epoch(EpochReport(self._member, epoch, self._config.max_epochs, *errors))
            if epoch - best_epoch >= self._config.patience:
                break
        return layers, epoch

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
            # The last batch is smaller; a plain mean over batches would weigh it too much.
            total += float(loss.detach()) * len(rows)
        return float((total / len(self._x)) ** 0.5)

    def _state(self) -> Layers:
        return [(w.detach().numpy().astype(np.float64), b.detach().numpy().astype(np.float64)) for w, b in self._layers]
