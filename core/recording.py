"""Recordings of one unit, checked when made. From an `OutputRecording` no fit reads a reference."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from softcal.core.errors import InputError
from softcal.core.identity import content_sha256
from softcal.core.windows import TAPS, windows

Array: TypeAlias = NDArray[np.float64]
Indices: TypeAlias = NDArray[np.int64]
Mask: TypeAlias = NDArray[np.bool_]
Rng: TypeAlias = np.random.Generator
Arrays: TypeAlias = Mapping[str, NDArray[np.generic]]
"""Parameters by name, as they are stored and hashed."""

GAP_FACTOR = 1.5
"""A step of t_s longer than this many sample periods is a gap: no window reaches across it."""

RATE_TOLERANCE = 0.01
"""Largest relative difference between the declared rate and the one the time stamps show."""


MASK_KINDS = ("missing", "overflow", "spike", "dropout", "no_reference", "reference_outlier")
"""Why a sample is masked: an empty cell, a value that no sensor gives, a spike faster than any press, a cable off for
longer; the last two are of the reference beside it. Stored by position: new kinds go to the end."""

MASKED = "masked_"
"""How the names of the arrays begin that store masked samples."""


@dataclass(frozen=True, eq=False)
class MaskedSamples:
    """Samples that a file holds and no fit sees: they are taken out, which leaves a gap in `t_s`.

    Args:
        t_s: (m,) time stamps in s.
        kinds: (m,) position of each one's kind in `MASK_KINDS`.
        values: (m,) what the column holds there; NaN for an empty cell.
        lines: (m,) line of the file; 0 where there was no file.
    """

    t_s: Array = field(default_factory=lambda: np.empty(0))
    kinds: Indices = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    values: Array = field(default_factory=lambda: np.empty(0))
    lines: Indices = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def counts(self) -> dict[str, int]:
        """Number of masked samples by kind; kinds without any are left out."""
        counts = np.bincount(self.kinds, minlength=len(MASK_KINDS))
        return {kind: int(count) for kind, count in zip(MASK_KINDS, counts, strict=True) if count}

    def arrays(self) -> dict[str, Array]:
        """Return what a recording stores of them: nothing where there are none."""
        columns = {name: np.asarray(values, dtype=np.float64) for name, values in vars(self).items()}
        return {f"{MASKED}{name}": values for name, values in columns.items()} if len(self) else {}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Array]) -> "MaskedSamples":
        """Return what `arrays` stored."""
        stored = {name.removeprefix(MASKED): values for name, values in arrays.items() if name.startswith(MASKED)}
        if not stored:
            return cls()
        kinds, lines = (stored[name].astype(np.int64) for name in ("kinds", "lines"))
        return cls(stored["t_s"], kinds, stored["values"], lines)

    def in_interval(self, start_s: float, stop_s: float) -> "MaskedSamples":
        """Return those of a stretch of time, its ends included."""
        return self._of_rows((self.t_s >= start_s) & (self.t_s <= stop_s))

    def of_kind(self, kind: str) -> "MaskedSamples":
        """Return those of one kind."""
        return self._of_rows(self.kinds == MASK_KINDS.index(kind))

    def _of_rows(self, is_row: Mask) -> "MaskedSamples":
        return MaskedSamples(self.t_s[is_row], self.kinds[is_row], self.values[is_row], self.lines[is_row])


@dataclass(frozen=True, eq=False)
class OutputRecording:
    """The output of one unit while it was pressed, without any reference.

    Args:
        t_s: (n,) time stamps in s, strictly increasing.
        output: (n,) sensor output in `output_unit`.
        sample_rate_Hz: nominal sample rate; the median step of `t_s` must agree within 2 %.
        stage_mm: (n,) stage position, positive when it compresses; None where it is not known.
        masked: samples of its file that are none of these.

    Raises:
        InputError: not finite, time repeated or backward, too short, or not at the declared rate.
    """

    serial: str
    t_s: Array
    output: Array
    sample_rate_Hz: float
    output_unit: str = "V"
    stage_mm: Array | None = None
    masked: MaskedSamples = field(default_factory=MaskedSamples)

    def __post_init__(self) -> None:
        for name in ("t_s", "output", "stage_mm"):
            if (values := getattr(self, name)) is not None:
                object.__setattr__(self, name, typed_column(name, values))
                _same_length("t_s", self.t_s, name, getattr(self, name))
        # 50 and 50.0 are one rate: they must have one hash.
        object.__setattr__(self, "sample_rate_Hz", float(self.sample_rate_Hz))
        if len(self.t_s) < TAPS:
            raise InputError(f"{len(self.t_s)} samples; at least {TAPS} are needed to fill one window")
        if not (np.isfinite(self.sample_rate_Hz) and self.sample_rate_Hz > 0):
            raise InputError(f"sample rate is {self.sample_rate_Hz} Hz; a positive number was expected")
        check_times(self.t_s)
        observed_Hz = 1.0 / float(np.median(np.diff(self.t_s)))
        if abs(observed_Hz / self.sample_rate_Hz - 1) > RATE_TOLERANCE:
            raise InputError(
                f"the time stamps show {observed_Hz:.4g} Hz, the declared sample rate is {self.sample_rate_Hz:.4g} Hz; "
                "correct the one that is wrong"
            )

    def __len__(self) -> int:
        return len(self.t_s)

    @cached_property
    def step(self) -> float:
        """Smallest step of the readout, in the output unit; infinite for a constant output."""
        return float(np.min(np.diff(np.unique(self.output)), initial=np.inf))

    @cached_property
    def segments(self) -> tuple[slice, ...]:
        """The gap-free stretches, in time order; a stretch shorter than one window is kept."""
        breaks = np.flatnonzero(np.diff(self.t_s) > GAP_FACTOR / self.sample_rate_Hz) + 1
        edges = [0, *breaks.tolist(), len(self.t_s)]
        return tuple(slice(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True))

    @cached_property
    def bridged(self) -> "OutputRecording":
        """Itself with straight lines across gaps shorter than a window: the output goes on there, few samples unseen.

        Levels, swings and time spent are read from it; windows that are fitted to or scored are not.
        """
        missing = np.round(np.diff(self.t_s) * self.sample_rate_Hz).astype(np.int64) - 1
        missing[missing >= TAPS] = 0
        if not missing.any():
            return self
        rows = np.arange(len(self))
        t_s = np.interp(
            np.arange(len(self) + missing.sum()), rows + np.concatenate([[0], np.cumsum(missing)]), self.t_s
        )
        stage_mm = None if self.stage_mm is None else np.interp(t_s, self.t_s, self.stage_mm)
        return replace(self, t_s=t_s, output=np.interp(t_s, self.t_s, self.output), stage_mm=stage_mm)

    @cached_property
    def window_rows(self) -> Indices:
        """(m,) index of the newest sample of every full window; none reaches across a gap."""
        return np.concatenate([np.arange(s.start + TAPS - 1, s.stop) for s in self.segments]).astype(np.int64)

    @cached_property
    def windows(self) -> Array:
        """(m, TAPS) full windows, newest sample last; row k belongs to sample `window_rows[k]`."""
        parts = [windows(self.output[s]) for s in self.segments if s.stop - s.start >= TAPS]
        if not parts:
            raise InputError(f"no gap-free stretch of {TAPS} samples; record the unit again without gaps")
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    @cached_property
    def sha256(self) -> str:
        return content_sha256(self.arrays(), self.settings())

    @cached_property
    def output_sha256(self) -> str:
        """Content hash of the output alone: one recording that stands for two units is known by it."""
        return content_sha256({"output": self.output}, {})

    def arrays(self) -> dict[str, Array]:
        stage = {} if self.stage_mm is None else {"stage_mm": self.stage_mm}
        return {"t_s": self.t_s, "output": self.output, **stage, **self.masked.arrays()}

    def settings(self) -> dict[str, float | str]:
        return {"serial": self.serial, "sample_rate_Hz": self.sample_rate_Hz, "output_unit": self.output_unit}

    def part(self, start: int, stop: int) -> "OutputRecording":
        rows = slice(start, stop)
        stage_mm = None if self.stage_mm is None else self.stage_mm[rows]
        t_s = self.t_s[rows]
        masked = self.masked.in_interval(t_s[0], t_s[-1]) if len(t_s) else MaskedSamples()
        return replace(self, t_s=t_s, output=self.output[rows], stage_mm=stage_mm, masked=masked)


@dataclass(frozen=True, eq=False)
class LabelledRecording:
    """An output recording together with the reference read beside it (source unit, or an audit).

    Args:
        unlabelled: the recording as any fit of a target may see it.
        reference: (n,) reference in `reference_unit`, sample by sample beside the output.

    Raises:
        InputError: lengths differ or a value is not finite.
    """

    unlabelled: OutputRecording
    reference: Array
    reference_unit: str = "N"

    def __post_init__(self) -> None:
        object.__setattr__(self, "reference", typed_column("reference", self.reference))
        _same_length("output", self.unlabelled.output, "reference", self.reference)

    def __len__(self) -> int:
        return len(self.reference)

    @property
    def serial(self) -> str:
        return self.unlabelled.serial

    @cached_property
    def direction(self) -> float:
        """1 where the output rises with the load, -1 where it falls."""
        return 1.0 if np.corrcoef(self.unlabelled.output, self.reference)[0, 1] >= 0 else -1.0

    @cached_property
    def sha256(self) -> str:
        return content_sha256(self.arrays(), self.settings())

    @property
    def output_sha256(self) -> str:
        return self.unlabelled.output_sha256

    def arrays(self) -> dict[str, Array]:
        return {**self.unlabelled.arrays(), "reference": self.reference}

    def settings(self) -> dict[str, float | str]:
        return {**self.unlabelled.settings(), "reference_unit": self.reference_unit}

    @property
    def windows(self) -> Array:
        """(m, TAPS) full windows of the output, newest sample last."""
        return self.unlabelled.windows

    @property
    def window_reference(self) -> Array:
        """(m,) reference at the newest sample of every full window."""
        return self.reference[self.unlabelled.window_rows]

    def part(self, start: int, stop: int) -> "LabelledRecording":
        return LabelledRecording(self.unlabelled.part(start, stop), self.reference[start:stop], self.reference_unit)


def check_times(t_s: Array) -> None:
    """Check that time stamps increase strictly.

    Raises:
        InputError: time repeats or goes back.
    """
    steps = np.diff(t_s)
    bad = np.flatnonzero(steps <= 0)
    if len(bad):
        k = int(bad[0])
        kind = "repeats" if steps[k] == 0 else "goes backward"
        raise InputError(f"t_s {kind} at sample {k + 1}: {t_s[k]:.6g} s, then {t_s[k + 1]:.6g} s")


def typed_column(name: str, values: Array, *, can_miss: bool = False) -> Array:
    """Return a column as (n,) float64; NaN stands for a missing sample where there can be one.

    Raises:
        InputError: not one-dimensional, or a value is not finite.
    """
    column = np.asarray(values, dtype=np.float64)
    if column.ndim != 1:
        raise InputError(f"{name} has {column.ndim} dimensions; one column of numbers was expected")
    if can_miss:
        return column
    bad = np.flatnonzero(~np.isfinite(column))
    if len(bad):
        raise InputError(f"{name} is {column[bad[0]]} at sample {bad[0]}; {len(bad)} of {len(column)} are not finite")
    return column


def _same_length(name: str, values: Array, other_name: str, other: Array) -> None:
    if len(values) != len(other):
        raise InputError(
            f"{name} has {len(values)} samples, {other_name} has {len(other)}; both must come from one recording"
        )
