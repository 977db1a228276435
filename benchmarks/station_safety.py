"""Press rigs of every drive, cell and hard stop with the real code, and print the largest force each truly saw.

python benchmarks/station_safety.py [--quick] [--kept FILE] [--part K N] [--each]

Time is simulated: it passes while the host waits, so a run takes seconds of the computer and is the same every time.
"""

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial

from common.command import ResultCache, no_longer_than, parser_of, part_of
from common.rig_trial import ForceLaw, RigCase, RigOutcome, press
from common.tables import print_table

from softcal.core.profiles import ramps
from softcal.station.devices.config import LATEST_S, UNKNOWN_S, FixtureConfig
from softcal.station.motion.bounds import FULL, REACTION_S, ForceBounds, Reaction

ACCELERATIONS, STOPS, SPEEDS = (10.0, 50.0, 500.0), (1.0, 20.0, 100.0, 1000.0), (1.0, 5.0, 20.0)
CELLS = tuple(itertools.product((80.0, 10.0), (0.0, 0.1, 0.5)))
QUICK = ((10.0,), ((80.0, 0.0), (10.0, 0.5)), (20.0, 1000.0), (5.0, 20.0))

LAYER, IN_THE_WAY = "under a soft layer", "in the way of the approach"
LAYER_N_MM = 2.0
"""Slope of the layer where it carries what is left of the limit."""

NOISE_N = 0.016
"""Four standard deviations of the load cell: a reading is no more exact."""

HANG_S = 300
"""A run that takes this much of the computer's time hangs; the slowest takes about 20 s."""


@dataclass(frozen=True)
class Trial:
    """One rig, what lies where, whether its file states how late the cell is, and the speed the profile asks for."""

    place: str
    is_stated: bool
    acceleration_mm_s2: float
    cell_Hz: float
    late_s: float
    stop_N_mm: float
    speed_mm_s: float

    @property
    def case(self) -> RigCase:
        """A hard stop 0.5 mm under a layer of 1.2·x^1.4 N; or bare, above where no unit should reach."""
        cell = (self.cell_Hz, self.late_s)
        latency_s = self.late_s if self.is_stated else UNKNOWN_S
        if self.place == LAYER:
            law = ForceLaw(stop_mm=0.5, stop_N_mm=self.stop_N_mm)
            return RigCase(self.acceleration_mm_s2, law, 1.2, *cell, latency_s=latency_s, approach_mm=1.1)
        law = ForceLaw(stop_mm=0.0, stop_N_mm=self.stop_N_mm)
        return RigCase(self.acceleration_mm_s2, law, 1.6, *cell, latency_s=latency_s, approach_mm=2.4)

    def bound_N(self) -> float:
        """Return the force a stop ends at, at most: noticed at the limit (or the touch), then v·T + v²/(2a) on."""
        case, touch_N = self.case, FixtureConfig().touch_N
        late_s = self.late_s if self.is_stated else LATEST_S
        reaction = Reaction(1.0 / case.cell_Hz + late_s + REACTION_S, case.acceleration_mm_s2)
        bounds = ForceBounds(reaction, case.limit_N, touch_N, FULL * case.capacity_N, case.stiffest_N_mm)
        if self.place == LAYER:
            fastest_mm_s = min(self.speed_mm_s, bounds.unknown_mm_s)
            return NOISE_N + bounds.worst_N(fastest_mm_s, case.limit_N, self.stop_N_mm + LAYER_N_MM)
        return NOISE_N + bounds.worst_N(bounds.free_mm_s, touch_N, self.stop_N_mm)


def main() -> None:
    """Press what is asked for and print the table."""
    parser = parser_of(__doc__, "the drive of a fresh GRBL, 24 runs", kept=True)
    parser.add_argument("--each", action="store_true", help="print a row for each run as well")
    options = parser.parse_args()
    trials = list(trials_of(*(QUICK if options.quick else (ACCELERATIONS, CELLS, STOPS, SPEEDS))))
    cache = ResultCache(options.kept)
    outcomes = [
        (trial, RigOutcome(**cache.get(repr(trial), partial(press_trial, trial)))) for trial in part_of(options, trials)
    ]
    if options.each:
        print_each(outcomes)
    for surface, is_latency_declared in itertools.product((LAYER, IN_THE_WAY), (False, True)):
        print_forces(
            surface,
            is_latency_declared,
            [(t, o) for t, o in outcomes if (t.place, t.is_stated) == (surface, is_latency_declared)],
        )
    print_summary(outcomes)


def trials_of(
    accelerations: Iterable[float],
    cells: Iterable[tuple[float, float]],
    stops: Iterable[float],
    speeds: Sequence[float],
) -> Iterator[Trial]:
    """Yield all rigs; in the way of the approach the profile's speed is of no matter."""
    for is_latency_declared, a, cell, stop_N_mm in itertools.product((False, True), accelerations, cells, stops):
        for speed_mm_s in speeds:
            yield Trial(LAYER, is_latency_declared, a, *cell, stop_N_mm, speed_mm_s)
        yield Trial(IN_THE_WAY, is_latency_declared, a, *cell, stop_N_mm, speeds[0])


def press_trial(trial: Trial) -> dict[str, object]:
    """Return what became of one trial.

    Raises:
        TimeoutError: the run hangs.
    """
    with no_longer_than(HANG_S, trial):
        return asdict(press(trial.case, ramps([1.4], trial.speed_mm_s, rest_s=0.5)))


def print_forces(place: str, is_stated: bool, outcomes: Sequence[tuple[Trial, RigOutcome]]) -> None:
    """Print the largest force of each cell against its bound: of its speeds the one that came nearest."""
    stops = sorted({trial.stop_N_mm for trial, _ in outcomes})
    latency_text = "the station file states how late the cell is" if is_stated else "the cell's latency is not stated"
    rigs = dict.fromkeys((t.acceleration_mm_s2, t.cell_Hz, t.late_s) for t, _ in outcomes)
    rows = []
    for rig in rigs:
        mine = [(t, o) for t, o in outcomes if (t.acceleration_mm_s2, t.cell_Hz, t.late_s) == rig]
        cells = [_nearest([(t, o) for t, o in mine if t.stop_N_mm == stop]) for stop in stops]
        rows.append((*(f"{value:g}" for value in rig), *cells))
    print(f"A hard stop {place}, {latency_text}: largest force of its bound, N.\n")
    print_table(("mm/s²", "cell, Hz", "late, s", *(f"{stop:g} N/mm" for stop in stops)), rows)


def _nearest(outcomes: Sequence[tuple[Trial, RigOutcome]]) -> str:
    if not outcomes:
        return ""
    trial, outcome = min(outcomes, key=lambda pair: pair[0].bound_N() - pair[1].largest_N)
    return f"{outcome.largest_N:.2f} of {trial.bound_N():.1f}"


def print_each(outcomes: Sequence[tuple[Trial, RigOutcome]]) -> None:
    """Print every run with what the operator reads."""
    rows = []
    for trial, outcome in outcomes:
        message = outcome.message.replace("|", "/") or "–"
        forces = f"{trial.bound_N():.1f}", f"{outcome.largest_N:.2f}"
        rows.append((*map(str, asdict(trial).values()), *forces, outcome.ends, message))
    head = "place | stated | mm/s² | cell, Hz | late, s | N/mm | mm/s | bound, N | largest, N | ends | operator reads"
    print_table(head, rows)


def print_summary(outcomes: Sequence[tuple[Trial, RigOutcome]]) -> None:
    """Print what must hold in every cell."""
    ends = [outcome.ends for _, outcome in outcomes]
    above = sum(outcome.largest_N > trial.bound_N() for trial, outcome in outcomes)
    full = sum(outcome.largest_N >= trial.case.capacity_N for trial, outcome in outcomes)
    worst = max(outcome.largest_N for _, outcome in outcomes)
    untrue = sum(not outcome.is_true for _, outcome in outcomes)
    counts = ", ".join(f"{ends.count(end)} {end}" for end in dict.fromkeys(sorted(ends)))
    print(
        f"{len(outcomes)} runs: {counts}. Largest force {worst:.1f} N; {above} above the bound, "
        f"{full} at or above the cell's capacity; {untrue} say something untrue of the stage."
    )


if __name__ == "__main__":
    main()
