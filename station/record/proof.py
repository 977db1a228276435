"""Whether the channels of a finished run tell one story: force and stage in step, one gain from press to press.

No I/O here. A channel that lies smoothly cannot be seen sample by sample; it is seen against the others.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.signal import lfilter

from softcal.core.errors import BadReply
from softcal.core.inspection.dropouts import find_dropouts
from softcal.core.recording import Array
from softcal.core.words.reason import Reason, reason
from softcal.station.record.method import METHOD

LAG, LAW, CHANGE, HANG = METHOD.lag, METHOD.law, METHOD.change, METHOD.hang
PRESS, OUTPUT, SLIP = METHOD.press, METHOD.output, METHOD.slip


def lag_s(t_s: Array, force_N: Array, stage_mm_at: Callable[[Array], Array], contact_mm: float) -> float:
    """Return by how much the force is behind the stage.

    The force is laid over a smooth law of the depth with relaxation (a generalised Maxwell solid), shifted in time, by
    least squares.

    Args:
        t_s, force_N: (n,) samples of the load cell, host clock.
        stage_mm_at: host times -> stage positions, same origin as contact_mm.

    Returns:
        Delay in s, positive when the force is late; NaN where the run does not tell: too shallow, too slow, too noisy.
    """
    if len(t_s) < PRESS.samples or float(np.max(stage_mm_at(t_s))) <= contact_mm:
        return float("nan")
    is_known = _is_known(t_s)
    t_s, force_N = t_s[is_known], force_N[is_known]
    grid_s = np.arange(t_s[0] - LAG.latest_s - LAG.beside_s, t_s[-1] - LAG.earliest_s + LAG.beside_s, LAW.grid_s)
    law = _law(np.maximum(0.0, stage_mm_at(grid_s) - contact_mm), LAW.relaxation_s)

    def misfit(lag: float) -> float:
        columns = [np.interp(t_s - lag, grid_s, column) for column in law]
        return _misfit(np.column_stack([np.ones_like(t_s), *columns]), force_N)

    coarse = np.arange(LAG.earliest_s, LAG.latest_s, LAG.coarse_s)
    misfits = np.array([misfit(lag) for lag in coarse])
    near = coarse[int(np.argmin(misfits))] + np.arange(-LAG.coarse_s, LAG.coarse_s + LAG.fine_s, LAG.fine_s)
    found = float(near[int(np.argmin([misfit(lag) for lag in near]))])
    # Presses that come again and again fit nearly as well half a press away: every other delay counts.
    others = misfits[np.abs(coarse - found) > LAG.beside_s]
    beside = min(misfit(found - LAG.beside_s), misfit(found + LAG.beside_s), *others)
    return found if beside > (LAG.tells + LAG.tells_samples / len(t_s)) * misfit(found) else float("nan")


def _is_known(t_s: Array) -> Array:
    """What arrives first may belong to a path before these samples, which the law does not know."""
    return np.asarray(t_s >= min(t_s[0] + LAG.latest_s, float(np.median(t_s))))


def check_lag(found_s: float, declared_s: float, period_s: float) -> None:
    """Raise `BadReply` when a cell, read every `period_s`, is later or earlier than stated."""
    off_s, slack_s = found_s - declared_s, LAG.period_share * period_s
    if off_s > LAG.late_s + slack_s or off_s < -LAG.early_s - slack_s:
        raise BadReply(reason("rig.behind", found_s=found_s, declared_s=declared_s, latency_s=max(0.0, found_s)))


def check_gain(stage_mm: Array, force_N: Array) -> None:
    """Raise `BadReply` when at equal depths, (n,), one press shows far more force than another."""
    ratio = _ratio(press_gains(stage_mm, force_N))
    if ratio > PRESS.gain:
        raise BadReply(reason("rig.gain", ratio=ratio))


def check_law(
    t_s: Array, force_N: Array, output: Array, stage_mm_at: Callable[[Array], Array], contact_mm: float
) -> None:
    """Lay one law of the depth with relaxation through the run: the force may not leave it, nor the cell change.

    It sees a gain, a zero or a delay that changes at any moment, and a cell that hangs for one.

    Args:
        t_s, force_N: (n,) samples of the load cell, host clock, its lateness and its zero taken off.
        output: (n,) of the first sensor there.
        stage_mm_at: host times -> stage positions, same origin as contact_mm.

    Raises:
        BadReply: one change of the cell explains what is off in force and output, or the force leaves the law for a
            moment.
    """
    grid_s = _grid(t_s)
    depth_mm = np.maximum(0.0, stage_mm_at(grid_s) - contact_mm)
    _check_moments(t_s, _basis(t_s, grid_s, depth_mm, LAW.relaxation_s), force_N)
    by_depth, by_force = _whole_basis(t_s, grid_s, depth_mm), _whole_basis(t_s, grid_s, np.interp(grid_s, t_s, force_N))
    explained = np.minimum(_explained(t_s, by_depth, force_N), _explained(t_s, by_force, output))
    if np.max(explained) > _by_chance(t_s):
        raise BadReply(reason("rig.odd_force", at_s=float(_moments(t_s)[np.argmax(explained)] - t_s[0])))


def check_slip(
    t_s: Array, force_N: Array, output: Array, stage_mm_at: Callable[[Array], Array], contact_mm: float
) -> None:
    """Raise `BadReply` when the stage lost steps: from one moment on it is higher than it counts.

    That explains more of what the law of the depth leaves than any change of the cell, and the sensor agrees with the
    cell. The arguments are those of `check_law`.
    """
    grid_s = _grid(t_s)
    depth_mm, by_force = stage_mm_at(grid_s) - contact_mm, _whole_basis(t_s, grid_s, np.interp(grid_s, t_s, force_N))
    by_depth = _whole_basis(t_s, grid_s, np.maximum(0.0, depth_mm))
    q, _ = np.linalg.qr(by_depth)
    left, weights = force_N - q @ (q.T @ force_N), _weights(by_depth, force_N)
    higher_mm = np.maximum(0.0, depth_mm - SLIP.tried_mm)
    slope = (_whole_basis(t_s, grid_s, higher_mm, float(np.max(depth_mm))) - by_depth) @ weights / SLIP.tried_mm
    column = slope[:, None] * (t_s[:, None] > _moments(t_s))
    own = column - q @ (q.T @ column)  # What the law could not make itself.
    lost_mm = (left @ own) / np.maximum(np.sum(own**2, axis=0), 1e-300)
    explained = lost_mm * (left @ own) / max(float(left @ left), 1e-300)
    k = int(np.argmax(explained))
    is_clear = explained[k] > max(SLIP.share, float(np.max(_explained(t_s, by_depth, force_N))))
    if abs(lost_mm[k]) < SLIP.least_mm or not is_clear or np.max(_explained(t_s, by_force, output)) > _by_chance(t_s):
        return
    raise BadReply(reason("rig.slipped", at_s=float(_moments(t_s)[k] - t_s[0]), lost_mm=float(lost_mm[k])))


def is_output_alone(
    t_s: Array, force_N: Array, output: Array, stage_mm_at: Callable[[Array], Array], contact_mm: float
) -> bool:
    """Whether a change is far clearer in the output by the force than in the force by the depth."""
    grid_s = _grid(t_s)
    by_depth = _whole_basis(t_s, grid_s, np.maximum(0.0, stage_mm_at(grid_s) - contact_mm))
    by_force = _whole_basis(t_s, grid_s, np.interp(grid_s, t_s, force_N))
    in_force, in_output = _explained(t_s, by_depth, force_N), _explained(t_s, by_force, output)
    return bool(np.max(in_output) > OUTPUT.alone * np.max(in_force))


def find_output_change(t_s: Array, force_N: Array, output: Array) -> Reason | None:
    """Return by how much the output at equal force changed at one moment, or drifts; None where it does neither.

    The cell is taken to be right: `check_law` has compared it with the depth. All are (n,), host clock.
    """
    grid_s = _grid(t_s)
    basis = _whole_basis(t_s, grid_s, np.interp(grid_s, t_s, force_N))
    q, _ = np.linalg.qr(basis)
    fitted = q @ (q.T @ output)
    left = output - fitted
    squares, count = max(float(left @ left), 1e-300), len(t_s)

    def explained(change: Array) -> float:
        own, _ = np.linalg.qr(change - q @ (q.T @ change))
        return float(np.sum((own.T @ left) ** 2)) / squares

    def step(at_s: float) -> Array:
        return np.column_stack([np.ones(count), fitted - fitted[0]]) * (t_s > at_s)[:, None]

    drift = (t_s - t_s[0])[:, None]
    by_drift, at_s = explained(drift), max(_moments(t_s), key=lambda at_s: explained(step(at_s)))
    is_drift = by_drift > explained(step(at_s))
    change = drift if is_drift else step(at_s)
    weights = _weights(np.column_stack([basis, change]), output)
    usual, changed = basis @ weights[: basis.shape[1]], change @ weights[basis.shape[1] :]
    is_after = t_s > at_s
    share = float(np.mean(changed[is_after]) / np.mean(usual[is_after]))
    if is_drift:
        by_range = float(np.ptp(changed) / np.ptp(usual))
        if by_drift < OUTPUT.drift + _noise(t_s) or by_range < OUTPUT.drift_range:
            return None
        return reason("rig.output_drift", rate=float(weights[-1]), percent=100.0 * by_range)
    if explained(change) < OUTPUT.step + _noise(t_s) or abs(share) < OUTPUT.step_share:
        return None
    code = "rig.output_fell" if share < 0.0 else "rig.output_rose"
    return reason(code, percent=100.0 * abs(share), at_s=float(at_s - t_s[0]))


def _grid(t_s: Array) -> Array:
    return np.arange(t_s[0], t_s[-1] + LAW.grid_s, LAW.grid_s)


def _whole_basis(t_s: Array, grid_s: Array, value: Array, largest: float | None = None) -> Array:
    """Return the law of a value on the grid, and what is left of a path before: it fades with the relaxation."""
    relaxation_s = [time_s for time_s in LAW.every_relaxation_s if time_s < t_s[-1] - t_s[0]]
    before = [np.ones_like(t_s), *(np.exp((t_s[0] - t_s) / time_s) for time_s in relaxation_s)]
    return np.column_stack([*before, _basis(t_s, grid_s, value, relaxation_s, largest)])


def _by_chance(t_s: Array) -> float:
    """Return what share of a misfit one change explains of a good rig; 1 where there are too few samples."""
    return CHANGE.share + _noise(t_s) if len(t_s) >= CHANGE.moments else 1.0


def _noise(t_s: Array) -> float:
    """Return what share of noise the best of all changes explains: a gain, a zero or a delay."""
    return float(2.0 * np.log(3 * CHANGE.moments)) / len(t_s)


def _explained(t_s: Array, basis: Array, values: Array) -> Array:
    """Return what share of a law's misfit a gain, a zero or a delay explains that changes, by moment."""
    q, _ = np.linalg.qr(basis)
    fitted = q @ (q.T @ values)
    left, is_after, squares = values - fitted, t_s[:, None] > _moments(t_s), []
    for change in (fitted - fitted[0], np.ones_like(t_s), np.gradient(fitted)):
        column = is_after * change[:, None]
        own = column - q @ (q.T @ column)  # What the law could not make itself.
        squares.append((left @ own) ** 2 / np.maximum(np.sum(own**2, axis=0), 1e-300))
    most = np.max(squares, axis=0)
    is_slight = most < len(t_s) * (CHANGE.slight * np.ptp(values)) ** 2
    return np.where(is_slight, 0.0, most / max(float(left @ left), 1e-300))


def _moments(t_s: Array) -> Array:
    return np.linspace(t_s[0], t_s[-1], CHANGE.moments + 2)[1:-1]


def _check_moments(t_s: Array, basis: Array, force_N: Array) -> None:
    length = max(1, round(HANG.mean_s / float(np.median(np.diff(t_s)))))
    off_N = force_N - basis @ _weights(basis, force_N)
    for _ in range(HANG.rounds):
        # Least absolute deviations: least squares would bend the law towards the odd moment.
        trust = 1 / np.sqrt(np.maximum(np.abs(off_N), np.median(np.abs(off_N)) + 1e-12))
        off_N = force_N - basis @ _weights(basis * trust[:, None], force_N * trust)
    mean_N = np.convolve(off_N, np.full(length, 1 / length), "same")
    mean_N = np.where(_is_known(t_s), mean_N, 0.0)
    oddest = int(np.argmax(np.abs(mean_N)))
    is_rest = np.abs(t_s - t_s[oddest]) > HANG.beside_s
    share = abs(mean_N[oddest]) / float(np.quantile(np.abs(force_N), HANG.largest))
    rest_N = float(np.sqrt(np.mean(off_N[is_rest] ** 2))) if np.any(is_rest) else float("inf")
    times = abs(mean_N[oddest]) / rest_N
    if share > HANG.share or (share > HANG.least and times > HANG.times):
        raise BadReply(reason("rig.odd_force", at_s=float(t_s[oddest] - t_s[0])))


def check_output_gain(stage_mm: Array, output: Array) -> None:
    """Raise `BadReply` when at equal depths one press changes the output far more than another."""
    is_up = stage_mm <= PRESS.shallow * np.max(stage_mm)
    change = output - (np.median(output[is_up]) if np.any(is_up) else output[0])
    ratio = _ratio(press_gains(stage_mm, change * np.sign(np.sum(change))))
    if ratio > PRESS.output_gain:
        raise BadReply(reason("rig.output_gain", ratio=ratio))


def check_follows(t_s: Array, output: Array, stage_mm_at: Callable[[Array], Array], contact_mm: float) -> None:
    """Raise `BadReply` when too little of the variance of an output, (n, channels), goes with the depth.

    An input that floats does not follow. Positions are those of `lag_s`.
    """
    grid_s = _grid(t_s)
    depth_mm = np.maximum(0.0, stage_mm_at(grid_s) - contact_mm)
    if len(t_s) < PRESS.samples or float(np.max(depth_mm)) <= 0.0:
        return
    basis = np.column_stack([np.ones_like(t_s), _basis(t_s, grid_s, depth_mm, LAW.relaxation_s)])
    for values in output.T:
        spread = float(np.sum((values - values.mean()) ** 2))
        followed = 1.0 - _misfit(basis, values) / spread if spread else 0.0
        if followed < OUTPUT.follows:
            raise BadReply(reason("rig.follows", percent=100 * followed))


def check_converter(t_s: Array, output: Array, stage_mm: Array, unit: str) -> None:
    """Raise `BadReply` when a bit of an output, (n, channels), hangs, or it jumps away for a moment and back.

    A rail may be the only reading with some bit, and a bit that hangs makes jumps: bits are read beside the dropouts.
    """
    dropouts = [dropout for values in output.T for dropout in find_dropouts(t_s, values, stage_mm, METHOD.dropout)]
    is_off = np.zeros(len(t_s), dtype=bool)
    for dropout in dropouts:
        is_off[dropout.begin : dropout.end] = True
    check_bits(output[~is_off])
    if dropouts:
        first = min(dropouts, key=lambda dropout: dropout.begin)
        at_s, lasts_s = t_s[first.begin], (first.end - first.begin) * np.median(np.diff(t_s))
        levels = {"level": first.level, "expected": first.expected}
        raise BadReply(reason("rig.dropout", at_s=float(at_s), lasts_s=float(lasts_s), unit=unit, **levels))


def check_bits(output: Array) -> None:
    """Raise `BadReply` when a line of the converter hangs: a bit of the output, (n, channels), that never changes.

    Readings of a converter are whole multiples of its step, and run through several times the bit's weight.
    """
    for values in output.T:
        levels = np.unique(values)
        if len(levels) < OUTPUT.levels:
            continue
        counts = levels / np.min(np.diff(levels))
        if np.max(np.abs(counts - np.round(counts))) > OUTPUT.rounding or np.max(np.abs(counts)) > 2**31:
            continue  # No converter's steps: an instrument that averages.
        codes = np.round(counts).astype(np.int64)
        for bit in range(int(np.log2(np.ptp(codes) / OUTPUT.span)) + 1):
            if len(np.unique(codes >> bit & 1)) == 1:
                raise BadReply(reason("rig.bit", bit=bit))


def press_gains(stage_mm: Array, force_N: Array) -> Array:
    """Return the force of each press relative to the run's usual one at equal depths, (number of presses,).

    A press that never is where others have a quarter of the run's largest force is left out.
    """
    # Stretches that leave the shallow tenth and come back to it, or to the end.
    is_deep = np.concatenate([[False], stage_mm > PRESS.shallow * np.max(stage_mm), [False]])
    turns = np.flatnonzero(np.diff(is_deep.astype(int)))
    if not len(turns):
        return np.empty(0)
    edges = np.linspace(0.0, float(np.max(stage_mm)) + 1e-9, PRESS.depths)
    bins = np.digitize(stage_mm, edges)
    medians = np.full(len(edges) + 1, np.nan)
    for k in np.unique(bins):
        medians[k] = np.median(force_N[bins == k])
    usual = medians[bins]
    is_pressed = np.isfinite(usual) & (usual > PRESS.pressed * np.nanmax(usual))
    gains = []
    for begin, end in turns.reshape(-1, 2):
        own = is_pressed[begin:end]
        if np.count_nonzero(own) >= PRESS.samples:
            expected, force = usual[begin:end][own], force_N[begin:end][own]
            gains.append(float(np.dot(force, expected) / np.dot(expected, expected)))
    return np.array(gains)


def _ratio(gains: Array) -> float:
    return float(np.max(gains) / max(float(np.min(gains)), 1e-9)) if len(gains) > 1 else 1.0


def _basis(
    t_s: Array, grid_s: Array, value: Array, relaxation_s: Sequence[float], largest: float | None = None
) -> Array:
    return np.column_stack([np.interp(t_s, grid_s, column) for column in _law(value, relaxation_s, largest)])


def _law(value: Array, relaxation_s: Sequence[float], largest: float | None = None) -> list[Array]:
    """Return what a force may be made of by the depth, or an output by the force: also relaxed powers.

    They are powers of shares of the largest value.
    """
    share = value / max(float(np.max(value)) if largest is None else largest, 1e-9)
    columns = [share**power for power in LAW.powers]
    for time_s in relaxation_s:
        kept = float(np.exp(-LAW.grid_s / time_s))
        columns += [lfilter([1.0, -1.0], [1.0, -kept], share**power) for power in LAW.relaxed_powers]
    return columns


def _weights(basis: Array, force_N: Array) -> Array:
    return np.asarray(np.linalg.lstsq(basis, force_N, rcond=None)[0])


def _misfit(basis: Array, force_N: Array) -> float:
    return float(np.sum((force_N - basis @ _weights(basis, force_N)) ** 2))
