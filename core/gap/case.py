"""A case for diagnosis: several runs of one unit on one rig, checked once when made; its size; mistakes in it.

Pads of 0.2 N and of 200 N, outputs in V or mV, strokes of 0.3 or 30 mm give the same diagnosis. Time is not scaled:
creep, mains and clocks have their own.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Literal, get_args

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from softcal.core.errors import InputError
from softcal.core.messages.reason import Reason, reason, with_sentences
from softcal.core.recording import Array
from softcal.core.twin.effects import ChainStage, Parameter
from softcal.core.twin.parameters import ReadoutMetadata

RunKind = Literal["press", "rigid_block", "dummy_resistor", "dead_weights", "rest"]
KINDS: tuple[RunKind, ...] = get_args(RunKind)
CHANNELS = ("stage_mm", "force_N", "output_V", "temperature_C")
NEEDED: dict[RunKind, tuple[str, ...]] = {
    "press": (),
    "rigid_block": ("stage_mm", "force_N"),
    "dummy_resistor": ("output_V",),
    "dead_weights": ("force_N", "known_force_N"),
    "rest": (),
}
CHANNEL_OF_STAGE: dict[ChainStage, str] = {
    "motion": "stage_mm",
    "mechanics": "stage_mm",
    "transduction": "output_V",
    "electronics": "output_V",
    "acquisition": "output_V",
    "load_cell": "force_N",
}
"""The channel without which nothing of a stage shows."""

SHORTEST = 30
"""Fewest samples of a run; five base parameters and a noise level are estimated from them."""

HALF_WIDTH = 4
"""Samples on either side that a straight line is fitted to: 0.18 s at 50 Hz."""


@dataclass(frozen=True, eq=False)
class DrivingForce:
    """A measured force, (n,), smoothed to drive the chain, and the SD of the noise that is left."""

    force_N: Array
    sigma_N: Array


@dataclass(frozen=True, eq=False)
class Run:
    """One run of a case; a channel that was not recorded is None.

    Args:
        t_s: (n,) time stamps, strictly increasing; the run starts from rest at the first.
        stage_mm, force_N, output_V, temperature_C: (n,) recorded channels.
        known_force_N: (n,) weights laid on, of a run with dead weights.
        dummy_ohm: the resistor in place of the sensor, of a run with a dummy resistor.
        is_planned: not recorded yet; its measured channels hold zeros and are not looked at.

    Raises:
        InputError: a channel is too short, not finite or constant, time goes back, or one is missing.
    """

    name: str
    t_s: Array
    readout: ReadoutMetadata
    stage_mm: Array | None = None
    force_N: Array | None = None
    output_V: Array | None = None
    temperature_C: Array | None = None
    known_force_N: Array | None = None
    dummy_ohm: float | None = None
    kind: RunKind = "press"
    profile: str = ""
    is_planned: bool = False

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(f"{self.name}: kind {self.kind!r} is not known; known are {', '.join(KINDS)}")
        if len(self.t_s) < SHORTEST:
            raise InputError(f"{self.name}: {len(self.t_s)} samples; at least {SHORTEST} are needed for a diagnosis")
        if not np.all(np.isfinite(self.t_s)):
            raise InputError(f"{self.name}: t_s is not finite everywhere")
        steps_s = np.diff(self.t_s)
        if np.any(steps_s <= 0):
            at = int(np.argmax(steps_s <= 0)) + 1
            raise InputError(f"{self.name}: t_s repeats or goes backward at sample {at} ({self.t_s[at]:.6g} s)")
        for channel in (*CHANNELS, "known_force_N"):
            values = getattr(self, channel)
            if values is None:
                continue
            if len(values) != len(self.t_s):
                raise InputError(f"{self.name}: {channel} has {len(values)} samples, t_s has {len(self.t_s)}")
            bad = np.flatnonzero(~np.isfinite(values))
            if len(bad):
                first = f"{channel} is {values[bad[0]]} at sample {bad[0]}"
                raise InputError(f"{self.name}: {first}; {len(bad)} not finite")
        for channel in NEEDED[self.kind]:
            if getattr(self, channel) is None:
                raise InputError(f"{self.name}: a {self.kind} run needs {channel}, which is not recorded")
        if self.kind == "dummy_resistor" and not (self.dummy_ohm is not None and self.dummy_ohm > 0):
            raise InputError(f"{self.name}: a dummy_resistor run needs dummy_ohm above 0 in its metadata")
        if self.kind == "press" and not self.is_planned:
            if sum(getattr(self, channel) is not None for channel in ("stage_mm", "force_N", "output_V")) < 2:
                raise InputError(f"{self.name}: two of stage_mm, force_N, output_V are needed to see any gap")
            for channel in ("stage_mm", "force_N", "output_V"):
                values = getattr(self, channel)
                if values is not None and np.ptp(values) == 0:
                    raise InputError(f"{self.name}: {channel} is {values[0]:.6g} throughout; nothing was pressed")

    def __len__(self) -> int:
        return len(self.t_s)

    def column(self, name: str) -> Array:
        """Return a recorded column, (n,)."""
        return np.asarray(getattr(self, name))

    @property
    def observed_rate_Hz(self) -> float:
        """Sample rate that the time stamps show."""
        return 1.0 / float(np.median(np.diff(self.t_s)))

    @cached_property
    def elapsed_s(self) -> Array:
        """(n,) time since the first sample."""
        return np.asarray(self.t_s - self.t_s[0])

    @cached_property
    def driving_force(self) -> DrivingForce:
        """The measured force, smoothed to drive the chain where there is no stage position."""
        if self.force_N is None:
            raise ValueError(f"{self.name} has no force")
        squares = np.sort(np.diff(self.force_N, 2) ** 2 / 6)
        # A straight ramp does not enter second differences; a Gaussian without its largest 20 % of squares keeps 0.438
        # of its variance.
        sigma_N = float(np.sqrt(np.mean(squares[: max(1, int(0.8 * len(squares)))]) / 0.438))
        smooth_N, share = straightened(self.force_N, sigma_N, HALF_WIDTH)
        return DrivingForce(smooth_N, sigma_N * np.sqrt(share))

    @cached_property
    def step_s(self) -> Array:
        """(n,) time since the sample before; 0 at the first."""
        return np.diff(self.t_s, prepend=self.t_s[0])

    @cached_property
    def temperature_rise_K(self) -> Array | None:
        """(n,) temperature above that of the first sample."""
        return None if self.temperature_C is None else self.temperature_C - self.temperature_C[0]


COMMON = {"N": 8.0, "mm": 3.0, "ohm": 10.0, "V": 4.0}
"""Force, stroke, series resistor and supply of the rig of the catalogue's bounds."""


FACTOR = re.compile(r"(N|mm|ohm|V|s|K|Hz|rad|1)([²³]?)")


POWERS = {"": 1, "²": 2, "³": 3}


@dataclass(frozen=True)
class RigScale:
    """How large a rig is against the common one, by unit; other units are not scaled."""

    sizes: tuple[tuple[str, float], ...] = ()

    @classmethod
    def from_case(cls, case: "Case") -> "RigScale":
        """Read force and stroke off the runs that are pressed, the others off the metadata."""
        spans = {}
        for unit, channel in (("mm", "stage_mm"), ("N", "force_N")):
            span = max((float(np.ptp(v)) for v in case.recorded(channel)), default=0.0)
            spans[unit] = span / COMMON[unit] or None
        # Without a cell, or without a stage, the pad is as stiff as the common one.
        positive_sizes = [size for size in spans.values() if size]
        common = positive_sizes[0] if positive_sizes else 1.0
        readout = case.readout
        sizes = {unit: size or common for unit, size in spans.items()}
        sizes |= {"ohm": readout.r_series_ohm / COMMON["ohm"], "V": readout.vref_V / COMMON["V"]}
        return cls(tuple(sizes.items()))

    def factor(self, unit: str) -> float:
        """Return by what a quantity of this unit, as `N/mm³`, is larger than on the common rig."""
        sizes, (over, _, under) = dict(self.sizes), unit.partition("/")
        matches = [FACTOR.fullmatch(part.strip()) for part in (over, under)]
        times, per = (sizes.get(one[1], 1.0) ** POWERS[one[2]] if one else 1.0 for one in matches)
        return times / per

    def sized(self, parameter: Parameter) -> Parameter:
        """Return a parameter with the bounds and the usual size that it has on this rig."""
        return _sized(self, parameter)


@lru_cache(maxsize=4096)
def _sized(scale: RigScale, parameter: Parameter) -> Parameter:
    factor = scale.factor(parameter.unit)
    return replace(parameter, low=factor * parameter.low, high=factor * parameter.high, usual=factor * parameter.usual)


@dataclass(frozen=True)
class MenuEntry:
    """One experiment that may be proposed: its run, channels still zeros, and minutes with set-up."""

    name: str
    run: Run
    minutes: float


def straightened(signal: Array, sigma: float, half: int) -> tuple[Array, Array]:
    """Return the smoothed signal and, per sample, which share of the noise variance is left."""
    out, share, is_open = signal.copy(), np.ones(len(signal)), np.ones(len(signal), dtype=np.bool_)
    # Centred takes the most noise off; one-sided lines keep corners where they are.
    for first, last in ((-half, half), (-half, 0), (0, half)):
        x = np.arange(first, last + 1.0)
        middle, design = x.mean(), np.column_stack([np.ones(len(x)), x - x.mean()])
        windows = sliding_window_view(signal, len(x))
        lines = windows @ np.linalg.pinv(design).T
        residual_variance = np.sum((windows - lines @ design.T) ** 2, axis=1) / (len(x) - 2)
        at = np.arange(len(windows)) - first
        # A line that leaves more than twice the noise's variance lies across a bend.
        fits = is_open[at] & (residual_variance < 2.0 * sigma**2)
        out[at[fits]] = lines[fits, 0] - middle * lines[fits, 1]
        share[at[fits]] = 1.0 / len(x) + middle**2 / np.sum((x - middle) ** 2)
        is_open[at[fits]] = False
    return out, share


@dataclass(frozen=True, eq=False)
class Case:
    """Runs of one unit on one rig.

    Args:
        is_planned: a case of runs that are not recorded yet; a special run alone will do.
        stiffness_N_mm: lowest and highest peak force over depth of this lot, where it states them.

    Raises:
        InputError: nothing is pressed, or units, rates or electronics of the runs differ.
    """

    serial: str
    runs: tuple[Run, ...]
    is_planned: bool = False
    stiffness_N_mm: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if not self.presses and not self.is_planned:
            raise InputError(f"case {self.serial}: no run in which the sensor is pressed; a diagnosis needs one")
        first = self.runs[0]
        for run in self.runs[1:]:
            # A rate of its own is found where its time stamps are looked at.
            for entry in (f for f in fields(ReadoutMetadata) if f.name != "sample_rate_Hz"):
                expected, other = getattr(first.readout, entry.name), getattr(run.readout, entry.name)
                if expected != other:
                    raise InputError(
                        f"{run.name}: {entry.name} is {other}, but {expected} in {first.name}; "
                        "all runs of a case come from one unit on one rig"
                    )
        for channel in ("stage_mm", "force_N", "output_V"):
            has = [getattr(run, channel) is not None for run in self.presses]
            if any(has) and not all(has):
                without = self.presses[has.index(False)].name
                raise InputError(f"{without}: {channel} is missing, other runs have it; add it or leave that run out")

    @cached_property
    def presses(self) -> tuple[Run, ...]:
        """The runs in which the sensor is pressed."""
        return tuple(run for run in self.runs if run.kind == "press")

    @property
    def readout(self) -> ReadoutMetadata:
        return self.runs[0].readout

    def has(self, channel: str) -> bool:
        """Whether the runs in which the sensor is pressed recorded this channel."""
        return all(getattr(run, channel) is not None for run in self.presses)

    def recorded(self, channel: str) -> list[Array]:
        """Return a channel, (n,) each, of the pressed runs that recorded it."""
        return [values for run in self.presses if (values := getattr(run, channel)) is not None]

    def changes(self, channel: str, kind: str = "press", by: float = 0.0) -> bool:
        """Whether a channel changes, by so much, in any run of a kind."""
        logs = [getattr(run, channel) for run in self.runs if run.kind == kind]
        return any(log is not None and np.ptp(log) > 0 and np.ptp(log) >= by for log in logs)

    @property
    def unseen_stages(self) -> tuple[ChainStage, ...]:
        """Stages that the recorded channels cannot show at all."""
        return tuple(stage for stage, channel in CHANNEL_OF_STAGE.items() if not self.has(channel))

    @property
    def missing_channels(self) -> tuple[str, ...]:
        """Channels that no pressed run recorded."""
        return tuple(channel for channel in CHANNELS if not self.has(channel))


Kind = Literal[
    "unit_factor",
    "gain",
    "zero",
    "sign",
    "swapped_columns",
    "swapped_divider",
    "other_unit",
    "swapped_runs",
    "rate",
    "out_of_range",
    "constant",
    "repeats",
    "noise",
]


@dataclass(frozen=True)
class DataMistake:
    """One mistake: what it is, where it shows, and what would repair it.

    Args:
        channel: `stage`, `force`, `output`, `temperature` or `time`; `one+other` where exchanged.
        runs: numbers of the runs; empty for all.
        factor: repaired values over recorded ones; None where there is no such number.
    """

    what: Kind
    channel: str
    runs: tuple[int, ...]
    factor: float | None
    evidence: Reason
    repair: Reason

    def record(self) -> dict[str, object]:
        return with_sentences(vars(self) | {"runs": list(self.runs) or "all"}, "evidence", "repair")


SHIFTED: Mapping[str, tuple[float, float]] = {"°F": (5.0 / 9.0, -160.0 / 9.0), "K": (1.0, -273.15)}
"""What values in these must be multiplied by, and what be added then."""


def numbers(case: Case) -> list[int]:
    """Return the numbers of the runs of a case: those of their folders, or their places from 1."""
    names = [run.name for run in case.runs]
    return [int(n) for n in names] if all(n.isdigit() for n in names) else list(range(1, len(names) + 1))


def apart(
    channel: str, run: int, factor: float, units: Mapping[str, float], same: float, others: float = 0.0
) -> DataMistake:
    """Return what is wrong with one run against the others: its unit, else its gain.

    Args:
        factor: what brings its values to those of the others.
        units: what values in each must be multiplied by.
        same: a ratio this near to the factor of a unit is it.
        others: logarithm of the factor by which the others differ among themselves.
    """
    evidence = reason("data.run.apart", channel=channel, ratio=1.0 / factor)
    if unit := unit_of(factor, units, same, others):
        return of_unit(channel, (run,), unit, units[unit], evidence)
    return of_gain(channel, (run,), factor, evidence)


def unit_of(factor: float, units: Mapping[str, float], same: float, others: float = 0.0) -> str:
    """Return the unit whose factor this is, empty where it is none."""
    if factor <= 0.0:
        return ""
    near = min(units, key=lambda unit: abs(np.log(units[unit] / factor)))
    return near if abs(np.log(units[near] / factor)) < np.log(same) + others else ""


def of_unit(
    channel: str, runs: tuple[int, ...], unit: str, factor: float, evidence: Reason, repair: str = "data.repair.unit"
) -> DataMistake:
    """Return the mistake of a channel that is in another unit."""
    mended = reason(repair, channel=channel, factor=factor, unit=unit)
    return DataMistake("unit_factor", channel, runs, factor, evidence, mended)


def of_gain(channel: str, runs: tuple[int, ...], factor: float, evidence: Reason) -> DataMistake:
    """Return the mistake of a channel with a wrong gain."""
    repair = reason("data.repair.gain", channel=channel, factor=factor)
    return DataMistake("gain", channel, runs, factor, evidence, repair)


def of_sign(channel: str, runs: tuple[int, ...], evidence: Reason) -> DataMistake:
    """Return the mistake of a channel with the other sign."""
    return DataMistake("sign", channel, runs, -1.0, evidence, reason("data.repair.sign", channel=channel))


def of_samples(channel: str, runs: tuple[int, ...], count: int, evidence: Reason) -> DataMistake:
    """Return the mistake of samples of a channel that no instrument can have shown."""
    return DataMistake("out_of_range", channel, runs, None, evidence, reason("data.repair.samples", count=count))


def of_shifted(
    channel: str, runs: tuple[int, ...], unit: str, factor: float, offset: float, evidence: Reason
) -> DataMistake:
    """Return the mistake of a channel in a unit with another zero, such as degrees Fahrenheit."""
    repair = reason("data.repair.shifted", channel=channel, factor=factor, offset=offset, unit=unit)
    return DataMistake("unit_factor", channel, runs, factor, evidence, repair)
