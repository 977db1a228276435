"""Whether the channels of a finished run tell one story, at every instant: force, stage and output against each other.

No I/O here. A channel that lies smoothly cannot be seen sample by sample. It is seen against the others: the output is
a law of the force (a channel that creeps, behind a filter), the force a law of the depth (a soft unit that relaxes, has
loops and softens). One test looks for an instant from which on a law holds no longer as it stood.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter
from scipy.special import ndtri

from softcal.core.errors import BadReply
from softcal.core.recording import Array
from softcal.core.words.reason import reason

ALPHA = 0.001
"""How often noise alone makes one story refuse a run, at most: shared by all instants and kinds (Bonferroni)."""

WRONG, LOST, LOST_MM = 0.0075, 0.01, 0.03
"""A change is refused that surely moves what its law gives by more than this share of its range (RMS over the profile):
output by force, and force by depth; there the stage must also surely be off by so much: stiff units show every µm."""

MOMENTS, ROWS = 120, 1500
"""Instants at which a change may begin, half of them spread over time, half over the way of the channel; and means of
readings that a law is fitted to."""

POWERS = (1, 2, 3, 4)
CREEP_POWERS, CREEP_S = (1, 2, 3), (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
"""What an output remembers of the force: it creeps, and its filter lags."""

KNOTS, RELAXED_POWERS, RELAXATION_S = 16, (1, 3), (0.1, 0.5, 3.0)
"""What a unit's force remembers of the depth. Faster than that, relaxation would look like an early load cell."""

LOOP, SOFTENS = 0.1, (0.7, 3.0)
"""Share of the depth over which a loop closes (Duhem), and compressions after which a unit has softened (Mullins)."""

GRID_S, WHITE_S = 0.01, 0.5
"""Laws are laid out at these steps. What is left of a law may hang together over so long."""

COARSE_S, FINE_S, EARLIEST_S, LATEST_S = 0.02, 0.0025, -0.32, 0.7
"""Delays that are tried when force and stage are laid over each other."""

LATE_S, PERIOD_SHARE = 0.01, 0.25
"""A cell may seem so much later or earlier than declared, and by this share of its sampling period."""

BESIDE_S, TELLS, TELLS_SAMPLES = 0.04, 1.1, 40.0
"""A delay is known that fits n samples TELLS + TELLS_SAMPLES/n times better than any that is BESIDE_S or more away: few
samples fit anyhow."""

FOLLOWS = 0.7
"""Share of an output's variance that goes with the depth, at least; 0.84 is the least of a good rig."""

BIT_LEVELS, BIT_SPAN, BIT_ROUNDING = 16, 2, 0.01
"""Different readings that are needed to know a converter's step, how many times a bit's weight they must run through,
and how far from whole steps they may be."""

FEWEST, SHALLOW, FREE = 10, 0.1, 0.02
"""A law is laid through so many readings at least. A press is deeper than this share of the deepest. Below this share
of the largest force a unit that comes back slowly may have left the stage: no law of the depth holds there."""


class Term(NamedTuple):
    """One column of a law on its grid: `column`, of what `slope` times a change of the input adds, remembered for so
    long (0 for not)."""

    column: Array
    slope: Array
    memory_s: float = 0.0


@dataclass(frozen=True, eq=False)
class Law:
    """What a channel may be made of, by another one.

    Args:
        grid_s: (m,) instants, GRID_S apart.
        value: (m,) the other channel there, in shares of its largest.
        terms: its columns, (m,) each.
    """

    grid_s: Array
    value: Array
    terms: Sequence[Term]

    def basis(self, t_s: Array) -> Array:
        """Return the columns at instants, (n, 1 + number of terms); the first is constant."""
        return np.column_stack([np.ones_like(t_s), *(np.interp(t_s, self.grid_s, term.column) for term in self.terms)])


def output_law(grid_s: Array, force_N: Array) -> Law:
    """Return what a sensor's output may be made of by the force on it, (m,) on the grid."""
    value = force_N / max(float(np.max(np.abs(force_N))), 1e-9)
    # Either line may be some milliseconds late.
    rate = np.gradient(_slow(_slow(value, CREEP_S[0])[::-1], CREEP_S[0])[::-1])
    late = [Term(rate * value**power, np.zeros_like(value)) for power in (0, 1)]
    return Law(grid_s, value, [*_powers(value), *_remembered(value, CREEP_POWERS, CREEP_S), *late])


def unit_law(grid_s: Array, depth_mm: Array) -> Law:
    """Return what a soft unit's force may be made of by its depth (a generalised Maxwell solid), (m,) on the grid."""
    depth = np.maximum(0.0, depth_mm)
    value = depth / max(float(np.max(depth)), 1e-9)
    done = np.cumsum(np.diff((value > SHALLOW).astype(int), prepend=0) == -1)
    factors = [_loop(value), *(np.exp(-done / presses) for presses in SOFTENS)]
    bent = [Term(f * value**p, p * f * value ** (p - 1)) for f in factors for p in RELAXED_POWERS]
    # Straight from knot to knot: a soft layer may lie on a hard one.
    knots = np.arange(KNOTS) / KNOTS
    elastic = [Term(np.maximum(0.0, value - knot), (value > knot).astype(np.float64)) for knot in knots]
    terms = [*elastic, *_remembered(value, RELAXED_POWERS, RELAXATION_S), *bent]
    # Above the unit nothing changes with the depth.
    return Law(grid_s, value, [term._replace(slope=term.slope * (value > 0.0)) for term in terms])


@dataclass(frozen=True)
class Change:
    """What departs from a law.

    Args:
        kind: what changes, one of ANY.
        at_s: since the first reading.
        size: how much it changes: a factor − 1 for a gain, s for a lag, else in units of the channel's largest value.
        share: by how much it moves what the law gives, RMS over the profile, in shares of the range.
        sure: the least that share may be, by the noise that is left.
    """

    kind: str
    at_s: float
    size: float
    share: float
    sure: float


INPUT, OWN = "input ", "own "
ANY = ("input gain", "input zero", "input lag", "own gain", "own zero", "own lag", "own moment")
SLIPS = ("input zero",)
"""Kinds of change: of force or output anything; of the stage, that it is not where it was counted to be."""


def find_change(t_s: Array, values: Array, law: Law, kinds: Sequence[str], begins_s: float) -> Change | None:
    """Look for the instant from which on a channel departs most clearly from its law.

    Least squares of the law, and then of the law with one change more: at each of MOMENTS instants of each kind. What
    is left is taken for noise that hangs together over WHITE_S. Noise alone exceeds the bound in ALPHA of all runs at
    most.

    Args:
        t_s, values: (n,) readings.
        law: what they may be made of.
        kinds: of changes that are looked for.
        begins_s: where the profile begins.

    Returns:
        The clearest change that noise does not explain; None without one.
    """
    if len(t_s) < FEWEST + len(law.terms):
        return None
    t_s, y, basis = (_means(column) for column in (t_s, values, law.basis(t_s)))
    q, _ = np.linalg.qr(basis)
    weights = _weights(basis, y)
    left = y - basis @ weights
    moments = _moments(t_s, np.interp(t_s, law.grid_s, law.value))
    fitted = basis @ weights
    columns = np.concatenate([_columns(kind, t_s, moments, law, weights, fitted) for kind in kinds], axis=1)
    own = columns - q @ (q.T @ columns)
    power = np.sum(own**2, axis=0)
    # A change that the law itself could make is none.
    is_known = power > 1e-6 * np.maximum(np.sum(columns**2, axis=0), 1e-300)
    score = np.where(is_known, own.T @ left, 0.0) / np.sqrt(np.where(is_known, power, 1.0))
    k = int(np.argmax(np.abs(score)))
    size = float(score[k] / np.sqrt(power[k])) if is_known[k] else 0.0
    spent = 1.0 - (basis.shape[1] + 1) / len(y)
    deviations = abs(float(score[k])) / _noise(left - size * own[:, k], t_s) * np.sqrt(spent)
    inside = t_s >= begins_s
    share = float(np.sqrt(np.mean((size * columns[inside, k]) ** 2)) / np.ptp(fitted[inside]))
    sure = share * max(0.0, 1.0 + float(ndtri(0.5 * ALPHA / len(score))) / deviations)
    kind, moment = kinds[k // len(moments)], float(moments[k % len(moments)])
    return Change(kind, moment - float(t_s[0]), size, share, sure)


def check_story(
    output: tuple[Array, Array],
    force: tuple[Array, Array] | None,
    stage_mm_at: Callable[[Array], Array],
    contact_mm: float,
    pressed_s: tuple[float, float, float],
) -> None:
    """See whether the output follows the force, and the force the stage, by one law from the slow press to the end.

    Args:
        output: instants, host clock, and the output of the first sensor; (n,) each.
        force: the same of the load cell, its lateness and its zero taken off; None without one: then the output is
            laid over the depth.
        stage_mm_at: host times -> stage positions, same origin as contact_mm.
        contact_mm: where the unit's surface is.
        pressed_s: when the slow press begins, when the profile begins, and when it ends.

    Raises:
        BadReply: from one instant on a channel departs from its law.
    """
    begun_s, profile_s, ended_s = pressed_s
    grid_s = np.arange(begun_s, ended_s + GRID_S, GRID_S)
    depth_mm = stage_mm_at(grid_s) - contact_mm
    unit = unit_law(grid_s, depth_mm)
    if force is None:
        return _refuse_slip(find_change(*_between(output, pressed_s), unit, SLIPS, profile_s), depth_mm)
    # The output remembers what the force was before, too.
    before_s = np.arange(max(begun_s - 3.0 * CREEP_S[-1], force[0][0]), ended_s + GRID_S, GRID_S)
    law = output_law(before_s, np.interp(before_s, *force))
    slower_s = min(output, force, key=lambda channel: len(channel[0]))[0]
    seen = _between((slower_s, np.interp(slower_s, *output)), pressed_s)
    change = find_change(*seen, law, ANY, profile_s)
    if change is not None and change.sure > WRONG:
        raise BadReply(reason("rig.story.force", at_s=change.at_s, percent=100 * change.share))
    t_s, force_N = _between(force, pressed_s)
    is_felt = force_N > FREE * np.max(force_N, initial=0.0)
    _refuse_slip(find_change(t_s[is_felt], force_N[is_felt], unit, SLIPS, profile_s), depth_mm)


def _between(channel: tuple[Array, Array], pressed_s: tuple[float, float, float]) -> tuple[Array, Array]:
    inside = (channel[0] >= pressed_s[0]) & (channel[0] <= pressed_s[2])
    return channel[0][inside], channel[1][inside]


def _refuse_slip(change: Change | None, depth_mm: Array) -> None:
    if change is None or change.sure <= LOST:
        return
    lost_mm = abs(change.size) * float(np.max(depth_mm))
    if lost_mm * change.sure / change.share > LOST_MM:
        raise BadReply(reason("rig.story.stage", at_s=change.at_s, percent=100 * change.share, lost_mm=lost_mm))


def _columns(kind: str, t_s: Array, moments: Array, law: Law, weights: Array, fitted: Array) -> Array:
    """Return what a change of this kind adds from each of the moments on, (n, moments), for a change by one."""
    after = t_s[:, None] > moments
    if kind == OWN + "moment":
        return np.asarray(after & (t_s[:, None] <= np.append(moments[1:], np.inf)), dtype=np.float64)
    if kind.startswith(OWN):
        own = {"gain": fitted - weights[0], "zero": np.ones_like(t_s), "lag": -np.gradient(fitted, t_s)}
        return np.asarray(after * own[kind.removeprefix(OWN)][:, None])
    rate = np.gradient(law.value, law.grid_s)
    change = {"gain": law.value, "zero": np.ones_like(law.value), "lag": -rate}[kind.removeprefix(INPUT)]
    added = np.zeros_like(after, dtype=np.float64)
    for memory_s in {term.memory_s for term in law.terms}:
        grid = np.zeros_like(law.value)
        for weight, term in zip(weights[1:], law.terms, strict=True):
            if term.memory_s == memory_s:
                grid += weight * term.slope * change
        if memory_s:
            grid = _slow(grid, memory_s)
            kept = np.exp(-np.maximum(0.0, t_s[:, None] - moments) / memory_s)
            added -= kept * np.interp(moments, law.grid_s, grid)
        added += np.interp(t_s, law.grid_s, grid)[:, None]
    return np.asarray(after * added)


def _moments(t_s: Array, value: Array) -> Array:
    way = np.cumsum(np.abs(np.diff(value, prepend=value[0])))
    share = (t_s - t_s[0]) / (t_s[-1] - t_s[0]) + way / max(float(way[-1]), 1e-9)
    return np.asarray(np.interp(np.linspace(0.0, float(share[-1]), MOMENTS + 2)[1:-1], share, t_s))


def _means(values: Array) -> Array:
    """Return means over so many neighbours that ROWS are left."""
    each = max(1, -(-len(values) // ROWS))
    count = len(values) // each
    return np.asarray(values[: count * each].reshape(count, each, *values.shape[1:]).mean(axis=1))


def _noise(left: Array, t_s: Array) -> float:
    """Return the standard deviation of what is left of a law, made larger where neighbours hang together."""
    each = max(1, round(WHITE_S / float(np.median(np.diff(t_s)))))
    count = len(left) // each
    variance = float(np.mean(left**2))
    if count < FEWEST:
        return max(float(np.sqrt(variance)), 1e-300)
    together = each * float(np.mean(left[: count * each].reshape(count, each).mean(axis=1) ** 2))
    return max(float(np.sqrt(max(variance, together))), 1e-300)


def lag_s(t_s: Array, force_N: Array, stage_mm_at: Callable[[Array], Array], contact_mm: float) -> float:
    """Return by how much the force is behind the stage.

    The force is laid over the law of a soft unit, shifted in time, by least squares.

    Args:
        t_s, force_N: (n,) samples of the load cell, host clock.
        stage_mm_at: host times -> stage positions, same origin as contact_mm.
        contact_mm: where the unit's surface is.

    Returns:
        Delay in s, positive when the force is late; NaN where the run does not tell: too shallow, too slow, too noisy.
    """
    if len(t_s) < FEWEST or float(np.max(stage_mm_at(t_s))) <= contact_mm:
        return float("nan")
    # What arrives first may belong to a path before these samples, which the law does not know.
    is_known = t_s >= min(t_s[0] + LATEST_S, float(np.median(t_s)))
    t_s, force_N = t_s[is_known], force_N[is_known]
    grid_s = np.arange(t_s[0] - LATEST_S - BESIDE_S, t_s[-1] - EARLIEST_S + BESIDE_S, GRID_S)
    law = unit_law(grid_s, stage_mm_at(grid_s) - contact_mm)

    def misfit(lag: float) -> float:
        return _misfit(law.basis(t_s - lag), force_N)

    coarse = np.arange(EARLIEST_S, LATEST_S, COARSE_S)
    misfits = np.array([misfit(lag) for lag in coarse])
    near = coarse[int(np.argmin(misfits))] + np.arange(-COARSE_S, COARSE_S + FINE_S, FINE_S)
    found = float(near[int(np.argmin([misfit(lag) for lag in near]))])
    # Presses that come again and again fit nearly as well half a press away: every other delay counts.
    others = misfits[np.abs(coarse - found) > BESIDE_S]
    beside = min(misfit(found - BESIDE_S), misfit(found + BESIDE_S), *others)
    return found if beside > (TELLS + TELLS_SAMPLES / len(t_s)) * misfit(found) else float("nan")


def check_lag(found_s: float, declared_s: float, period_s: float) -> None:
    """Raise `BadReply` when the load cell is later, or earlier, than its station file says.

    Args:
        period_s: between two of its samples.
    """
    off_s, slack_s = found_s - declared_s, PERIOD_SHARE * period_s
    if abs(off_s) > LATE_S + slack_s:
        raise BadReply(reason("rig.behind", found_s=found_s, declared_s=declared_s, latency_s=max(0.0, found_s)))


def check_follows(t_s: Array, output: Array, stage_mm_at: Callable[[Array], Array], contact_mm: float) -> None:
    """See whether the output of every sensor follows the depth at all: an input that floats does not.

    Args:
        t_s: (n,) instants.
        output: (n, channels) of the sensors.
        stage_mm_at: instants -> stage positions, same origin as contact_mm.
        contact_mm: where the unit's surface is.

    Raises:
        BadReply: less than FOLLOWS of an output's variance goes with the depth.
    """
    grid_s = np.arange(t_s[0], t_s[-1] + GRID_S, GRID_S)
    depth_mm = np.maximum(0.0, stage_mm_at(grid_s) - contact_mm)
    if len(t_s) < FEWEST or float(np.max(depth_mm)) <= 0.0:
        return
    basis = unit_law(grid_s, depth_mm).basis(t_s)
    for values in output.T:
        spread = float(np.sum((values - values.mean()) ** 2))
        followed = 1.0 - _misfit(basis, values) / spread if spread else 0.0
        if followed < FOLLOWS:
            raise BadReply(reason("rig.follows", percent=100 * followed))


def check_bits(output: Array) -> None:
    """Look for a line of the converter that hangs: a bit that is always the same where it should change.

    Args:
        output: (n, channels) of the sensors; readings of a converter are whole multiples of its step.

    Raises:
        BadReply: one bit never changes although the readings run through several times its weight.
    """
    for values in output.T:
        levels = np.unique(values)
        if len(levels) < BIT_LEVELS:
            continue
        counts = levels / np.min(np.diff(levels))
        if np.max(np.abs(counts - np.round(counts))) > BIT_ROUNDING or np.max(np.abs(counts)) > 2**31:
            continue  # No converter's steps: an instrument that averages.
        codes = np.round(counts).astype(np.int64)
        for bit in range(int(np.log2(np.ptp(codes) / BIT_SPAN)) + 1):
            if len(np.unique(codes >> bit & 1)) == 1:
                raise BadReply(reason("rig.bit", bit=bit))


def _powers(value: Array) -> list[Term]:
    return [Term(value**power, power * value ** (power - 1)) for power in POWERS]


def _remembered(value: Array, powers: Sequence[int], times_s: Sequence[float]) -> list[Term]:
    return [
        Term(_slow(value**power, time_s), power * value ** (power - 1), time_s)
        for time_s in times_s
        for power in powers
    ]


def _slow(values: Array, time_s: float) -> Array:
    """Return a first-order low-pass of values on the grid, from rest."""
    kept = float(np.exp(-GRID_S / time_s))
    return np.asarray(lfilter([1.0 - kept], [1.0, -kept], values))


def _loop(value: Array) -> Array:
    """Return the state of a loop, −1 to 1: dz/dx = (1 − z·sign(dx))/LOOP."""
    steps = np.diff(value, prepend=value[:1])
    kept, signs = np.exp(-np.abs(steps) / LOOP), np.sign(steps)
    state, states = 0.0, np.empty_like(value)
    for k in range(len(value)):
        state = signs[k] + (state - signs[k]) * kept[k] if signs[k] else state
        states[k] = state
    return states


def _weights(basis: Array, force_N: Array) -> Array:
    return np.asarray(np.linalg.lstsq(basis, force_N, rcond=None)[0])


def _misfit(basis: Array, force_N: Array) -> float:
    return float(np.sum((force_N - basis @ _weights(basis, force_N)) ** 2))
