"""Where the gap lies: three maps refitted separately, and where the residual stands out."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from softcal.core.gap.case import Case, Run
from softcal.core.gap.fit import Fit
from softcal.core.gap.method import METHOD
from softcal.core.gap.problem import Block
from softcal.core.gap.start import base_fit
from softcal.core.profiles import pressed
from softcal.core.recording import Array
from softcal.core.twin.effects import ChainStage
from softcal.core.twin.parameters import SensorType
from softcal.core.words.reason import Reason, reason

CONFIG = METHOD.structure

TIED = 1e-6
"""Share of the largest speed by which two samples of one ramp differ in rounding alone."""


@dataclass(frozen=True)
class Structure:
    """How much of a residual is not noise: excess in standard errors, rms in units of the noise."""

    z: float
    rms: float

    @property
    def is_significant(self) -> bool:
        return self.z > CONFIG.dirty_z


@dataclass(frozen=True)
class Map:
    """One chain relation fitted alone: stage→force, force→output or stage→output."""

    name: str
    structure: Structure


@dataclass(frozen=True)
class Regime:
    """A condition in which a channel's gap stands out: share of its energy, and over that of time."""

    channel: str
    name: Reason
    share: float
    lift: float


def structure(found: Fit, channel: str | None = None) -> Structure:
    """Measure the structure left in the residual of a fit, of one channel or of all."""
    parts = [found.residual[b.place] for b in found.problem.blocks if channel in (None, b.channel)]
    largest = -np.inf
    for length in CONFIG.block_samples:
        # Block sums of white noise keep variance 1 at any length; structure adds up in them.
        sums = [_block_sums(part, length) for part in parts]
        every = np.concatenate(sums)
        if len(every) > 3:
            largest = max(largest, float((np.mean(every**2) - 1.0) / np.sqrt(2.0 / len(every))))
    short = np.concatenate([_block_sums(part, CONFIG.block_samples[0]) for part in parts])
    energy = max(0.0, float(np.mean(short**2)) - 1.0) / CONFIG.block_samples[0] if len(short) else 0.0
    return Structure(largest, float(np.sqrt(energy)))


def is_clean(found: Fit) -> bool:
    """Whether a fit leaves no structure."""
    return not structure(found).is_significant


def _block_sums(values: Array, length: int) -> Array:
    whole = len(values) // length * length
    return np.asarray(values[:whole].reshape(-1, length).sum(axis=1) / np.sqrt(length))


def three_maps(case: Case) -> tuple[Map, ...]:
    """Fit each chain relation of the base alone, without any effect, and measure what it leaves."""
    stage, force, output = (case.has(channel) for channel in ("stage_mm", "force_N", "output_V"))
    is_pressure, runs = case.readout.sensor_type == "pressure", {}
    if stage and force:
        runs["stage→force"] = [replace(run, output_V=None) for run in case.presses]
    if force and output and is_pressure:
        runs["force→output"] = [replace(run, stage_mm=None) for run in case.presses]
    if stage and output:
        runs["stage→output"] = [replace(run, force_N=None) for run in case.presses]
    return tuple(Map(name, structure(base_fit(Case(case.serial, tuple(of))))) for name, of in runs.items())


BEFORE: tuple[ChainStage, ...] = ("mechanics", "motion")
BEHIND: tuple[ChainStage, ...] = ("transduction", "electronics", "acquisition")


def suspects(maps: tuple[Map, ...], sensor_type: SensorType = "pressure") -> tuple[ChainStage, ...]:
    """Return the stages that the pattern of dirty maps points to; none when all are clean.

    A dirty stage→force with a clean force→output is motion or mechanics, the reverse is the channel or
    its electronics; when stage→output alone is clean, the load cell is what both others share.
    """
    z = {m.name: m.structure.z for m in maps}
    dirty = {m.name for m in maps if m.structure.is_significant}
    if not dirty:
        return ()
    if sensor_type == "strain":
        # A strain sensor does not feel the force: pad and cell look alike.
        pad_or_behind = BEFORE if "stage→force" in dirty else BEHIND
        return pad_or_behind if "stage→output" in dirty else ("mechanics", "load_cell")
    if len(z) < 3:
        # One map alone: what lies on its own side, and the cell that reads its force.
        side = {"stage→force": BEFORE, "force→output": BEHIND}.get(next(iter(z)))
        return (*BEFORE, *BEHIND) if side is None else (*side, "load_cell")
    loud = max(z.values())
    left_out: dict[str, tuple[ChainStage, ...]]
    left_out = {"stage→output": ("load_cell",), "force→output": BEFORE, "stage→force": BEHIND}
    for name, stages in left_out.items():
        if name not in dirty or z[name] <= CONFIG.quiet * loud:
            return stages
    # All three are dirty: the cleanest of them leaves out the stage that the other two share.
    quietest = min(z, key=lambda name: z[name])
    return left_out[quietest] if z[quietest] < 5 * CONFIG.quiet * loud else (*BEFORE, *BEHIND)


def regimes(found: Fit) -> tuple[Regime, ...]:
    """Return the regimes in which the residual of a fit stands out, the strongest first."""
    out = []
    for channel in ("force_N", "output_V"):
        blocks = found.problem.blocks_of(channel, "press")
        if not blocks:
            continue
        for name, share, time_share in shares_of_gap(found, blocks, _conditions(found, blocks)):
            out.append(Regime(channel, name, float(np.clip(share, 0.0, 1.0)), share / time_share))
    return tuple(sorted(out, key=lambda r: -r.share * np.log(max(r.lift, 1.0) + 1e-9)))


def shares_of_gap(
    found: Fit, blocks: list[Block], conditions: Mapping[Reason, Array]
) -> Iterator[tuple[Reason, float, float]]:
    """Yield each condition with its share of the structured energy of these blocks, and of the time."""
    excess = np.concatenate([found.residual[b.place] ** 2 - 1.0 for b in blocks])
    total = float(excess.sum())
    # Within four standard errors of the sum of squares there is no gap to divide.
    if total > 4 * np.sqrt(2 * len(excess)):
        for name, members in conditions.items():
            time_share = float(np.mean(members))
            # A regime of next to no time, or of nearly all, says nothing of where a gap lies.
            if 0.01 < time_share < 0.95:
                yield name, float(excess[members].sum()) / total, time_share


def _conditions(found: Fit, blocks: list[Block]) -> dict[Reason, Array]:
    case = found.problem.case
    runs = [case.runs[b.run] for b in blocks]
    drive = np.concatenate([_drive(run) for run in runs])
    speed = np.concatenate([np.gradient(_drive(run), run.t_s) for run in runs])
    part = np.concatenate([run.elapsed_s / run.elapsed_s[-1] for run in runs])
    # Without a stage the load tells: a fiftieth of the largest counts as contact.
    contact = found.base.u0_mm if case.has("stage_mm") else 0.02 * float(drive.max())
    touching = drive > contact
    # Quantiles of this recording: no speed in mm/s is fast for every rig.
    quick = np.abs(speed[touching & (np.abs(speed) > 0)])
    slow = float(np.quantile(quick, 0.02)) if len(quick) else 0.0
    fast = float(np.quantile(quick, 0.6)) if len(quick) else np.inf
    fastest = float(np.max(np.abs(speed)))
    moving = np.abs(speed) > max(0.5 * slow, 1e-9 * fastest)
    depth = (drive - contact) / max(float(drive.max()) - contact, 1e-9 * float(np.ptp(drive)))
    conditions = {
        Reason("gap.regime.loading"): touching & moving & (speed > 0),
        Reason("gap.regime.unloading"): touching & moving & (speed < 0),
        Reason("gap.regime.hold"): touching & ~moving,
        Reason("gap.regime.no_contact"): ~touching,
        Reason("gap.regime.first_touch"): touching & (depth < 0.15),
        Reason("gap.regime.high_load"): depth > 0.8,
        Reason("gap.regime.fast_motion"): touching & (np.abs(speed) > fast + TIED * fastest),
        Reason("gap.regime.start"): part < 0.25,
        Reason("gap.regime.end"): part > 0.75,
    }
    for k, run in enumerate(runs):
        name = reason("gap.regime.run", run=run.name)
        if run.profile:
            name = reason("gap.regime.run_pressed", run=run.name, pressed=pressed(run.profile))
        conditions[name] = np.concatenate([np.full(len(r), i == k) for i, r in enumerate(runs)])
    return conditions


def _drive(run: Run) -> Array:
    drive = run.stage_mm if run.stage_mm is not None else run.force_N
    return np.zeros(len(run)) if drive is None else drive
