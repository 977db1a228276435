"""What every rig has and no cause has to explain: a cell that was not tared, a unit that sits anew in every run."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
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


@dataclass(frozen=True, eq=False)
class Nearby:
    """The offsets of every run around one prediction: nearby they follow another one along the same directions.

    Args:
        directions: per block, (3, n), how the channel changes with each offset; None where the unit is not in the run.
        moved: by run (zero of the force, share of R0, seat) that are in the prediction; none where all are small.
    """

    directions: list[Array | None]
    moved: Mapping[int, Array] = field(default_factory=dict)

    def own(self, base: BaseParameters) -> dict[int, BaseParameters]:
        """Return the base of every run that has one of its own."""
        return {
            run: base.with_values(u0_mm=base.u0_mm + seat, r0_ohm=base.r0_ohm * (1.0 + resistance))
            for run, (_, resistance, seat) in self.moved.items()
        }

    def added(self, problem: "Problem", clean: Array) -> Array:
        """Return a prediction, (samples,) with the bases of `own`, with what the offsets add to it."""
        out = clean.copy()
        for block in problem.blocks if self.moved else ():
            if block.channel == "force_N" and block.run in self.moved:
                out[block.place] += self.moved[block.run][0]
        runs, sizes = _solved(problem, self.directions, out)
        _add(problem, self.directions, dict(zip(runs, sizes, strict=True)), out)
        return out


def with_offsets(problem: "Problem", base: BaseParameters, clean: Array, again: Again) -> tuple[Array, Nearby]:
    """Return a prediction, (samples,), with the offsets of every run in it, and how they move nearby."""
    near = Nearby(_all_directions(problem, base, clean))
    runs, solved = _solved(problem, near.directions, clean)
    sizes = dict(zip(runs, solved, strict=True))
    if not _is_bent(problem, near.directions, sizes):
        out = clean.copy()
        _add(problem, near.directions, sizes, out)
        return out, near
    # A surface that lies lower moves the corner of first touch: a straight step along the slope would leave it.
    own = Nearby([], sizes).own(base)
    clean = again(own)
    near = Nearby(_all_directions(problem, base, clean, own), sizes)
    return near.added(problem, clean), near


def _add(problem: "Problem", directions: list[Array | None], sizes: Mapping[int, Array], out: Array) -> None:
    for block, rows in zip(problem.blocks, directions, strict=True):
        if rows is not None:
            out[block.place] += combine(sizes[block.run], rows)


def run_directions(problem: "Problem", base: BaseParameters, clean: Array) -> dict[int, Array]:
    """Return per seated run, (3, samples), how a prediction changes with each of its offsets; 0 in other runs."""
    out: dict[int, Array] = {}
    for block, rows in zip(problem.blocks, _all_directions(problem, base, clean), strict=True):
        if rows is not None:
            out.setdefault(block.run, np.zeros((3, len(clean))))[:, block.place] = rows
    return out


def _is_bent(problem: "Problem", directions: list[Array | None], sizes: Mapping[int, Array]) -> bool:
    """Whether a resistance or a seat moves a channel by so much that its slope does not foretell it."""
    for block, rows in zip(problem.blocks, directions, strict=True):
        if rows is not None and _moves(rows, sizes[block.run], problem.noise[block.place]) > STRAIGHT_SIGMA:
            return True
    return False


@compiled
def _moves(rows: Array, sizes: Array, noise: Array) -> float:
    """Return the most that resistance or seat moves a sample by, in units of the least noise."""
    most, least = 0.0, np.inf
    for k in range(rows.shape[1]):
        for i in range(RESISTANCE_AT, 3):
            most = max(most, abs(rows[i, k] * sizes[i]))
        least = min(least, noise[k])
    return most / least


def _solved(problem: "Problem", directions: list[Array | None], clean: Array) -> tuple[list[int], Array]:
    """Return the seated runs and, (runs, 3), their sizes along the directions of their blocks."""
    runs = list(dict.fromkeys(b.run for b, rows in zip(problem.blocks, directions, strict=True) if rows is not None))
    normal, slope = np.zeros((len(runs), 3, 3)), np.zeros((len(runs), 3))
    for block, rows in zip(problem.blocks, directions, strict=True):
        if rows is not None:
            k, at = runs.index(block.run), block.place
            _add_normal_equations(normal[k], slope[k], rows, problem.measured[at], clean[at], problem.slow_noise[at])
    return runs, _sizes(normal, slope, problem.largest_offsets)


@compiled
def _sizes(normal: Array, slope: Array, largest: Array) -> Array:
    """Solve (runs, 3, 3) normal equations within bounds; a direction that a run does not have gets 0.

    Of resistance and seat the middle run is taken off: one that is far off for another reason must not move the others.
    """
    count = len(normal)
    free = np.zeros((count, 3))
    for run in range(count):
        scale = np.ones(3)
        for i in range(3):
            if normal[run, i, i] > 0.0:
                scale[i] = np.sqrt(normal[run, i, i])
        # The ridge divides what two directions that look alike share among both.
        alike = normal[run] / np.outer(scale, scale) + 1e-6 * np.eye(3)
        free[run] = np.linalg.solve(alike, slope[run] / scale) / scale
    for i in range(3):
        is_shown = normal[:, i, i] > 0.0
        if i >= RESISTANCE_AT and is_shown.any():
            free[is_shown, i] -= np.median(free[is_shown, i])
        free[:, i] = np.minimum(np.maximum(free[:, i], -largest[i]), largest[i])
    return free


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
def _add_normal_equations(
    normal: Array, slope: Array, rows: Array, measured: Array, clean: Array, noise: Array
) -> None:
    """Add RRᵀ and R·e of rows and errors over the noise; errors that nobody knows are left out."""
    # Sums of their own: adding to the arrays at every sample takes ten times as long.
    aa = ab = ac = bb = bc = cc = ae = be = ce = 0.0
    for k in range(len(measured)):
        error = measured[k] - clean[k]
        if np.isnan(error):
            continue
        weight = 1.0 / (noise[k] * noise[k])
        a, b, c = rows[0, k], rows[1, k], rows[2, k]
        wa, wb, wc = weight * a, weight * b, weight * c
        aa += wa * a
        ab += wa * b
        ac += wa * c
        bb += wb * b
        bc += wb * c
        cc += wc * c
        ae += wa * error
        be += wb * error
        ce += wc * error
    normal += np.array([[aa, ab, ac], [ab, bb, bc], [ac, bc, cc]])
    slope += np.array([ae, be, ce])
