"""Would f be better, trained with a random level and gain common to a window? Nylon runs, streamed and followed or not.

Errors over those of the same seed trained without, per quarter of the run after the labelled one.

python benchmarks/adapt_nylon_shift.py [--seeds N]
"""

import argparse
from collections.abc import Iterator
from unittest.mock import patch

import pandas as pd
import torch
from adapt_common import DATA, Unit, calibrate, follow, part_rmse, print_markdown
from adapt_nylon import RATE_HZ, own_error

from softcal.core.network import training_steps
from softcal.core.network.config import NetworkConfig
from softcal.core.recording import Array

SIZES = ((0.0, 0.0), (0.05, 0.0), (0.1, 0.0), (0.2, 0.0), (0.1, 0.03), (0.1, 0.1))
"""Standard deviations of the level, in those of the output, and of the gain."""

Plain = training_steps._Training


def shifted(level: float, gain: float) -> type[Plain]:
    """Return a training whose windows are moved anew in every step; what validates is left as it is."""

    class Shifted(Plain):
        def _forward(self, x: torch.Tensor) -> torch.Tensor:
            if torch.is_grad_enabled():
                by, times = torch.randn(2, len(x), 1, generator=self._random)
                x = (1.0 + gain * times) * x + level * by
            return super()._forward(x)

    return Shifted if level or gain else Plain


def errors(unit: Unit, labelled: Array, used: Array) -> tuple[float, list[float], list[float]]:
    """Return the error on the labelled part, and per later quarter without following and with it."""
    t_s, output, reference = used
    parts = [part_rmse(follow(unit, mode, t_s, output)[0], reference, 3) for mode in ("none", "improved")]
    return own_error(unit.network, labelled[1], labelled[2]), parts[0], parts[1]


def rows(seeds: int) -> Iterator[list[object]]:
    for path in sorted((DATA / "nylon_drift").glob("*.parquet")):
        columns = pd.read_parquet(path).to_numpy().T
        quarter = columns.shape[1] // 4
        labelled, used = columns[:, :quarter], columns[:, quarter:]
        for seed in range(seeds):
            plain = None
            for level, gain in SIZES:
                with patch.object(training_steps, "_Training", shifted(level, gain)):
                    unit = calibrate(labelled[0], labelled[1], labelled[2], RATE_HZ, NetworkConfig(seed=seed))
                found = errors(unit, labelled, used)
                plain = plain or found
                yield [path.stem, seed, level, gain, found[0] / plain[0], *map(ratios, found[1:], plain[1:])]


def ratios(values: list[float], plain: list[float]) -> str:
    return " ".join(f"{a / b:.3f}" for a, b in zip(values, plain, strict=True))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=1)
    print_markdown(
        ["run", "seed", "level", "gain", "labelled quarter", "quarters 2 to 4, not followed", "followed"],
        rows(parser.parse_args().seeds),
    )
