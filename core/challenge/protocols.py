"""Protocols of the stage in a run: ramps, steps with holds, random paths, rest, and experiments."""

from collections.abc import Callable, Iterable

import numpy as np

from softcal.core.challenge.rig import Path
from softcal.core.recording import Array, Rng

RUN_S = 40.0
"""Length of an ordinary run: four of them are a case of about 8,000 samples at 50 Hz."""


class _PathBuilder:
    def __init__(self, rest_s: float) -> None:
        self.times, self.positions_mm = [0.0, rest_s], [0.0, 0.0]

    def go(self, position_mm: float, speed_mm_s: float) -> None:
        self.times.append(self.times[-1] + abs(position_mm - self.positions_mm[-1]) / speed_mm_s)
        self.positions_mm.append(position_mm)

    def stay(self, duration_s: float) -> None:
        self.times.append(self.times[-1] + duration_s)
        self.positions_mm.append(self.positions_mm[-1])

    def press(self, depth_mm: float, speed_mm_s: float, rest_s: float) -> None:
        self.go(depth_mm, speed_mm_s)
        self.go(0.0, speed_mm_s)
        self.stay(rest_s)

    def path(self, name: str, duration_s: float | None = None) -> Path:
        """Return the path, cut off after a duration where there is one."""
        times, positions_mm = np.array(self.times), np.array(self.positions_mm)
        if duration_s is None:
            return Path(name, times, positions_mm)
        is_within, last_mm = times < duration_s, float(np.interp(duration_s, times, positions_mm))
        return Path(name, np.append(times[is_within], duration_s), np.append(positions_mm[is_within], last_mm))

    @property
    def now_s(self) -> float:
        return self.times[-1]


def log_uniform(rng: Rng, low: float, high: float) -> float:
    """Draw a number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _ramps(name: str, rng: Rng, depth_mm: float, draw_mm_s: Callable[[Rng], float]) -> Path:
    pen = _PathBuilder(rng.uniform(0.6, 2.0))
    while pen.now_s < RUN_S:
        speed_mm_s = draw_mm_s(rng)
        pen.press(depth_mm * rng.uniform(0.75, 1.0), speed_mm_s, rng.uniform(0.2, 1.0))
    return pen.path(name, RUN_S)


def steps_with_holds(rng: Rng, depth_mm: float) -> Path:
    """Step up and down a staircase and hold on every step."""
    pen = _PathBuilder(rng.uniform(0.6, 2.0))
    while pen.now_s < RUN_S:
        levels = np.sort(rng.uniform(0.2, 1.0, rng.integers(2, 5)))
        for level in [*levels, *levels[:-1][::-1]]:
            pen.go(depth_mm * float(level), 5.0)
            pen.stay(rng.uniform(1.5, 4.0))
        pen.go(0.0, 5.0)
        pen.stay(rng.uniform(1.5, 4.0))
    return pen.path("steps with holds", RUN_S)


def random_path(rng: Rng, depth_mm: float, duration_s: float = RUN_S) -> Path:
    """Return a path to random depths at random speeds, with occasional rests."""
    pen = _PathBuilder(rng.uniform(0.6, 2.0))
    while pen.now_s < duration_s:
        position_mm = 0.0 if rng.random() < 0.2 else depth_mm * rng.uniform(0.0, 1.0)
        pen.go(position_mm, log_uniform(rng, 0.4, 5.0))
        if rng.random() < 0.3:
            pen.stay(rng.uniform(0.2, 2.0))
    return pen.path("random", duration_s)


def one_rich_run(rng: Rng, depth_mm: float) -> Path:
    """A ramp of each speed, a few holds, a random stretch, rest at both ends, in one run."""
    pen = _PathBuilder(1.0)
    for speed_mm_s in (0.4, 4.0, 1.5):
        pen.press(depth_mm * rng.uniform(0.85, 1.0), speed_mm_s, 0.7)
    for level in rng.uniform(0.2, 1.0, 3):
        pen.go(depth_mm * float(level), 5.0)
        pen.stay(2.5)
    for level in rng.uniform(0.0, 1.0, 10):
        pen.go(depth_mm * float(level), rng.uniform(0.7, 4.0))
    pen.go(0.0, 2.0)
    pen.stay(2.0)
    return pen.path("one rich run")


def kept_back(rng: Rng, depth_mm: float) -> Path:
    """Return a held-out protocol: growing ramps, a hold at mid-depth, an interrupted descent."""
    pen = _PathBuilder(1.0)
    for share in (0.45, 0.7, 0.95):
        pen.go(depth_mm * share, rng.uniform(0.8, 1.6))
        pen.stay(rng.uniform(0.0, 2.5))
        pen.go(depth_mm * share * 0.4, rng.uniform(0.8, 3.0))
        pen.stay(rng.uniform(0.5, 2.0))
        pen.go(0.0, rng.uniform(0.8, 3.0))
        pen.stay(1.0)
    return pen.path("kept back", RUN_S)


def long_hold(rng: Rng, depth_mm: float) -> Path:
    """Hold for five minutes, then rest for half as long."""
    pen = _PathBuilder(2.0)
    pen.go(0.9 * depth_mm, 5.0)
    pen.stay(300.0)
    pen.go(0.0, 5.0)
    pen.stay(150.0)
    return pen.path("long hold")


def _presses(name: str, mm: float, presses: Iterable[tuple[float, float]], rest_s: float = 0.0) -> Path:
    """Press to each share of the depth at its speed in mm/s, then rest."""
    pen = _PathBuilder(2.0)
    for share, speed_mm_s in presses:
        pen.press(share * mm, speed_mm_s, 1.0)
    if rest_s:
        pen.stay(rest_s)
    return pen.path(name)


def small_reversals(rng: Rng, depth_mm: float) -> Path:
    """Reverse by a few per cent of the depth, at three depths and two speeds."""
    pen = _PathBuilder(2.0)
    for centre in (0.3, 0.6, 0.85):
        for speed_mm_s in (0.2, 2.0):
            for swing in (0.04, 0.08, 0.12):
                pen.go((centre + swing) * depth_mm, speed_mm_s)
                pen.go((centre - swing) * depth_mm, speed_mm_s)
    pen.go(0.0, 2.0)
    pen.stay(2.0)
    return pen.path("small reversals")


PROTOCOLS: dict[str, Callable[[Rng, float], Path]] = {
    "slow_ramps": lambda rng, mm: _ramps("slow ramps", rng, mm, lambda rng: rng.uniform(0.25, 0.5)),
    "fast_ramps": lambda rng, mm: _ramps("fast ramps", rng, mm, lambda rng: rng.uniform(2.0, 5.0)),
    "one_speed_ramps": lambda rng, mm: _ramps("ramps at 1 mm/s", rng, mm, lambda _: 1.0),
    "mixed_ramps": lambda rng, mm: _ramps("ramps of mixed speed", rng, mm, lambda rng: log_uniform(rng, 0.4, 4.0)),
    "steps_with_holds": steps_with_holds,
    "random": random_path,
    "one_rich_run": one_rich_run,
    "kept_back": kept_back,
    "lot_source": lambda rng, mm: random_path(rng, mm, 180.0),
    "lot_unit": lambda rng, mm: random_path(rng, mm, 90.0),
    "rest": lambda rng, mm: _PathBuilder(120.0).path("rest"),
    "long_hold": long_hold,
    "rate_sweep": lambda rng, mm: _presses("rate sweep", mm, [(0.95, v) for v in (0.2, 5.0, 0.5, 2.0, 1.0, 5.0)]),
    # Twice to each of four growing depths, and once more to the second.
    "amplitude_ladder": lambda rng, mm: _presses(
        "amplitude ladder", mm, [(share, 1.0) for share in (0.3, 0.3, 0.5, 0.5, 0.7, 0.7, 0.9, 0.9, 0.5)], 20.0
    ),
    "slow_touch_down": lambda rng, mm: _presses("slow touch-down", mm, [(0.3, 0.05)] * 2),
    "small_reversals": small_reversals,
}
"""Paths by name; each takes a generator and the depth in mm of the rig's peak force.

The unit that is the source of a lot is pressed at random for three minutes, each of the others, and
in its audit, for half as long.
"""


def weights(rng: Rng, peak_N: float) -> tuple[Array, Array]:
    """Dead weights on the cell, up and down: corner times in s and forces in N."""
    steps = np.concatenate([np.linspace(0.0, peak_N, 6), np.linspace(peak_N, 0.0, 6)[1:]])
    starts_s = 8.0 * np.arange(len(steps))
    times = np.ravel(np.column_stack([starts_s, starts_s + 7.5]))
    return times, np.repeat(steps, 2)
