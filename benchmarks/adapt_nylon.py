"""Drift of a silver-coated nylon strain sensor: error per quarter of each run, the first one labelled.

python benchmarks/adapt_nylon.py [--quick]
"""

import argparse
from collections.abc import Iterator

import numpy as np
import pandas as pd
from adapt_common import DATA, Unit, calibrate, follow, part_rmse, print_markdown

from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.recording import Array
from softcal.core.windows import TAPS, windows

RATE_HZ = 10.0
QUEUED = ("ot 512", "ot-improved 512", "ot 1500", "ot-improved 1500")
"""The paper's online method with queues of so many windows."""

MODES = ("none", "basic", "improved", *QUEUED)
LEVELS = np.linspace(0.005, 0.995, 100)


def quantile_remap(unit: Unit, output: Array) -> Array:
    """Re-map the quantiles of the last calibration length onto those of the calibration, ten times per length."""
    source = unit.source.unlabelled.output
    length = len(source)
    history = np.concatenate([source, output])
    estimate = np.full(len(output), np.nan)
    for start in range(0, len(output), length // 10):
        stop = min(len(output), start + length // 10)
        seen = np.quantile(history[start : start + length], LEVELS)
        piece = history[start + length - TAPS + 1 : stop + length]
        mapped = np.interp(piece, seen, np.quantile(source, LEVELS))
        estimate[start:stop] = unit.network.evaluate(windows(mapped))
    return estimate


def rows(seeds: int) -> Iterator[list[object]]:
    for path in sorted((DATA / "nylon_drift").glob("*.parquet")):
        t_s, output, reference = pd.read_parquet(path).to_numpy().T
        quarter = len(t_s) // 4
        errors: dict[str, list[list[float]]] = {name: [] for name in ("first", *MODES, "quantile")}
        for seed in range(seeds):
            first = slice(0, quarter)
            unit = calibrate(t_s[first], output[first], reference[first], RATE_HZ, NetworkConfig(seed=seed))
            later = slice(quarter, None)
            errors["first"].append([own_error(unit.network, output[first], reference[first])])
            for mode in MODES:
                estimate, _ = follow(unit, mode, t_s[later], output[later])
                errors[mode].append(part_rmse(estimate, reference[later], 3))
            errors["quantile"].append(part_rmse(quantile_remap(unit, output[later]), reference[later], 3))
        median = {name: np.median(values, axis=0) for name, values in errors.items()}
        for k in range(3):
            none, improved, first_error = (
                float(v) for v in (median["none"][k], median["improved"][k], median["first"][0])
            )
            others = [float(median[name][k]) for name in ("basic", *QUEUED, "quantile")]
            yield [
                path.stem,
                k + 2,
                first_error,
                none,
                others[0],
                improved,
                *others[1:],
                improved / none,
                improved / first_error,
            ]


def own_error(network: Network, output: Array, reference: Array) -> float:
    return rmse(network.evaluate(windows(output)), reference[TAPS - 1 :])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one seed instead of three")
    header = [
        "run",
        "quarter",
        "first quarter",
        "no adaptation",
        "basic",
        "improved",
        *QUEUED,
        "quantile re-map",
    ]
    print_markdown([*header, "improved / none", "improved / first"], rows(1 if parser.parse_args().quick else 3))
