"""Which stage of the chain the gap sits in, from maps and residual; no effect is needed; the twin that explains it.

Three maps are refitted separately: they name a group of stages, the residual one within it. What swings to and fro over
the stage position, or jumps in time, is motion. What lasts at rest or swings with the voltage is
electronics. What follows the slope of the output is acquisition. The rest acts only under load.

The explained twin, for station and simulated lots, is the refitted base with the named causes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from softcal.core.gap.case import Case, Run
from softcal.core.gap.evidence import with_constants
from softcal.core.gap.fit import Map, form_of
from softcal.core.gap.model import Block, Fit
from softcal.core.gap.twin_reach import dither_of
from softcal.core.messages.reason import Reason, reason
from softcal.core.profiles import describe_profile
from softcal.core.recording import Array
from softcal.core.twin.catalogue import EFFECTS
from softcal.core.twin.effects import ChainStage, SearchTarget
from softcal.core.twin.empirical_terms import EmpiricalTerm
from softcal.core.twin.parameters import SensorType
from softcal.core.twin.simulate import EffectSetting, Twin

TIED = 1e-6
"""Share of the largest speed by which two samples of one ramp differ in rounding alone."""


def cases_of_maps(case: Case) -> dict[str, Case]:
    """Return the recordings of each chain relation alone, by its name."""
    stage, force, output = (case.has(channel) for channel in ("stage_mm", "force_N", "output_V"))
    is_pressure, runs = case.readout.sensor_type == "pressure", {}
    if stage and force:
        runs["stage→force"] = [replace(run, output_V=None) for run in case.presses]
    if force and output and is_pressure:
        runs["force→output"] = [replace(run, stage_mm=None) for run in case.presses]
    if stage and output:
        runs["stage→output"] = [replace(run, force_N=None) for run in case.presses]
    return {name: Case(case.serial, tuple(of)) for name, of in runs.items()}


BEFORE: tuple[ChainStage, ...] = ("mechanics", "motion")
BEHIND: tuple[ChainStage, ...] = ("transduction", "electronics", "acquisition")


def suspects(maps: tuple[Map, ...], quiet: float, sensor_type: SensorType = "pressure") -> tuple[ChainStage, ...]:
    """Return the stages that the pattern of dirty maps points to; none when all are clean.

    Args:
        quiet: a map this much cleaner than the dirtiest counts as closed.

    A dirty stage→force with a clean force→output is motion or mechanics, the reverse is the channel or
    its electronics; when stage→output alone is clean, the load cell is what both others share.
    """
    z = {m.name: m.structure.z for m in maps}
    structured = {m.name for m in maps if m.structure.is_significant}
    if not structured:
        return ()
    if sensor_type == "strain":
        # A strain sensor does not feel the force: pad and cell look alike.
        pad_or_behind = BEFORE if "stage→force" in structured else BEHIND
        return pad_or_behind if "stage→output" in structured else ("mechanics", "load_cell")
    if len(z) < 3:
        # One map alone: what lies on its own side, and the cell that reads its force.
        side = {"stage→force": BEFORE, "force→output": BEHIND}.get(next(iter(z)))
        return (*BEFORE, *BEHIND) if side is None else (*side, "load_cell")
    loud = max(z.values())
    excluded: dict[str, tuple[ChainStage, ...]]
    excluded = {"stage→output": ("load_cell",), "force→output": BEFORE, "stage→force": BEHIND}
    for name, stages in excluded.items():
        if name not in structured or z[name] <= quiet * loud:
            return stages
    # All three are dirty: the cleanest of them leaves out the stage that the other two share.
    quietest = min(z, key=lambda name: z[name])
    return excluded[quietest] if z[quietest] < 5 * quiet * loud else (*BEFORE, *BEHIND)


def conditions_of_presses(result: Fit, blocks: list[Block]) -> dict[Reason, Array]:
    """Return (n,) per condition of pressing whether a row of the blocks was recorded under it."""
    case = result.problem.case
    runs = [case.runs[b.run] for b in blocks]
    drive = np.concatenate([_drive(run) for run in runs])
    speed = np.concatenate([np.gradient(_drive(run), run.t_s) for run in runs])
    part = np.concatenate([run.elapsed_s / run.elapsed_s[-1] for run in runs])
    # Without a stage the load tells: a fiftieth of the largest counts as contact.
    contact = result.base.u0_mm if case.has("stage_mm") else 0.02 * float(drive.max())
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
            name = reason("gap.regime.run_pressed", run=run.name, pressed=describe_profile(run.profile))
        conditions[name] = np.concatenate([np.full(len(r), i == k) for i, r in enumerate(runs)])
    return conditions


def _drive(run: Run) -> Array:
    drive = run.stage_mm if run.stage_mm is not None else run.force_N
    return np.zeros(len(run)) if drive is None else drive


@dataclass(frozen=True)
class Tone:
    """The strongest tone of a channel, in units of the noise; `width_Hz` is of its spectrum."""

    channel: str
    frequency_Hz: float
    rms: float
    width_Hz: float

    def is_same(self, other: "Tone") -> bool:
        """Whether another tone, of another run for example, is this one."""
        distance_Hz = abs(self.frequency_Hz - other.frequency_Hz)
        return self.channel == other.channel and distance_Hz < self.width_Hz + other.width_Hz


def strongest_tone(result: Fit) -> Tone | None:
    """Return the strongest tone in the residuals of a channel; None where there is none.

    A ripple over the travel changes with the speed: of several runs two must show the same tone.
    """
    tones = [t for block in result.problem.blocks if (t := _tone(result, block)) is not None]
    alone = len(result.problem.case.presses) == 1
    repeated = [t for t in tones if alone or sum(t.is_same(other) for other in tones) > 1]
    return max(repeated, key=lambda tone: tone.rms, default=None)


def _tone(result: Fit, block: Block) -> Tone | None:
    """Return the strongest tone of one channel of one run.

    The largest of m ordinates of a periodogram of white noise exceeds g times their mean with a chance
    of about m·exp(−g) (R. A. Fisher, Proc. R. Soc. A 125, 54, 1929).
    """
    run, config = result.problem.case.runs[block.run], result.problem.method.fault_location
    residual = result.residual[block.rows]
    if run.kind != "press":
        return None
    step_s = float(np.median(run.step_s))
    frequency_Hz = np.fft.rfftfreq(len(residual), step_s)
    is_fast = frequency_Hz > config.slowest_Hz
    power = (np.abs(np.fft.rfft(residual - residual.mean())) ** 2 / len(residual))[is_fast]
    if len(power) < config.fewest:
        return None
    at = int(np.argmax(power))
    # The median of exponential ordinates is ln 2 of their mean, which a strong tone would raise.
    level = float(np.median(power)) / math.log(2.0)
    rms = math.sqrt(2.0 * max(power[at] - level, 0.0) / len(residual))
    if rms < config.faintest or power[at] < level * math.log(len(power) / config.chance):
        return None
    return Tone(block.channel, float(frequency_Hz[is_fast][at]), rms, 1.0 / (step_s * len(residual)))


@dataclass(frozen=True)
class LooseNoise:
    """Noise that is not the same everywhere: which stage that points to, and what is seen."""

    stage: ChainStage
    detail: Reason


def loose_noise(result: Fit) -> LooseNoise | None:
    """Return what is wrong with the noise, None where it is even.

    A clock that jitters makes fast samples noisier. A bad contact or a disturbed line throws single
    samples far off; a line picks up a tone. None of these leaves a structure that sums up.
    """
    problem, config = result.problem, result.problem.method.fault_location
    if dither_of(problem) is not None:
        return None
    rows = zip(result.effects, result.effect_values, strict=True)
    fitted = [(effect.signs.search_target, values) for effect, values in rows]
    tone = strongest_tone(result)
    lines = [values for search_target, values in fitted if search_target == SearchTarget.LINE]
    # A named line breathes as that of mains does: what its equation leaves is a tone beside it.
    is_near_mains = tone is not None and any(
        tone.channel == "output_V"
        and abs(tone.frequency_Hz - frequency_Hz) < config.breathes_Hz
        and tone.rms * problem.noise_floor("output_V") < config.max_line_share * amplitude / np.sqrt(2.0)
        for amplitude, frequency_Hz, *_ in lines
    )
    if tone is not None and not is_near_mains:
        stage: ChainStage = "electronics" if tone.channel == "output_V" else "load_cell"
        name = tone.channel.split("_")[0]
        detail = reason("gap.seen.tone", frequency_Hz=tone.frequency_Hz, channel=name, rms=tone.rms)
        return LooseNoise(stage, detail)
    levels_V = [
        values[0] for search_target, values in fitted if search_target in (SearchTarget.CEILING, SearchTarget.FLOOR)
    ]
    return _loose_output(result, levels_V)


def _loose_output(result: Fit, levels_V: Sequence[float]) -> LooseNoise | None:
    problem, runs, config = result.problem, result.problem.case.runs, result.problem.method.fault_location
    blocks = [b for b in problem.blocks_of("output_V", "press") if runs[b.run].stage_mm is not None]
    if not blocks:
        return None
    every_V = np.concatenate([result.predicted[b.rows] for b in blocks])
    is_open, near_V = np.ones(len(every_V), dtype=np.bool_), config.clipped_sigma * problem.noise_floor("output_V")
    # A clipped output has less noise than the rest, and stands still.
    for level_V in levels_V:
        is_open &= np.abs(every_V - level_V) >= near_V
    quick = []
    for block in blocks:
        # What a sample has beyond the mean of its neighbours; white noise keeps its variance.
        residual, roughness = result.residual[block.rows], np.zeros(block.rows.stop - block.rows.start)
        roughness[1:-1] = (residual[1:-1] - 0.5 * (residual[:-2] + residual[2:])) / np.sqrt(1.5)
        quick.append(roughness)
    error, output_V = np.concatenate(quick)[is_open], every_V[is_open]
    speed = np.abs(np.concatenate([_rate(result, b) for b in blocks]))[is_open]
    is_loaded = output_V > output_V.min() + config.loaded * np.ptp(output_V)
    is_slow = speed < np.quantile(speed, 0.5)
    spikes = int(np.count_nonzero(np.abs(error[is_slow]) > config.spike_sigma))
    # More than one in twenty are no spikes but a wider noise.
    if config.fewest_spikes <= spikes < 0.05 * len(error):
        return LooseNoise("electronics", reason("gap.seen.spikes", count=spikes))
    if np.count_nonzero(is_loaded) < 100:
        return None
    # Noise may grow with the load as well; only samples under load are compared.
    slow_to, fast_from = np.quantile(speed[is_loaded], (0.4, 0.75))
    fast, slow = error[is_loaded & (speed >= fast_from)] ** 2, error[is_loaded & (speed <= slow_to)] ** 2
    z = (fast.mean() - slow.mean()) / np.sqrt(2.0 / len(fast) + 2.0 / len(slow))
    if z > config.uneven_z and fast.mean() > config.uneven_ratio * slow.mean():
        return LooseNoise("acquisition", Reason("gap.seen.jitter"))
    return None


def likely_stages(base: Fit, maps: tuple[Map, ...]) -> tuple[ChainStage, ...]:
    """Return the stages the gap may sit in, the likeliest first; none where no map shows a gap."""
    pointed = suspects(maps, base.problem.method.structure.quiet, base.problem.case.readout.sensor_type)
    loose, loudest = loose_noise(base), max((m.structure.z for m in maps), default=0.0)
    if loose is not None and loudest < base.problem.method.fault_location.faint_z:
        return (loose.stage, *(stage for stage in pointed if stage != loose.stage))
    first: list[ChainStage] = []
    if "motion" in pointed and "transduction" not in pointed:
        first.append("motion" if _is_motion(base) else "mechanics")
    elif "transduction" in pointed and "motion" not in pointed:
        first.append(_behind(base, loose))
    return (*first, *(stage for stage in pointed if stage not in first))


def _rate(result: Fit, block: Block) -> Array:
    run = result.problem.case.runs[block.run]
    return np.asarray(np.gradient(result.predicted[block.rows], run.t_s))


def _behind(base: Fit, loose: LooseNoise | None) -> ChainStage:
    config = base.problem.method.fault_location
    blocks = base.problem.blocks_of("output_V", "press")
    if not blocks:
        return "transduction"
    error = np.concatenate([base.residual[b.rows] for b in blocks])
    output_V = np.concatenate([base.predicted[b.rows] for b in blocks])
    rate = np.concatenate([_rate(base, b) for b in blocks])
    excess = max(float(error @ error) - len(error), 1.0)
    share, swings = _static(error, output_V, excess, config.bins)
    if share > config.min_share:
        return "electronics" if swings >= config.swings else "transduction"
    if loose is not None:
        return loose.stage
    # A shift in time errs by the slope of the output, to first order.
    if float(error @ rate) ** 2 / float(rate @ rate) > config.min_share * excess:
        return "acquisition"
    # At rest neither pad nor channel acts: what errs there comes from behind them.
    at_rest = output_V < output_V.min() + 0.02 * np.ptp(output_V)
    mean = excess / len(error)
    if np.count_nonzero(at_rest) > 50 and float(np.mean(error[at_rest] ** 2)) - 1.0 > config.min_share * mean:
        return "electronics"
    return "transduction"


def _static(error: Array, drive: Array, excess: float, bins: int) -> tuple[float, int]:
    """Return which share of the excess the drive determines, and how often it changes sign."""
    edges = np.linspace(drive.min(), drive.max() + 1e-12, bins + 1)
    bin_of = np.clip(np.digitize(drive, edges) - 1, 0, bins - 1)
    count = np.bincount(bin_of, minlength=bins)
    sums = np.bincount(bin_of, weights=error, minlength=bins)
    is_filled = count > 8
    means = sums[is_filled] / count[is_filled]
    clear = means[np.abs(means) > 4.0 / np.sqrt(count[is_filled])]
    share = float(np.sum(sums[is_filled] ** 2 / count[is_filled]) - np.count_nonzero(is_filled)) / excess
    return share, int(np.count_nonzero(np.diff(np.sign(clear))))


def _is_motion(base: Fit) -> bool:
    """Whether the force is off as by a wrong position: a ripple over the travel, or a jump."""
    blocks = base.problem.blocks_of("force_N", "press")
    if not blocks:
        return False
    config, errors, travels, jumps, trends, sets = base.problem.method.fault_location, [], [], 0.0, 0.0, 0.0
    for block in blocks:
        travel = np.asarray(base.problem.case.runs[block.run].stage_mm)
        depth_mm = np.maximum(0.0, travel - base.base.u0_mm)
        slope = base.base.k1_N_mm + 3.0 * base.base.k3_N_mm3 * depth_mm**2
        # So scaled a wrong position weighs alike at any depth.
        scaled = base.residual[block.rows] * float(np.median(slope)) / np.maximum(slope, 1e-9 * float(np.max(slope)))
        error, total = np.where(depth_mm > 0, scaled, 0.0), len(travel)
        # The energy that one step in time takes away, beyond the mean ...
        total_error, count, cumulated = float(error.sum()), np.arange(1, total), np.cumsum(error)[:-1]
        steps = cumulated**2 / count + (total_error - cumulated) ** 2 / (total - count)
        jumps += float(np.max(steps) - total_error**2 / total)
        # ... a straight line in time ...
        t = np.arange(total) - 0.5 * (total - 1)
        trends += float((error @ t) ** 2 / (t @ t))
        # ... and a function of the deepest position so far.
        deepest = np.maximum.accumulate(travel)
        bin_of = np.digitize(deepest, np.linspace(deepest.min(), deepest.max() + 1e-12, 9))
        sums = np.bincount(bin_of, weights=error) ** 2 / np.maximum(np.bincount(bin_of), 1)
        sets += float(np.sum(sums) - total_error**2 / total)
        errors.append(error)
        travels.append(travel)
    every = np.concatenate(errors)
    excess = max(float(every @ every) - len(every), 1.0)
    share, swings = _static(every, np.concatenate(travels), excess, config.bins)
    if share > config.min_share and swings >= config.swings:
        return True
    return jumps > config.min_share * excess and jumps > 1.2 * max(sets, trends)


def explained_twin(result: Fit, terms: Sequence[EmpiricalTerm] = ()) -> Twin:
    """Return base parameters, noise and causes of a fitted hypothesis as a twin.

    A cause enters by the equation it was fitted by. Episodes belong to the recording they were found in
    and are left out: losses of samples and bad contacts are repaired, not simulated.
    """
    result = with_constants(result)
    readout = result.problem.case.readout
    # σV without the share of rounding, q²/12 where the noise is not small against a step.
    sigma_V = dither_of(result.problem)
    if sigma_V is None:
        sigma_V = float(np.sqrt(max(_noise_floor(result, "output_V") ** 2 - readout.step_V**2 / 12, 0.0)))
    base = result.base.with_values(sigma_output_V=sigma_V, sigma_force_N=_noise_floor(result, "force_N"))
    settings = []
    for effect, values in zip(result.effects, result.effect_values, strict=True):
        if effect.id not in EFFECTS or EFFECTS[effect.id].is_episodic:
            continue
        constants = {p.name: v for p, v in zip(effect.parameters, values, strict=True)} | dict(effect.constants)
        form = form_of(result, effect)
        # What belongs to a recording alone, as the phase of a hum, is no parameter of the twin.
        effect_side = effect if form else EFFECTS[effect.id].find_side([effect.parameters[0].name])
        fitted = {k: v for k, v in constants.items() if k in effect_side.value_names and np.isfinite(v)}
        settings.append(EffectSetting(effect.id, fitted, form=form))
    return Twin(base, tuple(settings), readout, tuple(terms))


def _noise_floor(result: Fit, channel: str) -> float:
    return result.problem.noise_floor(channel) if channel in result.problem.sigma else 0.0
