"""The noise floor: is what a hypothesis leaves noise, and is it the same noise everywhere?

What is left counts as noise where it is no larger than its level and follows nothing that is known
of the runs: depth, speed, load, time, temperature, what came before, its own past, another channel.
What fades of it fades in time and is as strong at rest as under load.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import TypeAlias

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import ndtr

from softcal.core.gap.case import Mask, Run
from softcal.core.gap.colour import Colour, Stretch, log_likelihood, read_noise
from softcal.core.gap.fit import Fit
from softcal.core.gap.linear import combine, dots
from softcal.core.gap.method import METHOD
from softcal.core.gap.problem import Block, Problem
from softcal.core.gap.start import noise_levels
from softcal.core.recording import Array
from softcal.core.twin.mechanics import elastic_force
from softcal.core.twin.signals import low_pass

CONFIG = METHOD.floor


def noise_of(found: Fit, channels: Iterable[str] | None = None) -> tuple[dict[str, float], dict[str, Colour]]:
    """Return white noise and, in these channels or where there already is one, the fading part."""
    levels, colours, config = noise_levels(found), {}, found.problem.colour_config
    for channel in found.problem.colour if channels is None else channels:
        noise = read_noise([_stretch(found, b) for b in found.problem.blocks_of(channel)], config)
        if noise.gain > config.gain:
            levels[channel], colours[channel] = noise.white, noise.colour
    return levels, colours


def coloured(found: Fit) -> Problem | None:
    """Return the problem with noise that fades, read from what is left; None where it is white."""
    problem = found.problem
    # The noise of a measured force that drives the chain cannot be told from the output's.
    if problem.is_driven_by_force:
        return None
    levels, colours = noise_of(found, problem.scored_channels)
    return problem.with_noise(levels, colours) if colours else None


def _stretch(found: Fit, block: Block, use: Array | None = None) -> Stretch:
    error = (found.problem.measured - found.predicted)[block.place]
    step_s = found.problem.case.runs[block.run].step_s
    return Stretch(error, step_s, np.ones(len(error)) if use is None else use)


Halves: TypeAlias = Callable[[Fit, Block], Mask | None]
"""Which samples of a block, (n,), lie in one of two conditions; None where nothing tells."""

Variables: TypeAlias = Callable[[Fit, str], Iterable[Sequence[Array]]]
"""What the residual of a channel may follow: groups of (samples,) columns."""


def under_load(found: Fit, block: Block) -> Mask | None:
    """Return where the sensor of the twin is pressed."""
    run = found.problem.case.runs[block.run]
    return None if run.kind != "press" or run.stage_mm is None else run.stage_mm > found.base.u0_mm


def of_chain(found: Fit, channel: str) -> list[list[Array]]:
    """Return what the chain of the base knows as one group, 0 outside the pressed runs."""
    problem, out = found.problem, dict[str, Array]()
    blocks = [b for b in problem.blocks_of(channel, "press") if problem.case.runs[b.run].stage_mm is not None]
    runs = [problem.case.runs[b.run] for b in blocks]
    depths = [np.maximum(np.asarray(run.stage_mm) - found.base.u0_mm, 0.0) for run in runs]
    loads = [elastic_force(depth, found.base.k1_N_mm, found.base.k3_N_mm3) for depth in depths]
    deepest, largest = (max((float(part.max()) for part in p), default=1.0) or 1.0 for p in (depths, loads))
    for block, run, depth_mm, load_N in zip(blocks, runs, depths, loads, strict=True):
        t_s, depth, load = run.elapsed_s, depth_mm / deepest, load_N / largest
        rate, furthest = np.gradient(load, t_s), np.maximum.accumulate(depth)
        way, columns = np.sign(rate), dict[str, Array]()
        for k in range(CONFIG.hats):
            near = np.maximum(0.0, 1.0 - CONFIG.hats * np.abs(depth - (k + 1) / CONFIG.hats))
            columns[f"depth {k}"] = near * (depth > 0.0)
        columns |= {"time": t_s, "load · time": load * t_s}
        columns |= {"way": way, "load · way": load * way, "load² · way": load**2 * way}
        columns |= {"rate": rate, "load · rate": load * rate}
        columns |= {"acceleration": np.gradient(np.gradient(depth, t_s), t_s), "position": np.asarray(run.stage_mm)}
        columns |= {"deepest so far": furthest, "load · deepest so far": load * furthest}
        if run.temperature_rise_K is not None:
            columns |= {"temperature": run.temperature_rise_K, "load · temperature": load * run.temperature_rise_K}
        for tau_s in CONFIG.memory_s:
            remembered = low_pass(load, run.step_s, tau_s, np.zeros(2))
            columns |= {f"memory {tau_s}": remembered, f"load · memory {tau_s}": load * remembered}
        for name, column in columns.items():
            out.setdefault(name, np.zeros(len(problem.measured)))[block.place] = column
    return [list(out.values())]


def columns_of(signal: Array, run: Run, times: float) -> dict[str, list[Array]]:
    """Return what a residual may follow of a signal within −1 and 1: groups of (n,) columns.

    Args:
        times: by what this rig is slower than a common one; memories fade by so much more slowly.
    """
    rate, hats = np.gradient(signal, run.t_s), CONFIG.hats
    way, quick = np.sign(rate), np.gradient(rate, run.t_s)
    places = [2.0 * k / (hats - 1) - 1.0 for k in range(hats)]
    memories = [low_pass(signal, run.step_s, times * tau_s, np.zeros(2)) for tau_s in CONFIG.memory_s]
    return {
        "level": [np.maximum(0.0, 1.0 - 0.5 * (hats - 1) * np.abs(signal - place)) for place in places],
        "way": [way, signal * way, signal**2 * way],
        "rate": [rate, np.abs(rate), rate * np.abs(rate), signal * rate, quick],
        "memory": [*memories, *(signal * remembered for remembered in memories)],
        "time": [run.elapsed_s, signal * run.elapsed_s],
    }


def is_noise(found: Fit, halves: Sequence[Halves] = (under_load,), follows: Variables = of_chain) -> bool:
    """Whether what a fit leaves in channels of fading noise fades alike everywhere and is noise."""
    # What has not faded by the longest time tried is no noise but a wander: an R0 that walks.
    longest_s = found.problem.colour_config.longest_s
    if any(colour.fading_s > CONFIG.wanders * longest_s for colour in found.problem.colour.values()):
        return False
    is_even = all(_is_even(found, channel, half) for half in halves for channel in found.problem.colour)
    return is_even and noise_chance(found, tuple(found.problem.colour), follows) > CONFIG.chance


def noise_chance(found: Fit, channels: Sequence[str] = (), follows: Variables = of_chain) -> float:
    """Return how likely noise leaves as much as a fit does, in these channels or all scored ones."""
    problem, chances = found.problem, []
    for channel in channels or problem.scored_channels:
        # By how many standard errors what is left is more than noise. A filter has taken the memory out of noise that
        # fades, and its size was read off what is left.
        blocks, tests = problem.blocks_of(channel), []
        if channel not in problem.colour:
            squares = np.concatenate([found.residual[b.place] for b in blocks]) ** 2
            count = int(np.count_nonzero(squares))
            # The noise level is of the same samples: its error adds as much as it takes.
            tests.append((float(np.sum(squares)) - count) / float(np.sqrt(2.0 * max(count, 1))))
        if tests and not problem.is_driven_by_force:
            tests.append(_remembers(found, blocks))
        # What another channel leaves of the same runs: their noises have nothing in common.
        elsewhere = np.zeros(len(problem.measured))
        others = {b.run: b for name in problem.scored_channels if name != channel for b in problem.blocks_of(name)}
        for block in blocks:
            if block.run in others and problem.case.runs[block.run].kind == "press":
                elsewhere[block.place] = (problem.measured - found.predicted)[others[block.run].place]
        # A measured force that drives the chain is smoothed: what is left of its noise has a memory.
        for group in () if problem.is_driven_by_force else follows(found, channel):
            columns = [*group, elsewhere] if elsewhere.any() else group
            seen = projected([problem.whitened(column) for column in columns], found.jacobian)
            # A direction takes 1 off χ² by chance.
            chi2 = float(np.sum(dots(seen, found.residual) ** 2)) if len(seen) else 0.0
            tests.append(_standard(chi2, len(seen)) if len(seen) else 0.0)
        # The worst of several tests (Bonferroni).
        chances.append(min(1.0, len(tests) * float(ndtr(-max(tests)))) if tests else 1.0)
    return min(chances)


def _is_even(found: Fit, channel: str, half: Halves) -> bool:
    """Whether one fading noise fits both conditions alike; white noise may grow with the load."""
    problem = found.problem
    parts: dict[bool, list[Stretch]] = {False: [], True: []}
    for block in problem.blocks_of(channel):
        is_inside = half(found, block)
        if is_inside is not None:
            parts[True].append(_stretch(found, block, is_inside.astype(np.float64)))
            parts[False].append(_stretch(found, block, (~is_inside).astype(np.float64)))
    if any(sum(float(s.use.sum()) for s in part) < CONFIG.fewest for part in parts.values()):
        return True
    gain, white, colour = 0.0, problem.sigma[channel], problem.colour[channel]
    for part in parts.values():
        # Against this fading noise beside any white one.
        lost = partial(lambda x, part: -log_likelihood(part, white * float(np.exp(x)), colour), part=part)
        common = minimize_scalar(lost, bounds=(-2.0, 2.0), method="bounded")
        gain += read_noise(part, problem.colour_config).log_likelihood + float(common.fun)
    return gain < CONFIG.uneven


def _remembers(found: Fit, blocks: Sequence[Block]) -> float:
    """Return by how many standard errors a residual follows its own past (Box and Pierce 1970)."""
    parts = [found.residual[b.place] for b in blocks]
    products, count, energy = np.zeros(CONFIG.lags), 0, 0.0
    for part in parts:
        count, energy = count + len(part), energy + float(part @ part)
        products += [float(part[k:] @ part[:-k]) for k in range(1, CONFIG.lags + 1)]
    return _standard(count * float(np.sum((products / energy) ** 2)), CONFIG.lags) if energy > 0.0 else 0.0


def _standard(chi2: float, freedom: int) -> float:
    """Return χ² as a standard normal value (Wilson and Hilferty 1931)."""
    wide = 2.0 / (9.0 * freedom)
    return float((np.cbrt(chi2 / freedom) - 1.0 + wide) / np.sqrt(wide))


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
