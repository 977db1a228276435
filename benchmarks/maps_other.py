"""Measured units that were pressed otherwise than their source: eGaIn pair, skin, insole on another day, both ways.

Errors are after / own: own is a network trained on the unit's own labels of the tested sitting. Known loads are taken
in that sitting too, from rows that are not tested: the zero and nine tenths of the range. f and own networks are
smaller than the paper's, alike for all, so that hundreds of cases fit in minutes.

`--known` prints two known loads alone: the default, half way kept in its place, and what the best gain and level behind
a line would leave, chosen on the tested labels: no gain and no level can be better.

python benchmarks/maps_other.py [egain|skin|insole ...] [--every N] [--without N] [--known] [--cache DIR]
"""

import pickle
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from common.command import parser_of
from common.map_methods import METHODS, NETWORK, SOURCES, egain, insole, score, skin, split, summary, taxel, taxels
from common.tables import print_table

from softcal.core.identity import content_sha256
from softcal.core.maps.anchors import refine
from softcal.core.maps.catalogue import family
from softcal.core.maps.choose import choose_map
from softcal.core.maps.config import MapConfig
from softcal.core.maps.interface import Anchors, FitProblem
from softcal.core.maps.monotone import shape_distance
from softcal.core.metrics import rmse
from softcal.core.network.network import Network
from softcal.core.network.training import fit_network
from softcal.core.recording import LabelledRecording, OutputRecording

DAYS = ("calibration", "validation_1")
POSITIONS = ("left", "middle", "right")
METHOD_NAMES = ("before (no map)", "two_point", "monotone", "softcal default", "ot.da.EMDTransport")
LOADS = (1, 2, 3, 5)


Result = TypeVar("Result")


@dataclass(frozen=True)
class Case:
    """One unit behind one source.

    Args:
        line: of the table it belongs to.
        source: labelled rows that f is trained on.
        unit: recording the map is fitted to.
        use: labelled rows of the tested sitting that are not tested: known loads and own calibration come from them.
        test: labelled rows that are tested.
    """

    line: str
    source: LabelledRecording
    unit: OutputRecording
    use: LabelledRecording
    test: LabelledRecording


class Networks:
    """Networks by the recording they were trained on, and what was measured; kept in a folder between runs."""

    def __init__(self, folder: Path | None) -> None:
        self._folder, self._results = folder, dict[str, Any]()

    def network_of(self, recording: LabelledRecording) -> Network:
        """Return the network of a recording."""
        return self.load_or_make(recording.sha256, lambda: fit_network(recording, NETWORK).network)

    def load_or_make(self, key: str, make: Callable[[], Result]) -> Result:
        """Return what was made under this key, now or by an earlier run."""
        path = None if self._folder is None else self._folder / key
        if key not in self._results and path is not None and path.exists():
            self._results[key] = pickle.loads(path.read_bytes())
        if key not in self._results:
            self._results[key] = make()
            if path is not None:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(pickle.dumps(self._results[key]))
        return self._results[key]


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("sets", nargs="*", default=list(SETS), choices=SETS)
    parser.add_argument("--every", type=int, default=4, metavar="N", help="every Nth taxel as a unit")
    parser.add_argument("--without", type=int, metavar="N", help="leave every Nth taxel out as a unit")
    parser.add_argument("--known", action="store_true", help="two known loads alone")
    parser.add_argument("--cache", type=Path, help="keep trained networks here")
    options = parser.parse_args()
    networks = Networks(options.cache)
    if options.known:
        left_out = set() if options.without is None else set(taxels(insole(DAYS[0]))[:: options.without]) - {*SOURCES}
        print_known_loads(
            [c for s in options.sets for c in SETS[s](options.every) if c.use.serial not in left_out], networks
        )
        return
    lines: dict[str, list[dict[str, float]]] = {}
    for name in options.sets:
        for case in SETS[name](options.every):
            lines.setdefault(case.line, []).append(ratios(case, networks))
    columns = (*METHOD_NAMES, *(f"{count} known" for count in LOADS))
    print("after / own, median (95 %):\n")
    rows = [
        (line, len(line_ratios), *(_cell([unit[name] for unit in line_ratios]) for name in columns))
        for line, line_ratios in lines.items()
    ]
    print_table(("source, units", "cases", *columns), rows)
    if "insole" in options.sets:
        print("Five sources at once, each unit behind the one that its output is bent most like:\n")
        nearest = {
            name: [ratios(case, networks) for case in cases] for name, cases in nearest_cases(options.every).items()
        }
        rows = [
            (name, len(line_ratios), *(_cell([unit[method] for unit in line_ratios]) for method in columns))
            for name, line_ratios in nearest.items()
        ]
        print_table(("units", "cases", *columns), rows)


def print_known_loads(cases: list[Case], networks: Networks) -> None:
    """Print medians of two known loads by source, and over all."""
    lines: dict[str, list[tuple[float, float, float]]] = {}
    for case in cases:
        lines.setdefault(case.line, []).append(errors_with_two_loads(case, networks))
    lines["all"] = [ratios for line in lines.values() for ratios in line]
    head = (
        "source, units",
        "cases",
        "two known loads",
        "half way in their place",
        "best gain and level, by the labels",
    )
    print_table(
        head, ((line, len(ratios), *(float(m) for m in np.median(ratios, axis=0))) for line, ratios in lines.items())
    )


def errors_with_two_loads(case: Case, networks: Networks) -> tuple[float, float, float]:
    """After / own with two known loads: the default, half way, and a line with the best gain and level."""
    network, own_network = networks.network_of(case.source), networks.network_of(case.use)
    loads = known_loads(case.use, 2) or Anchors(np.empty(0), np.empty(0))
    problem = FitProblem(case.source, network, case.unit, loads)
    maps = [choose_map(problem).unit_map]
    for name in ("averaged", "two_point"):
        maps.append(refine(problem, family(name).fit(problem), loads, "").unit_map)
    default, half, line = (one.apply(case.test.windows) for one in maps)
    span, middle = float(np.ptp(case.source.unlabelled.output)), float(np.median(line))
    errors = (
        score(network, middle + level * span + gain * (line - middle), case.test)
        for gain in np.linspace(0.8, 1.25, 16)
        for level in np.linspace(-0.1, 0.1, 13)
    )
    own_rmse = score(own_network, np.asarray(case.test.windows), case.test)
    return (
        score(network, default, case.test) / own_rmse,
        score(network, half, case.test) / own_rmse,
        min(errors) / own_rmse,
    )


def nearest_cases(every: int) -> dict[str, list[Case]]:
    """The insole's units that are no source themselves, by day, each behind the nearest of the five sources."""
    by_unit: dict[tuple[str, str], list[Case]] = {}
    for case in insole_cases(every):
        if case.use.serial not in SOURCES:
            by_unit.setdefault((case.line.split(",")[0], case.use.serial), []).append(case)
    cases_by_name: dict[str, list[Case]] = {}
    for (day, _), cases in by_unit.items():
        best = min(cases, key=lambda case: shape_distance(case.source, case.unit, MapConfig()))
        cases_by_name.setdefault(day, []).append(best)
    return cases_by_name


def _cell(values: list[float]) -> str:
    median, high, _ = summary(values)
    return f"{median:.2f} ({high:.2f})"


def ratios(case: Case, networks: Networks) -> dict[str, float]:
    """After / own of every method on one unit; kept beside the networks, so that a run that is broken off goes on."""
    key = content_sha256({}, {"case": [part.sha256 for part in (case.source, case.unit, case.use, case.test)]})
    return networks.load_or_make(key, lambda: measured(case, networks))


def measured(case: Case, networks: Networks) -> dict[str, float]:
    """After / own of every method on one unit."""
    network, own_network = networks.network_of(case.source), networks.network_of(case.use)
    problem = FitProblem(case.source, network, case.unit)
    errors = {name: rmse(METHODS[name](problem, case.test), case.test.window_reference) for name in METHOD_NAMES}
    for count in LOADS:
        chosen = choose_map(replace(problem, anchors=known_loads(case.use, count)))
        errors[f"{count} known"] = score(network, chosen.unit_map.apply(case.test.windows), case.test)
    own_rmse = score(own_network, np.asarray(case.test.windows), case.test)
    return {name: error / own_rmse for name, error in errors.items()}


def egain_cases(every: int) -> Iterator[Case]:
    """Both directions; rows 0-799 fit, 800-1199 test."""
    for source, target in (("S1", "S2"), ("S2", "S1")):
        unit = egain(target).part(0, 800)
        yield Case(
            f"eGaIn {source} to {target}",
            egain(source).part(0, 800),
            unit.unlabelled,
            unit,
            egain(target).part(800, 1200),
        )


def skin_cases(every: int) -> Iterator[Case]:
    """Every place behind every other; the first 4,200 rows fit, the rest test."""
    for source in POSITIONS:
        for target in POSITIONS:
            if source != target:
                whole = skin(target)
                unit, test = whole.part(0, 4200), whole.part(4200, len(whole.reference))
                yield Case(f"skin, source {source}", skin(source).part(0, 4200), unit.unlabelled, unit, test)


def insole_cases(every: int) -> Iterator[Case]:
    """Maps fitted to one day's programme, tested on held-out stretches of the source's day; both ways."""
    for day, other in (DAYS, DAYS[::-1]):
        tested, fitted = insole(day), insole(other)
        train, test_rows = split(len(tested))
        for source in SOURCES:
            for name in taxels(tested)[::every]:
                if name != source:
                    use_recording, test = (taxel(tested, name, rows) for rows in (train, test_rows))
                    line = f"insole {day}, source {source}"
                    yield Case(line, taxel(tested, source, train), taxel(fitted, name).unlabelled, use_recording, test)


SETS: dict[str, Callable[[int], Iterator[Case]]] = {"egain": egain_cases, "skin": skin_cases, "insole": insole_cases}


def known_loads(audit: LabelledRecording, count: int) -> Anchors | None:
    """Output and load where the unit rested: the slowest samples near evenly spaced loads, the zero first."""
    if not count:
        return None
    loads = np.concatenate([[0.0], np.linspace(0.0, 0.9 * float(np.quantile(audit.reference, 0.98)), count)[1:]])
    speed = np.abs(np.convolve(np.gradient(audit.reference), np.ones(15) / 15, mode="same"))
    picked = []
    for load in loads:
        near = np.argsort(np.abs(audit.reference - load))[:60]
        picked.append(near[np.argsort(speed[near])[:20]])
    return Anchors(
        np.array([audit.unlabelled.output[rows].mean() for rows in picked]),
        np.array([audit.reference[rows].mean() for rows in picked]),
    )


if __name__ == "__main__":
    main()
