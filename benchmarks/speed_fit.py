"""Seconds and memory to fit one map, against POT's exact transport on the same windows in the same run.

python benchmarks/speed_fit.py [--quick]
"""

import argparse
import time
import tracemalloc
import warnings

import numpy as np
import ot
from common.tables import print_table

from softcal.core.maps.choose import choose_map
from softcal.core.maps.interface import FitProblem
from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.network.training import fit_network
from softcal.core.recording import LabelledRecording, OutputRecording

GAIN, OFFSET_V = 1.2, 0.05


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="POT at 1,500 windows instead of 6,250")
    exact = 1500 if parser.parse_args().quick else 6250
    network = fit_network(unit(4000, 1, 1.0, 0.0), NetworkConfig(max_epochs=60)).network
    versus_pot(network, exact)
    growth(network)


def versus_pot(network: Network, count: int) -> None:
    """Time and error of the default and of EMDTransport on equal windows."""
    problem, test = pair(network, count), unit(4000, 9, GAIN, OFFSET_V)
    ours_s = fit_seconds(network, count)
    chosen = choose_map(problem)
    transport = ot.da.EMDTransport(max_iter=100_000_000)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        start = time.perf_counter()
        transport.fit(Xs=np.array(problem.target.windows), Xt=np.array(problem.source.windows))
        theirs_s = time.perf_counter() - start
        moved = transport.transform(Xs=np.array(test.windows))
    rows = [
        (
            f"softcal default ({chosen.family})",
            ours_s,
            rmse(network.evaluate(chosen.unit_map.apply(test.windows)), test.window_reference),
        ),
        ("ot.da.EMDTransport", theirs_s, rmse(network.evaluate(moved), test.window_reference)),
    ]
    print(f"{count} x {count} windows, {theirs_s / ours_s:.0f} times faster:\n")
    print_table(("method", "fit, s", "error, N"), rows)


def growth(network: Network) -> None:
    """Time and peak memory of the default against the number of samples, and the slope of log time over log samples."""
    counts, rows = (3125, 6250, 12_500, 25_000, 50_000), []
    for count in counts:
        problem = pair(network, count)
        tracemalloc.start()
        choose_map(problem)
        peak_MB = tracemalloc.get_traced_memory()[1] / 1e6
        tracemalloc.stop()
        rows.append((count, fit_seconds(network, count), peak_MB))
    slope = float(np.polyfit(np.log(counts), np.log([row[1] for row in rows]), 1)[0])
    print(f"Growth with samples, slope {slope:.2f} (1 is linear):\n")
    print_table(("windows a side", "fit, s", "peak, MB"), rows)


def fit_seconds(network: Network, count: int, repeats: int = 5) -> float:
    """Median wall time of a map, on recordings that nothing was computed of before."""
    times = []
    for _ in range(repeats):
        problem = pair(network, count)
        start = time.perf_counter()
        choose_map(problem)
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def pair(network: Network, count: int) -> FitProblem:
    """Source and unit of so many windows, pressed independently."""
    return FitProblem(unit(count + 14, 1, 1.0, 0.0), network, unit(count + 14, 2, GAIN, OFFSET_V).unlabelled)


def unit(count: int, seed: int, gain: float, offset_V: float) -> LabelledRecording:
    """Random presses to 0.5 ... 3 N at random speeds through a bending, slightly noisy sensor."""
    rng, parts, length = np.random.default_rng(seed), [], 0
    while length < count:
        peak, up, down, rest = rng.uniform(0.5, 3.0), *rng.integers(10, 60, 3)
        parts += [np.linspace(0, peak, up), np.linspace(peak, 0, down), np.zeros(rest)]
        length += up + down + rest
    force_N = np.concatenate(parts)[:count]
    output_V = 0.5 + offset_V + gain * (0.1 * force_N + 0.02 * force_N**2) + rng.normal(0, 0.0008, count)
    return LabelledRecording(OutputRecording(f"U{seed}", np.arange(count) / 50.0, output_V, 50.0), force_N)


if __name__ == "__main__":
    main()
