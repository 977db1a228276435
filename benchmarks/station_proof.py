"""Press good rigs of many kinds, change one channel of each recording from a random moment on, and say what passed.

python benchmarks/station_proof.py [--seeds A B] [--each N] [--steps N]

The constants of station/proof.py were chosen on seeds 0 to 99; others test them. The default, seeds 200 to 211 with 12
changes and one press with lost steps each, takes about four minutes on two cores.
"""

import argparse
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from softcal.core.errors import SoftcalError
from softcal.core.recording import Array
from softcal.station.acquisition import RunProgress
from softcal.station.interfaces import Sample
from softcal.station.recording import Raw, RunFacts, StationRecording, assemble
from softcal.station.simulated.proof_trial import GoodRig, draw_good_rig, press_good_rig
from softcal.station.simulated.station import SimulatedStation
from softcal.station.spool import SpooledRun, read_spool

GAINS = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.97, 1.03, 1.05, 1.1, 1.3, 2.0)
ZEROS_N = (-0.5, -0.2, -0.1, -0.05, 0.05, 0.1, 0.2, 0.5)
LAGS_S = (-0.3, -0.1, -0.05, -0.02, 0.02, 0.05, 0.1, 0.3)
SLIPS_MM = (0.05, 0.1, 0.2, 0.5)
WRONG_PERCENT = 1.0
SHOWN = 0.2
"""Share of the largest force that the slow press shows before anything changes."""

Change = Callable[[Array, Array], Array]
Row = tuple[str, float, bool]
"""(what was changed, by how much what was recorded as good is wrong in % of its range, whether it was)"""


def main() -> None:
    """Press, change, print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs=2, default=(200, 212), metavar=("A", "B"))
    parser.add_argument("--each", type=int, default=12, metavar="N", help="changes of each good recording")
    parser.add_argument("--steps", type=int, default=1, metavar="N", help="presses of each rig that lose steps")
    options = parser.parse_args()
    rows, refused, pressed = list[Row](), list[str](), 0
    for seed in range(*options.seeds):
        rig, rng = draw_good_rig(seed), np.random.default_rng([seed, 34])
        run, said = _pressed(rig, lambda progress, station: None)
        pressed += 1
        if said or run is None:
            refused.append(f"{seed}: {rig.unit}, {rig.cell_Hz:g} Hz: {said}")
            continue
        rows += _changed(run, rng, options.each)
        rows += _slipped(rig, rng, options.steps)
    _print(rows, refused, pressed)


def _pressed(
    rig: GoodRig, on_progress: Callable[[RunProgress, SimulatedStation], None]
) -> tuple[SpooledRun | None, str]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.spool"
        try:
            press_good_rig(rig, path, on_progress)
        except SoftcalError as error:
            return None, str(error)
        return read_spool(path), ""


def _changed(run: SpooledRun, rng: np.random.Generator, each: int) -> Iterator[Row]:
    """Change one channel of a good recording, each time from another moment on, or what is stated of the cell."""
    facts = RunFacts(**run.facts)
    good = assemble(Raw(run.output, run.force, run.polls), facts)
    # What changes before a unit was pressed at all shows nowhere in its run: there is nothing to compare with.
    force_N = np.array([s.values[0] - facts.zero_N for s in run.force])
    shown_s = min(run.force[int(np.argmax(force_N > SHOWN * np.max(force_N)))].host_s, facts.span_s[0])
    kinds = ("gain", "zero", "lag", "output gain", "output lag", "stated lag")
    for k in range(each):
        kind = kinds[k % len(kinds)]
        begins_s = shown_s if rng.random() < 0.5 else facts.span_s[0]
        at_s = float(rng.uniform(begins_s, facts.span_s[1]))
        output, force, own = run.output, run.force, facts
        if kind == "stated lag":
            own = replace(facts, force_late_s=max(0.0, facts.force_late_s + rng.choice(LAGS_S)), is_latency_stated=True)
        elif kind.startswith("output"):
            output = _from(output, at_s, _change(kind.removeprefix("output "), output[0].values[0], rng))
        else:
            force = _from(force, at_s, _change(kind, facts.zero_N, rng))
        found = _assembled(Raw(output, force, run.polls), own)
        yield kind, 0.0 if found is None else _off_percent(good, found), found is not None


def _change(kind: str, level: float, rng: np.random.Generator) -> Change:
    if kind == "gain":
        gain = float(rng.choice(GAINS))
        return lambda t_s, values: level + gain * (values - level)
    if kind == "zero":
        moved = float(rng.choice(ZEROS_N))
        return lambda t_s, values: values + moved
    late_s = float(rng.choice(LAGS_S))
    return lambda t_s, values: np.interp(t_s - late_s, t_s, values)


def _from(samples: tuple[Sample, ...], at_s: float, change: Change) -> tuple[Sample, ...]:
    t_s, values = np.array([s.host_s for s in samples]), np.array([s.values[0] for s in samples])
    changed = np.where(t_s > at_s, change(t_s, values), values)
    return tuple(replace(s, values=(float(value), *s.values[1:])) for s, value in zip(samples, changed, strict=True))


def _assembled(raw: Raw, facts: RunFacts) -> StationRecording | None:
    try:
        return assemble(raw, facts)
    except SoftcalError:
        return None


def _off_percent(good: StationRecording, found: StationRecording) -> float:
    """Return how far the labels, or the outputs beside them, are off, RMS in % of their range."""
    pairs = ((good.force_N, found.force_N), (good.output[:, 0], found.output[:, 0]))
    return max(100.0 * float(np.sqrt(np.mean((a - b) ** 2)) / np.ptp(a)) for a, b in pairs)


def _slipped(rig: GoodRig, rng: np.random.Generator, count: int) -> Iterator[Row]:
    """Press while the motor loses steps at a random force on the way down or up; what is off is `stage_mm`."""
    for _ in range(count):
        lost_mm, from_N = float(rng.choice(SLIPS_MM)), float(rng.uniform(0.1, 1.5))
        after = int(rng.integers(1, 60))
        seen = [0]

        def lose(
            progress: RunProgress,
            station: SimulatedStation,
            seen: list[int] = seen,
            from_N: float = from_N,
            after: int = after,
            lost_mm: float = lost_mm,
        ) -> None:
            seen[0] += progress.force_N is not None and progress.force_N > from_N
            if seen[0] == after:
                seen[0] += 1
                station.rig.lose_steps(lost_mm)

        run, _ = _pressed(rig, lose)
        if seen[0] > after:
            yield f"steps {lost_mm:g} mm", 100.0 * lost_mm / rig.profile.deepest_mm, run is not None


def _print(rows: list[Row], refused: list[str], pressed: int) -> None:
    print(f"{pressed} good rigs pressed; {len(refused)} refused.\n")
    print("| what changes | changes | recorded as good | of these wrong by 1 % or more | the most wrong, % |")
    print("|---|---|---|---|---|")
    table: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        table[row[0]].append(row)
    for kind, found in sorted(table.items()):
        passed = [percent for _, percent, is_good in found if is_good]
        wrong = sum(percent >= WRONG_PERCENT for percent in passed)
        print(f"| {kind} | {len(found)} | {len(passed)} | {wrong} | {max(passed, default=0.0):.2f} |")
    for line in refused:
        print(f"\nRefused although good: {line}")


if __name__ == "__main__":
    main()
