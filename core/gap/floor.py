"""The noise floor: is what a hypothesis leaves noise, and is it the same noise everywhere?

Noise that fades looks like a gap, and a gap that nothing explains could be called noise. What is left counts as noise
only where it passes three tests. What fades of it is as strong at rest as under load. It follows nothing that the chain
knows: depth, speed, load, time, temperature, what came before. And nothing of it is seen in two channels at once.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.optimize import minimize_scalar

from softcal.core.gap.case import Mask
from softcal.core.gap.colour import Colour, Stretch, log_likelihood, read_noise
from softcal.core.gap.fit import Fit
from softcal.core.gap.library import variables
from softcal.core.gap.linear import combine, dots
from softcal.core.gap.problem import Block, Problem
from softcal.core.gap.start import noise_levels
from softcal.core.recording import Array


@dataclass(frozen=True)
class FloorConfig:
    """When what is left counts as noise.

    Args:
        uneven: log likelihood that noise of its own at rest, and of its own under load, may gain over the same fading
            noise in both: two numbers more gain 1 on average and 9 in one of 10,000.
        coherent: standard errors by which what is left may follow the variables of the chain.
        fewest: samples at rest and under load, each, that tell; fewer do not test.
    """

    uneven: float = 14.0
    coherent: float = 4.5
    fewest: int = 100


CONFIG = FloorConfig()

WANDERS = 0.9
"""Share of the longest fading time from which a time stands on its bound."""


def noise_of(found: Fit) -> tuple[dict[str, float], dict[str, Colour]]:
    """Return the white noise of every channel and, where the problem has some that fades, that part anew."""
    levels = noise_levels(found)
    if not found.problem.colour:
        return levels, {}
    return _noise_of(found, levels, tuple(found.problem.colour))


def coloured(found: Fit) -> Problem | None:
    """Return the problem of a fit with noise that fades, read from what the fit leaves; None where it is white."""
    problem = found.problem
    # A measured force that drives the chain brings its own noise along; it cannot be told from the output's.
    if problem.is_driven_by_force:
        return None
    levels, colours = _noise_of(found, noise_levels(found), problem.scored_channels)
    return problem.with_noise(levels, colours) if colours else None


def _noise_of(
    found: Fit, levels: dict[str, float], channels: Sequence[str]
) -> tuple[dict[str, float], dict[str, Colour]]:
    colours = {}
    for channel in channels:
        noise = read_noise([_stretch(found, b) for b in _blocks(found, channel)], found.problem.colour_config)
        if noise.gain > found.problem.colour_config.gain:
            levels[channel], colours[channel] = noise.white, noise.colour
    return levels, colours


def _blocks(found: Fit, channel: str) -> list[Block]:
    return [b for b in found.problem.blocks if b.channel == channel]


def _stretch(found: Fit, block: Block, use: Array | None = None) -> Stretch:
    error = (found.problem.measured - found.predicted)[block.place]
    step_s = found.problem.case.runs[block.run].step_s
    return Stretch(error, step_s, np.ones(len(error)) if use is None else use)


Halves: TypeAlias = Callable[[Fit, Block], Mask | None]
"""Which samples of a channel of a run, (n,), lie in one of two conditions; None where nothing tells."""

Variables: TypeAlias = Callable[[Fit, str], Iterable[Mapping[str, Array]]]
"""What the residual of a channel may follow: (samples,) columns by name, in groups that are tested one by one."""


def under_load(found: Fit, block: Block) -> Mask | None:
    """Return where the sensor of the twin is pressed."""
    run = found.problem.case.runs[block.run]
    return None if run.kind != "press" or run.stage_mm is None else run.stage_mm > found.base.u0_mm


def of_chain(found: Fit, channel: str) -> list[Mapping[str, Array]]:
    """Return what the chain of the twin knows, as one group."""
    return [variables(found, channel)]


def is_noise(found: Fit, halves: Sequence[Halves] = (under_load,), follows: Variables = of_chain) -> bool:
    """Whether what a fit leaves in its channels of coloured noise fades, and passes the three tests."""
    # What has not faded by the longest time that is tried is no noise but a wander: an R0 that walks, a drift.
    longest_s = found.problem.colour_config.longest_s
    if any(colour.fading_s > WANDERS * longest_s for colour in found.problem.colour.values()):
        return False
    return all(
        all(_is_even(found, channel, half) for half in halves) and _is_free(found, channel, follows)
        for channel in found.problem.colour
    )


def _is_even(found: Fit, channel: str, half: Halves) -> bool:
    """Whether one fading noise fits both conditions, as rest and load, alike; white noise may grow with the load."""
    problem = found.problem
    parts: dict[bool, list[Stretch]] = {False: [], True: []}
    for block in _blocks(found, channel):
        is_inside = half(found, block)
        if is_inside is not None:
            parts[True].append(_stretch(found, block, is_inside.astype(np.float64)))
            parts[False].append(_stretch(found, block, (~is_inside).astype(np.float64)))
    if any(sum(float(s.use.sum()) for s in part) < CONFIG.fewest for part in parts.values()):
        return True
    white, colour = problem.sigma[channel], problem.colour[channel]
    gain = sum(
        read_noise(part, problem.colour_config).log_likelihood - _with_own_white(part, white, colour)
        for part in parts.values()
    )
    return gain < CONFIG.uneven


def _with_own_white(part: Sequence[Stretch], white: float, colour: Colour) -> float:
    """Return the largest log likelihood of a part with this fading noise, whatever its white noise."""
    found = minimize_scalar(
        lambda x: -log_likelihood(part, white * float(np.exp(x)), colour), bounds=(-2.0, 2.0), method="bounded"
    )
    return -float(found.fun)


def _is_free(found: Fit, channel: str, follows: Variables) -> bool:
    """Whether what is left follows none of the variables more than noise does by chance."""
    groups = [[*group.values(), *_elsewhere(found, channel)] for group in follows(found, channel)]
    return not any(_is_followed(found, columns) for columns in groups)


def _is_followed(found: Fit, columns: Sequence[Array]) -> bool:
    seen = projected([found.problem.whitened(column) for column in columns], found.jacobian)
    by_chance = len(seen)
    if not by_chance:
        return False
    # The cube root of χ² over its degrees of freedom is nearly normal, for few of them too (Wilson and Hilferty 1931).
    gain, wide = float(np.sum(dots(seen, found.residual) ** 2)) / by_chance, 2.0 / (9.0 * by_chance)
    return bool(np.cbrt(gain) > 1.0 - wide + CONFIG.coherent * np.sqrt(wide))


def _elsewhere(found: Fit, channel: str) -> list[Array]:
    """Return what the channel before this one leaves of the same runs: noise of two channels has nothing in common."""
    problem, out = found.problem, np.zeros(len(found.problem.measured))
    others = {b.run: b for name in problem.scored_channels if name != channel for b in _blocks(found, name)}
    for block in _blocks(found, channel):
        if block.run in others and problem.case.runs[block.run].kind == "press":
            out[block.place] = (problem.measured - found.predicted)[others[block.run].place]
    return [out] if out.any() else []


def projected(rows: Sequence[Array], held: Array) -> Array:
    """Return (k, n) orthonormal rows that span what others, (m, n), leave of these."""
    away = orthonormal(np.asarray(held))
    left = [row - combine(dots(away, row), away) for row in rows] if len(away) else list(rows)
    return orthonormal(np.array([row for row, whole in zip(left, rows, strict=True) if _stands(row, whole)]))


def _stands(row: Array, whole: Array) -> bool:
    # What the fit imitates to a ten-thousandth of its energy is rounding.
    return float(row @ row) > 1e-4 * float(whole @ whole) > 0.0


def orthonormal(rows: Array) -> Array:
    """Return (k, n) orthonormal rows that span (m, n) rows; directions below a millionth of the strongest are left."""
    if not len(rows):
        return np.zeros((0, 0))
    size = np.sqrt(np.sum(rows**2, axis=1))
    unit = rows[size > 0.0] / size[size > 0.0][:, None]
    if not len(unit):
        return np.zeros((0, rows.shape[1]))
    strength, axes = np.linalg.eigh(unit @ unit.T)
    keep = strength > 1e-6 * strength[-1]
    return np.asarray((axes[:, keep] / np.sqrt(strength[keep])).T @ unit)
