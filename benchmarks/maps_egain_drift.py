"""Can 1,200 rows of the eGaIn pair say whether to correct a sensor's drift? Evidence without labels beside the effect.

Stretches of the pair, each fitted on its first rows and tested on those that follow. *Corrected*: the unit's output is
scaled so that its running peak (97 % of the last 200 samples, above rest) stays where it was on the rows that were
fitted. Evidence is what could choose: the slope of that peak over the fitted rows, of unit and source, its scatter, and
where it stands on the tested rows. A chooser takes the correction where one of these is beyond a threshold; the last
table tells the best threshold of each, chosen with hindsight over all stretches, and how often it is wrong even so.

python benchmarks/maps_egain_drift.py [--seeds N]
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from map_methods import egain, print_table, score

from softcal.core.maps.choose import choose_map
from softcal.core.maps.interface import FitProblem
from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.network.training import fit_network
from softcal.core.recording import Array, LabelledRecording

NETWORK = NetworkConfig(hidden=(40, 20), max_epochs=60, batch=128)
STRETCHES = ((0, 650, 750), (0, 650, 850), (0, 700, 900), (0, 750, 950), (0, 800, 1000), (0, 800, 1200))
"""First row, end of the fitted rows, end of the tested rows; with fewer or later rows f cannot be trained on S2."""

RUNNING, PEAK = 200, 0.97


@dataclass(frozen=True)
class Peaks:
    """The running peak of one sensor over the fitted rows, in logarithms."""

    slope: float
    scatter: float
    tested: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help="trainings of f, of which the median counts")
    found = list(effects(parser.parse_args().seeds))
    head = ("direction", "rows", "corrected / as it is", *found[0][3])
    print_table(head, ((direction, rows, effect, *evidence.values()) for direction, rows, effect, evidence in found))
    print("The best threshold of each, with hindsight:\n")
    helps = np.array([effect < 1 for _, _, effect, _ in found])
    rows = []
    for name in found[0][3]:
        values = np.array([evidence[name] for *_, evidence in found])
        rows.append((name, min(wrong(values, helps)), len(helps)))
    print_table(("evidence", "wrong at best", "stretches"), rows)


def wrong(values: Array, helps: Array) -> Iterator[int]:
    """Wrong choices for every threshold, in either direction; a threshold that always or never corrects included."""
    for threshold in (-np.inf, *np.sort(values)):
        for chosen in (values > threshold, values <= threshold):
            yield int(np.count_nonzero(chosen != helps))


def effects(seeds: int) -> Iterator[tuple[str, str, float, dict[str, float]]]:
    """Direction, rows, error with the correction over the error without, and the evidence."""
    for source, target in (("S1", "S2"), ("S2", "S1")):
        for start, cut, stop in STRETCHES:
            known, unit = egain(source).part(start, cut), egain(target).part(start, stop)
            corrected, peaks = steadied(unit, cut - start)
            _, own = steadied(known, cut - start)
            networks = [network_of(source, (start, cut), seed) for seed in range(seeds)]
            ratio = error(known, corrected, networks) / error(known, unit, networks)
            evidence = {
                "slope of the unit": peaks.slope,
                "its size": abs(peaks.slope),
                "scatter of the unit": peaks.scatter,
                "tested rows of the unit": peaks.tested,
                "their size": abs(peaks.tested),
                "slope of the source": own.slope,
                "slope of unit less source": peaks.slope - own.slope,
            }
            yield f"{source} to {target}", f"{start}-{cut}, {cut}-{stop}", ratio, evidence


@cache
def network_of(source: str, rows: tuple[int, int], seed: int) -> Network:
    """f of one stretch of the source."""
    return fit_network(egain(source).part(*rows), replace(NETWORK, seed=seed)).network


def error(known: LabelledRecording, unit: LabelledRecording, networks: Sequence[Network]) -> float:
    """Median error of the default over trainings of f, on the rows behind those that were fitted."""
    cut, errors = len(known.reference), []
    train, test = unit.part(0, cut), unit.part(cut, len(unit.reference))
    for network in networks:
        chosen = choose_map(FitProblem(known, network, train.unlabelled))
        errors.append(score(network, chosen.unit_map.apply(test.windows), test))
    return float(np.median(errors))


def steadied(recording: LabelledRecording, cut: int) -> tuple[LabelledRecording, Peaks]:
    """The recording with its running peak held, and what the peak did. Row k knows rows up to k only."""
    output = recording.unlabelled.output
    rest = float(np.quantile(output[:cut], 0.02))
    ends = np.maximum(np.arange(len(output)) + 1, RUNNING)
    peak = np.array([np.quantile(output[max(end - RUNNING, 0) : end], PEAK) for end in ends]) - rest
    usual = float(np.median(peak[:cut]))
    moved = np.log(peak / usual)
    slope = float(np.polyfit(np.linspace(0, 1, cut), moved[:cut], 1)[0])
    held = replace(recording.unlabelled, output=rest + (output - rest) * usual / peak)
    tested = float(moved[cut:].mean()) if len(moved) > cut else 0.0
    return replace(recording, unlabelled=held), Peaks(slope, float(np.std(moved[:cut])), tested)


if __name__ == "__main__":
    main()
