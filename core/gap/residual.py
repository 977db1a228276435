"""What a hypothesis leaves: is it noise, and is it the same noise everywhere; when does it stand out; how large is it?

What is left counts as noise where it is no larger than its level and follows nothing that is known
of the runs: depth, speed, load, time, temperature, what came before, its own past, another channel.
What fades of it fades in time and is as strong at rest as under load.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import comb

import numpy as np
from scipy.optimize import minimize, minimize_scalar
from scipy.special import ndtr

from softcal.core.gap.case import HALF_WIDTH
from softcal.core.gap.fit import Fit
from softcal.core.gap.linear import Colour, Noise, Stretch, dots, log_likelihood, noise_terms, projected
from softcal.core.gap.method import ColourConfig, ShrinkConfig
from softcal.core.gap.problem import Block, Problem
from softcal.core.recording import Array

TRIMMED = 0.02
"""Share of squared differences, the largest, left out of a noise estimate: steps are not noise."""


@dataclass(frozen=True)
class ChannelGap:
    """The gap of one channel on samples held back, root mean square in the channel's unit."""

    rmse_before: float
    rmse_after: float
    noise_floor: float


@dataclass(frozen=True)
class Shrink:
    """1 − (after − floor)/(before − floor): forecast with 90 % interval, and on unseen samples.

    There is no forecast where the unseen samples of the same runs contradict it already.
    """

    predicted: float | None
    low: float | None
    high: float | None
    held_out: float

    @classmethod
    def checked(cls, forecast: tuple[float, float, float], held_out: float, config: ShrinkConfig) -> "Shrink":
        """Return a forecast beside what was measured, left out where that lies far outside its interval."""
        _, low, high = forecast
        far = max(high - low, config.contradicts)
        if low - far <= held_out <= high + far:
            return cls(*forecast, held_out)
        return cls(None, None, None, held_out)


def gap_of_base(base: Fit) -> dict[str, ChannelGap]:
    """Return what a base leaves, where nothing else was fitted."""
    problem, gap = base.problem, {}
    for channel in problem.scored_channels:
        parts = [(problem.measured - base.predicted)[b.place] for b in problem.blocks_of(channel)]
        rms = float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))
        gap[channel] = ChannelGap(rms, rms, problem.floor(channel))
    return gap


def noise_levels(found: Fit) -> dict[str, float]:
    """Return σ of the white noise per channel from the differences of neighbouring residuals.

    A structured residual is smooth and hardly enters.
    """
    problem, order = found.problem, found.problem.model.smooth_order
    squares: dict[str, list[Array]] = {}
    for block in problem.blocks:
        error = (problem.measured - found.predicted)[block.place]
        # White noise of variance 1 gives differences of variance 2, second ones of 6.
        squares.setdefault(block.channel, []).append(np.diff(error, order) ** 2 / comb(2 * order, order))
    levels = dict(problem.sigma)
    for channel, parts in squares.items():
        every = np.sort(np.concatenate(parts))
        trimmed = every[: max(1, int(len(every) * (1 - TRIMMED)))]
        # A Gaussian without its largest 2 % of squares keeps 0.873 of its variance.
        variance = float(np.mean(trimmed)) / 0.873
        levels[channel] = max(float(np.sqrt(variance)), problem.least_noise(channel))
    return levels


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


def read_noise(stretches: Sequence[Stretch], config: ColourConfig) -> Noise:
    """Return the likeliest noise; the white part sets the scale: two numbers are searched for."""
    error, step_s, use = (np.concatenate([getattr(s, name) for s in stretches]) for name in ("error", "step_s", "use"))
    begins = np.zeros(len(error))
    begins[np.cumsum([0, *(len(s.error) for s in stretches)])[:-1]] = 1.0
    count = max(float(use.sum()), 1.0)

    def scale(ratio: float, fading_s: float) -> tuple[float, float]:
        squares, log_det = noise_terms(error, step_s, use, begins, ratio, fading_s)
        variance = max(squares / count, 1e-300)
        return variance, -0.5 * (count * (1.0 + float(np.log(variance))) + log_det)

    def lost(x: Array) -> float:
        outside = max(np.log(config.shortest_s) - x[1], x[1] - np.log(config.longest_s), 0.0)
        held = float(np.exp(np.clip(x[1], np.log(config.shortest_s), np.log(config.longest_s))))
        return float(count * outside**2 - scale(float(np.exp(x[0])), held)[1])

    starts = [np.log([ratio, fading_s]) for ratio in config.ratios for fading_s in config.fading_s]
    start = min(starts, key=lost)
    # Half a natural logarithm: less than the distance of two starts.
    simplex = start + 0.5 * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    options = {"xatol": 0.02, "fatol": 0.05, "initial_simplex": simplex}
    minimum = minimize(lost, start, method="Nelder-Mead", options=options)
    ratio, fading_s = float(np.exp(minimum.x[0])), float(np.exp(minimum.x[1]))
    fading_s = float(np.clip(fading_s, config.shortest_s, config.longest_s))
    variance, log_likelihood = scale(ratio, fading_s)
    white = float(np.sqrt(variance))
    alone = scale(0.0, 1.0)[1]
    return Noise(white, Colour(ratio * white, fading_s), log_likelihood, log_likelihood - alone)


def is_noise(found: Fit) -> bool:
    """Whether what a fit leaves in channels of fading noise fades alike everywhere and is noise."""
    # What has not faded by the longest time tried is no noise but a wander: an R0 that walks.
    problem, config = found.problem, found.problem.method.floor
    longest_s = config.wanders * problem.colour_config.longest_s
    if any(colour.fading_s > longest_s for colour in problem.colour.values()):
        return False
    is_even = all(_is_even(found, channel) for channel in problem.colour)
    return is_even and noise_chance(found, tuple(problem.colour)) > config.chance


def noise_chance(found: Fit, channels: Sequence[str] = ()) -> float:
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
        for group in () if problem.is_driven_by_force else problem.model.followed(found, channel):
            columns = [*group, elsewhere] if elsewhere.any() else group
            seen = projected([problem.whitened(column) for column in columns], found.jacobian)
            # A direction takes 1 off χ² by chance.
            chi2 = float(np.sum(dots(seen, found.residual) ** 2)) if len(seen) else 0.0
            tests.append(_standard(chi2, len(seen)) if len(seen) else 0.0)
        # The worst of several tests (Bonferroni).
        chances.append(min(1.0, len(tests) * float(ndtr(-max(tests)))) if tests else 1.0)
    return min(chances)


def _is_even(found: Fit, channel: str) -> bool:
    """Whether one fading noise fits both of two conditions alike; white noise may grow with the load."""
    problem, config = found.problem, found.problem.method.floor
    white, colour = problem.sigma[channel], problem.colour[channel]
    blocks = problem.blocks_of(channel)
    for halves in zip(*(list(problem.model.halves(found, block)) for block in blocks), strict=True):
        pairs = [(b, is_in) for b, is_in in zip(blocks, halves, strict=True) if is_in is not None]
        sides = [[(b, (is_in == side).astype(np.float64)) for b, is_in in pairs] for side in (False, True)]
        parts = [[_stretch(found, b, use) for b, use in side] for side in sides]
        if any(sum(float(s.use.sum()) for s in part) < config.fewest for part in parts):
            continue
        gain = 0.0
        for part in parts:
            # Against this fading noise beside any white one.
            lost = partial(lambda x, part: -log_likelihood(part, white * float(np.exp(x)), colour), part=part)
            common = minimize_scalar(lost, bounds=(-2.0, 2.0), method="bounded")
            gain += read_noise(part, problem.colour_config).log_likelihood + float(common.fun)
        if gain >= config.uneven:
            return False
    return True


def _remembers(found: Fit, blocks: Sequence[Block]) -> float:
    """Return by how many standard errors a residual follows its own past (Box and Pierce 1970)."""
    lags = found.problem.method.floor.lags
    parts = [found.residual[b.place] for b in blocks]
    products, count, energy = np.zeros(lags), 0, 0.0
    for part in parts:
        count, energy = count + len(part), energy + float(part @ part)
        products += [float(part[k:] @ part[:-k]) for k in range(1, lags + 1)]
    return _standard(count * float(np.sum((products / energy) ** 2)), lags) if energy > 0.0 else 0.0


def _standard(chi2: float, freedom: int) -> float:
    """Return χ² as a standard normal value (Wilson and Hilferty 1931)."""
    wide = 2.0 / (9.0 * freedom)
    return float((np.cbrt(chi2 / freedom) - 1.0 + wide) / np.sqrt(wide))


def with_driving_noise(problem: Problem, found: Fit) -> Problem:
    """Return the problem with the noise of a measured force where it drives the chain.

    σ² = σV² + (dV/dF·σF)²: errors in variables to first order.
    """
    case = problem.case
    driven = [run.kind == "press" and run.stage_mm is None and run.force_N is not None for run in case.runs]
    if not any(driven):
        return problem
    extra = np.zeros(len(problem.measured))
    for block in (b for b in problem.blocks if driven[b.run]):
        run = case.runs[block.run]
        force_N = np.asarray(run.force_N)
        order = np.argsort(force_N, kind="stable")
        x, y = force_N[order], found.predicted[block.place][order]
        # A slope from neighbours would be noise over noise; a 24th of the samples shows the curve's.
        edges = np.linspace(0, len(x) - 1, 25).astype(int)
        keep = np.concatenate([[True], np.diff(x[edges]) > 1e-7 * np.ptp(x)])
        slopes = np.gradient(y[edges][keep], x[edges][keep]) if keep.sum() > 2 else np.zeros(int(keep.sum()))
        slope = np.interp(force_N, x[edges][keep], slopes)
        # Smoothed noise moves slowly: it counts as often as samples share it.
        extra[block.place] = (2 * HALF_WIDTH + 1) * (slope * run.driving_force.sigma_N) ** 2
    return replace(problem, extra_variance=extra)
