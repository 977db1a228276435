"""The noise floor: is what a hypothesis leaves noise, and is it the same noise everywhere?

A gap that nothing explains could be called noise, and noise that fades looks like a gap. What is left counts as noise
only where it passes these tests. It is no larger than its noise level. It follows nothing that is known of the runs:
depth, speed, load, time, temperature, what came before, its own past, another channel at the same time. And what fades
of it fades in time and is as strong at rest as under load.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TypeAlias

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import ndtr

from softcal.core.gap.case import Mask
from softcal.core.gap.colour import Colour, Stretch, log_likelihood, read_noise
from softcal.core.gap.fit import Fit
from softcal.core.gap.library import variables
from softcal.core.gap.linear import combine, dots
from softcal.core.gap.method import METHOD
from softcal.core.gap.problem import Block, Problem
from softcal.core.gap.start import noise_levels
from softcal.core.recording import Array

CONFIG = METHOD.floor


def noise_of(found: Fit) -> tuple[dict[str, float], dict[str, Colour]]:
    """Return the white noise of every channel and, where there is one, the fading part."""
    levels = noise_levels(found)
    if not found.problem.colour:
        return levels, {}
    return _noise_of(found, levels, tuple(found.problem.colour))


def coloured(found: Fit) -> Problem | None:
    """Return the problem with noise that fades, read from what is left; None where it is white."""
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
        noise = read_noise([_stretch(found, b) for b in found.problem.blocks_of(channel)], found.problem.colour_config)
        if noise.gain > found.problem.colour_config.gain:
            levels[channel], colours[channel] = noise.white, noise.colour
    return levels, colours


def _stretch(found: Fit, block: Block, use: Array | None = None) -> Stretch:
    error = (found.problem.measured - found.predicted)[block.place]
    step_s = found.problem.case.runs[block.run].step_s
    return Stretch(error, step_s, np.ones(len(error)) if use is None else use)


Halves: TypeAlias = Callable[[Fit, Block], Mask | None]
"""Which samples of a block, (n,), lie in one of two conditions; None where nothing tells."""

Variables: TypeAlias = Callable[[Fit, str], Iterable[Mapping[str, Array]]]
"""What the residual of a channel may follow: groups of (samples,) columns by name."""


def under_load(found: Fit, block: Block) -> Mask | None:
    """Return where the sensor of the twin is pressed."""
    run = found.problem.case.runs[block.run]
    return None if run.kind != "press" or run.stage_mm is None else run.stage_mm > found.base.u0_mm


def of_chain(found: Fit, channel: str) -> list[Mapping[str, Array]]:
    """Return what the chain of the twin knows, as one group."""
    return [variables(found, channel)]


def is_noise(found: Fit, halves: Sequence[Halves] = (under_load,), follows: Variables = of_chain) -> bool:
    """Whether what a fit leaves in channels of fading noise fades alike everywhere and passes for noise."""
    # What has not faded by the longest time that is tried is no noise but a wander: an R0 that walks, a drift.
    longest_s = found.problem.colour_config.longest_s
    if any(colour.fading_s > CONFIG.wanders * longest_s for colour in found.problem.colour.values()):
        return False
    is_even = all(_is_even(found, channel, half) for half in halves for channel in found.problem.colour)
    return is_even and noise_chance(found, tuple(found.problem.colour), follows) > CONFIG.chance


def noise_chance(found: Fit, channels: Sequence[str] = (), follows: Variables = of_chain) -> float:
    """Return how likely noise alone leaves as much as a fit does: its size, its memory, and what it follows.

    Args:
        channels: those that are looked at; all that are scored where none is named.
    """
    return min(_chance(found, channel, follows) for channel in channels or found.problem.scored_channels)


def _chance(found: Fit, channel: str, follows: Variables) -> float:
    # A measured force that drives the chain is smoothed: what is left of its noise has a memory, and is small.
    tests = [_strays(found, channel)] if channel not in found.problem.colour else []
    if not found.problem.is_driven_by_force:
        # A filter has taken the memory out of noise that fades, and its size was read off what is left.
        tests += [_remembers(found, channel)] if tests else []
        groups = [[*group.values(), *_elsewhere(found, channel)] for group in follows(found, channel)]
        tests += [_follows(found, columns) for columns in groups]
    # The worst of several tests (Bonferroni).
    return min(1.0, len(tests) * float(ndtr(-max(tests)))) if tests else 1.0


def _strays(found: Fit, channel: str) -> float:
    """Return by how many standard errors the mean square of a residual is above that of noise."""
    squares = np.concatenate([found.residual[b.place] for b in found.problem.blocks_of(channel)]) ** 2
    count = int(np.count_nonzero(squares))
    # The noise level was estimated from the same samples: its error adds as much as it takes.
    return (float(np.sum(squares)) - count) / float(np.sqrt(2.0 * max(count, 1)))


def _is_even(found: Fit, channel: str, half: Halves) -> bool:
    """Whether one fading noise fits both conditions alike; white noise may grow with the load."""
    problem = found.problem
    parts: dict[bool, list[Stretch]] = {False: [], True: []}
    for block in found.problem.blocks_of(channel):
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
    """Return the largest log likelihood of a part with this fading noise and any white one."""
    minimum = minimize_scalar(
        lambda x: -log_likelihood(part, white * float(np.exp(x)), colour), bounds=(-2.0, 2.0), method="bounded"
    )
    return -float(minimum.fun)


def _remembers(found: Fit, channel: str) -> float:
    """Return by how many standard errors a residual follows its own past (Box and Pierce 1970)."""
    parts = [found.residual[b.place] for b in found.problem.blocks_of(channel)]
    products, count = np.zeros(CONFIG.lags), 0
    for part in parts:
        count += len(part)
        products += [float(part[k:] @ part[:-k]) for k in range(1, CONFIG.lags + 1)]
    energy = sum(float(part @ part) for part in parts)
    return _standard(count * float(np.sum((products / energy) ** 2)), CONFIG.lags) if energy > 0.0 else 0.0


def _follows(found: Fit, columns: Sequence[Array]) -> float:
    """Return by how many standard errors a residual lies along (samples,) columns."""
    seen = projected([found.problem.whitened(column) for column in columns], found.jacobian)
    # A direction takes 1 off χ² by chance.
    return _standard(float(np.sum(dots(seen, found.residual) ** 2)), len(seen)) if len(seen) else 0.0


def _standard(chi2: float, freedom: int) -> float:
    """Return χ² as a standard normal value (Wilson and Hilferty 1931)."""
    wide = 2.0 / (9.0 * freedom)
    return float((np.cbrt(chi2 / freedom) - 1.0 + wide) / np.sqrt(wide))


def _elsewhere(found: Fit, channel: str) -> list[Array]:
    """Return what another channel leaves of the same runs: their noises have nothing in common."""
    problem, out = found.problem, np.zeros(len(found.problem.measured))
    others = {b.run: b for name in problem.scored_channels if name != channel for b in found.problem.blocks_of(name)}
    for block in found.problem.blocks_of(channel):
        if block.run in others and problem.case.runs[block.run].kind == "press":
            out[block.place] = (problem.measured - found.predicted)[others[block.run].place]
    return [out] if out.any() else []


def projected(rows: Sequence[Array], held: Array) -> Array:
    """Return (k, n) orthonormal rows that span what others, (m, n), leave of these."""
    away = orthonormal(np.asarray(held))
    left = [row - combine(dots(away, row), away) for row in rows] if len(away) else list(rows)
    # What the fit imitates to a ten-thousandth of its energy is rounding.
    stand = [row for row, whole in zip(left, rows, strict=True) if float(row @ row) > 1e-4 * float(whole @ whole) > 0.0]
    return orthonormal(np.array(stand))


def orthonormal(rows: Array) -> Array:
    """Return (k, n) orthonormal rows that span rows, but for those a millionth as strong."""
    if not len(rows):
        return np.zeros((0, 0))
    size = np.sqrt(np.sum(rows**2, axis=1))
    unit = rows[size > 0.0] / size[size > 0.0][:, None]
    if not len(unit):
        return np.zeros((0, rows.shape[1]))
    strength, axes = np.linalg.eigh(unit @ unit.T)
    keep = strength > 1e-6 * strength[-1]
    return np.asarray((axes[:, keep] / np.sqrt(strength[keep])).T @ unit)
