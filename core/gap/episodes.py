"""Effects that must be placed first: lost samples, bad contacts, hum, a clipped output."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from softcal.core.gap.fit import fit
from softcal.core.gap.hypothesis import Episodes, start_coordinates
from softcal.core.gap.linear import energy, wave_sums
from softcal.core.gap.model import Block, Fit
from softcal.core.recording import Array, Mask
from softcal.core.twin.effects import Effect, SearchTarget
from softcal.core.twin.signals import compiled

PLACEMENTS = 4
"""How often episodes are placed again; they hardly move after the third time."""

MAINS_Hz = (50.0, 60.0)

ACROSS = np.array([1.0, 1.0, 0.0, -1.0, -1.0]) / 2.0
"""Mean after an instant less mean before it; the sample that placed the instant is left out."""

SKEW_STEPS = 8
"""Skews tried on either side before losses are placed, each half a sample more in a run."""

LocateEpisodes: TypeAlias = Callable[[Fit, str], tuple[list[Array], float]]
"""Find the rows of an episodic effect in every run, and its size."""

Placer: TypeAlias = Callable[[Fit, Effect], Fit | None]
"""Add an effect to a fit where it explains anything, once what must be found of it was found."""


def with_losses(result: Fit, effect: Effect) -> Fit | None:
    """Add an effect that loses samples: place the losses, fit, place again.

    A skew fitted through losses is wrong between them, and steps of one sample stand in for the rest.
    So they are placed by the skew of the clock at which placed losses leave least.
    """
    rates, best, min_cost = _clocks(result, "rate"), result, np.inf
    problem, samples = result.problem, max(len(run) for run in result.problem.case.presses)
    for skew in np.arange(-SKEW_STEPS, SKEW_STEPS + 1) * 0.5 / samples if rates else ():
        coordinates = result.coordinates.copy()
        coordinates[result.hypothesis.index_of(rates[0])] = skew
        start = replace(result, coordinates=coordinates, predicted=problem.predict(result.hypothesis, coordinates))
        rows = _locate_losses(start, effect.id)[0]
        hypothesis = result.hypothesis.adding(effect, episodes=_merged(result, effect.id, rows))
        predicted = problem.predict(hypothesis, np.append(coordinates, 0.0))
        misfit = energy(problem.whitened(problem.measured - predicted))
        cost = misfit + problem.method.evidence.episode_cost * float(np.log(problem.count)) * hypothesis.episode_count
        if cost < min_cost:
            best, min_cost = start, cost
    return _with_episodes(best, effect, _locate_losses)


def _clocks(result: Fit, kind: str) -> list[str]:
    return [e.id for e in result.effects if e.signs.clock == kind]


def with_intervals(result: Fit, effect: Effect) -> Fit | None:
    """Add an effect that acts in a few intervals: place, fit, again; None where nothing jumps."""
    grown = _with_episodes(result, effect, _locate_bad_contacts)
    if grown is None:
        return None
    # What it takes away must jump within three samples, as it does.
    without, is_retained = grown.hypothesis.without(effect.id)
    problem, clean = grown.problem, grown.problem.predict(without, grown.coordinates[is_retained])
    pull = power = 0.0
    for block in problem.blocks_of("output_V"):
        fitted, residual = (
            np.convolve((values - clean)[block.rows] / problem.noise[block.rows], ACROSS, mode="valid")
            for values in (grown.predicted, problem.measured)
        )
        pull, power = pull + float(fitted @ residual), power + energy(fitted)
    # Neighbouring differences share most of their noise: their sum has that of Σ|w|² as many.
    error = np.sqrt(energy(ACROSS) * len(ACROSS) * power)
    config = problem.method.episode
    is_bad = power > 0.0 and pull > config.event_share * power and pull > config.event_sigma * error
    return grown if is_bad else None


def _with_episodes(result: Fit, effect: Effect, locate: LocateEpisodes) -> Fit | None:
    best: Fit | None = None
    current = result
    for _ in range(PLACEMENTS):
        rows, size = locate(current, effect.id)
        if not any(len(r) for r in rows):
            break
        hypothesis = result.hypothesis.adding(effect, episodes=_merged(result, effect.id, rows))
        start = current.coordinates[: len(result.coordinates)]
        grown = fit(result.problem, hypothesis, np.concatenate([start, start_coordinates([effect], [[size]])]))
        is_same = best is not None and grown.chi2 > best.chi2 - 1.0
        if best is None or grown.chi2 < best.chi2:
            best = grown
        if is_same:
            break
        current = grown
    return best


def relocate_episodes(result: Fit) -> Fit:
    """Locate the episodes of a hypothesis once more: what was added since may have blurred them."""
    best = result
    episodic = sorted((e for e in result.effects if e.is_episodic), key=lambda e: list(ROWS).index(_search_target(e)))
    for effect in episodic:
        for _ in range(PLACEMENTS):
            rows, _ = ROWS[_search_target(effect)](best, effect.id)
            if not any(len(r) for r in rows):
                break
            hypothesis = replace(best.hypothesis, episodes=_merged(best, effect.id, rows))
            again = fit(best.problem, hypothesis, best.coordinates)
            if again.bic > best.bic - 1.0:
                break
            best = again
    return best


def _search_target(effect: Effect) -> SearchTarget:
    target = effect.signs.search_target
    if target is None or target not in ROWS:
        raise ValueError(f"{effect.id} is episodic, but says not how its episodes are placed")
    return target


def _merged(result: Fit, effect_id: str, rows: list[Array]) -> Episodes:
    return tuple({**result.hypothesis.episodes_of(k), effect_id: rows[k]} for k in range(len(rows)))


def _robust_noise(result: Fit, blocks: list[Block]) -> float:
    error = np.abs(result.problem.measured - result.predicted) * result.problem.weights
    parts = np.concatenate([error[b.rows] for b in blocks])
    return max(1.0, 1.48 * float(np.median(parts)))


def _locate_losses(result: Fit, effect_id: str) -> tuple[list[Array], float]:
    case = result.problem.case
    rows: list[Array] = [np.empty((0, 2)) for _ in case.runs]
    plain = replace(result.hypothesis, episodes=_merged(result, effect_id, rows))
    # Offsets of a run are fitted to what was measured: with its losses open they would follow them.
    bare = result.problem.bare
    closed = bare.predict(plain, result.coordinates)
    offsets = result.predicted - bare.predict(result.hypothesis, result.coordinates)
    if not result.hypothesis.episode_count:
        offsets = np.zeros(len(offsets))
    blocks = result.problem.blocks_of("output_V", "press")
    level = _robust_noise(result, blocks)
    # A delay fitted through the losses lies in their middle: the first samples stand before it.
    config = result.problem.method.episode
    max_lead = config.max_advance if _clocks(result, "delay") else 0
    for block in blocks:
        measured = result.problem.measured[block.rows]
        noise = result.problem.noise[block.rows] * level
        predicted = closed[block.rows] + float(np.median(offsets[block.rows]))
        ahead = np.concatenate([np.full(max_lead, predicted[0]), predicted])
        penalty = 4.0 * np.log(len(measured))
        shifts = lag_path(measured, ahead, noise, max_lead, config.longest_loss, penalty, config.min_following)
        at = np.flatnonzero(np.diff(shifts) > 0) + 1
        t_s = case.runs[block.run].elapsed_s
        rows[block.run] = np.array([(t_s[k], shifts[k] - shifts[k - 1]) for k in at]).reshape(-1, 2)
    return rows, float(max((r[:, 1].max() for r in rows if len(r)), default=0.0))


@compiled
def lag_path(
    measured: Array, predicted: Array, noise: Array, max_lead: int, longest: int, penalty: float, min_following: int
) -> Array:
    """Return how many samples were lost before each sample: the cheapest path that never falls.

    Viterbi over the loss so far; a further loss costs `penalty`, a sample at most 25: an outlier.

    Args:
        measured, noise: (n,).
        predicted: (lead + n,) without any loss, `max_lead` samples of rest before the first.
        max_lead: most samples by which the path may start late; it starts at 0 where this is 0.
        longest: largest loss.
        min_following: samples that must follow a loss to judge it by.
    """
    n = len(measured)
    back = np.zeros((n, longest + 1), dtype=np.int16)
    cost = np.full(longest + 1, 1e18)
    cost[: max_lead + 1] = 0.0
    for k in range(n):
        cheapest, source = 1e18, 0
        moved = np.empty(longest + 1)
        for s in range(longest + 1):
            stay = cost[s]
            if 0 < k < n + max_lead - s - min_following and cheapest + penalty < stay:
                moved[s], back[k, s] = cheapest + penalty, source
            else:
                moved[s], back[k, s] = stay, s
            if stay < cheapest:
                cheapest, source = stay, s
        for s in range(longest + 1):
            # After the end nobody knows what was measured: it costs what a right prediction would.
            z = (measured[k] - predicted[k + s]) / noise[k] if k + s < n + max_lead else 1.0
            cost[s] = moved[s] + min(z * z, 25.0)
    out = np.empty(n)
    s = int(np.argmin(cost))
    for k in range(n - 1, -1, -1):
        out[k] = s
        s = back[k, s]
    return out


def _locate_bad_contacts(result: Fit, effect_id: str) -> tuple[list[Array], float]:
    case, readout = result.problem.case, result.problem.case.readout
    rows: list[Array] = [np.empty((0, 2)) for _ in case.runs]
    good = result.coordinates
    if effect_id in result.ids:
        good = result.coordinates.copy()
        good[result.hypothesis.index_of(effect_id)] = 0.0
    clean = result.problem.predict(result.hypothesis, good)
    blocks = [b for b in result.problem.blocks_of("output_V") if case.runs[b.run].kind != "dummy_resistor"]
    level = _robust_noise(result, blocks)
    errors, sigmas = [], []
    for block in blocks:
        divider_V = np.maximum(readout.vref_V - clean[block.rows], readout.step_V)
        slope = divider_V**2 / (readout.vref_V * readout.r_series_ohm)
        errors.append((result.problem.measured - clean)[block.rows] / slope)
        sigmas.append(result.problem.noise[block.rows] * level / slope)
    every, spread = np.concatenate(errors), float(np.median(np.concatenate(sigmas)))
    largest = float(np.max(np.abs(every)))
    if largest < 2 * spread:
        return rows, 0.0
    sizes = np.geomspace(2 * spread, largest, 16)
    penalty = 2.0 * np.log(len(every))
    best_gain, best_size, best_paths = 0.0, 0.0, []
    for size in np.concatenate([sizes, -sizes]):
        paths = [step_path(e, s, float(size), penalty) for e, s in zip(errors, sigmas, strict=True)]
        gain = sum(
            float(np.sum((e[p] / s[p]) ** 2 - ((e[p] - size) / s[p]) ** 2))
            for e, s, p in zip(errors, sigmas, paths, strict=True)
        )
        if gain > best_gain:
            best_gain, best_size, best_paths = gain, float(size), paths
    for block, path in zip(blocks, best_paths, strict=False):
        t_s = case.runs[block.run].elapsed_s
        edges = np.flatnonzero(np.diff(np.concatenate([[False], path, [False]]).astype(int)))
        end_s = np.append(t_s, 2 * t_s[-1] - t_s[-2])
        rows[block.run] = np.column_stack([end_s[edges[0::2]], end_s[edges[1::2]]]).reshape(-1, 2)
    return rows, best_size


@compiled
def step_path(error: Array, sigma: Array, size: float, penalty: float) -> Mask:
    """Return where the error stands at `size`, not at 0: two-state Viterbi, `penalty` a change."""
    n = len(error)
    back = np.zeros((n, 2), dtype=np.int8)
    low, high = 0.0, penalty
    for k in range(n):
        go_low, go_high = low, high
        if high + penalty < low:
            go_low, back[k, 0] = high + penalty, 1
        if low + penalty < high:
            go_high, back[k, 1] = low + penalty, 0
        else:
            back[k, 1] = 1
        low = go_low + min((error[k] / sigma[k]) ** 2, 100.0)
        high = go_high + min(((error[k] - size) / sigma[k]) ** 2, 100.0)
    out = np.zeros(n, dtype=np.bool_)
    state = 1 if high < low else 0
    for k in range(n - 1, -1, -1):
        out[k] = state == 1
        state = back[k, state]
    return out


def with_line(result: Fit, effect: Effect) -> Fit | None:
    """Add the strongest line of the output near an alias of the mains, its phase free by run."""
    case, problem = result.problem.case, result.problem
    blocks = problem.blocks_of("output_V")
    longest_s = max(float(case.runs[b.run].elapsed_s[-1]) for b in blocks)
    # Where mains may stand in the spectrum: nowhere at 0 and at half the rate.
    config = problem.method.episode
    rate_Hz, within_Hz, parts = case.readout.sample_rate_Hz, config.mains_tolerance_Hz, [np.empty(0)]
    for mains_Hz in MAINS_Hz:
        alias_Hz = abs(mains_Hz - rate_Hz * round(mains_Hz / rate_Hz))
        if within_Hz < alias_Hz < rate_Hz / 2 - within_Hz:
            parts.append(np.arange(alias_Hz - within_Hz, alias_Hz + within_Hz, 0.4 / longest_s))
    grid = np.unique(np.concatenate(parts))
    if not len(grid):
        return None
    losses = [e.id for e in result.effects if e.signs.search_target == SearchTarget.LOSSES]
    power = np.zeros(len(grid))
    sums: dict[int, NDArray[np.complex128]] = {}
    for block in blocks:
        # When the samples were taken: later by those lost before.
        run, sampled_s = case.runs[block.run], case.runs[block.run].elapsed_s.copy()
        episodes = result.hypothesis.episodes_of(block.run)
        for loss_at_s, count in (row for effect_id in losses for row in episodes.get(effect_id, ())):
            sampled_s += count / run.readout.sample_rate_Hz * (run.elapsed_s >= loss_at_s)
        sums[block.run] = wave_sums(grid, sampled_s, (problem.measured - result.predicted)[block.rows])
        power += np.abs(sums[block.run]) ** 2 / (block.rows.stop - block.rows.start)
    at = int(np.argmax(power))
    level = max(problem.noise_floor("output_V") ** 2, float(np.median(power)) / len(blocks))
    if 2 * power[at] / level < config.line_gain:
        return None
    effect = effect if effect.of_runs is None else effect.of_runs(len(case.runs))
    values = [float(np.sqrt(2 * power[at] / sum(b.rows.stop - b.rows.start for b in blocks))), float(grid[at])]
    # Re(S) = A/2·n·sin φ and Im(S) = −A/2·n·cos φ of a run's sum over A·sin(ωt + φ).
    phases = {k: float(np.arctan2(sums[k][at].real, -sums[k][at].imag)) for k in sums}
    values += [phases.get(k, 0.0) for k in range(len(case.runs))]
    start = np.concatenate([result.coordinates, start_coordinates([effect], [values])])
    return fit(problem, result.hypothesis.adding(effect), start)


def with_level(result: Fit, effect: Effect) -> Fit | None:
    """Add an effect that clips the output: fit without the flat tops, then set the level there."""
    side = 1 if effect.signs.search_target == SearchTarget.CEILING else -1
    problem = result.problem
    blocks = problem.blocks_of("output_V", "press")
    if not blocks:
        return None
    every_V = np.concatenate([problem.measured[b.rows] for b in blocks])
    # Noise on a flat top reaches 3.5 σ above it and as far below.
    margin_V = 7 * problem.noise_floor("output_V") + problem.case.readout.step_V
    near = np.zeros(len(problem.measured), dtype=np.bool_)
    for block in blocks:
        if side > 0:
            near[block.rows] = problem.measured[block.rows] > every_V.max() - margin_V
        else:
            near[block.rows] = problem.measured[block.rows] < every_V.min() + margin_V
    flat_samples = problem.method.episode.flat_samples
    if not flat_samples <= np.count_nonzero(near) < 0.7 * len(near):
        return None
    unclipped_weight = ~near if problem.weight_of_sample is None else problem.weight_of_sample * ~near
    rest = fit(problem.seeing(unclipped_weight.astype(np.float64)), result.hypothesis, result.coordinates)
    excess = side * (rest.predicted - problem.measured) / problem.total_noise
    over = near & (excess > 0)
    excess = excess[over]
    if np.count_nonzero(excess > 3) < flat_samples:
        return None
    level_V = float(np.median(problem.measured[over]))
    start = np.concatenate([rest.coordinates, start_coordinates([effect], [[level_V]])])
    return fit(problem, result.hypothesis.adding(effect), start)


ROWS: Mapping[SearchTarget, LocateEpisodes] = {
    SearchTarget.LOSSES: _locate_losses,
    SearchTarget.INTERVALS: _locate_bad_contacts,
}
"""How the rows of an episodic effect are found."""

PLACERS: Mapping[SearchTarget, Placer] = {
    SearchTarget.LOSSES: with_losses,
    SearchTarget.INTERVALS: with_intervals,
    SearchTarget.LINE: with_line,
    SearchTarget.CEILING: with_level,
    SearchTarget.FLOOR: with_level,
}
"""How an effect that must be placed first is added to a fit."""
