"""What every rig has and no cause has to explain: a cell not tared, a unit that sits anew."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from softcal.core.gap.case import Case
from softcal.core.gap.linear import combine, dots, gram
from softcal.core.gap.method import METHOD
from softcal.core.recording import Array
from softcal.core.twin.parameters import BaseParameters
from softcal.core.twin.signals import compiled

CONFIG = METHOD.offset

if TYPE_CHECKING:
    from softcal.core.gap.problem import Hypothesis, Problem

STRAIGHT_SIGMA = 0.5
"""Share of its noise that an offset may move a sample along the slope: bends err far less."""

IS_RELATIVE = np.array([False, True, True])
"""Whose common part is the base's own: resistance and surface, not the zero of the force."""

OFFSET_NAMES = ("zero of force_N", "unloaded resistance", "height of the surface")
"""What the twin's offsets are called, in their order."""

PASSES = 3
"""How often offsets that bend a channel are taken up anew: what is left shrinks by its square."""

SEATED = ("press", "rest")
"""Kinds of run in which the unit lies under the stage."""

Directions: TypeAlias = list[Array | None]
"""Per block, (k, n), how a channel changes with each offset; None where a run has none."""


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


Sizes: TypeAlias = Mapping[int, Array]
"""By run, (k,), the sizes of its offsets that are in a prediction."""


@dataclass(frozen=True, eq=False)
class Nearby:
    """The offsets around one prediction, and along what they move nearby; `moved` is in it already."""

    directions: Directions
    moved: Sizes = field(default_factory=dict)

    def sizes(self, problem: "Problem", clean: Array) -> dict[int, Array]:
        """Return what is still to be added to a prediction, (samples,) with `moved` in it."""
        pairs = list(zip(problem.blocks, self.directions, strict=True))
        runs, count = list(dict.fromkeys(b.run for b, rows in pairs if rows is not None)), len(problem.largest_offsets)
        normal, slope = np.zeros((len(runs), count, count)), np.zeros((len(runs), count))
        for block, rows in pairs:
            if rows is not None:
                k, at = runs.index(block.run), block.place
                noise = problem.slow_noise[at]
                _add_normal_equations(normal[k], slope[k], rows, problem.measured[at], clean[at], noise)
        has = np.array([self.moved.get(run, np.zeros(count)) for run in runs]).reshape(len(runs), count)
        sizes = _sizes(normal, slope, has, problem.largest_offsets, problem.are_relative)
        return dict(zip(runs, sizes, strict=True))

    def added(self, problem: "Problem", clean: Array) -> Array:
        """Return a prediction, (samples,) with `moved` in it, with what the offsets add to it."""
        out, sizes = clean.copy(), self.sizes(problem, clean)
        for block, rows in zip(problem.blocks, self.directions, strict=True):
            if rows is not None:
                out[block.place] += combine(sizes[block.run], rows)
        return out


def offsets(problem: "Problem", base: BaseParameters, clean: Array) -> list[Offsets]:
    """Return the least-squares offsets of every run within their bounds: the rest stays a gap.

    Of resistance and seat only what the runs differ by is taken: the rest is the base's R0 and u0.
    """
    sizes = Nearby(directions(problem, base, clean, {})).sizes(problem, clean)
    return [Offsets(run, *map(float, row)) for run, row in sizes.items()]


def with_offsets(
    problem: "Problem", hypothesis: "Hypothesis", coordinates: Array, clean: Array
) -> tuple[Array, Nearby]:
    """Return a (samples,) prediction with the offsets that bend it, and how all move nearby."""
    near = Nearby(problem.directions(hypothesis, coordinates, clean, {}))
    for _ in range(PASSES - 1):
        sizes, bending = near.sizes(problem, clean), np.flatnonzero(problem.are_bending)
        # Where no offset moves a channel further than its slope foretells, the slope will do.
        if not len(bending) or not any(
            rows is not None and _moves(rows, sizes[block.run], bending, problem.noise[block.place]) > STRAIGHT_SIGMA
            for block, rows in zip(problem.blocks, near.directions, strict=True)
        ):
            break
        # A lower surface moves the corner of first touch, which a step along the slope would leave.
        moved = {run: step + near.moved.get(run, 0.0) for run, step in sizes.items()}
        clean = problem.clean(hypothesis, coordinates, moved)
        near = Nearby(problem.directions(hypothesis, coordinates, clean, moved), moved)
    return clean, near


def bases_of(base: BaseParameters, sizes: Sizes) -> dict[int, BaseParameters]:
    """Return the base of every run that has one of its own."""
    return {
        run: base.with_values(u0_mm=base.u0_mm + seat, r0_ohm=base.r0_ohm * (1.0 + resistance))
        for run, (_, resistance, seat) in sizes.items()
    }


def rows_of_runs(problem: "Problem", directions: Directions) -> dict[int, Array]:
    """Return by run, (k, samples), how a prediction changes with its offsets; 0 in other runs."""
    out: dict[int, Array] = {}
    for block, rows in zip(problem.blocks, directions, strict=True):
        if rows is not None:
            out.setdefault(block.run, np.zeros((len(rows), len(problem.measured))))[:, block.place] = rows
    return out


def own_rows(problem: "Problem", directions: Directions) -> tuple[list[Array], tuple[int, ...]]:
    """Return (samples,) rows along which runs may move on their own, and the kind of each.

    Of what is relative they move by what they differ by alone; one run alone by all of it.
    """
    of_run = rows_of_runs(problem, directions).values()
    out: list[Array] = []
    kinds: list[int] = []
    for kind, is_relative in enumerate(problem.are_relative):
        each = [rows[kind] for rows in of_run if rows[kind].any()]
        if is_relative and not problem.case.is_planned:
            each = [row - each[0] for row in each[1:]]
        out, kinds = out + each, kinds + [kind] * len(each)
    return out, tuple(kinds)


@compiled
def _moves(rows: Array, sizes: Array, bending: NDArray[np.int64], noise: Array) -> float:
    """Return the most that one of these offsets moves a sample by, in units of the least noise."""
    most, least = 0.0, np.inf
    for k in range(rows.shape[1]):
        for i in bending:
            most = max(most, abs(rows[i, k] * sizes[i]))
        least = min(least, noise[k])
    return most / least


@compiled
def _sizes(normal: Array, slope: Array, has: Array, largest: Array, are_relative: NDArray[np.bool_]) -> Array:
    """Solve (runs, k, k) normal equations within bounds; a direction that a run lacks gets 0.

    Of those that are relative the middle run is taken off: one far off must not move the others.
    """
    count, kinds = slope.shape
    free = np.zeros((count, kinds))
    for run in range(count):
        scale = np.ones(kinds)
        for i in range(kinds):
            if normal[run, i, i] > 0.0:
                scale[i] = np.sqrt(normal[run, i, i])
        # The ridge divides what two directions that look alike share among both.
        alike = normal[run] / np.outer(scale, scale) + 1e-6 * np.eye(kinds)
        free[run] = np.linalg.solve(alike, slope[run] / scale) / scale + has[run]
    for i in range(kinds):
        is_shown = normal[:, i, i] > 0.0
        if are_relative[i] and is_shown.any():
            free[is_shown, i] -= np.median(free[is_shown, i])
        free[:, i] = np.minimum(np.maximum(free[:, i], -largest[i]), largest[i])
    return free - has


def largest_offsets(case: Case) -> Array:
    """Return the bounds of what is taken off: N, share of R0, mm."""
    return np.array(
        [
            CONFIG.tare * _range(case, "force_N"),
            CONFIG.resistance,
            CONFIG.seat * _range(case, "stage_mm"),
        ]
    )


def _range(case: Case, channel: str) -> float:
    values = (getattr(run, channel) for run in case.runs if run.kind in SEATED)
    return max((float(np.ptp(v)) for v in values if v is not None), default=0.0)


def directions(problem: "Problem", base: BaseParameters, clean: Array, sizes: Sizes) -> Directions:
    """Return per block, (3, n), how the channel changes with each offset; None without the unit."""
    own = bases_of(base, sizes)
    out: Directions = []
    for block in problem.blocks:
        run, mine = problem.case.runs[block.run], own.get(block.run, base)
        if run.kind not in SEATED:
            out.append(None)
            continue
        # Where nothing is pressed, or nobody knows how deep, the seat changes nothing.
        stage_mm = run.stage_mm if run.stage_mm is not None and run.kind == "press" else np.full(len(run), -np.inf)
        kinds = (block.channel == "force_N", run.readout.sensor_type == "strain")
        given = (mine.u0_mm, mine.k1_N_mm, mine.k3_N_mm3, mine.kappa_per_N)
        out.append(_rows(kinds, stage_mm, clean[block.place], run.readout.vref_V, given))
    return out


@compiled
def _rows(
    kinds: tuple[bool, bool], stage_mm: Array, clean: Array, vref_V: float, base: tuple[float, float, float, float]
) -> Array:
    """(3, n) change of a channel per N of tare, share of R0 and mm of seat, by the base."""
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
def _add_normal_equations(
    normal: Array, slope: Array, rows: Array, measured: Array, clean: Array, noise: Array
) -> None:
    """Add RRᵀ and R·e of rows and errors over the noise; errors that nobody knows are left out."""
    weighted, error = np.empty(rows.shape), np.empty(len(measured))
    for k in range(len(measured)):
        error[k] = (measured[k] - clean[k]) / noise[k]
        is_known = not np.isnan(error[k])
        for i in range(rows.shape[0]):
            weighted[i, k] = rows[i, k] / noise[k] if is_known else 0.0
        if not is_known:
            error[k] = 0.0
    normal += gram(weighted)
    slope += dots(weighted, error)
