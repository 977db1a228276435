"""Checks of a finished run: force and stage in time, one gain in all presses.

No I/O here. A single sample of a smooth channel shows no fault; a comparison with the other channels does.
"""

import itertools
from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
from scipy.optimize import minimize
from scipy.signal import find_peaks, lfilter

from softcal.core.errors import BadReply
from softcal.core.inspection.dropouts import find_dropouts
from softcal.core.messages.reason import Reason, reason
from softcal.core.recording import Array
from softcal.station.device_names import device_label
from softcal.station.record.method import OutputConfig, PressConfig, ProofMethod, StrokeConfig


class PressLaw:
    """The laws of one run: force by depth, output by force. What changes once in the run leaves them.

    Args:
        t_s, force_N: (n,) samples of the load cell, host clock, its lateness and its zero taken off.
        output: (n,) of the first sensor there.
        stage_mm_at: host times -> stage positions, same origin as contact_mm.
    """

    def __init__(
        self,
        t_s: Array,
        force_N: Array,
        output: Array,
        stage_mm_at: Callable[[Array], Array],
        contact_mm: float,
        method: ProofMethod,
    ) -> None:
        self._t_s, self._force_N, self._output, self._method = t_s, force_N, output, method
        self._basis = LawBasis(t_s, method)
        self._depth_mm = stage_mm_at(self._basis.grid_s) - contact_mm
        self._moments_s = np.linspace(t_s[0], t_s[-1], method.change.moments + 2)[1:-1]

    @cached_property
    def _by_depth(self) -> Array:
        return self._basis.with_history(np.maximum(0.0, self._depth_mm))

    @cached_property
    def _by_force(self) -> Array:
        return self._basis.with_history(np.interp(self._basis.grid_s, self._t_s, self._force_N))

    @cached_property
    def _in_force(self) -> Array:
        return self._explained(self._by_depth, self._force_N)

    @cached_property
    def _in_output(self) -> Array:
        return self._explained(self._by_force, self._output)

    @property
    def _noise(self) -> float:
        """Return the share of noise that the best change of gain, zero or delay explains."""
        return float(2.0 * np.log(3 * self._method.change.moments)) / len(self._t_s)

    @property
    def _by_chance(self) -> float:
        """Return the share of a misfit that a change explains on a good rig; 1 for too few samples."""
        change = self._method.change
        return change.share + self._noise if len(self._t_s) >= change.moments else 1.0

    def check(self) -> None:
        """Raise `BadReply` if one change of the cell explains the misfit of force and output, at any moment.

        That is a gain, a zero or a delay; so is a force that leaves the law for a moment, as that of a cell that hangs.
        """
        self._check_moments()
        explained = np.minimum(self._in_force, self._in_output)
        if np.max(explained) > self._by_chance:
            raise BadReply(reason("rig.odd_force", at_s=float(self._moments_s[np.argmax(explained)] - self._t_s[0])))

    def check_slip(self) -> None:
        """Raise `BadReply` if the stage lost steps: from one moment on it is above its counter.

        That leaves a smaller residual of the depth law than any change of the cell, and than a unit that softens
        where it was pressed (Mullins); and the sensor agrees with the cell.
        """
        t_s, grid_s, config = self._t_s, self._basis.grid_s, self._method.slip
        by_cell = float(np.max(self._in_force))
        if by_cell <= self._by_chance or np.max(self._in_output) > self._by_chance:
            return

        def misfit(slip: tuple[float, float], every: int = 1) -> float:
            higher_mm = np.maximum(0.0, self._depth_mm - slip[1] * (grid_s > slip[0]))
            basis = LawBasis(t_s[::every], self._method, grid_s).with_history(higher_mm, float(np.max(self._depth_mm)))
            return _misfit(basis, self._force_N[::every])

        every = max(1, len(t_s) // config.samples)
        candidates = ((at_s, lost_mm) for at_s in self._moments_s for lost_mm in config.candidates_mm)
        coarse = min(candidates, key=lambda slip: misfit(slip, every))
        at_s, lost_mm = minimize(misfit, coarse, method="Nelder-Mead", options={"maxfev": config.finer}).x
        # A law that bends fits better from another zero, from the first press on: then nothing was lost.
        before = min(misfit((at_s, 0.0)), misfit((-np.inf, lost_mm)))
        residual = misfit((at_s, lost_mm)) / max(before, 1e-300)
        softened = _misfit(self._basis.softening(np.maximum(0.0, self._depth_mm)), self._force_N) / max(before, 1e-300)
        max_ratio = min(config.max_residual, config.clear * (1.0 - by_cell), config.max_softening * softened)
        if abs(lost_mm) >= config.min_loss_mm and residual < max_ratio:
            raise BadReply(reason("rig.slipped", at_s=float(at_s - t_s[0]), lost_mm=float(lost_mm)))

    def name_cause(self, error: BadReply) -> BadReply:
        """Return a change of the output as the cause if the output is inconsistent; else the error unchanged.

        It is where a change is far clearer in the output by the force than in the force by the depth.
        """
        is_long = len(self._t_s) >= self._method.change.moments
        if not is_long or np.max(self._in_output) <= self._method.output.alone * np.max(self._in_force):
            return error
        change = self.find_output_change()
        return error if change is None else BadReply(change)

    def find_output_change(self) -> Reason | None:
        """Return the change of the output at equal force, by a step or a drift; None without either.

        The cell is taken to be right: `check` has compared it with the depth.
        """
        t_s, basis, output, config = self._t_s, self._by_force, self._output, self._method.output
        q, _ = np.linalg.qr(basis)
        fitted = q @ (q.T @ output)
        residual = output - fitted
        squares, count = max(float(residual @ residual), 1e-300), len(t_s)

        def explained(change: Array) -> float:
            orthogonal, _ = np.linalg.qr(change - q @ (q.T @ change))
            return float(np.sum((orthogonal.T @ residual) ** 2)) / squares

        def step(at_s: float) -> Array:
            return np.column_stack([np.ones(count), fitted - fitted[0]]) * (t_s > at_s)[:, None]

        drift = (t_s - t_s[0])[:, None]
        by_drift, at_s = explained(drift), max(self._moments_s, key=lambda at_s: explained(step(at_s)))
        is_drift = by_drift > explained(step(at_s))
        change = drift if is_drift else step(at_s)
        weights = _weights(np.column_stack([basis, change]), output)
        usual, changed = basis @ weights[: basis.shape[1]], change @ weights[basis.shape[1] :]
        is_after = t_s > at_s
        share = float(np.mean(changed[is_after]) / np.mean(usual[is_after]))
        if is_drift:
            by_range = float(np.ptp(changed) / np.ptp(usual))
            if by_drift < config.drift + self._noise or by_range < config.drift_range:
                return None
            return reason("rig.output_drift", rate=float(weights[-1]), percent=100.0 * by_range)
        if explained(change) < config.step + self._noise or abs(share) < config.step_share:
            return None
        code = "rig.output_fell" if share < 0.0 else "rig.output_rose"
        return reason(code, percent=100.0 * abs(share), at_s=float(at_s - t_s[0]))

    def _explained(self, basis: Array, values: Array) -> Array:
        """Return what share of a law's misfit a gain, a zero or a delay explains that changes, by moment."""
        q, _ = np.linalg.qr(basis)
        fitted = q @ (q.T @ values)
        residual, is_after, squares = values - fitted, self._t_s[:, None] > self._moments_s, []
        for change in (fitted - fitted[0], np.ones_like(values), np.gradient(fitted)):
            column = is_after * change[:, None]
            orthogonal = column - q @ (q.T @ column)  # What the law could not make itself.
            squares.append((residual @ orthogonal) ** 2 / np.maximum(np.sum(orthogonal**2, axis=0), 1e-300))
        max_explained = np.max(squares, axis=0)
        is_slight = max_explained < len(values) * (self._method.change.slight * np.ptp(values)) ** 2
        return np.where(is_slight, 0.0, max_explained / max(float(residual @ residual), 1e-300))

    def _check_moments(self) -> None:
        t_s, force_N, hang = self._t_s, self._force_N, self._method.hang
        basis = self._basis.plain(np.maximum(0.0, self._depth_mm))
        length = max(1, round(hang.mean_s / float(np.median(np.diff(t_s)))))
        off_N = force_N - basis @ _weights(basis, force_N)
        for _ in range(hang.rounds):
            # Least absolute deviations: least squares would bend the law towards the odd moment.
            trust = 1 / np.sqrt(np.maximum(np.abs(off_N), np.median(np.abs(off_N)) + 1e-12))
            off_N = force_N - basis @ _weights(basis * trust[:, None], force_N * trust)
        mean_N = np.convolve(off_N, np.full(length, 1 / length), "same")
        # What arrives first may belong to a path before these samples, which the law does not know.
        mean_N[t_s < min(t_s[0] + self._method.lag.latest_s, float(np.median(t_s)))] = 0.0
        oddest = int(np.argmax(np.abs(mean_N)))
        is_rest = np.abs(t_s - t_s[oddest]) > hang.apart_s
        share = abs(mean_N[oddest]) / float(np.quantile(np.abs(force_N), hang.largest))
        rest_N = float(np.sqrt(np.mean(off_N[is_rest] ** 2))) if np.any(is_rest) else float("inf")
        if share > hang.share or (share > hang.min_frac and abs(mean_N[oddest]) > hang.times * rest_N):
            raise BadReply(reason("rig.odd_force", at_s=float(t_s[oddest] - t_s[0])))


class LawBasis:
    """Terms of a force by depth, or of an output by force: powers, also relaxed, on a time grid."""

    def __init__(self, t_s: Array, method: ProofMethod, grid_s: Array | None = None) -> None:
        self._t_s, self._law = t_s, method.law
        self.grid_s = np.arange(t_s[0], t_s[-1] + self._law.grid_s, self._law.grid_s) if grid_s is None else grid_s

    def plain(self, value: Array) -> Array:
        """Return the law of a value on the grid that begins with the run."""
        return self._columns([], value, self._law.relaxation_s)

    def with_history(self, value: Array, largest: float | None = None) -> Array:
        """Return the model of a value on the grid, and the relaxing contribution of the path before it."""
        t_s = self._t_s
        relaxation_s = [time_s for time_s in self._law.every_relaxation_s if time_s < t_s[-1] - t_s[0]]
        before = [np.ones_like(t_s), *(np.exp((t_s[0] - t_s) / time_s) for time_s in relaxation_s)]
        return self._columns(before, value, relaxation_s, largest)

    def softening(self, depth_mm: Array) -> Array:
        """Return the model of depth and of a unit that softens with its largest depth so far."""
        share = depth_mm / max(float(np.max(depth_mm)), 1e-9)
        deepest = np.maximum.accumulate(share)
        virgin = [share**power * (1.0 - deepest) ** order for power in (1, 2) for order in (1, 2)]
        again = [share**power * (share < 0.999 * deepest) for power in (1, 2)]
        columns = [np.interp(self._t_s, self.grid_s, column) for column in (*virgin, *again)]
        return np.column_stack([self.with_history(depth_mm), *columns])

    def _columns(
        self, before: list[Array], value: Array, relaxation_s: Sequence[float], largest: float | None = None
    ) -> Array:
        share = value / max(float(np.max(value)) if largest is None else largest, 1e-9)
        columns = [share**power for power in self._law.powers]
        for time_s in relaxation_s:
            decay = float(np.exp(-self._law.grid_s / time_s))
            columns += [lfilter([1.0, -1.0], [1.0, -decay], share**power) for power in self._law.relaxed_powers]
        return np.column_stack([*before, *(np.interp(self._t_s, self.grid_s, column) for column in columns)])


def check_gain(stage_mm: Array, force_N: Array, config: PressConfig) -> None:
    """Raise `BadReply` when at equal depths, (n,), one press shows far more force than another."""
    ratio = _ratio(press_gains(stage_mm, force_N, config))
    if ratio > config.gain:
        raise BadReply(reason("rig.gain", ratio=ratio))


def check_output_gain(stage_mm: Array, output: Array, config: PressConfig) -> None:
    """Raise `BadReply` when at equal depths one press changes the output far more than another."""
    is_up = stage_mm <= config.shallow * np.max(stage_mm)
    change = output - (np.median(output[is_up]) if np.any(is_up) else output[0])
    ratio = _ratio(press_gains(stage_mm, change * np.sign(np.sum(change)), config))
    if ratio > config.output_gain:
        raise BadReply(reason("rig.output_gain", ratio=ratio))


def check_follows(
    t_s: Array, output: Array, stage_mm_at: Callable[[Array], Array], contact_mm: float, method: ProofMethod
) -> None:
    """Raise `BadReply` if the depth explains too little of the variance of an output, (n, channels).

    An input that floats does not follow. Positions are those of `PressLaw`.
    """
    law = LawBasis(t_s, method)
    depth_mm = np.maximum(0.0, stage_mm_at(law.grid_s) - contact_mm)
    if len(t_s) < method.press.samples or float(np.max(depth_mm)) <= 0.0:
        return
    basis = np.column_stack([np.ones_like(t_s), law.plain(depth_mm)])
    for values in output.T:
        spread = float(np.sum((values - values.mean()) ** 2))
        followed = 1.0 - _misfit(basis, values) / spread if spread else 0.0
        if followed < method.output.follows:
            raise BadReply(reason("rig.follows", percent=100 * followed))


def check_strokes(t_s: Array, values: Array, depth_mm: Array, device: str, config: StrokeConfig) -> None:
    """Raise `BadReply` if a channel, (n, channels), stays at its level in a stroke of the stage on the unit.

    A stroke goes from one turn of the depth, (n,), to the next; a channel that lags follows a little later.
    """
    period_s, way_mm = float(np.median(np.diff(t_s))), config.way * float(np.max(depth_mm, initial=0.0))
    length, late = max(1, round(config.mean_s / period_s)), round(config.lag_s / period_s)
    turns = np.concatenate([find_peaks(sign * depth_mm, prominence=way_mm)[0] for sign in (1.0, -1.0)])
    ends = np.unique([0, *turns, len(t_s) - 1])
    strokes = [(a, b) for a, b in itertools.pairwise(ends) if abs(depth_mm[b] - depth_mm[a]) >= way_mm > 0.0]
    for column in values.T:
        means = np.convolve(column, np.full(length, 1.0 / length), "valid")
        spans = [float(np.ptp(means[a : max(a + 1, b + late - length)])) for a, b in strokes]
        if spans and min(spans) < config.share * max(spans):
            a, b = strokes[int(np.argmin(spans))]
            about = {"level": float(np.mean(column[a:b])), "stuck_mm": abs(float(depth_mm[b] - depth_mm[a]))}
            raise BadReply(reason("rig.stuck", device=device_label(device), **about))


def check_converter(t_s: Array, output: Array, stage_mm: Array, unit: str, method: ProofMethod) -> None:
    """Raise `BadReply` if an output, (n, channels), has a stuck bit, or jumps for a moment and returns.

    A rail may be the only reading with some bit, and a stuck bit makes jumps: bits are checked outside dropouts.
    """
    dropouts = [dropout for values in output.T for dropout in find_dropouts(values, stage_mm, method.dropout)]
    is_off = np.zeros(len(t_s), dtype=bool)
    for dropout in dropouts:
        is_off[dropout.begin : dropout.end] = True
    check_bits(output[~is_off], method.output)
    if dropouts:
        first = min(dropouts, key=lambda dropout: dropout.begin)
        at_s, lasts_s = t_s[first.begin], (first.end - first.begin) * np.median(np.diff(t_s))
        levels = {"level": first.level, "expected": first.expected}
        raise BadReply(reason("rig.dropout", at_s=float(at_s), lasts_s=float(lasts_s), unit=unit, **levels))


def check_bits(output: Array, config: OutputConfig) -> None:
    """Raise `BadReply` when a line of the converter hangs: a bit of the output, (n, channels), that never changes.

    Readings of a converter are whole multiples of its step, and run through several times the bit's weight.
    """
    for values in output.T:
        levels = np.unique(values)
        if len(levels) < config.levels:
            continue
        counts = levels / np.min(np.diff(levels))
        if np.max(np.abs(counts - np.round(counts))) > config.rounding or np.max(np.abs(counts)) > 2**31:
            continue  # No converter's steps: an instrument that averages.
        codes = np.round(counts).astype(np.int64)
        for bit in range(int(np.log2(np.ptp(codes) / config.span)) + 1):
            if len(np.unique(codes >> bit & 1)) == 1:
                raise BadReply(reason("rig.bit", bit=bit))


def press_gains(stage_mm: Array, force_N: Array, config: PressConfig) -> Array:
    """Return the force of each press relative to the run's usual one at equal depths, (number of presses,).

    A press that never is where others have a quarter of the run's largest force is left out.
    """
    # Stretches that leave the shallow tenth and come back to it, or to the end.
    is_deep = np.concatenate([[False], stage_mm > config.shallow * np.max(stage_mm), [False]])
    turns = np.flatnonzero(np.diff(is_deep.astype(int)))
    if not len(turns):
        return np.empty(0)
    edges = np.linspace(0.0, float(np.max(stage_mm)) + 1e-9, config.depths)
    bins = np.digitize(stage_mm, edges)
    medians = np.full(len(edges) + 1, np.nan)
    for k in np.unique(bins):
        medians[k] = np.median(force_N[bins == k])
    usual = medians[bins]
    is_pressed = np.isfinite(usual) & (usual > config.pressed * np.nanmax(usual))
    gains = []
    for begin, end in turns.reshape(-1, 2):
        is_compared = is_pressed[begin:end]
        if np.count_nonzero(is_compared) >= config.samples:
            expected, force = usual[begin:end][is_compared], force_N[begin:end][is_compared]
            gains.append(float(np.dot(force, expected) / np.dot(expected, expected)))
    return np.array(gains)


def _ratio(gains: Array) -> float:
    return float(np.max(gains) / max(float(np.min(gains)), 1e-9)) if len(gains) > 1 else 1.0


def _weights(basis: Array, force_N: Array) -> Array:
    return np.asarray(np.linalg.lstsq(basis, force_N, rcond=None)[0])


def _misfit(basis: Array, force_N: Array) -> float:
    return float(np.sum((force_N - basis @ _weights(basis, force_N)) ** 2))
