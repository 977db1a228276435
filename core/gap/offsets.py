"""What every rig has and no cause has to explain: a cell that was not tared, a unit that sits anew in every run."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from softcal.core.gap.case import Case, Run
from softcal.core.gap.linear import combine
from softcal.core.recording import Array
from softcal.core.twin.parameters import BaseParameters
from softcal.core.twin.signals import compiled

if TYPE_CHECKING:
    from softcal.core.gap.fit import Problem

TARE = 0.03
"""Largest force at rest that counts as a cell that was not tared, as a share of the range of the force."""

RESISTANCE = 0.02
"""Largest change of the unloaded resistance from run to run that counts as seating or room temperature."""

SEAT = 0.03
"""Largest change of the height of the surface from run to run that counts as seating, as a share of the stroke."""

STRAIGHT_SIGMA = 0.5
"""Noise of one sample up to which an offset may move it along the slope: where it bends, the error is far smaller."""

RESISTANCE_AT, SEAT_AT = 1, 2
"""Where these stand among the three offsets of a run; the zero of the force comes first."""

SEATED = ("press", "rest")
"""Kinds of run in which the unit lies under the stage."""


@dataclass(frozen=True)
class Offsets:
    """What one run has of its own.

    Args:
        run: its index in the case.
        force_N: what the cell reads at rest.
        resistance: by what share R0 differs from that of the middle run.
        seat_mm: by how much the surface lies lower than in the middle run.
    """

    run: int
    force_N: float = 0.0
    resistance: float = 0.0
    seat_mm: float = 0.0


def offsets(problem: "Problem", base: BaseParameters, clean: Array) -> list[Offsets]:
    """Return the least-squares offsets of every run, within their bounds: what is beyond them stays a gap.

    Of resistance and seat only what the runs differ by is taken: their common part is the base's own R0 and u0.

    Args:
        problem: its recordings and their noise; samples that a fit may not see count, an offset is no forecast.
        base: where the directions are taken.
        clean: (samples,) prediction of the twin.
    """
    runs, sizes = _solved(problem, _all_directions(problem, base, clean), clean)
    return [Offsets(run, *map(float, row)) for run, row in zip(runs, sizes, strict=True)]


Again = Callable[[Mapping[int, BaseParameters]], Array]
"""Predict once more, with a base of its own for every run."""


def with_offsets(problem: "Problem", base: BaseParameters, clean: Array, again: Again) -> Array:
    """Return a prediction, (samples,), with the offsets of every run in it."""
    directions = _all_directions(problem, base, clean)
    runs, sizes = _solved(problem, directions, clean)
    tares = dict(zip(runs, sizes[:, 0], strict=True))
    if _is_bent(problem, directions, dict(zip(runs, sizes, strict=True))):
        # A surface that lies lower moves the corner of first touch: a straight step along the slope would leave it.
        own = {
            run: base.with_values(u0_mm=base.u0_mm + seat, r0_ohm=base.r0_ohm * (1.0 + resistance))
            for run, (_, resistance, seat) in zip(runs, sizes, strict=True)
        }
        clean = again(own)
        for block in problem.blocks:
            if block.channel == "force_N":
                clean[block.place] += tares.get(block.run, 0.0)
        directions = _all_directions(problem, base, clean, own)
        runs, sizes = _solved(problem, directions, clean)
    out, found = clean.copy(), dict(zip(runs, sizes, strict=True))
    for block, rows in zip(problem.blocks, directions, strict=True):
        if rows is not None:
            out[block.place] += combine(found[block.run], rows)
    return out


def _is_bent(problem: "Problem", directions: list[Array | None], sizes: Mapping[int, Array]) -> bool:
    """Whether a resistance or a seat moves a channel by so much that its slope does not foretell it."""
    for block, rows in zip(problem.blocks, directions, strict=True):
        if rows is None:
            continue
        largest = np.max(np.abs(rows[RESISTANCE_AT:]), axis=1) * np.abs(sizes[block.run][RESISTANCE_AT:])
        if np.any(largest > STRAIGHT_SIGMA * float(np.min(problem.noise[block.place]))):
            return True
    return False


def _solved(problem: "Problem", directions: list[Array | None], clean: Array) -> tuple[list[int], Array]:
    """Return the seated runs and, (runs, 3), their sizes along the directions of their blocks."""
    runs = list(dict.fromkeys(b.run for b, rows in zip(problem.blocks, directions, strict=True) if rows is not None))
    normal, slope = np.zeros((len(runs), 3, 3)), np.zeros((len(runs), 3))
    for block, rows in zip(problem.blocks, directions, strict=True):
        if rows is not None:
            k, at = runs.index(block.run), block.place
            _add_normal_equations(normal[k], slope[k], rows, problem.measured[at] - clean[at], problem.slow_noise[at])
    if not runs:
        return [], np.zeros((0, 3))
    free = _least_squares(normal, slope)
    is_shown = np.diagonal(normal, axis1=1, axis2=2) > 0.0
    for k in (RESISTANCE_AT, SEAT_AT):
        # The middle run: one that is far off for another reason must not move the others.
        free[is_shown[:, k], k] -= np.median(free[is_shown[:, k], k]) if is_shown[:, k].any() else 0.0
    return runs, np.clip(free, -problem.largest_offsets, problem.largest_offsets)


def _least_squares(normal: Array, slope: Array) -> Array:
    """Solve (runs, 3, 3) normal equations; a direction that a run does not have gets 0."""
    diagonal = np.diagonal(normal, axis1=1, axis2=2)
    scale = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    # The ridge divides what two directions that look alike share among both.
    alike = normal / (scale[:, :, None] * scale[:, None, :]) + 1e-6 * np.eye(3)
    return np.asarray(np.linalg.solve(alike, (slope / scale)[:, :, None])[:, :, 0] / scale)


def largest_offsets(case: Case) -> Array:
    """Return the bounds of what is taken off: N, share of R0, mm."""
    return np.array([TARE * _range(case, "force_N"), RESISTANCE, SEAT * _range(case, "stage_mm")])


def _range(case: Case, channel: str) -> float:
    values = (getattr(run, channel) for run in case.runs if run.kind in SEATED)
    return max((float(np.ptp(v)) for v in values if v is not None), default=0.0)


def _all_directions(
    problem: "Problem", base: BaseParameters, clean: Array, own: Mapping[int, BaseParameters] = MappingProxyType({})
) -> list[Array | None]:
    """Return per block, (3, n), how the channel changes with each offset; None where the unit is not in the run."""
    runs = problem.case.runs
    return [
        _directions(runs[b.run], own.get(b.run, base), b.channel, clean[b.place])
        if runs[b.run].kind in SEATED
        else None
        for b in problem.blocks
    ]


def _directions(run: Run, base: BaseParameters, channel: str, clean: Array) -> Array:
    """(3, n) change of a channel per N of tare, per share of R0 and per mm of seat, by the base's own equations."""
    readout = run.readout
    # Where nothing is pressed, or nobody knows how deep, the seat changes nothing.
    stage_mm = run.stage_mm if run.stage_mm is not None and run.kind == "press" else np.full(len(run), -np.inf)
    kinds = (channel == "force_N", readout.sensor_type == "strain")
    return _rows(kinds, stage_mm, clean, readout.vref_V, (base.u0_mm, base.k1_N_mm, base.k3_N_mm3, base.kappa_per_N))


@compiled
def _rows(
    kinds: tuple[bool, bool], stage_mm: Array, clean: Array, vref_V: float, base: tuple[float, float, float, float]
) -> Array:
    is_force, is_strain = kinds
    u0_mm, k1_N_mm, k3_N_mm3, kappa_per_N = base
    out = np.zeros((3, len(clean)))
    for k in range(len(clean)):
        depth_mm = max(stage_mm[k] - u0_mm, 0.0)
        force_per_mm = -(k1_N_mm + 3.0 * k3_N_mm3 * depth_mm**2) if depth_mm > 0.0 else 0.0
        if is_force:
            out[0, k], out[2, k] = 1.0, force_per_mm
        elif not np.isnan(clean[k]):
            out[1, k] = clean[k] * (1.0 - clean[k] / vref_V)
            drive = depth_mm if is_strain else k1_N_mm * depth_mm + k3_N_mm3 * depth_mm**3
            per_mm = (-1.0 if depth_mm > 0.0 else 0.0) if is_strain else force_per_mm
            # A fit on its way may drive the base's resistance to infinity.
            out[2, k] = out[1, k] * kappa_per_N / max(1.0 - kappa_per_N * drive, 0.05) * per_mm
    return out


@compiled
def _add_normal_equations(normal: Array, slope: Array, rows: Array, error: Array, noise: Array) -> None:
    """Add RRᵀ and R·e of rows and errors over the noise; errors that nobody knows are left out."""
    for k in range(len(error)):
        if np.isnan(error[k]):
            continue
        weight = 1.0 / noise[k] ** 2
        for i in range(3):
            weighted = weight * rows[i, k]
            slope[i] += weighted * error[k]
            for j in range(3):
                normal[i, j] += weighted * rows[j, k]
