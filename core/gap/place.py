"""Which stage of the chain the gap sits in, from maps and residual; no effect is needed.

The three maps name a group of stages, the residual one within it. What swings to and fro over the
stage position, or jumps in time, is motion. What lasts at rest or swings with the voltage is
electronics. What follows the slope of the output is acquisition. The rest acts only under load.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from softcal.core.gap.fit import Fit
from softcal.core.gap.method import METHOD
from softcal.core.gap.problem import Block
from softcal.core.gap.residual import Map, suspects
from softcal.core.recording import Array
from softcal.core.twin.effects import ChainStage, Placing
from softcal.core.words.reason import Reason, reason

CONFIG = METHOD.place


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


def strongest_tone(found: Fit) -> Tone | None:
    """Return the strongest tone in the residuals of a channel; None where there is none.

    A ripple over the travel changes with the speed: of several runs two must show the same tone.
    """
    tones = [t for block in found.problem.blocks if (t := _tone(found, block)) is not None]
    alone = len(found.problem.case.presses) == 1
    repeated = [t for t in tones if alone or sum(t.is_same(other) for other in tones) > 1]
    return max(repeated, key=lambda tone: tone.rms, default=None)


def _tone(found: Fit, block: Block) -> Tone | None:
    """Return the strongest tone of one channel of one run.

    The largest of m ordinates of a periodogram of white noise exceeds g times their mean with a chance
    of about m·exp(−g) (R. A. Fisher, Proc. R. Soc. A 125, 54, 1929).
    """
    run = found.problem.case.runs[block.run]
    residual = found.residual[block.place]
    if run.kind != "press":
        return None
    step_s = float(np.median(run.step_s))
    frequency_Hz = np.fft.rfftfreq(len(residual), step_s)
    is_fast = frequency_Hz > CONFIG.slowest_Hz
    power = (np.abs(np.fft.rfft(residual - residual.mean())) ** 2 / len(residual))[is_fast]
    if len(power) < CONFIG.fewest:
        return None
    at = int(np.argmax(power))
    # The median of exponential ordinates is ln 2 of their mean, which a strong tone would raise.
    level = float(np.median(power)) / math.log(2.0)
    rms = math.sqrt(2.0 * max(power[at] - level, 0.0) / len(residual))
    if rms < CONFIG.faintest or power[at] < level * math.log(len(power) / CONFIG.chance):
        return None
    return Tone(block.channel, float(frequency_Hz[is_fast][at]), rms, 1.0 / (step_s * len(residual)))


@dataclass(frozen=True)
class LooseNoise:
    """Noise that is not the same everywhere: which stage that points to, and what is seen."""

    stage: ChainStage
    detail: Reason


def loose_noise(found: Fit) -> LooseNoise | None:
    """Return what is wrong with the noise, None where it is even.

    A clock that jitters makes fast samples noisier. A bad contact or a disturbed line throws single
    samples far off; a line picks up a tone. None of these leaves a structure that sums up.
    """
    problem = found.problem
    if problem.dither_V is not None:
        return None
    rows = zip(found.effects, found.effect_values, strict=True)
    fitted = [(effect.signs.placing, values) for effect, values in rows]
    tone = strongest_tone(found)
    lines = [values for placing, values in fitted if placing == Placing.LINE]
    # A named line breathes as that of mains does: what its equation leaves is a tone beside it.
    is_beside_line = tone is not None and any(
        tone.channel == "output_V"
        and abs(tone.frequency_Hz - frequency_Hz) < CONFIG.breathes_Hz
        and tone.rms * problem.floor("output_V") < CONFIG.most_of_line * amplitude / np.sqrt(2.0)
        for amplitude, frequency_Hz, *_ in lines
    )
    if tone is not None and not is_beside_line:
        stage: ChainStage = "electronics" if tone.channel == "output_V" else "load_cell"
        name = tone.channel.split("_")[0]
        seen = reason("gap.seen.tone", frequency_Hz=tone.frequency_Hz, channel=name, rms=tone.rms)
        return LooseNoise(stage, seen)
    levels_V = [values[0] for placing, values in fitted if placing in (Placing.CEILING, Placing.FLOOR)]
    return _loose_output(found, levels_V)


def _loose_output(found: Fit, levels_V: Sequence[float]) -> LooseNoise | None:
    problem, runs = found.problem, found.problem.case.runs
    blocks = [b for b in problem.blocks_of("output_V", "press") if runs[b.run].stage_mm is not None]
    if not blocks:
        return None
    every_V = np.concatenate([found.predicted[b.place] for b in blocks])
    is_open, near_V = np.ones(len(every_V), dtype=np.bool_), CONFIG.clipped_sigma * problem.floor("output_V")
    # A clipped output has less noise than the rest, and stands still.
    for level_V in levels_V:
        is_open &= np.abs(every_V - level_V) >= near_V
    quick = []
    for block in blocks:
        # What a sample has beyond the mean of its neighbours; white noise keeps its variance.
        residual, own = found.residual[block.place], np.zeros(block.place.stop - block.place.start)
        own[1:-1] = (residual[1:-1] - 0.5 * (residual[:-2] + residual[2:])) / np.sqrt(1.5)
        quick.append(own)
    error, output_V = np.concatenate(quick)[is_open], every_V[is_open]
    speed = np.abs(np.concatenate([_rate(found, b) for b in blocks]))[is_open]
    is_loaded = output_V > output_V.min() + CONFIG.loaded * np.ptp(output_V)
    is_slow = speed < np.quantile(speed, 0.5)
    spikes = int(np.count_nonzero(np.abs(error[is_slow]) > CONFIG.spike_sigma))
    # More than one in twenty are no spikes but a wider noise.
    if CONFIG.fewest_spikes <= spikes < 0.05 * len(error):
        return LooseNoise("electronics", reason("gap.seen.spikes", count=spikes))
    if np.count_nonzero(is_loaded) < 100:
        return None
    # Noise may grow with the load as well; only samples under load are compared.
    slow_to, fast_from = np.quantile(speed[is_loaded], (0.4, 0.75))
    fast, slow = error[is_loaded & (speed >= fast_from)] ** 2, error[is_loaded & (speed <= slow_to)] ** 2
    z = (fast.mean() - slow.mean()) / np.sqrt(2.0 / len(fast) + 2.0 / len(slow))
    if z > CONFIG.uneven_z and fast.mean() > CONFIG.uneven_ratio * slow.mean():
        return LooseNoise("acquisition", Reason("gap.seen.jitter"))
    return None


def likely_stages(base: Fit, maps: tuple[Map, ...]) -> tuple[ChainStage, ...]:
    """Return the stages the gap may sit in, the likeliest first; none where no map shows a gap."""
    pointed = suspects(maps, base.problem.case.readout.sensor_type)
    loose, loudest = loose_noise(base), max((m.structure.z for m in maps), default=0.0)
    if loose is not None and loudest < CONFIG.faint_z:
        return (loose.stage, *(stage for stage in pointed if stage != loose.stage))
    first: list[ChainStage] = []
    if "motion" in pointed and "transduction" not in pointed:
        first.append("motion" if _is_motion(base) else "mechanics")
    elif "transduction" in pointed and "motion" not in pointed:
        first.append(_behind(base, loose))
    return (*first, *(stage for stage in pointed if stage not in first))


def _rate(found: Fit, block: Block) -> Array:
    run = found.problem.case.runs[block.run]
    return np.asarray(np.gradient(found.predicted[block.place], run.t_s))


def _behind(base: Fit, loose: LooseNoise | None) -> ChainStage:
    blocks = base.problem.blocks_of("output_V", "press")
    if not blocks:
        return "transduction"
    error = np.concatenate([base.residual[b.place] for b in blocks])
    output_V = np.concatenate([base.predicted[b.place] for b in blocks])
    rate = np.concatenate([_rate(base, b) for b in blocks])
    excess = max(float(error @ error) - len(error), 1.0)
    share, swings = _static(error, output_V, excess)
    if share > CONFIG.most:
        return "electronics" if swings >= CONFIG.swings else "transduction"
    if loose is not None:
        return loose.stage
    # A shift in time errs by the slope of the output, to first order.
    if float(error @ rate) ** 2 / float(rate @ rate) > CONFIG.most * excess:
        return "acquisition"
    # At rest neither pad nor channel acts: what errs there comes from behind them.
    at_rest = output_V < output_V.min() + 0.02 * np.ptp(output_V)
    mean = excess / len(error)
    if np.count_nonzero(at_rest) > 50 and float(np.mean(error[at_rest] ** 2)) - 1.0 > CONFIG.most * mean:
        return "electronics"
    return "transduction"


def _static(error: Array, drive: Array, excess: float) -> tuple[float, int]:
    """Return which share of the excess the drive determines, and how often it changes sign."""
    edges = np.linspace(drive.min(), drive.max() + 1e-12, CONFIG.bins + 1)
    place = np.clip(np.digitize(drive, edges) - 1, 0, CONFIG.bins - 1)
    count = np.bincount(place, minlength=CONFIG.bins)
    sums = np.bincount(place, weights=error, minlength=CONFIG.bins)
    seen = count > 8
    means = sums[seen] / count[seen]
    clear = means[np.abs(means) > 4.0 / np.sqrt(count[seen])]
    share = float(np.sum(sums[seen] ** 2 / count[seen]) - np.count_nonzero(seen)) / excess
    return share, int(np.count_nonzero(np.diff(np.sign(clear))))


def _is_motion(base: Fit) -> bool:
    """Whether the force is off as by a wrong position: a ripple over the travel, or a jump."""
    blocks = base.problem.blocks_of("force_N", "press")
    if not blocks:
        return False
    errors, travels, jumps, trends, sets = [], [], 0.0, 0.0, 0.0
    for block in blocks:
        travel = np.asarray(base.problem.case.runs[block.run].stage_mm)
        depth_mm = np.maximum(0.0, travel - base.base.u0_mm)
        slope = base.base.k1_N_mm + 3.0 * base.base.k3_N_mm3 * depth_mm**2
        # So scaled a wrong position weighs alike at any depth.
        scaled = base.residual[block.place] * float(np.median(slope)) / np.maximum(slope, 1e-9 * float(np.max(slope)))
        error, total = np.where(depth_mm > 0, scaled, 0.0), len(travel)
        # The energy that one step in time takes away, beyond the mean ...
        whole, count, left = float(error.sum()), np.arange(1, total), np.cumsum(error)[:-1]
        steps = left**2 / count + (whole - left) ** 2 / (total - count)
        jumps += float(np.max(steps) - whole**2 / total)
        # ... a straight line in time ...
        t = np.arange(total) - 0.5 * (total - 1)
        trends += float((error @ t) ** 2 / (t @ t))
        # ... and a function of the deepest position so far.
        deepest = np.maximum.accumulate(travel)
        place = np.digitize(deepest, np.linspace(deepest.min(), deepest.max() + 1e-12, 9))
        sums = np.bincount(place, weights=error) ** 2 / np.maximum(np.bincount(place), 1)
        sets += float(np.sum(sums) - whole**2 / total)
        errors.append(error)
        travels.append(travel)
    every = np.concatenate(errors)
    excess = max(float(every @ every) - len(every), 1.0)
    share, swings = _static(every, np.concatenate(travels), excess)
    if share > CONFIG.most and swings >= CONFIG.swings:
        return True
    return jumps > CONFIG.most * excess and jumps > 1.2 * max(sets, trends)
