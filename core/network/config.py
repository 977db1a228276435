"""Configuration of f and its training, and the report of a training."""

from dataclasses import dataclass


@dataclass(frozen=True)
class NetworkConfig:
    """Architecture and training of f; the defaults are the paper's 15-120-70-35-1 (Kim et al. 2020).

    Args:
        hidden: widths of the hidden layers.
        seed: of initial weights and batch order; equal seeds give equal networks on one machine.
        members: networks from consecutive seeds, merged into one whose estimate is their mean.
        max_epochs: passes over the training windows at most.
        patience: epochs without a better validation error before training stops.
        batch: windows per step at least; long recordings take larger ones.
        learning_rate: first step of Adam, halved on every plateau of `patience / 3` epochs.
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
