"""Whether the channels of a finished run tell one story: force and stage in step, one gain from press to press.

No I/O here. A channel that lies smoothly cannot be seen sample by sample; it is seen against the others.
"""

from collections.abc import Callable

import numpy as np

from softcal.core.errors import BadReply
from softcal.core.recording import Array
from softcal.core.words.reason import reason

STEP_S, EARLIEST_S, LATEST_S = 0.0025, -0.15, 0.7
"""Delays that are tried when force and stage are laid over each other."""

POWERS = (1, 2, 3, 4)
LATE_S, EARLY_S = 0.04, 0.12
"""A cell may seem this much later than declared, or this much earlier: relaxation makes a soft unit's force lead."""

TELLS = 1.5
"""A delay that fits the run so many times better than one LATE_S beside it is known."""

GAIN = 1.4
"""Largest ratio between the stiffest and the softest press of one run; a cell whose gain halves shows 2."""

PRESS_SAMPLES = 10


def lag_s(t_s: Array, force_N: Array, stage_mm_at: Callable[[Array], Array], contact_mm: float) -> float:
    """Return by how much the force is behind the stage.

    The force is laid over a smooth law of the depth, shifted in time, by least squares.

    Args:
        t_s, force_N: (n,) samples of the load cell, host clock.
        stage_mm_at: host times -> stage positions, same origin as contact_mm.
        contact_mm: where the unit's surface is.

    Returns:
        Delay in s, positive when the force is late; NaN where the run does not tell: too shallow, too slow, too noisy.
    """

    def misfit(lag: float) -> float:
        return _misfit(t_s - lag, force_N, stage_mm_at, contact_mm)

    lags = np.arange(EARLIEST_S, LATEST_S, STEP_S)
    if len(t_s) < PRESS_SAMPLES or float(np.max(stage_mm_at(t_s))) <= contact_mm:
        return float("nan")
    coarse = lags[::8]
    best = coarse[int(np.argmin([misfit(lag) for lag in coarse]))]
    near = lags[np.abs(lags - best) <= 8 * STEP_S]
    found = float(near[int(np.argmin([misfit(lag) for lag in near]))])
    beside = min(misfit(found - LATE_S), misfit(found + LATE_S))
    return found if beside > TELLS * misfit(found) else float("nan")


def check_lag(found_s: float, declared_s: float) -> None:
    """Raise `BadReply` when the load cell is later, or earlier, than its station file says."""
    off_s = found_s - declared_s
    if off_s > LATE_S or off_s < -EARLY_S:
        raise BadReply(reason("rig.behind", found_s=found_s, declared_s=declared_s, latency_s=max(0.0, found_s)))


def check_gain(stage_mm: Array, force_N: Array) -> None:
    """Compare the presses of a run with each other at equal depths.

    Args:
        stage_mm: (n,) depth, 0 at the start of the profile.
        force_N: (n,) force there.

    Raises:
        BadReply: at equal depths one press shows far more force than another.
    """
    gains = press_gains(stage_mm, force_N)
    if len(gains) > 1 and float(np.max(gains)) > GAIN * float(np.min(gains)):
        raise BadReply(reason("rig.gain", ratio=np.max(gains) / np.min(gains)))


def press_gains(stage_mm: Array, force_N: Array) -> Array:
    """Return the force of each press relative to the run's usual one at equal depths, (number of presses,)."""
    presses = _presses(stage_mm)
    if not presses:
        return np.empty(0)
    edges = np.linspace(0.0, float(np.max(stage_mm)) + 1e-9, 25)
    bins = np.digitize(stage_mm, edges)
    usual = np.array([_median(force_N[bins == k]) for k in range(len(edges) + 1)])[bins]
    is_pressed = np.isfinite(usual) & (usual > 0.25 * np.nanmax(usual))
    gains = []
    for begin, end in presses:
        own = is_pressed[begin:end]
        if np.count_nonzero(own) >= PRESS_SAMPLES:
            expected, force = usual[begin:end][own], force_N[begin:end][own]
            gains.append(float(np.dot(force, expected) / np.dot(expected, expected)))
    return np.array(gains)


def _presses(stage_mm: Array) -> list[tuple[int, int]]:
    """Stretches that leave the shallow tenth and come back to it, or to the end."""
    is_deep = np.concatenate([[False], stage_mm > 0.1 * np.max(stage_mm), [False]])
    turns = np.flatnonzero(np.diff(is_deep.astype(int)))
    return [(int(begin), int(end)) for begin, end in zip(turns[::2], turns[1::2], strict=True)]


def _median(values: Array) -> float:
    return float(np.median(values)) if len(values) else float("nan")


def _misfit(t_s: Array, force_N: Array, stage_mm_at: Callable[[Array], Array], contact_mm: float) -> float:
    depth_mm = np.maximum(0.0, stage_mm_at(t_s) - contact_mm)
    scale = max(float(np.max(depth_mm)), 1e-9)
    basis = np.column_stack([np.ones_like(depth_mm), *((depth_mm / scale) ** power for power in POWERS)])
    _, residual, rank, _ = np.linalg.lstsq(basis, force_N, rcond=None)
    if len(residual):
        return float(residual[0])
    return float(np.sum((force_N - force_N.mean()) ** 2)) if rank < 2 else 0.0
