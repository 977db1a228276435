"""Typical mistakes of people in recordings: drawn for a case, and applied to the measured runs."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeAlias

import numpy as np

from softcal.core.challenge.rig import PRESS, Measured, Rig
from softcal.core.json_input import parse_json
from softcal.core.recording import Array, Rng

COLUMNS = {"stage": "stage_mm", "force": "force_N", "output": "output_V"}
UNITS: Mapping[str, Mapping[str, float]] = {
    "force": {"kgf": 9.80665, "gf": 9.80665e-3, "mN": 1e-3},
    "stage": {"inch": 25.4, "m": 1e3, "um": 1e-3},
    "output": {"mV": 1e-3},
}
"""What one of these units is in the unit of the column."""

UNITS_OF_RUN: Mapping[str, Mapping[str, float]] = {
    "force": {**UNITS["force"], "lbf": 4.44822},
    "stage": {**UNITS["stage"], "cm": 10.0, "2.54 mm": 2.54, "degree as rad": float(np.pi / 180.0)},
    "output": UNITS["output"],
}
"""The same where the other runs are right. A whole case in cm or lbf is as stiff as other pads."""

MAX_INVALID_SAMPLES = 12
"""Most samples that a broken transmission spoils in a run."""


@dataclass(frozen=True)
class Mistake:
    """One mistake in the recordings of a case.

    Args:
        what: kind, as in a report of schema `softcal.gap/1`.
        channel: `stage`, `force`, `output` or `time`; empty where it concerns several.
        runs: numbers of the runs from 1; empty for all.
        factor: true over written values; the multiplied gain or added zero; 0 without one.
        seed: of what else is random in it.
    """

    what: str
    channel: str = ""
    runs: tuple[int, ...] = ()
    factor: float = 0.0
    seed: int = 0

    def to_text(self) -> str:
        return json.dumps(self.__dict__)

    @classmethod
    def from_text(cls, text: str) -> "Mistake":
        record = parse_json(text)
        return cls(**{**record, "runs": tuple(record["runs"])})

    def concerns(self, run: int) -> bool:
        return not self.runs or run in self.runs


@dataclass(frozen=True)
class RunOnFile:
    """A run in the form of its files, with the sample rate of the metadata."""

    measured: Measured
    sample_rate_Hz: float


class _MistakenCase(NamedTuple):
    """Recordings for a mistake: the measured runs, and the same paths pressed on another unit."""

    rig: Rig
    runs: Sequence[Measured]
    other_unit_runs: Sequence[Measured]


_Corrupt: TypeAlias = Callable[[_MistakenCase, int, Mistake], Measured]


def other_unit(rig: Rig, mistake: Mistake) -> Rig:
    """Return another unit of the lot: other values of every parameter, with the same electronics."""
    rng = np.random.default_rng([mistake.seed, 5])

    def varied(value: float, spread: float) -> float:
        # A unit within 5 % of the other one is nobody's mistake to notice.
        return float(value * np.exp(rng.choice([-1.0, 1.0]) * rng.uniform(0.05, spread)))

    return replace(
        rig,
        u0_mm=rig.u0_mm + float(rng.uniform(-0.05, 0.2)),
        k1_N_mm=varied(rig.k1_N_mm, 0.2),
        k3_N_mm3=varied(rig.k3_N_mm3, 0.2),
        r0_ohm=varied(rig.r0_ohm, 0.25),
        kappa_per_N=varied(rig.kappa_per_N, 0.12),
    )


def write_runs(rig: Rig, runs: Sequence[Measured], other_unit_runs: Sequence[Measured], text: str) -> list[RunOnFile]:
    """Return the runs of a case as its files have them.

    Args:
        other_unit_runs: the same runs of `other_unit`; used where the mistake is of that kind.
        text: the mistake, empty for none.
    """
    files = [RunOnFile(measured, rig.sample_rate_Hz) for measured in runs]
    if not text:
        return files
    mistake, case = Mistake.from_text(text), _MistakenCase(rig, runs, other_unit_runs)
    _, corrupt = _KINDS[mistake.what]
    rate_Hz = rig.sample_rate_Hz * (mistake.factor if mistake.what == "rate" else 1.0)
    return [
        RunOnFile(corrupt(case, k, mistake), rate_Hz)
        if mistake.concerns(k + 1) and file.measured.kind == PRESS
        else file
        for k, file in enumerate(files)
    ]


def _corrupt_column(corrupted: Callable[[Array, Mistake], Array]) -> _Corrupt:
    def corrupt(case: _MistakenCase, k: int, mistake: Mistake) -> Measured:
        name = COLUMNS[mistake.channel]
        return case.runs[k].with_columns(**{name: corrupted(case.runs[k].columns[name], mistake)})

    return corrupt


def _swapped_columns(case: _MistakenCase, k: int, mistake: Mistake) -> Measured:
    one, other = (COLUMNS[name] for name in mistake.channel.split("+"))
    columns = case.runs[k].columns
    return case.runs[k].with_columns(**{one: columns[other], other: columns[one]})


def _swapped_runs(case: _MistakenCase, k: int, mistake: Mistake) -> Measured:
    name = COLUMNS[mistake.channel]
    partner = next(run for run in mistake.runs if run != k + 1) - 1
    return case.runs[k].with_columns(**{name: case.runs[partner].columns[name]})


def _out_of_range(values: Array, mistake: Mistake) -> Array:
    rng, corrupted = np.random.default_rng([mistake.seed, 6]), values.copy()
    corrupted[rng.choice(len(values), int(rng.integers(1, MAX_INVALID_SAMPLES + 1)), replace=False)] = mistake.factor
    return corrupted


STUCK_VALUES = {"output": (6.5535e4, 9.99, -1.0), "force": (999.0, -999.0, 8388.607), "stage": (999.0, -999.0)}
"""What a broken transmission leaves in a column."""


@dataclass(frozen=True)
class _Dice:
    """Random numbers for a mistake of a case; lengths and names as in `draw_mistake`."""

    rng: Rng
    peak_N: float
    span_V: float
    runs: int

    def pick(self, names: Sequence[str]) -> str:
        return str(names[int(self.rng.integers(len(names)))])

    def one(self) -> tuple[int, ...]:
        return (int(self.rng.integers(1, self.runs + 1)),)

    def all_or_one(self) -> tuple[int, ...]:
        return () if self.rng.random() < 0.5 else self.one()

    def seed(self) -> int:
        return int(self.rng.integers(2**31))


def _draw_unit(dice: _Dice) -> Mistake:
    at = dice.all_or_one()
    units = UNITS_OF_RUN if at else UNITS
    channel = dice.pick(list(units))
    return Mistake("unit_factor", channel, at, units[channel][dice.pick(list(units[channel]))])


def _draw_gain(dice: _Dice) -> Mistake:
    factor = 1.0 + float(dice.rng.choice([-1.0, 1.0]) * dice.rng.uniform(0.05, 0.25))
    # An output above its reference would be another mistake.
    channel = dice.pick(("force", "output"))
    return Mistake("gain", channel, dice.one(), min(factor, 1.0 / factor) if channel == "output" else factor)


def _draw_zero(dice: _Dice) -> Mistake:
    channel, rng = dice.pick(("stage", "force", "output")), dice.rng
    stage_mm, force_N = rng.uniform(0.3, 1.0), dice.peak_N * rng.uniform(0.05, 0.2)
    size = {"stage": stage_mm, "force": force_N, "output": dice.span_V * 0.1}[channel]
    return Mistake("zero", channel, dice.one(), float(rng.choice([-1.0, 1.0]) * size))


def _draw_swapped_runs(dice: _Dice) -> Mistake:
    one, other = (int(k) + 1 for k in dice.rng.choice(dice.runs, 2, replace=False))
    return Mistake("swapped_runs", dice.pick(("force", "output")), tuple(sorted((one, other))))


def _draw_out_of_range(dice: _Dice) -> Mistake:
    channel = dice.pick(list(STUCK_VALUES))
    rail = float(STUCK_VALUES[channel][int(dice.rng.integers(len(STUCK_VALUES[channel])))])
    return Mistake("out_of_range", channel, dice.one(), rail, dice.seed())


PAIRS = ("stage+force", "force+output", "stage+output")

_KINDS: Mapping[str, tuple[Callable[[_Dice], Mistake], _Corrupt]] = {
    "unit_factor": (_draw_unit, _corrupt_column(lambda values, mistake: values / mistake.factor)),
    "gain": (_draw_gain, _corrupt_column(lambda values, mistake: values * mistake.factor)),
    "zero": (_draw_zero, _corrupt_column(lambda values, mistake: values + mistake.factor)),
    "sign": (
        lambda dice: Mistake("sign", dice.pick(("stage", "force")), dice.all_or_one()),
        _corrupt_column(lambda values, mistake: -values),
    ),
    "swapped_columns": (lambda dice: Mistake("swapped_columns", dice.pick(PAIRS), dice.all_or_one()), _swapped_columns),
    "swapped_divider": (
        lambda dice: Mistake("swapped_divider", "output"),
        # The channel above, the series resistor below: V = Vref·Rs/(R + Rs), read by the same ADC.
        lambda case, k, mistake: case.runs[k].with_columns(output_V=case.rig.vref_V - case.runs[k].columns["output_V"]),
    ),
    "other_unit": (
        lambda dice: Mistake("other_unit", "", dice.one(), seed=dice.seed()),
        lambda case, k, mistake: case.other_unit_runs[k],
    ),
    "swapped_runs": (_draw_swapped_runs, _swapped_runs),
    "rate": (
        lambda dice: Mistake("rate", "time", dice.all_or_one(), float(dice.rng.choice([0.5, 2.0, 0.9, 1.2, 10.0]))),
        lambda case, k, mistake: case.runs[k],
    ),
    "out_of_range": (_draw_out_of_range, _corrupt_column(_out_of_range)),
}
"""By kind, how a mistake is drawn and what it does to a run."""


def draw_mistake(rng: Rng, rig: Rig, peak_N: float, span_V: float, runs: int) -> str:
    """Draw one mistake for a case of two or more runs, every kind equally likely, in the form of a label."""
    draw, _ = list(_KINDS.values())[rng.integers(len(_KINDS))]
    return draw(_Dice(rng, peak_N, span_V, runs)).to_text()
