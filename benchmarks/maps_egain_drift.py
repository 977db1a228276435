"""Can 1,200 rows of the eGaIn pair say whether to correct a sensor's drift? Evidence without labels beside the effect.

Stretches of the pair, each fitted on its first rows and tested on those that follow. *Corrected*: the unit's output is
scaled so that its running peak (97 % of the last 200 samples, above rest) stays where it was on the rows that were
fitted. Evidence is what could choose: the slope of that peak over the fitted rows, of unit and source, its scatter, and
where it stands on the tested rows. A chooser takes the correction where one of these is beyond a threshold; the last
table tells the best threshold of each, chosen with hindsight over all stretches, and how often it is wrong even so.

`--figure` draws what the rows before 800 say by themselves, each press for itself, beside the rows that are judged: the
ratio of both settings with its 90 % interval over presses (jackknife; Miller 1974).

python benchmarks/maps_egain_drift.py [--seeds N] [--figure FILE]
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from map_methods import egain, print_table
from plotly.subplots import make_subplots
from scipy.stats import t as student
from screens_common import write_figure

from softcal.core.maps.choose import choose_map
from softcal.core.maps.interface import FitProblem
from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.network.training import fit_network
from softcal.core.recording import Array, LabelledRecording
from softcal.core.windows import TAPS

NETWORK = NetworkConfig(hidden=(40, 20), max_epochs=60, batch=128)
PAIRS = (("S1", "S2"), ("S2", "S1"))
STRETCHES = ((0, 650, 750), (0, 650, 850), (0, 700, 900), (0, 750, 950), (0, 800, 1000), (0, 800, 1200))
"""First row, end of the fitted rows, end of the tested rows; with fewer or later rows f cannot be trained on S2."""

GIVEN, JUDGED = (0, 650, 800), (0, 800, 1200)
"""The largest stretch within the rows that are given, and the one that is judged."""

RUNNING, PEAK = 200, 0.97
PRESS_N = 1.2
"""A press begins where the load rises through this."""


@dataclass(frozen=True)
class Peaks:
    """The running peak of one sensor over the fitted rows, in logarithms."""

    slope: float
    scatter: float
    tested: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help="trainings of f, of which the median counts")
    parser.add_argument("--figure", type=Path, help="draw what the given rows say: .html, or .png by chromium")
    options = parser.parse_args()
    found = list(effects(options.seeds))
    head = ("direction", "rows", "corrected / as it is", *found[0][3])
    print_table(head, ((direction, rows, effect, *evidence.values()) for direction, rows, effect, evidence in found))
    print("The best threshold of each, with hindsight:\n")
    helps = np.array([effect < 1 for _, _, effect, _ in found])
    rows = []
    for name in found[0][3]:
        values = np.array([evidence[name] for *_, evidence in found])
        rows.append((name, min(wrong(values, helps)), len(helps)))
    print_table(("evidence", "wrong at best", "stretches"), rows)
    chosen = {pair: [presses(*pair, stretch, options.seeds) for stretch in (GIVEN, JUDGED)] for pair in PAIRS}
    print(
        "Corrected / as it is with its 90 % interval over presses: on the given rows, and on those that are judged:\n"
    )
    scored = []
    for (source, target), parts in chosen.items():
        for name, part in zip(("given", "judged"), parts, strict=True):
            low, high = part.interval()
            scored.append((f"{source} to {target}", name, len(part.row), part.ratio, f"{low:.3f} to {high:.3f}"))
    print_table(("direction", "rows", "presses", "corrected / as it is", "90 % interval"), scored)
    if options.figure:
        draw_figure(chosen, options.figure)


def wrong(values: Array, helps: Array) -> Iterator[int]:
    """Wrong choices for every threshold, in either direction; a threshold that always or never corrects included."""
    for threshold in (-np.inf, *np.sort(values)):
        for chosen in (values > threshold, values <= threshold):
            yield int(np.count_nonzero(chosen != helps))


def effects(seeds: int) -> Iterator[tuple[str, str, float, dict[str, float]]]:
    """Direction, rows, error with the correction over the error without, and the evidence."""
    for source, target in PAIRS:
        for start, cut, stop in STRETCHES:
            known, unit = egain(source).part(start, cut), egain(target).part(start, stop)
            corrected, peaks = steadied(unit, cut - start)
            _, own = steadied(known, cut - start)
            networks = [network_of(source, (start, cut), seed) for seed in range(seeds)]
            ratio = rms(squares(known, corrected, networks)) / rms(squares(known, unit, networks))
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


def squares(known: LabelledRecording, unit: LabelledRecording, networks: Sequence[Network]) -> Array:
    """Squared errors of the default on the rows behind those that were fitted: a row per training of f."""
    cut, found = len(known.reference), []
    train, test = unit.part(0, cut), unit.part(cut, len(unit.reference))
    for network in networks:
        unit_map = choose_map(FitProblem(known, network, train.unlabelled)).unit_map
        found.append((network.evaluate(unit_map.apply(test.windows)) - test.window_reference) ** 2)
    return np.array(found)


def rms(found: Array) -> float:
    """Median RMS error over the trainings of f."""
    return float(np.median(np.sqrt(found.mean(axis=1))))


@dataclass(frozen=True)
class Presses:
    """Mean squared error of each press, medians over trainings of f: as the unit is, and corrected.

    Args:
        row: first row of each press.
        plain, corrected: mean squared errors, N^2.
        weight: samples of each press.
    """

    row: Array
    plain: Array
    corrected: Array
    weight: Array

    @property
    def ratio(self) -> float:
        """RMS error with the correction over that without."""
        return float(np.sqrt((self.corrected @ self.weight) / (self.plain @ self.weight)))

    def interval(self) -> tuple[float, float]:
        """90 % interval of the ratio, had other presses of the same kind come: jackknife of its log, Student's t."""
        count, keep = len(self.row), ~np.eye(len(self.row), dtype=bool)
        without = [replace(self, **{k: v[kept] for k, v in vars(self).items()}).ratio for kept in keep]
        log = np.log(without)
        spread = np.sqrt((count - 1) / count * np.sum((log - log.mean()) ** 2))
        reach = float(np.exp(student.ppf(0.95, count - 1) * spread))
        return self.ratio / reach, self.ratio * reach


def presses(source: str, target: str, stretch: tuple[int, int, int], seeds: int) -> Presses:
    """Errors of both settings on one stretch, press by press."""
    start, cut, stop = stretch
    known, unit = egain(source).part(start, cut), egain(target).part(start, stop)
    corrected, _ = steadied(unit, cut - start)
    networks = [network_of(source, (start, cut), seed) for seed in range(seeds)]
    plain, held = (np.median(squares(known, one, networks), axis=0) for one in (unit, corrected))
    load = unit.reference[len(unit.reference) - len(plain) :]
    begins = np.flatnonzero((load[1:] > PRESS_N) & (load[:-1] <= PRESS_N)) + 1
    parts = np.split(np.arange(len(load)), begins)
    # What is left of a press before the first begins belongs to it; with the last one it makes a whole.
    parts = [part for part in parts if len(part) >= TAPS]
    first = stop - len(load)
    plain_N2, held_N2 = (np.array([errors[part].mean() for part in parts]) for errors in (plain, held))
    row, weight = np.array([first + part[0] for part in parts]), np.array([float(len(part)) for part in parts])
    return Presses(row, plain_N2, held_N2, weight)


def draw_figure(chosen: Mapping[tuple[str, str], Sequence[Presses]], file: Path) -> None:
    """Draw each press, and the ratio of each part with its interval; below 1 the correction helps."""
    figure = make_subplots(1, 2, subplot_titles=[f"{a} to {b}" for a, b in chosen], shared_yaxes=True)
    kinds = (("given rows, fitted on 0-649", "#2166ac"), ("judged rows, fitted on 0-799", "#b35806"))
    for column, parts in enumerate(chosen.values(), start=1):
        for (name, colour), part in zip(kinds, parts, strict=True):
            marks = {"color": colour, "size": 8}
            each = np.sqrt(part.corrected / part.plain)
            shown = {"name": name, "showlegend": column == 1, "legendgroup": name}
            figure.add_scatter(x=part.row, y=each, mode="markers", marker=marks, **shown, row=1, col=column)
            low, high = part.interval()
            ends = [float(part.row[0]), float(part.row[-1] + part.weight[-1])]
            figure.add_scatter(
                x=ends, y=[part.ratio] * 2, mode="lines", line={"color": colour}, showlegend=False, row=1, col=column
            )
            figure.add_shape(
                type="rect", x0=ends[0], x1=ends[1], y0=low, y1=high, fillcolor=colour, opacity=0.15, line_width=0,
                row=1, col=column,
            )  # fmt: skip
        ends = [float(GIVEN[1]), float(JUDGED[2])]
        even = {"mode": "lines", "line": {"color": "#333333", "dash": "dash"}, "showlegend": False}
        figure.add_scatter(x=ends, y=[1.0, 1.0], **even, row=1, col=column)
    figure.update_xaxes(title_text="row of the press").update_yaxes(type="log", tickvals=[0.8, 0.9, 1.0, 1.1, 1.2, 1.3])
    figure.update_yaxes(title_text="RMSE, drift corrected / as it is", col=1)
    legend = {"orientation": "h", "y": 1.2}
    write_figure(figure.update_layout(template="simple_white", legend=legend, margin={"t": 80, "b": 60}), file)


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
