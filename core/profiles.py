"""Stage profiles as data: straight moves, holds and rests, for the twin and the stage."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from softcal.core.errors import InputError
from softcal.core.messages.reason import Reason, reason
from softcal.core.recording import Array, Rng

NAME_AND_SIZE = re.compile(r"(\D+?) (\d.*)", re.DOTALL)
"""A name that says what the profile was made with: `ramps 0.6 mm/s`."""


@dataclass(frozen=True)
class Segment:
    """One straight piece of a profile; one that ends where it began is a hold."""

    target_mm: float
    duration_s: float


@dataclass(frozen=True)
class Profile:
    """A stage profile that begins at rest at position 0.

    Raises:
        InputError: no segment, or one without duration.
    """

    name: str
    segments: tuple[Segment, ...]

    def __post_init__(self) -> None:
        if not self.segments:
            raise InputError(f"profile {self.name!r} has no segment")
        for k, segment in enumerate(self.segments):
            if not (np.isfinite(segment.target_mm) and np.isfinite(segment.duration_s) and segment.duration_s > 0):
                raise InputError(f"profile {self.name!r}, segment {k}: {segment}; finite target, duration above 0 s")

    @property
    def duration_s(self) -> float:
        return sum(segment.duration_s for segment in self.segments)

    @property
    def deepest_mm(self) -> float:
        return max(segment.target_mm for segment in self.segments)

    @property
    def fastest_mm_s(self) -> float:
        positions = self._corner_mm
        return float(max(abs(np.diff(positions)) / [segment.duration_s for segment in self.segments]))

    @property
    def presses(self) -> int:
        """How often the stage turns from going deeper to going back."""
        steps = np.sign(np.diff(self._corner_mm))
        moved = steps[steps != 0]
        return int(np.count_nonzero((moved[:-1] > 0) & (moved[1:] < 0)))

    @property
    def _corner_mm(self) -> Array:
        return np.array([0.0, *(segment.target_mm for segment in self.segments)])

    def position_mm(self, t_s: Array) -> Array:
        """Return the stage position at instants t_s (s since the start); after the end it stays."""
        corners_s = np.concatenate([[0.0], np.cumsum([segment.duration_s for segment in self.segments])])
        return np.asarray(np.interp(t_s, corners_s, self._corner_mm))

    def sample(self, rate_Hz: float) -> tuple[Array, Array]:
        """Return t_s and stage_mm, (n,) each, at this rate from 0 s to the end of the profile."""
        t_s = np.arange(int(self.duration_s * rate_Hz) + 1) / rate_Hz
        return t_s, self.position_mm(t_s)

    def then(self, other: "Profile", name: str) -> "Profile":
        return Profile(name, self.segments + other.segments)


def moves(name: str, targets_mm: Sequence[float], speeds_mm_s: Sequence[float], holds_s: Sequence[float]) -> Profile:
    """Return straight moves with a hold after each, (m,) of each number; a hold of 0 s is none."""
    segments, at_mm = [], 0.0
    for target_mm, speed_mm_s, hold_s in zip(targets_mm, speeds_mm_s, holds_s, strict=True):
        if speed_mm_s <= 0:
            raise InputError(f"profile {name!r}: speed {speed_mm_s} mm/s; a speed above 0 was expected")
        if target_mm != at_mm:
            segments.append(Segment(target_mm, abs(target_mm - at_mm) / speed_mm_s))
        if hold_s > 0:
            segments.append(Segment(target_mm, hold_s))
        at_mm = target_mm
    return Profile(name, tuple(segments))


def rest(duration_s: float) -> Profile:
    """Return a rest: nothing is pressed."""
    return Profile(f"rest {duration_s:g} s", (Segment(0.0, duration_s),))


def ramps(depths_mm: Sequence[float], speed_mm_s: float, rest_s: float = 2.0, name: str | None = None) -> Profile:
    """Return one triangle per depth at one speed, with a rest before and after all of them."""
    count = len(depths_mm)
    targets = [0.0, *np.column_stack([depths_mm, np.zeros(count)]).ravel().tolist()]
    holds = [rest_s] + [0.0] * (2 * count - 1) + [rest_s]
    return moves(name or f"ramps {speed_mm_s:g} mm/s", targets, [speed_mm_s] * len(targets), holds)


def rate_sweep(depth_mm: float, speeds_mm_s: Sequence[float] = (0.2, 0.5, 1.0, 2.0, 5.0)) -> Profile:
    """Return one triangle to the same depth at each speed, 2 s of rest between them."""
    targets = [0.0] + [depth_mm, 0.0] * len(speeds_mm_s)
    speeds = [1.0, *np.repeat(speeds_mm_s, 2).tolist()]
    return moves("rate sweep", targets, speeds, [2.0] + [0.0, 2.0] * len(speeds_mm_s))


def steps_with_holds(depths_mm: Sequence[float], hold_s: float = 8.0, speed_mm_s: float = 4.0) -> Profile:
    """Return fast steps through the depths and back to 0, each followed by a hold."""
    targets = [0.0, *depths_mm, 0.0]
    return moves("steps with holds", targets, [speed_mm_s] * len(targets), [2.0] + [hold_s] * (len(targets) - 1))


def long_hold(depth_mm: float, hold_s: float = 400.0, speed_mm_s: float = 4.0) -> Profile:
    """Return one fast step, a long hold and a long recovery."""
    return moves("long hold", [0.0, depth_mm, 0.0], [speed_mm_s] * 3, [2.0, hold_s, hold_s / 2])


def amplitude_ladder(depth_mm: float, speed_mm_s: float = 1.0, rest_s: float = 60.0) -> Profile:
    """Return pairs of triangles of growing depth, a rest, and the first pair again."""
    ladder = [depth_mm * part for part in (0.5, 0.5, 0.75, 0.75, 1.0, 1.0)]
    climb = ramps(ladder, speed_mm_s, name="amplitude ladder")
    return climb.then(rest(rest_s), "amplitude ladder").then(ramps(ladder[:2], speed_mm_s), "amplitude ladder")


def slow_touch_down(depth_mm: float = 0.8, speed_mm_s: float = 0.05) -> Profile:
    """Return one slow approach through the first contact and back."""
    return ramps([depth_mm], speed_mm_s, name="slow touch-down")


def small_reversals(depth_mm: float, stroke_mm: float = 0.4) -> Profile:
    """Return a climb with small reversals on the way, slow and fast: minor loops."""
    levels = depth_mm * np.array([0.4, 0.6, 0.8, 1.0])
    targets, speeds = [0.0], [1.0]
    for speed_mm_s in (0.5, 3.0):
        for level in levels:
            targets += [float(level), float(level) - stroke_mm, float(level)]
            speeds += [speed_mm_s] * 3
        targets.append(0.0)
        speeds.append(speed_mm_s)
    return moves("small reversals", targets, speeds, [2.0] + [0.0] * (len(targets) - 2) + [2.0])


def random_presses(
    rng: Rng, duration_s: float, depth_mm: float, fastest_mm_s: float = 5.0, return_share: float = 0.5
) -> Profile:
    """Return presses of "different rates and magnitudes", as the paper has them, with short holds.

    Args:
        duration_s: at least this long; the last press is finished and 1 s of rest follows.
        return_share: share of the moves that are followed by one back to 0.
    """
    targets, speeds, holds, spent_s, at_mm = [0.0], [1.0], [1.0], 1.0, 0.0
    while spent_s < duration_s or at_mm > 0:
        is_return = at_mm > 0 and (spent_s >= duration_s or rng.random() < return_share)
        target_mm = 0.0 if is_return else float(rng.uniform(0.25, 1.0) * depth_mm)
        speed_mm_s = float(np.exp(rng.uniform(np.log(fastest_mm_s / 10), np.log(fastest_mm_s))))
        hold_s = float(rng.choice([0.0, rng.uniform(0.2, 1.5)]))
        spent_s += abs(target_mm - at_mm) / speed_mm_s + hold_s
        targets.append(target_mm)
        speeds.append(speed_mm_s)
        holds.append(hold_s)
        at_mm = target_mm
    holds[-1] = max(holds[-1], 1.0)
    return moves("random presses", targets, speeds, holds)


def source_profile(rng: Rng, duration_s: float = 170.0, depth_mm: float = 3.5) -> Profile:
    """Return the long profile of a source unit: a rate sweep, steps with holds, random presses."""
    opening = rate_sweep(depth_mm, (0.5, 1.5, 4.0)).then(
        steps_with_holds([0.4 * depth_mm, 0.7 * depth_mm, depth_mm, 0.5 * depth_mm], hold_s=3.0), "opening"
    )
    remaining_s = max(10.0, duration_s - opening.duration_s)
    return opening.then(random_presses(rng, remaining_s, depth_mm), "source")


def unit_profile(rng: Rng, duration_s: float = 25.0, depth_mm: float = 3.5) -> Profile:
    """Return the short profile of a target unit: one full press, then random presses."""
    opening = ramps([depth_mm], 3.0, rest_s=1.0)
    remaining_s = max(5.0, duration_s - opening.duration_s)
    return opening.then(random_presses(rng, remaining_s, depth_mm), "unit")


BUILT_IN: Mapping[str, Callable[[Rng, float], Profile]] = {
    "source": lambda rng, depth_mm: source_profile(rng, depth_mm=depth_mm),
    "unit": lambda rng, depth_mm: unit_profile(rng, depth_mm=depth_mm),
    "ramps": lambda rng, depth_mm: ramps([depth_mm] * 3, 2.0),
    "rate sweep": lambda rng, depth_mm: rate_sweep(depth_mm),
    "steps with holds": lambda rng, depth_mm: steps_with_holds([depth_mm * part for part in (0.4, 0.7, 1.0, 0.5)]),
    "long hold": lambda rng, depth_mm: long_hold(depth_mm),
    "amplitude ladder": lambda rng, depth_mm: amplitude_ladder(depth_mm),
    "slow touch-down": lambda rng, depth_mm: slow_touch_down(min(0.8, depth_mm)),
    "small reversals": lambda rng, depth_mm: small_reversals(depth_mm),
    "random presses": lambda rng, depth_mm: random_presses(rng, 60.0, depth_mm),
}
"""The profiles there are, by name, for a depth in mm; any other is a file of moves."""


def describe_profile(name: str) -> Reason:
    """Return the name of a profile, as a recording keeps it, in words to be translated."""
    match = NAME_AND_SIZE.fullmatch(name)
    if match is None:
        return reason("gap.pressed", profile=name)
    return reason("gap.pressed.sized", profile=match[1], size=match[2])
