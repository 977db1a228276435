"""Mistakes in recordings that stand in the way of any diagnosis: units, signs, columns, rates, runs.

Evidence lies inside the case: steps of the ADC, Vref, time stamps, channels that contradict each
other, one run against the others, what the lot states. A pad of an unusual size is asked about, and
diagnosed. No effect of the catalogue is fitted before this has found nothing.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import TypeAlias

import numpy as np

from softcal.core.gap.case import Case, DataMistake, Run, apart, numbers, of_gain, of_sign, of_unit
from softcal.core.gap.method import MistakeConfig
from softcal.core.recording import RATE_TOLERANCE, Array
from softcal.core.words.reason import Reason, reason

COLUMNS = {"stage": "stage_mm", "force": "force_N", "output": "output_V"}

TIME_UNITS = {"ms": 1e-3, "us": 1e-6, "min": 60.0}
UNITS: Mapping[str, Mapping[str, float]] = {
    "stage": {"inch": 25.4, "cm": 10.0, "m": 1e3, "um": 1e-3},
    "force": {"kgf": 9.80665, "gf": 9.80665e-3, "mN": 1e-3},
}
"""What units that people write by mistake are in the unit of the column."""

EVERY_UNIT = [(channel, unit, factor) for channel, units in UNITS.items() for unit, factor in units.items()]

UNITS_OF_RUN: Mapping[str, Mapping[str, float]] = {
    "stage": {**UNITS["stage"], "2.54 mm": 2.54, "degree as rad": np.pi / 180, "rad as degree": 180 / np.pi},
    "force": {**UNITS["force"], "lbf": 4.44822, "kN": 1e3},
    "output": {"mV": 1e-3},
}
"""The same for one run, where the others tell how large its values must be."""


def mistakes(case: Case, config: MistakeConfig) -> tuple[DataMistake, ...]:
    """Return the mistakes that the channels show by themselves, none where they look sound.

    The first kind that is found hides what comes after it: a wrong column has no unit.
    """
    for look in (_rates, _columns, _ranges, _strays, _runs_exchanged, _directions, _against_stated, _runs_apart):
        found = tuple(look(case, config))
        if found:
            return found
    return ()


def doubts(case: Case, config: MistakeConfig) -> tuple[DataMistake, ...]:
    """Return units that would make an unusual pad of a case a usual one: questions, no findings."""
    size = _size(case)
    if case.stiffness_N_mm is not None or not size.is_odd(config):
        return ()
    fitting = []
    for channel, unit, factor in EVERY_UNIT:
        repaired = size.with_unit(channel, factor)
        oddness = repaired.oddness(config)
        if not repaired.is_odd(config) and oddness < np.log(config.near_usual):
            # Stages are told to go at round speeds, which speaks for a unit of theirs.
            speed = repaired.speed_mm_s if channel == "stage" else None
            is_round = speed is not None and abs(float(f"{speed:.1e}") / speed - 1.0) < 2e-3
            fitting.append((oddness - 0.5 * is_round, channel, unit, factor))
    if not fitting:
        return ()
    _, channel, unit, factor = min(fitting)
    return (of_unit(channel, (), unit, factor, _unusual(size, channel, *config.stiffness_N_mm), "data.ask.unit"),)


Look: TypeAlias = Callable[[Run, MistakeConfig], Iterable[DataMistake]]


def _in_runs(look: Look) -> Callable[[Case, MistakeConfig], Iterator[DataMistake]]:
    """Look at every run of a case; a mistake in all that are pressed is one of the whole case."""

    def in_case(case: Case, config: MistakeConfig) -> Iterator[DataMistake]:
        groups: dict[tuple[str, str, float | None], tuple[DataMistake, set[int]]] = {}
        for k, run in enumerate(case.runs):
            for one in look(run, config):
                factor = None if one.factor is None else float(f"{one.factor:.2g}")
                groups.setdefault((one.what, one.channel, factor), (one, set()))[1].add(k)
        number = numbers(case)
        pressed = {k for k, run in enumerate(case.runs) if run.kind == "press"}
        for one, at in groups.values():
            yield replace(one, runs=() if at >= pressed else tuple(number[k] for k in sorted(at)))

    return in_case


def _presses(case: Case) -> list[tuple[int, Run]]:
    """Return the runs that are pressed, with their numbers."""
    return [(n, run) for n, run in zip(numbers(case), case.runs, strict=True) if run.kind == "press"]


def _channels(run: Run) -> dict[str, Array]:
    every = {short: getattr(run, name) for short, name in COLUMNS.items()}
    return {short: values for short, values in every.items() if values is not None}


@_in_runs
def _rates(run: Run, _: MistakeConfig) -> Iterator[DataMistake]:
    stated_Hz, ratio = run.readout.sample_rate_Hz, run.seen_Hz / run.readout.sample_rate_Hz
    if abs(ratio - 1.0) <= RATE_TOLERANCE:
        return
    evidence = reason("data.rate", seen=run.seen_Hz, stated=stated_Hz)
    unit = next((u for u, s in TIME_UNITS.items() if abs(ratio / s - 1.0) <= RATE_TOLERANCE), None)
    if unit is not None:
        yield of_unit("time", (), unit, TIME_UNITS[unit], evidence)
    else:
        yield DataMistake("rate", "time", (), ratio, evidence, reason("data.repair.rate", seen=run.seen_Hz))


@_in_runs
def _columns(run: Run, config: MistakeConfig) -> Iterator[DataMistake]:
    """The output shows by the steps of the ADC, the stage by its smoothness."""
    channels = _channels(run)
    if run.kind != "press" or len(channels) < 2:
        return
    output, pair = _output_by_steps(run, channels, config), ""
    if output not in (None, "output"):
        pair = "+".join(name for name in COLUMNS if name in ("output", output))
    elif output is not None and len(channels) == 3:
        # Second differences against the span, corners left out.
        rough = {}
        for name in ("stage", "force"):
            low, high = np.quantile(channels[name], (0.02, 0.98))
            bends = np.sort(np.abs(np.diff(channels[name], 2)))
            rms = np.sqrt(np.mean(bends[: max(1, int(0.8 * len(bends)))] ** 2))
            rough[name] = float(rms / max(high - low, 1e-12))
        is_commanded = rough["force"] < rough["stage"] and rough["force"] < config.smooth * rough["stage"]
        pair = "stage+force" if is_commanded else ""
    if pair:
        one, other = pair.split("+")
        evidence = reason("data.swapped_columns.steps" if "output" in pair else "data.swapped_columns.smooth")
        repair = reason("data.repair.swap", one=COLUMNS[one], other=COLUMNS[other])
        yield DataMistake("swapped_columns", pair, (), None, evidence, repair)


def _output_by_steps(run: Run, channels: Mapping[str, Array], config: MistakeConfig) -> str | None:
    """Return the column that stands on the steps of the ADC, None where the steps do not tell."""
    step_V, vref_V = run.readout.step_V, run.readout.vref_V
    # The last digit of a file moves a value off its step; on finer steps no column stands.
    tolerance = config.off_step * step_V
    shares = {}
    for name, values in channels.items():
        is_on = np.abs(values - np.round(values / step_V) * step_V) < tolerance
        # A column that stands still on zero is on the steps of any ADC.
        is_telling = np.abs(values) > step_V
        is_within = (values > 0) & (values <= vref_V + step_V)
        shares[name] = float(np.mean((is_on & is_within)[is_telling])) if is_telling.mean() > 0.2 else 0.0
    first, *others = sorted(shares, key=lambda name: -shares[name])
    return first if shares[first] > config.on_grid and all(shares[name] < config.off_grid for name in others) else None


@_in_runs
def _ranges(run: Run, config: MistakeConfig) -> Iterator[DataMistake]:
    """An output cannot leave what its ADC can read."""
    output_V, vref_V = run.output_V, run.readout.vref_V
    if output_V is None:
        return
    margin_V = max(2 * run.readout.step_V, 1e-3 * vref_V)
    is_beyond = (output_V < -margin_V) | (output_V > vref_V + margin_V)
    if not is_beyond.any():
        return
    worst_V, count = float(output_V[np.argmax(np.abs(output_V))]), int(is_beyond.sum())
    evidence = reason("data.out_of_range.output", worst=worst_V, vref=vref_V, count=count)
    if is_beyond.mean() <= config.few:
        yield _of_samples("output", count, evidence)
        return
    # The unit or sign that brings the output of the run back.
    factors = {"mV": 1e-3, "uV": 1e-6}
    if np.all(output_V == np.round(output_V)):
        factors = {"codes": run.readout.step_V, **factors}
    low, high = np.quantile(output_V, (0.02, 0.98))
    for unit, factor in factors.items():
        if 0.01 < low * factor / vref_V and 0.02 < high * factor / vref_V < 1.0:
            yield of_unit("output", (), unit, factor, evidence)
            return
    is_turned = high < 0 and -low <= vref_V
    yield of_sign("output", (), evidence) if is_turned else _of_samples("output", count, evidence)


def _of_samples(channel: str, count: int, evidence: Reason) -> DataMistake:
    return DataMistake("out_of_range", channel, (), None, evidence, reason("data.repair.samples", count=count))


@_in_runs
def _strays(run: Run, config: MistakeConfig) -> Iterator[DataMistake]:
    """Single samples of a position or force far beyond all others."""
    for name, values in _channels(run).items() if run.kind == "press" else ():
        low, high = (float(end) for end in np.quantile(values, (0.01, 0.99)))
        reach = config.far * (high - low)
        is_beyond = (values < low - reach) | (values > high + reach)
        if 0 < is_beyond.mean() <= config.few:
            count, unit = int(is_beyond.sum()), COLUMNS[name].split("_")[1]
            worst = float(values[np.argmax(np.abs(values - 0.5 * (low + high)))])
            ends = {"worst": worst, "low": low, "high": high}
            evidence = reason("data.out_of_range.strays", count=count, channel=name, **ends, unit=unit)
            yield _of_samples(name, count, evidence)


def _agreement(one: Array, other: Array) -> float:
    return float(np.corrcoef(one, other)[0, 1])


def _runs_exchanged(case: Case, config: MistakeConfig) -> list[DataMistake]:
    """A column that fits its own run badly and that of another run well."""
    for name, ((i, one), (j, other)) in product(("output", "force", "stage"), combinations(_presses(case), 2)):
        mine, theirs = _channels(one), _channels(other)
        if len(one) != len(other) or name not in mine or len(mine) < 2:
            continue
        rest = [r for r in mine if r != name]
        alike = [_agreement(*(run[r] for r in rest)) for run in (mine, theirs) if len(rest) == 2]
        if min(alike, default=1.0) < config.paired:
            continue
        now = max(abs(_agreement(run[name], run[r])) for run in (mine, theirs) for r in rest)
        pairs = ((mine, theirs), (theirs, mine))
        exchanged = min(_agreement(to[r], of[name]) for to, of in pairs for r in rest)
        if now < config.unpaired and exchanged > config.paired:
            evidence = reason("data.swapped_runs", channel=name, now=now, exchanged=exchanged)
            repair = reason("data.repair.exchange", channel=name, one=i, other=j)
            return [DataMistake("swapped_runs", name, (i, j), None, evidence, repair)]
    return []


@_in_runs
def _directions(run: Run, config: MistakeConfig) -> Iterator[DataMistake]:
    channels = _channels(run) if run.kind == "press" else {}
    stage, force, output = (channels.get(name) for name in COLUMNS)
    turned = []
    if force is not None:
        low, high = np.quantile(force, (0.02, 0.98))
        if low < 0 and -low > 3.0 * abs(high):
            turned, force = ["force"], -force
    if stage is not None:
        pressed = force if force is not None else output
        is_against = pressed is not None and _agreement(stage, pressed) < config.opposed
        if is_against and (force is not None or float(np.median(stage)) < 0):
            turned, stage = [*turned, "stage"], -stage
    for name in turned:
        yield of_sign(name, (), reason("data.sign", channel=name))
    pressing = force if force is not None else stage
    if output is None or pressing is None or run.readout.sensor_type == "strain":
        return
    correlation = _agreement(output, pressing)
    if correlation < config.opposed:
        evidence, repair = reason("data.swapped_divider", correlation=correlation), reason("data.repair.divider")
        yield DataMistake("swapped_divider", "output", (), None, evidence, repair)


@dataclass(frozen=True)
class _Size:
    """How far the pad was pressed; None where the channel is missing."""

    depth_mm: float | None
    force_N: float | None
    speed_mm_s: float | None

    @property
    def stiffness_N_mm(self) -> float | None:
        return None if self.depth_mm is None or self.force_N is None else self.force_N / self.depth_mm

    def with_unit(self, channel: str, factor: float) -> "_Size":
        names = ("depth_mm", "speed_mm_s") if channel == "stage" else ("force_N",)
        own = {name: getattr(self, name) for name in names}
        return replace(self, **{name: None if value is None else value * factor for name, value in own.items()})

    def oddness(self, config: MistakeConfig) -> float:
        """Return the largest distance from the usual, as a logarithm."""
        known = [(value, usual) for name, usual in config.usual if (value := getattr(self, name)) is not None]
        return max((abs(np.log(value / usual)) for value, usual in known), default=0.0)

    def is_odd(self, config: MistakeConfig) -> bool:
        """Whether no common pad is pressed so."""
        for name in ("stiffness_N_mm", "depth_mm", "force_N"):
            if (value := getattr(self, name)) is not None:
                low, high = getattr(config, name)
                return not low <= value <= high
        return False


def _size(case: Case) -> _Size:
    depths, forces, speeds = [], [], []
    for run in case.presses:
        channels = _channels(run)
        load = channels.get("force", channels.get("output"))
        if "force" in channels:
            low, high = np.quantile(channels["force"], (0.02, 0.995))
            forces.append(float(high - min(low, 0.5 * high)) if low < 0 else float(high))
        if "stage" in channels and load is not None:
            stage_mm = channels["stage"]
            low, high = np.quantile(load, (0.02, 0.995))
            part = (load - low) / max(float(high - low), 1e-12)
            # The load begins where a line through 5 % and 15 % of it meets none.
            twentieth, three = (stage_mm[np.abs(part - level) < 0.02] for level in (0.05, 0.15))
            if len(twentieth) and len(three):
                contact_mm = float(1.5 * np.median(twentieth) - 0.5 * np.median(three))
            else:
                touching = stage_mm[part > 0.03]
                contact_mm = float(np.quantile(touching, 0.02)) if len(touching) else 0.0
            depths.append(float(np.quantile(stage_mm, 0.995)) - contact_mm)
            speeds.append(float(np.quantile(np.abs(np.gradient(stage_mm, run.t_s)), 0.98)))
    depth_mm, force_N = (max(float(np.median(v)), 1e-9) if v else None for v in (depths, forces))
    return _Size(depth_mm, force_N, max(speeds, default=None))


def _unusual(size: _Size, channel: str, low: float, high: float) -> Reason:
    if size.stiffness_N_mm is not None:
        return reason("data.unit.stiffness", seen=size.stiffness_N_mm, low=low, high=high)
    if size.depth_mm is not None:
        return reason("data.unit.size", channel=channel, seen=size.depth_mm, unit="mm")
    return reason("data.unit.size", channel=channel, seen=size.force_N or 0.0, unit="N")


def _against_stated(case: Case, config: MistakeConfig) -> list[DataMistake]:
    """Units and gains of a whole case: the pad's stiffness against what the lot states."""
    size, stated = _size(case), case.stiffness_N_mm
    stiffness = size.stiffness_N_mm
    if stated is None or stiffness is None or stated[0] <= stiffness <= stated[1]:
        return []
    middle, evidence = float(np.sqrt(stated[0] * stated[1])), _unusual(size, "force", *stated)
    distance, channel, unit, factor = min(
        (abs(np.log(size.with_unit(c, f).stiffness_N_mm or 1e-9) - np.log(middle)), c, u, f) for c, u, f in EVERY_UNIT
    )
    if distance < abs(np.log(stated[1] / middle)) + np.log(config.near_stated):
        return [of_unit(channel, (), unit, factor, evidence)]
    return [of_gain("force", (), middle / stiffness, evidence)]


def _runs_apart(case: Case, config: MistakeConfig) -> list[DataMistake]:
    """One run that differs from all others by a factor that no effect has."""
    presses = _presses(case)
    if len(presses) < config.fewest_runs:
        return []
    for name, reference in (("force", "output"), ("stage", "output"), ("force", "stage"), ("stage", "force")):
        if not (case.has(COLUMNS[name]) and case.has(COLUMNS[reference])):
            continue
        if reference != "output" and case.has("output_V"):
            continue
        spans = np.log([_spread_at(_channels(run)[reference], _channels(run)[name]) for _, run in presses])
        for at, (k, _) in enumerate(presses):
            ratio = float(np.exp(np.median(np.delete(spans, at)) - spans[at]))
            others = np.ptp(np.delete(spans, at))
            if abs(np.log(ratio)) > np.log(config.apart) + others:
                return [apart(name, k, ratio, UNITS_OF_RUN[name], config.same_factor, others)]
    return []


def _spread_at(reference: Array, values: Array) -> float:
    """Return the slope of a channel against another one over the middle of what both show.

    Both are sorted: one that is late, or has lost samples, shows the same values at other instants.
    """
    reference, values = np.sort(reference), np.sort(values)
    low, high = np.quantile(reference, (0.05, 0.95))
    top = values[reference >= low + 0.6 * (high - low)]
    bottom = values[reference <= low + 0.1 * (high - low)]
    return max(abs(float(np.median(top) - np.median(bottom))) / max(float(high - low), 1e-12), 1e-12)
