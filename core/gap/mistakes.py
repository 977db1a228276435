"""Mistakes in recordings that stand in the way of any diagnosis: units, signs, columns, rates, runs.

Evidence lies inside the case: steps of the ADC, Vref, time stamps, channels that contradict each
other, one run against the others, what the lot states. A pad of an unusual size is asked about, and
diagnosed. No effect of the catalogue is fitted before this has found nothing.

An effect acts in every run. Where one number, or the base parameters, of one run alone explain what
the twin leaves in all of them, that run was recorded otherwise: by a gain, a zero, or another unit.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, product
from typing import TypeAlias

import numpy as np

from softcal.core.gap.case import (
    SHIFTED,
    Case,
    DataMistake,
    Run,
    apart,
    numbers,
    of_gain,
    of_samples,
    of_shifted,
    of_sign,
    of_unit,
)
from softcal.core.gap.fit import Tangent, fit
from softcal.core.gap.linear import energy, gram
from softcal.core.gap.method import MistakeConfig
from softcal.core.gap.model import Fit
from softcal.core.gap.search import Search
from softcal.core.gap.twin_reach import changing
from softcal.core.messages.reason import Reason, reason
from softcal.core.recording import RATE_TOLERANCE, Array
from softcal.core.twin.effects import Effect, Hook, Parameter

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
    for look in (
        _rates,
        _columns,
        _ranges,
        _strays,
        _runs_exchanged,
        _directions,
        _check_temperatures,
        _check_stated_stiffness,
        _runs_apart,
    ):
        result = tuple(look(case, config))
        if result:
            return result
    return ()


def suspect_units(case: Case, config: MistakeConfig) -> tuple[DataMistake, ...]:
    """Return units that would make an unusual pad of a case a usual one: questions, no findings."""
    size = _size(case)
    if case.stiffness_N_mm is not None or not size.is_implausible(config):
        return ()
    fitting = []
    for channel, unit, factor in EVERY_UNIT:
        repaired = size.with_unit(channel, factor)
        oddness = repaired.oddness(config)
        if not repaired.is_implausible(config) and oddness < np.log(config.near_usual):
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
        press_runs = {k for k, run in enumerate(case.runs) if run.kind == "press"}
        for one, at in groups.values():
            yield replace(one, runs=() if at >= press_runs else tuple(number[k] for k in sorted(at)))

    return in_case


def _presses(case: Case) -> list[tuple[int, Run]]:
    """Return the runs that are pressed, with their numbers."""
    return [(n, run) for n, run in zip(numbers(case), case.runs, strict=True) if run.kind == "press"]


def _channels(run: Run) -> dict[str, Array]:
    every = {short: getattr(run, name) for short, name in COLUMNS.items()}
    return {short: values for short, values in every.items() if values is not None}


@_in_runs
def _rates(run: Run, _: MistakeConfig) -> Iterator[DataMistake]:
    stated_Hz, ratio = run.readout.sample_rate_Hz, run.observed_rate_Hz / run.readout.sample_rate_Hz
    if abs(ratio - 1.0) <= RATE_TOLERANCE:
        return
    evidence = reason("data.rate", seen=run.observed_rate_Hz, stated=stated_Hz)
    unit = next((u for u, s in TIME_UNITS.items() if abs(ratio / s - 1.0) <= RATE_TOLERANCE), None)
    if unit is not None:
        yield of_unit("time", (), unit, TIME_UNITS[unit], evidence)
    else:
        yield DataMistake("rate", "time", (), ratio, evidence, reason("data.repair.rate", seen=run.observed_rate_Hz))


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
            second_differences = np.sort(np.abs(np.diff(channels[name], 2)))
            rms = np.sqrt(np.mean(second_differences[: max(1, int(0.8 * len(second_differences)))] ** 2))
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
        yield of_samples("output", (), count, evidence)
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
    yield of_sign("output", (), evidence) if is_turned else of_samples("output", (), count, evidence)


@_in_runs
def _strays(run: Run, config: MistakeConfig) -> Iterator[DataMistake]:
    """Single samples of a position or force far beyond all others."""
    for name, values in _channels(run).items() if run.kind == "press" else ():
        low, high = (float(end) for end in np.quantile(values, (0.01, 0.99)))
        max_distance = config.far * (high - low)
        is_beyond = (values < low - max_distance) | (values > high + max_distance)
        if 0 < is_beyond.mean() <= config.few:
            count, unit = int(is_beyond.sum()), COLUMNS[name].split("_")[1]
            worst = float(values[np.argmax(np.abs(values - 0.5 * (low + high)))])
            ends = {"worst": worst, "low": low, "high": high}
            evidence = reason("data.out_of_range.strays", count=count, channel=name, **ends, unit=unit)
            yield of_samples(name, (), count, evidence)


def _agreement(one: Array, other: Array) -> float:
    return float(np.corrcoef(one, other)[0, 1])


def _runs_exchanged(case: Case, config: MistakeConfig) -> list[DataMistake]:
    """A column that fits its own run badly and that of another run well."""
    for name, ((i, one), (j, other)) in product(("output", "force", "stage"), combinations(_presses(case), 2)):
        of_one, of_other = _channels(one), _channels(other)
        if len(one) != len(other) or name not in of_one or len(of_one) < 2:
            continue
        rest = [r for r in of_one if r != name]
        alike = [_agreement(*(run[r] for r in rest)) for run in (of_one, of_other) if len(rest) == 2]
        if min(alike, default=1.0) < config.paired:
            continue
        now = max(abs(_agreement(run[name], run[r])) for run in (of_one, of_other) for r in rest)
        pairs = ((of_one, of_other), (of_other, of_one))
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
        signal = force if force is not None else output
        is_against = signal is not None and _agreement(stage, signal) < config.opposed
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


def _check_temperatures(case: Case, config: MistakeConfig) -> list[DataMistake]:
    """One run whose temperature agrees with that of the others in another unit alone."""
    logs = [(n, run.temperature_C) for n, run in zip(numbers(case), case.runs, strict=True)]
    warm = {n: float(np.median(log)) for n, log in logs if log is not None}
    for n, level_C in warm.items():
        others_C = [other_C for k, other_C in warm.items() if k != n]
        for unit, (factor, offset) in SHIFTED.items():
            # Both units read higher than degrees Celsius wherever a sensor is calibrated.
            if others_C and level_C - max(others_C) > config.warmer_K:
                if abs(factor * level_C + offset - float(np.median(others_C))) < config.as_warm_K:
                    evidence = reason("data.run.shifted", channel="temperature")
                    return [of_shifted("temperature", (n,), unit, factor, offset, evidence)]
    return []


def find_repeats(base: Fit) -> tuple[DataMistake, ...]:
    """Return where a channel repeats one value while the base moves: questions, for a mechanism may stick."""
    problem, config, out = base.problem, base.problem.method.mistake, []
    for block in problem.blocks:
        every = np.concatenate([problem.measured[b.rows] for b in problem.blocks_of(block.channel)])
        low, high = float(every.min()), float(every.max())
        values, predicted = problem.measured[block.rows], base.predicted[block.rows]
        steps = np.abs(np.diff(values))
        # On the steps of an encoder a value stands until the next: the base must move over several.
        min_move = max(config.span * (high - low), config.repeats * float(np.quantile(steps[steps > 0.0], 0.05)))
        for part in np.split(np.arange(len(values)), np.flatnonzero(np.diff(values)) + 1):
            level, moves = float(values[part[0]]), float(np.ptp(predicted[part]))
            # What stands at an end is cut off there.
            if len(part) >= config.repeats and low < level < high and moves > min_move:
                run, name = problem.case.runs[block.run], block.channel
                times = {"start": float(run.elapsed_s[part[0]]), "end": float(run.elapsed_s[part[-1]])}
                evidence = reason("data.repeats", channel=name, level=level, count=len(part), **times)
                number = (numbers(problem.case)[block.run],)
                out.append(DataMistake("repeats", name, number, None, evidence, Reason("data.repair.repeats")))
    return tuple(out)


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
        values = {name: getattr(self, name) for name in names}
        return replace(self, **{name: None if value is None else value * factor for name, value in values.items()})

    def oddness(self, config: MistakeConfig) -> float:
        """Return the largest distance from the usual, as a logarithm."""
        measured = [(value, usual) for name, usual in config.usual if (value := getattr(self, name)) is not None]
        return max((abs(np.log(value / usual)) for value, usual in measured), default=0.0)

    def is_implausible(self, config: MistakeConfig) -> bool:
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


def _check_stated_stiffness(case: Case, config: MistakeConfig) -> list[DataMistake]:
    """Units and gains of a whole case: the pad's stiffness against what the lot states."""
    size, stiffness_range = _size(case), case.stiffness_N_mm
    stiffness = size.stiffness_N_mm
    if stiffness_range is None or stiffness is None or stiffness_range[0] <= stiffness <= stiffness_range[1]:
        return []
    middle, evidence = (
        float(np.sqrt(stiffness_range[0] * stiffness_range[1])),
        _unusual(size, "force", *stiffness_range),
    )
    distance, channel, unit, factor = min(
        (abs(np.log(size.with_unit(c, f).stiffness_N_mm or 1e-9) - np.log(middle)), c, u, f) for c, u, f in EVERY_UNIT
    )
    if distance < abs(np.log(stiffness_range[1] / middle)) + np.log(config.stated_margin):
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


@dataclass(frozen=True)
class _Oddity:
    """One way in which a run may differ: what, of which channel, by which effects of the twin."""

    quantity: str
    channel: str
    hooks: tuple[tuple[Hook, str, bool], ...]
    """(place of the chain, signal, whether it is multiplied instead of shifted) of every number."""


ODDITIES = (
    _Oddity("gain", "force", ((Hook.READING, "reading_N", True),)),
    _Oddity("zero", "force", ((Hook.READING, "reading_N", False),)),
    _Oddity("gain", "output", ((Hook.OUTPUT, "output_V", True),)),
    _Oddity("zero", "output", ((Hook.OUTPUT, "output_V", False),)),
    _Oddity("zero", "stage", ((Hook.MOTION, "pad_mm", False),)),
    _Oddity(
        "other_unit",
        "",
        (
            (Hook.FORCE, "force_N", True),
            (Hook.CHANNEL, "drive", True),
            (Hook.RESISTANCE, "resistance_ohm", True),
            (Hook.MOTION, "pad_mm", False),
        ),
    ),
)

_Fitted = tuple[Fit, int, _Oddity, float]
"""A fit with a mistake, its run, what it is, and the share it explains."""


def outlier_run(base: Fit) -> DataMistake | None:
    """Return the mistake of one run that explains what a fit leaves, None where none does."""
    config = base.problem.method.outlier
    outliers = [one for one in nearest(base, config.min_predicted_share)[:1] if one[3] >= config.share]
    return _finding(*outliers[0]) if outliers else None


def outlier_run_with_causes(search: "Search") -> DataMistake | None:
    """Return the mistake of one run that, with one cause or none, explains more than all causes."""
    best, base, config = search.best, search.base, search.base.problem.method.outlier
    if len(best.ids) < 2 and search.model.is_clean(best):
        return None
    singles = sorted((f for ids, f in search.fits.items() if len(ids) == 1), key=lambda f: f.chi2)[: config.parents]
    candidates = [
        (parent, result) for parent in (*singles, best) for result in nearest(parent, config.min_predicted_share)[:1]
    ]
    if not search.is_explained(best):
        # A cause as large as the mistake hides it from the base; beside it, it may explain the rest.
        for fitted, run, oddity, share in nearest(base, config.min_predicted_share_with_cause)[:2]:
            clean = [grown for grown in search.grown_from(fitted) if search.model.is_clean(grown)]
            candidates += [(base, (grown, run, oddity, share)) for grown in clean]
    priced = []
    for parent, (fitted, run, oddity, share) in candidates:
        # The mistake counts as one number more; it is of no catalogue and has no prior odds.
        price = parent.penalty if parent is not base or not singles else singles[0].penalty
        price += float(np.log(base.problem.count)) * len(oddity.hooks)
        if (share > config.share_with_cause or parent is base) and fitted.chi2 + price < best.bic - config.ahead:
            priced.append((fitted.chi2 + price, (fitted, run, oddity, share)))
    return _finding(*min(priced, key=lambda one: one[0])[1]) if priced else None


def nearest(base: Fit, promised_share: float) -> list[_Fitted]:
    """Return fitted mistakes of one run that promise this share of what is left, simplest first."""
    problem, is_clean = base.problem, base.problem.model.is_clean
    if is_clean(base):
        return []
    # Small zeros of single runs are taken off every fit; a mistake is looked for with none of them.
    base = fit(base.problem.bare, base.hypothesis, base.coordinates)
    runs = [k for k, run in enumerate(base.problem.case.runs) if run.kind == "press"]
    excess = base.chi2 - base.problem.count
    is_within_noise = excess < 4.0 * np.sqrt(2.0 * base.problem.count)
    if len(runs) < problem.method.mistake.fewest_runs or is_within_noise or is_clean(base):
        return []
    config, predicted_gains = problem.method.outlier, sorted(_predicted_gain(base, runs), key=lambda p: -p[0])
    result = []
    for gain, run, oddity in predicted_gains[:3]:
        if gain < max(promised_share * excess, 0.5 * predicted_gains[0][0]):
            continue
        effects = _effects(run, oddity, base)
        start = np.append(base.coordinates, np.zeros(len(effects)))
        fitted = fit(base.problem, base.hypothesis.adding(*effects), start, steps=30)
        result.append((fitted, run, oddity, (base.chi2 - fitted.chi2) / excess))

    def price(one: _Fitted) -> float:
        dearer = 0.0 if is_clean(one[0]) else config.dearer * excess
        return one[0].chi2 + len(one[2].hooks) * (config.each * float(np.log(base.problem.count)) + dearer)

    return sorted(result, key=price)


def _predicted_gain(base: Fit, runs: Sequence[int]) -> list[tuple[float, int, _Oddity]]:
    """Return to first order by how much each oddity of each run would lower χ² after a refit."""
    tangent, problem = Tangent(base), base.problem
    gains = []
    slopes = base.jacobian[base.hypothesis.of_base]
    for run in runs:
        inside = np.zeros(len(problem.measured))
        rows: dict[tuple[str, str], list[Array]] = {}
        for block in (b for b in problem.blocks if b.run == run):
            inside[block.rows] = 1.0
            channel, at_block = block.channel.split("_")[0], np.zeros(len(problem.measured))
            at_block[block.rows] = 1.0
            rows["zero", channel] = [problem.whitened(at_block)]
            rows["gain", channel] = [problem.whitened(at_block * base.predicted)]
        rows["other_unit", ""] = [row * inside for row in slopes]
        if problem.is_free[0]:
            rows["zero", "stage"] = [slopes[0] * inside]
        for oddity in ODDITIES:
            signatures = rows.get((oddity.quantity, oddity.channel))
            if signatures is None:
                continue
            gain, visible = 0.0, np.array([tangent.visible(s) for s in signatures if energy(s) > 0])
            if len(visible):
                pull = visible @ base.residual
                coefficients, *_ = np.linalg.lstsq(gram(visible) + 1e-12 * np.eye(len(visible)), pull, rcond=1e-9)
                gain = float(coefficients @ pull)
            gains.append((gain, run, oddity))
    return gains


def _effects(run: int, oddity: _Oddity, base: Fit) -> list[Effect]:
    columns, effects = {"reading_N": "force_N", "output_V": "output_V", "pad_mm": "stage_mm"}, []
    # It acts in this run alone.
    step = partial(changing, follows=lambda flow: float(flow.run == run))
    for hook, signal, is_gain in oddity.hooks:
        span = 1.0 if is_gain else _span(base.problem.case, columns[signal])
        size = Parameter("size", "", -0.9 * span, 3.0 * span, 0.05 * span, neutral=0.0)
        effects.append(Effect(f"{signal} of run {run}", "", hook, "", "", (size,), step(signal, is_offset=not is_gain)))
    return effects


def _span(case: Case, column: str) -> float:
    parts = case.recorded(column)
    return float(np.ptp(np.concatenate(parts))) if parts else 1.0


def _finding(fitted: Fit, run: int, oddity: _Oddity, share: float) -> DataMistake | None:
    case, min_size = fitted.problem.case, fitted.problem.method.outlier.min_gain
    number = (numbers(case)[run],)
    of_run = {e.id: values[0] for e, values in zip(fitted.effects, fitted.effect_values, strict=True)}
    sizes = [of_run[effect.id] for effect in _effects(run, oddity, fitted)]
    if oddity.quantity == "other_unit":
        stiffness, sensitivity, resistance, _ = sizes
        texts = {"stiffness": stiffness, "resistance": resistance, "sensitivity": sensitivity, "share": min(share, 1.0)}
        evidence = reason("data.run.other_unit", **texts)
        return DataMistake("other_unit", "", number, None, evidence, reason("data.repair.other_unit"))
    column = COLUMNS[oddity.channel]
    span, size = _span(case, column), sizes[0]
    if oddity.quantity == "gain":
        ratio = 1.0 + size
        if abs(ratio - 1.0) < min_size:
            return None
        evidence = reason("data.run.gain", channel=oddity.channel, ratio=ratio, share=min(share, 1.0))
        return of_gain(oddity.channel, number, 1.0 / ratio, evidence)
    offset, unit = size if oddity.channel != "stage" else -size, column.split("_")[1]
    if abs(offset) < min_size * span:
        return None
    evidence = reason("data.run.zero", channel=oddity.channel, offset=offset, unit=unit, share=min(share, 1.0))
    repair = reason("data.repair.zero", channel=oddity.channel, offset=offset, unit=unit)
    return DataMistake("zero", oddity.channel, number, offset, evidence, repair)
