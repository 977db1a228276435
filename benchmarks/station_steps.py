"""May a slow press go in steps that end by themselves, faster than a stop could hold? What a rigid thing then bears.

    python benchmarks/station_steps.py [--quick]

A step is one finite move, as long as the room that the force so far leaves on the stiffest thing; the next one begins
when the force after it is known. So no stop is needed, and a host that dies or comes late leaves no more than the
ceiling. A piece of a feed that a stop can hold is the way of station/motion today. Both are driven by the real driver
over the simulated controller; one line of a move, drawn, loses a byte or has a bit flipped.
"""

import re
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from common.command import parser_of
from common.rig_trial import ForceLaw, RigCase, open_rig
from common.tables import print_table, wilson_interval

from softcal.core.errors import DeviceError
from softcal.station.interfaces import Move
from softcal.station.motion.monitored_bench import bounds_of
from softcal.station.motion.motion import TICK_S

STIFFEST_N_MM, LIMIT_N, WAY_MM, SEEDS = 1000.0, 12.0, 0.06, 60
STEP_MM_S = 1.5
"""A step of 17 um at this speed takes 0.03 s; a slower one would gain nothing on a press that a stop holds."""

LINE_S = 0.02
"""How long a reading may be on its way."""

Spoil = Callable[[bytes, np.random.Generator], bytes]


def _lose(line: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(len(line) - 1))
    return line[:at] + line[at + 1 :]


def _flip(line: bytes, rng: np.random.Generator) -> bytes:
    wrong = bytearray(line)
    wrong[int(rng.integers(len(line) - 1))] ^= 1 << int(rng.integers(7))
    return bytes(wrong)


SPOILS: dict[str, Spoil] = {
    "nothing": lambda line, rng: line,
    "the host is 0.2 s late": lambda line, rng: line,
    "a byte is lost": _lose,
    "a bit is flipped": _flip,
}


class Trial(NamedTuple):
    """One press onto a rigid thing: the largest force, and how long it took to come upon it."""

    force_N: float
    seconds: float


def main() -> None:
    """Press onto a rigid thing in both ways, with each fault, and print the forces."""
    options = parser_of(__doc__, "six draws of each").parse_args()
    draws = range(6 if options.quick else SEEDS)
    head = "way | what happens | presses | largest force, N | above 18 N | 95 % interval (Wilson) | mm/s"
    print_table(head, _rows(draws))


def _rows(draws: range) -> Iterator[tuple[object, ...]]:
    for way, press in (("a feed that a stop holds", _feed), ("steps that end by themselves", _step)):
        for what, spoil in SPOILS.items():
            trials = [_press(press, spoil, seed, 0.2 if "late" in what else 0.0) for seed in draws]
            above = sum(trial.force_N > 18.0 for trial in trials)
            speed_mm_s = WAY_MM / np.median([trial.seconds for trial in trials])
            yield (
                way,
                what,
                len(trials),
                f"{max(t.force_N for t in trials):.1f}",
                above,
                wilson_interval(above, len(trials)),
                f"{speed_mm_s:.2f}",
            )


def _press(press: Callable[..., None], spoil: Spoil, seed: int, late_s: float) -> Trial:
    rng = np.random.default_rng([seed, 73])
    law = ForceLaw(0.0, 1.0, stop_mm=WAY_MM, stop_N_mm=float(STIFFEST_N_MM * rng.uniform(0.3, 1.0)))
    case = RigCase(
        law=law,
        limit_N=LIMIT_N,
        latency_s=0.0,
        surface_mm=2.2 + rng.uniform(0.0, 0.9),
        approach_mm=1.0,
        stiffest_N_mm=STIFFEST_N_MM,
        seed=seed,
    )
    with open_rig(case) as (bench, station):
        stage, force = bench.stage, station.rig
        stage.home()
        stage.begin(Move(case.surface_mm, 5.0))
        while stage.is_moving:
            bench.clock.sleep_s(TICK_S)
            stage.poll()
        if spoil in (_lose, _flip):
            _spoil_one(station.stage_wire, spoil, rng, int(rng.integers(1, 4)))
        began_s = bench.clock.now_s()
        try:
            press(bench, late_s, rng)
        except DeviceError:
            stage.stop()
        took_s = bench.clock.now_s() - began_s
        bench.clock.sleep_s(1.0)
        return Trial(force.largest_force_N, took_s)


def _spoil_one(wire: object, spoil: Spoil, rng: np.random.Generator, nth: int) -> None:
    """Spoil the nth line that moves the stage, where it comes to the controller."""
    receive, remaining = wire.receive, [nth]  # type: ignore[attr-defined]

    def spoil_answer() -> bytes:
        def once(match: re.Match[bytes]) -> bytes:
            remaining[0] -= 1
            return spoil(match[0], rng) if remaining[0] == 0 else match[0]

        return re.sub(rb"G90[^\n]*\n", once, receive())

    wire.receive = spoil_answer  # type: ignore[attr-defined]


def _feed(bench, late_s, rng) -> None:  # type: ignore[no-untyped-def]
    bounds, cell = bounds_of(bench), Cell(bench, late_s, rng)
    detected_N = bounds.rise_N(0.0)
    speed_mm_s = bounds.detected_mm_s(detected_N)
    to_mm = bench.stage.position_mm + 2 * WAY_MM
    bench.stage.begin(Move(to_mm, speed_mm_s, bounds.ahead_mm(speed_mm_s, detected_N)))
    cell.watch(detected_N)


def _step(bench, late_s, rng) -> None:  # type: ignore[no-untyped-def]
    bounds, at_mm, cell = bounds_of(bench), bench.stage.position_mm, Cell(bench, late_s, rng)
    end_mm, detected_N = at_mm + 2 * WAY_MM, bounds.rise_N(0.0)
    while at_mm < end_mm and cell.force_N <= detected_N:
        at_mm += (bounds.ceiling_N - max(0.0, cell.force_N)) / STIFFEST_N_MM
        bench.stage.begin(Move(at_mm, STEP_MM_S))
        cell.watch(detected_N)
        cell.await_fresh()


class Cell:
    """The load cell as a run reads it: look at the stage, which feeds it, then at the force."""

    def __init__(self, bench, late_s: float, rng: np.random.Generator) -> None:  # type: ignore[no-untyped-def]
        self._bench, self._late_s, self._rng = bench, late_s, rng
        self._zero_N, self.force_N = 0.0, 0.0
        bench.force.start()
        self._zero_N = self.await_fresh()

    def await_fresh(self) -> float:
        """Return a force that was taken after now."""
        end_s = self._bench.clock.now_s() + 1.0 / self._bench.force.rate_Hz + LINE_S
        while True:
            self._bench.clock.sleep_s(TICK_S)
            samples = self._bench.force.poll()
            if samples and samples[-1].host_s > end_s:
                self.force_N = samples[-1].values[0] - self._zero_N
                return self.force_N

    def watch(self, detected_N: float) -> None:
        """Follow a move, and stop it when more force has come than that."""
        while self._bench.stage.is_moving:
            self._bench.clock.sleep_s(TICK_S + (self._late_s if self._rng.random() < 0.1 else 0.0))
            self._bench.stage.poll()
            for sample in self._bench.force.poll():
                self.force_N = sample.values[0] - self._zero_N
            if self.force_N > detected_N:
                self._bench.stage.stop()
                return


if __name__ == "__main__":
    main()
