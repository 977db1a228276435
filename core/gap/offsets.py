"""What every rig has and no cause has to explain: a cell that was not tared, a unit that sits anew in every run."""

from dataclasses import dataclass
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


def with_offsets(problem: "Problem", base: BaseParameters, clean: Array) -> Array:
    """Return a prediction, (samples,), with the offsets of every run in it."""
    out = clean.copy()
    directions = _all_directions(problem, base, clean)
    sizes = dict(zip(*_solved(problem, directions, clean), strict=True))
    for block, rows in zip(problem.blocks, directions, strict=True):
        if rows is not None:
            out[block.place] += combine(sizes[block.run], rows)
    return out


def _solved(problem: "Problem", directions: list[Array | None], clean: Array) -> tuple[list[int], Array]:
    """Return the seated runs and, (runs, 3), their sizes along the directions of their blocks."""
    runs = list(dict.fromkeys(b.run for b, rows in zip(problem.blocks, directions, strict=True) if rows is not None))
    normal, slope = np.zeros((len(runs), 3, 3)), np.zeros((len(runs), 3))
    for block, rows in zip(problem.blocks, directions, strict=True):
        if rows is not None:
            k, at = runs.index(block.run), block.place
            _add_normal_equations(normal[k], slope[k], rows, problem.measured[at] - clean[at], problem.noise[at])
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


def _all_directions(problem: "Problem", base: BaseParameters, clean: Array) -> list[Array | None]:
    """Return per block, (3, n), how the channel changes with each offset; None where the unit is not in the run."""
    runs = problem.case.runs
    return [
        _directions(runs[b.run], base, b.channel, clean[b.place]) if runs[b.run].kind in SEATED else None
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
