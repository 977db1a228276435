"""Shares of planted faults that one look at a recording finds, and of good samples that it masks.

    python benchmarks/inspection.py [--quick] [--seed N]

Measured outputs (eGaIn, insole, nylon, skin) and forces as they are, then with faults planted at random: a loose cable
of each kind and length, codes of loggers, gaps, a late, held or tared reference. Found: share of the planted samples
that are masked, or of the planted faults that are named in their place. Masked: share of all other samples.
"""

import argparse
from collections import defaultdict
from collections.abc import Callable, Iterator

import numpy as np
import pandas as pd
from common.map_methods import DATA
from common.tables import print_table

from softcal.core.inspection.build import InspectedRecording, build_recording
from softcal.core.inspection.config import InspectionConfig
from softcal.core.inspection.inspection import InspectionFinding
from softcal.core.inspection.reference import BINS, unexplained_share
from softcal.core.recording import Array, Mask, Rng

Pair = tuple[Array, Array, float]
"""Output, reference and rate."""

CABLES: dict[str, Callable[[Array], Array]] = {
    "0 V": lambda run: 0 * run,
    "half": lambda run: run / 2,
    "rail": lambda run: 0 * run + (5.0 if run.max() < 5 else 2 * run.max()),
}
CODES = (8388607.0, 9.9e37, -9999.0, 2147483647.0, np.inf)
SPIKES_EACH = 5
STRETCHES_EACH = 10
FEW_DRAWS = 20
"""Times that spikes are planted in each recording of a set that has few of them."""

VISIBLE_SHARE = 0.12
"""Lower spikes, as a share of the range, are as high as what measured presses do themselves: up to 9 %."""


def outputs() -> Iterator[tuple[str, Array, Array | None, float]]:
    """Yield set, output, reference and rate of every measured recording."""
    for name in ("S1", "S2"):
        table = pd.read_csv(DATA / f"egain_pair/{name}.csv")
        yield "eGaIn", table["output_V"].to_numpy(), table["force_N"].to_numpy(), 50.0
    for name in ("calibration", "validation_1"):
        table = pd.read_parquet(DATA / f"insole_lot/{name}.parquet")
        pressure = table["pressure_bar"].to_numpy(float)
        for number, taxel in enumerate(column for column in table.columns if column.startswith("taxel")):
            # All lie under one pressure: every eighth tells what the others do.
            yield "insole", table[taxel].to_numpy(float), None if number % 8 else pressure, 48.9
    for path in sorted((DATA / "nylon_drift").glob("*.parquet")):
        table = pd.read_parquet(path)
        yield "nylon", table["output_R_over_R0"].to_numpy(float), table["strain_norm"].to_numpy(float), 10.0
    for path in sorted((DATA / "skin_places").glob("*.parquet")):
        table = pd.read_parquet(path)
        yield "skin", table["output_V"].to_numpy(), table["force_N"].to_numpy(), 50.0


def inspected(output: Array, reference: Array | None, rate_Hz: float) -> InspectedRecording:
    """Build a recording of evenly spaced samples."""
    t_s = np.arange(len(output)) / rate_Hz
    return build_recording("unit", t_s, output, sample_rate_Hz=rate_Hz, reference=reference, config=InspectionConfig())


def invalid(result: InspectedRecording, samples: int) -> Mask:
    """Return which samples were masked, (n,)."""
    is_masked = np.ones(samples, dtype=bool)
    is_masked[result.rows] = False
    return is_masked


class Shares:
    """Counts of planted and found, good and masked, by set and fault."""

    def __init__(self) -> None:
        self.counts: dict[tuple[str, str], list[int]] = defaultdict(lambda: [0, 0, 0, 0])

    def add(self, key: tuple[str, str], planted: Mask, masked: Mask) -> None:
        found_count, wrong = int((planted & masked).sum()), int((~planted & masked).sum())
        for index, value in enumerate((int(planted.sum()), found_count, int((~planted).sum()), wrong)):
            self.counts[key][index] += value

    def rows(self) -> list[list[object]]:
        return [
            [
                *key,
                planted,
                f"{found_count / planted:.2%}" if planted else "-",
                good,
                f"{wrong / good:.4%}" if good else "-",
            ]
            for key, (planted, found_count, good, wrong) in self.counts.items()
        ]


def plant_spikes(shares: Shares, name: str, output: Array, rate_Hz: float, rng: np.random.Generator) -> None:
    """Plant a loose cable of every kind and length, and codes; spikes that stand out too little are counted apart."""
    usual = invalid(inspected(output, None, rate_Hz), len(output))
    for kind, change in CABLES.items():
        for length in range(1, max(1, round(0.06 * rate_Hz)) + 1):
            faulty, rows, is_hidden = output.copy(), np.zeros(len(output), dtype=bool), np.zeros(len(output), bool)
            starts = rng.choice(np.arange(40, len(output) - 40, 40), SPIKES_EACH, replace=False) + rng.integers(30)
            for start in starts:
                faulty[start : start + length] = change(output[start : start + length])
                rows[start : start + length] = True
                is_hidden[start : start + length] = height_share(faulty, start, length, output) < VISIBLE_SHARE
            masked = invalid(inspected(faulty, None, rate_Hz), len(output))
            masked &= ~(usual & ~rows)
            shares.add((name, f"cable {kind}, {length} samples"), rows & ~is_hidden, masked & ~is_hidden)
            if is_hidden.any():
                shares.add((name, f"cable {kind}, less than {VISIBLE_SHARE:.0%} high"), is_hidden, masked & is_hidden)
    for code in CODES:
        faulty, rows = output.copy(), np.zeros(len(output), dtype=bool)
        rows[rng.choice(len(output), SPIKES_EACH, replace=False)] = True
        faulty[rows] = code
        masked = invalid(inspected(faulty, None, rate_Hz), len(output))
        shares.add((name, f"code {code:g}"), rows, masked & ~(usual & ~rows))


def height_share(faulty: Array, start: int, length: int, output: Array) -> float:
    """Return by which share of the range all of a planted run lies beyond both its neighbours."""
    run, neighbours = faulty[start : start + length], faulty[[start - 1, start + length]]
    height = max(neighbours.min() - run.max(), run.min() - neighbours.max())
    return float(height / np.ptp(np.quantile(output, (0.01, 0.99))))


def reference_faults(output: Array, force: Array, rate_Hz: float) -> Iterator[tuple[str, str, Array, Array, int]]:
    """Yield name, kind of finding, output, reference and row of each fault of a reference."""
    late, samples = round(0.5 * rate_Hz), len(output)
    yield "0.5 s late", "lag", output[late:], force[:-late], 0
    yield "0.5 s early", "lag", output[:-late], force[late:], 0
    yield "at a fifth of the rate", "held", output, force[np.arange(samples) // 5 * 5], 0


def plant_tares(references: dict[tuple[str, str], list[int]], name: str, recording: Pair, rng: Rng) -> None:
    """Look at stretches of a recording as they are, then with a tare at a random row of each."""
    output, force, rate_Hz = recording
    for _ in range(STRETCHES_EACH):
        length = int(rng.integers(600, len(output) + 1))
        start = int(rng.integers(0, len(output) - length + 1))
        rows = slice(start, start + length)
        references[name, "a stretch as measured: tare"][0] += 1
        references[name, "a stretch as measured: tare"][1] += len(tares(output[rows], force[rows], rate_Hz))
        for share in (0.15, 0.3):
            row, tared = int(length * rng.uniform(0.1, 0.9)), force[rows].copy()
            tared[row:] += share * rng.choice((-1, 1)) * np.ptp(tared)
            references[name, f"tare by {share:.0%} of the range"][0] += 1
            references[name, f"tare by {share:.0%} of the range"][1] += any(
                abs(one.start - row) <= 3 for one in tares(output[rows], tared, rate_Hz)
            )


def tares(output: Array, force: Array, rate_Hz: float) -> tuple[InspectionFinding, ...]:
    """Return the tares that a look names."""
    return inspected(output, force, rate_Hz).inspection.of_kind("tare")


def scatter(output: Array, reference: Array) -> float:
    """Return the share of a reference's variance that its mean at equal output leaves."""
    edges = np.unique(np.quantile(output, np.linspace(0, 1, BINS + 1)[1:-1]))
    return unexplained_share(np.searchsorted(edges, output, side="right").astype(np.int64), reference)


def measure(
    seed: int, is_quick: bool
) -> tuple[Shares, dict[tuple[str, str], list[int]], dict[tuple[str, str], list[float]]]:
    """Return the shares of samples, faults of references by set (tried, found), and what lags do to their scatter."""
    rng, shares = np.random.default_rng(seed), Shares()
    references: dict[tuple[str, str], list[int]] = defaultdict(lambda: [0, 0])
    lags: dict[tuple[str, str], list[float]] = defaultdict(list)
    for name, output, force, rate_Hz in outputs():
        if is_quick and name == "insole" and rng.random() < 0.8:
            continue
        plain = inspected(output, None, rate_Hz)
        shares.add((name, "as measured"), np.zeros(len(output), dtype=bool), invalid(plain, len(output)))
        for _ in range(1 if name == "insole" else FEW_DRAWS):
            plant_spikes(shares, name, output, rate_Hz, rng)
        if force is None:
            continue
        plain = inspected(output, force, rate_Hz)
        references[name, "as measured: lag, held or tare"][0] += 1
        references[name, "as measured: lag, held or tare"][1] += len(plain.inspection.of_kind("lag", "held", "tare"))
        plant_tares(references, name, (output, force, rate_Hz), rng)
        for fault, kind, faulty, reference, row in reference_faults(output, force, rate_Hz):
            found_count = inspected(faulty, reference, rate_Hz).inspection.of_kind(kind)
            if kind == "lag":
                lags[name, fault].append(scatter(faulty, reference) / scatter(output, force))
            references[name, fault][0] += 1
            references[name, fault][1] += any(abs(one.start - row) <= 3 for one in found_count)
    return shares, references, lags


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a fifth of the taxels")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    shares, references, lags = measure(options.seed, options.quick)
    print_table(("set", "fault", "planted samples", "found", "good samples", "masked of them"), shares.rows())
    rows = [[*key, trials, found_count] for key, (trials, found_count) in references.items()]
    print_table(("set", "fault of the reference", "tried", "found in its place"), rows)
    rows = [[*key, len(values), f"{min(values):.2f} to {max(values):.2f}"] for key, values in lags.items()]
    print_table(("set", "lag", "recordings", "scatter at equal output, times that as measured"), rows)


if __name__ == "__main__":
    main()
