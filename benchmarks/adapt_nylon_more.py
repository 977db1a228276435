"""Drift of a silver-coated nylon strain sensor in more runs than were measured: other stretches, shares and rates.

Each recording is calibrated on another share of it, begun later, or thinned to half its rate; the rest is streamed.

python benchmarks/adapt_nylon_more.py
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from adapt_common import DATA, calibrate, follow, part_rmse, print_markdown
from adapt_nylon import RATE_HZ, own_error

from softcal.core.network.config import NetworkConfig
from softcal.core.recording import Array

NETWORK = NetworkConfig(hidden=(40, 20), max_epochs=60)
"""Smaller than the paper's, so that two dozen of them are trained in minutes."""


@dataclass(frozen=True)
class Stretch:
    """What of a recording is used.

    Args:
        start: share of it left out before.
        labelled: share of the rest that calibrates.
        every: keep each so-manieth sample.
        seed: of the network.
    """

    start: float = 0.0
    labelled: float = 0.25
    every: int = 1
    seed: int = 0


STRETCHES = {
    "15 % labelled": Stretch(labelled=0.15),
    "20 % labelled": Stretch(labelled=0.2),
    "30 % labelled": Stretch(labelled=0.3),
    "40 % labelled": Stretch(labelled=0.4),
    "begun after a fifth": Stretch(start=0.2),
    "begun after two fifths": Stretch(start=0.4),
    "every second sample": Stretch(every=2),
    "another seed": Stretch(seed=7),
}


def rows() -> Iterator[list[object]]:
    for path in sorted((DATA / "nylon_drift").glob("*.parquet")):
        for name, stretch in STRETCHES.items():
            columns = pd.read_parquet(path).to_numpy().T
            first = round(stretch.start * columns.shape[1])
            yield [path.stem, name, *ratios(columns[:, first :: stretch.every], stretch)]


def ratios(columns: Array, stretch: Stretch) -> list[float]:
    """Return errors, and how they compare, of the later parts; the worst of three equal ones."""
    split = round(stretch.labelled * columns.shape[1])
    config = NetworkConfig(hidden=NETWORK.hidden, max_epochs=NETWORK.max_epochs, seed=stretch.seed)
    t_s, output, reference = columns[:, :split]
    unit = calibrate(t_s, output, reference, RATE_HZ / stretch.every, config)
    own = own_error(unit.network, columns[1, :split], columns[2, :split])
    t_s, output, reference = columns[:, split:]
    none, basic, improved = (
        np.array(part_rmse(follow(unit, mode, t_s, output)[0], reference, 3)) for mode in ("none", "basic", "improved")
    )
    worst = [float(np.max(values)) for values in (none, improved, basic / none, improved / none, improved / own)]
    return [own, *worst]


if __name__ == "__main__":
    table = list(rows())
    header = ["run", "stretch", "own error", "worst part, no adaptation", "worst part, improved"]
    print_markdown([*header, "basic / none", "improved / none", "improved / own"], table)
    none_worst, own_worst = (max(float(str(row[k])) for row in table) for k in (-2, -1))
    print(f"\n{len(table)} runs; worst part: {none_worst:.3f} of no adaptation, {own_worst:.3f} of the own error")
