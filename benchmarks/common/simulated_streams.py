"""Streams of use drawn at random, of many kinds: a sensor, an activity, what drifts and how the use changes.

Everything of a stream follows from its number and a seed. No code of softcal's twin is in it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.signal import lfilter

from softcal.app.registry.unit import source_state
from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.network.training import fit_network
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.unit.state import UnitState

SAMPLES = 12_000
CALIBRATION = 5_000
BEGINS = 0.2
"""Drift begins after this share of a stream, where the kind does not say otherwise."""

LAG_S, CREEP_S, CREEP = 0.05, 4.0, 0.05
"""Lag of a sensor, and the share of its answer that comes slowly."""

NOISE = 0.004
"""Noise of the output, in shares of its span."""

CURVES: Mapping[str, Callable[[Array], Array]] = {
    "power": lambda load: 0.8 + 0.55 * load**0.85,
    "saturating": lambda load: 0.5 + 1.2 * (1 - np.exp(-1.3 * load)),
    "convex": lambda load: 0.3 + 0.4 * load + 0.4 * load**2,
    "falling": lambda load: 2.5 - 0.9 * load**0.7,
}
"""Output in V over load from 0 to about 1.6."""


@dataclass(frozen=True)
class Style:
    """How an activity is done: height of its loads, duration of its cycles, scatter of both (None: as ever)."""

    load: float = 1.0
    pace: float = 1.0
    scatter: float | None = None


def stance(phase: Array) -> Array:
    """Return the double-humped force of one stride, 1 at its top; stance takes 62 % of it."""
    inside = phase < 0.62
    x = np.where(inside, phase / 0.62, 0.0)
    shape = np.sin(np.pi * x) * (1.0 - 0.45 * np.sin(np.pi * x) ** 8) / 0.86
    return np.where(inside, np.maximum(shape, 0.0), 0.0)


def gait(phase: Array, height: Array) -> Array:
    return height * stance(phase)


def press(phase: Array, height: Array) -> Array:
    """Rest, ramp up, hold, ramp down."""
    return np.asarray(height * np.interp(phase, [0.0, 0.25, 0.4, 0.7, 0.85, 1.0], [0.0, 0.0, 1.0, 1.0, 0.0, 0.0]))


def strain(phase: Array, height: Array) -> Array:
    """A triangle that turns at a preload."""
    return np.asarray(0.2 + 0.8 * height * (1 - np.abs(2 * phase - 1)))


def pump(phase: Array, height: Array) -> Array:
    return np.asarray(height * np.sin(np.pi * phase) ** 2)


Wave = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class Activity:
    """A cyclic use: its wave over phase, the duration of a cycle in s, a rate in Hz for it, and its scatter."""

    wave: Wave
    cycle_s: float
    rate_Hz: float
    scatter: float = 0.04


ACTIVITIES: Mapping[str, Activity] = {
    "gait": Activity(gait, 1.1, 50.0),
    "press": Activity(press, 4.0, 25.0),
    "strain": Activity(strain, 20.0, 10.0),
    "pump": Activity(pump, 2.0, 50.0),
}


def cycles(activity: Activity, samples: int, rng: np.random.Generator, style: Style | None = None) -> Array:
    """Return (samples,) loads of an activity, every cycle a little different."""
    style = style or Style()
    scatter = activity.scatter if style.scatter is None else style.scatter
    usual = activity.cycle_s / style.pace * activity.rate_Hz
    count = int(2 * samples / usual) + 2
    lengths = np.maximum(8, usual * (1 + scatter * rng.normal(size=count))).round().astype(int)
    heights = style.load * np.maximum(0.2, 1 + scatter * rng.normal(size=count))
    index = np.repeat(np.arange(count), lengths)[:samples]
    starts = np.concatenate([[0], np.cumsum(lengths)])
    phase = (np.arange(samples) - starts[index]) / lengths[index]
    return np.asarray(activity.wave(phase, heights[index]))


def station(samples: int, rate_Hz: float, rng: np.random.Generator) -> Array:
    """Return (samples,) loads of a compression profile: several depths and rates, holds and rests."""
    knots_s, loads = [0.0], [0.0]
    while knots_s[-1] * rate_Hz < samples:
        depth, ramp_s = rng.uniform(0.3, 1.6), rng.uniform(0.3, 2.5)
        knots_s += (knots_s[-1] + np.cumsum([ramp_s, rng.uniform(0.2, 2.0), ramp_s, rng.uniform(0.3, 2.0)])).tolist()
        loads += [depth, depth, 0.0, 0.0]
    return np.interp(np.arange(samples) / rate_Hz, knots_s, loads)


def read(
    curve: str,
    load: Array,
    rate_Hz: float,
    rng: np.random.Generator,
    gain: Array | float = 1.0,
    shift: Array | float = 0,
) -> Array:
    """Return (n,) output in V of a sensor with lag and creep.

    Args:
        gain, shift: drift of the output, (n,) or constant; the shift in shares of the sensor's span.
    """
    lagged = sum(
        share * lfilter([weight], [1.0, weight - 1.0], load)
        for share, weight in ((1 - CREEP, _weight(LAG_S, rate_Hz)), (CREEP, _weight(CREEP_S, rate_Hz)))
    )
    span = float(np.abs(CURVES[curve](np.ones(1)) - CURVES[curve](np.zeros(1)))[0])
    clean = CURVES[curve](np.maximum(lagged, 0.0))
    return np.asarray(gain * clean + span * (shift + NOISE * rng.normal(size=len(load))))


def _weight(time_s: float, rate_Hz: float) -> float:
    return 1.0 - float(np.exp(-1.0 / (time_s * rate_Hz)))


Random = np.random.Generator
Drift = Callable[[Array, Random], tuple[Array, Array]]
"""From (n,) 0 to 1 over the stream to (n,) gain and (n,) shift, the shift in shares of the sensor's span."""

Motion = Callable[[Activity, int, Random], Array]


def standing_still(x: Array, rng: Random) -> tuple[Array, Array]:
    return np.ones_like(x), np.zeros_like(x)


def level_creeps(x: Array, rng: Random) -> tuple[Array, Array]:
    return np.ones_like(x), _sign(rng) * rng.uniform(0.05, 0.3) * np.log1p(9 * _late(x)) / np.log(10)


def level_drifts(x: Array, rng: Random) -> tuple[Array, Array]:
    return np.ones_like(x), _sign(rng) * rng.uniform(0.05, 0.3) * _late(x)


def gain_drifts(x: Array, rng: Random) -> tuple[Array, Array]:
    return 1 + _sign(rng) * rng.uniform(0.05, 0.2) * _late(x), np.zeros_like(x)


def ages(x: Array, rng: Random) -> tuple[Array, Array]:
    return 1 + _sign(rng) * rng.uniform(0.05, 0.2) * _late(x), rng.normal(0, 0.15) * np.log1p(5 * _late(x))


def drifts_at_once(x: Array, rng: Random) -> tuple[Array, Array]:
    """From the first row on, and all of it in the first third."""
    early = np.minimum(1.0, 3 * x)
    return 1 + _sign(rng) * rng.uniform(0.05, 0.2) * early, _sign(rng) * rng.uniform(0.05, 0.2) * early


def ages_on(x: Array, rng: Random) -> tuple[Array, Array]:
    """Fast at first, slower and slower."""
    return 1 + _sign(rng) * rng.uniform(0.05, 0.2) * np.log1p(4 * x) / np.log(5), np.zeros_like(x)


def seasons(x: Array, rng: Random) -> tuple[Array, Array]:
    """There and back, as temperature does."""
    wave = np.sin(2 * np.pi * (x * rng.uniform(0.5, 3.0) + rng.random()))
    size = rng.uniform(0.3, 1.0)
    return 1 + 0.05 * size * (wave - wave[0]), 0.1 * size * (wave - wave[0])


def steps(x: Array, rng: Random) -> tuple[Array, Array]:
    """The level steps one to four times."""
    shift = np.zeros_like(x)
    for start in rng.uniform(BEGINS, 1, rng.integers(1, 5)):
        shift += np.where(x > start, rng.normal(0, 0.12), 0.0)
    return np.ones_like(x), shift


def is_reseated(x: Array, rng: Random) -> tuple[Array, Array]:
    is_after = x > rng.uniform(0.3, 0.7)
    return np.where(is_after, 1 + rng.normal(0, 0.05), 1.0), np.where(is_after, rng.normal(0, 0.15), 0.0)


def _late(x: Array) -> Array:
    return np.maximum(0.0, x - BEGINS) / (1 - BEGINS)


def _sign(rng: Random) -> float:
    return float(rng.choice([-1.0, 1.0]))


def same(activity: Activity, n: int, rng: Random) -> Array:
    return cycles(activity, n, rng)


def irregular(activity: Activity, n: int, rng: Random) -> Array:
    return cycles(activity, n, rng, Style(scatter=rng.uniform(0.08, 0.15)))


def changes(activity: Activity, n: int, rng: Random) -> Array:
    """Another load, another pace, or both, from somewhere in the middle on."""
    at = int(rng.uniform(0.25, 0.6) * n)
    style = Style(rng.uniform(0.7, 1.3), rng.uniform(0.7, 1.5), 0.06)
    return np.concatenate([cycles(activity, at, rng), cycles(activity, n - at, rng, style)])


def is_replaced(activity: Activity, n: int, rng: Random) -> Array:
    at = int(rng.uniform(0.25, 0.6) * n)
    return np.concatenate([same(activity, at, rng), other(activity, n - at, rng)])


def times(share: float) -> Motion:
    """Another load from the middle on, the rest unmoved."""

    def use(activity: Activity, n: int, rng: Random) -> Array:
        return np.concatenate([same(activity, n // 2, rng), cycles(activity, n - n // 2, rng, Style(share))])

    return use


def slowly_harder(activity: Activity, n: int, rng: Random) -> Array:
    return cycles(activity, n, rng) * np.linspace(1.0, rng.uniform(1.1, 1.3), n)


def other(activity: Activity, n: int, rng: Random) -> Array:
    """The wave of the next activity, at the rate and pace of this one."""
    waves = [one.wave for one in ACTIVITIES.values()]
    wave = waves[(waves.index(activity.wave) + 1) % len(waves)]
    return cycles(replace(activity, wave=wave), n, rng)


def sways(activity: Activity, n: int, rng: Random) -> Array:
    """A constant load with a little sway."""
    return np.asarray(0.5 + 0.2 * np.convolve(rng.normal(size=n + 99), np.ones(100) / 100, mode="valid"))


def rests(activity: Activity, n: int, rng: Random) -> Array:
    return np.zeros(n)


def runs(activity: Activity, n: int, rng: Random) -> Array:
    return cycles(activity, n, rng, Style(1.3, 1.5, 0.06))


def day(activity: Activity, n: int, rng: Random) -> Array:
    """Several uses in turn, the calibrated one most often."""
    parts: list[Array] = []
    while sum(map(len, parts)) < n:
        motion = [same, sways, same, runs, rests, other][int(rng.integers(6))]
        parts.append(motion(activity, int(rng.uniform(0.02, 0.15) * n), rng))
    return np.concatenate(parts)[:n]


@dataclass(frozen=True)
class Kind:
    """What a stream is of.

    Args:
        drift, use: of the sensor, and of whoever uses it.
        bend: by how much the characteristic bends, in shares of its span.
        is_about_rest: whether the gain turns about the output without load.
        is_under_way: whether the drift began with the calibration; a machine did that, and times the use.
    """

    drift: Drift
    use: Motion
    bend: float = 0.0
    is_about_rest: bool = False
    is_under_way: bool = False


KINDS: Mapping[str, Kind] = {
    "no drift": Kind(standing_still, same),
    "no drift, irregular use": Kind(standing_still, irregular),
    "no drift, loads x 1.3": Kind(standing_still, times(1.3)),
    "no drift, loads x 1.6": Kind(standing_still, times(1.6)),
    "no drift, loads x 0.6": Kind(standing_still, times(0.6)),
    "no drift, load and pace change": Kind(standing_still, changes),
    "no drift, another programme": Kind(standing_still, is_replaced),
    "no drift, a day of several uses": Kind(standing_still, day),
    "no drift, use grows slowly": Kind(standing_still, slowly_harder),
    "level creeps": Kind(level_creeps, same),
    "level drifts": Kind(level_drifts, same),
    "gain drifts": Kind(gain_drifts, same),
    "gain drifts about a standing rest": Kind(gain_drifts, same, is_about_rest=True),
    "level and gain age": Kind(ages, same),
    "age, and the use changes": Kind(ages, changes),
    "age, irregular use": Kind(ages, irregular),
    "seasons": Kind(seasons, same),
    "seasons, a day of several uses": Kind(seasons, day),
    "level steps": Kind(steps, same),
    "re-seated": Kind(is_reseated, same),
    "re-seated, and the use changes": Kind(is_reseated, changes),
    "drift while the first use is learnt": Kind(drifts_at_once, same),
    "the characteristic bends": Kind(ages, same, 0.3),
}

AGEING: Mapping[str, Kind] = {
    "ages on": Kind(ages_on, same, is_under_way=True),
    "ages on about a standing rest": Kind(ages_on, same, is_about_rest=True, is_under_way=True),
    "ages on, loads x 1.3": Kind(ages_on, times(1.3), is_about_rest=True, is_under_way=True),
    "ages on, load and pace change": Kind(ages_on, changes, is_about_rest=True, is_under_way=True),
    "ages on, use grows slowly": Kind(ages_on, slowly_harder, is_about_rest=True, is_under_way=True),
}
"""Kinds of sensors that drift from the calibration on."""


@dataclass(frozen=True, eq=False)
class Bench:
    """A kind of sensor whose f knows the whole range of loads."""

    network: Network
    calibration: UnitState
    source: LabelledRecording


@cache
def bench(curve: str, rate_Hz: float) -> Bench:
    """Train f on every activity and on the station's profile."""
    rng = np.random.default_rng(5)
    calibration_cycles = [
        cycles(Activity(a.wave, a.cycle_s, rate_Hz), 1500, rng, Style(1.1, scatter=0.2)) for a in ACTIVITIES.values()
    ]
    load = np.concatenate([station(4000, rate_Hz, rng), *calibration_cycles])
    source = LabelledRecording(_recording("source", read(curve, load, rate_Hz, rng), rate_Hz), load)
    network = fit_network(source, NetworkConfig(hidden=(32, 16), max_epochs=40)).network
    return Bench(network, source_state(source, network), source)


def _recording(serial: str, output: Array, rate_Hz: float) -> OutputRecording:
    return OutputRecording(serial, np.arange(len(output)) / rate_Hz, output, rate_Hz)


@dataclass(frozen=True, eq=False)
class Stream:
    """One stream: its unit, what it was calibrated with, and the true load under its output."""

    kind: str
    activity: str
    curve: str
    is_on_station: bool
    bench: Bench
    calibrated: OutputRecording
    used: OutputRecording
    load: Array

    @property
    def cycle(self) -> int:
        """Samples of a usual cycle."""
        activity = ACTIVITIES[self.activity]
        return round(activity.cycle_s * activity.rate_Hz)


def draw(number: int, seed: int, kinds: Mapping[str, Kind] = KINDS) -> Stream:
    """Draw the stream of a number: the kinds in turn, everything else at random."""
    rng = np.random.default_rng([seed, number])
    kind = list(kinds)[number % len(kinds)]
    name, curve = (str(rng.choice(list(names))) for names in (ACTIVITIES, CURVES))
    # A machine or a person.
    activity, of = replace(ACTIVITIES[name], scatter=float(rng.choice([0.004, 0.04]))), kinds[kind]
    if of.is_under_way:
        activity = replace(activity, scatter=0.004)
    # Every third unit was calibrated on the station, under another programme than its use.
    is_on_station = (bool(rng.random() < 1 / 3) or of.drift is drifts_at_once) and not of.is_under_way
    load = of.use(activity, SAMPLES, rng)
    before = CALIBRATION if of.is_under_way else 0
    gain, shift = of.drift(np.linspace(0, 1, before + SAMPLES), rng)
    x = np.linspace(0, 1, SAMPLES)
    ends = CURVES[curve](np.array([0.0, 1.0]))
    if of.is_about_rest:
        shift = shift + (1 - gain) * ends[0] / abs(ends[1] - ends[0])
    output = read(curve, load, activity.rate_Hz, rng, gain[before:], shift[before:])
    share = (output - ends[0]) / (ends[1] - ends[0])
    output = output + of.bend * _late(x) * (ends[1] - ends[0]) * share * (1 - share)
    profile = station(CALIBRATION, activity.rate_Hz, rng) if is_on_station else cycles(activity, CALIBRATION, rng)
    then = (gain[:before], shift[:before]) if of.is_under_way else (1.0, 0.0)
    calibrated = _recording("unit", read(curve, profile, activity.rate_Hz, rng, *then), activity.rate_Hz)
    operated = _recording("unit", output, activity.rate_Hz)
    return Stream(kind, name, curve, is_on_station, bench(curve, activity.rate_Hz), calibrated, operated, load)
