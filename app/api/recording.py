"""A recording as Python users hold it: from arrays, pandas or a file, with or without a reference."""

from collections.abc import Hashable
from dataclasses import dataclass
from functools import cached_property
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from softcal.core.errors import InputError
from softcal.core.recording import Array, LabelledRecording, OutputRecording

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False, repr=False)
class Recording:
    """The output of one unit over time, and the reference beside it where one was read.

    Args:
        output: (n,) sensor output in `output_unit`; a list, an array or a pandas Series.
        reference: (n,) load in `reference_unit` read at the same instants; None for a unit that was only pressed.
        sample_rate_Hz: samples a second; by default what `t_s` shows.
        t_s: (n,) time stamps in s, strictly increasing; by default made from `sample_rate_Hz`.
        serial: name of the unit: letters, digits, dot, dash and underscore.
        output_unit, reference_unit: physical units.
        stage_mm: (n,) stage position in mm, positive when it compresses, where the station knows it. Source and units
            that carry it are compared at equal stage histories.

    Raises:
        InputError: lengths differ, a value is not finite, time goes back, or neither rate nor time is given.
    """

    output: Any
    reference: Any = None
    sample_rate_Hz: float | None = None
    t_s: Any = None
    serial: str = "unit"
    output_unit: str = "V"
    reference_unit: str = "N"
    stage_mm: Any = None

    def __post_init__(self) -> None:
        # Whatever is wrong with it is said here, not at the first use.
        for name in ("serial", "output_unit", "reference_unit"):
            expect(name, getattr(self, name), str, "text")
        if self.sample_rate_Hz is not None:
            expect("sample_rate_Hz", self.sample_rate_Hz, Real, "a number of samples a second")
        for name in ("output", "reference", "t_s", "stage_mm"):
            if hasattr(getattr(self, name), "columns"):
                raise InputError(f"{name} is a table; one column was expected: Recording.from_frame takes a table")
        _ = self.labelled if self.reference is not None else self.unlabelled

    def __len__(self) -> int:
        return len(self.unlabelled)

    def __repr__(self) -> str:
        raw, read = self.unlabelled, "" if self.reference is None else f", reference in {self.reference_unit}"
        lasted_s = len(raw) / raw.sample_rate_Hz
        rate = f"{len(raw)} samples at {raw.sample_rate_Hz:g} Hz ({lasted_s:.4g} s)"
        return f"<Recording {self.serial}: {rate}, output in {self.output_unit}{read}>"

    @cached_property
    def unlabelled(self) -> OutputRecording:
        """The output alone: what every fit of a map takes."""
        output = _numbers("output", self.output)
        rate_Hz = self.sample_rate_Hz
        if self.t_s is not None:
            t_s = _numbers("t_s", self.t_s)
            steps = np.diff(t_s)
            if rate_Hz is None and np.any(steps > 0):
                rate_Hz = float(f"{1 / np.median(steps[steps > 0]):.5g}")
        elif rate_Hz is not None and rate_Hz > 0:
            t_s = np.arange(len(output)) / rate_Hz
        if rate_Hz is None or not rate_Hz > 0:
            raise InputError("neither sample_rate_Hz nor t_s says when samples were taken; give one of them")
        stage_mm = None if self.stage_mm is None else _numbers("stage_mm", self.stage_mm)
        return OutputRecording(self.serial, t_s, output, rate_Hz, self.output_unit, stage_mm)

    @cached_property
    def labelled(self) -> LabelledRecording:
        """Output and reference: what trains f, and what an error is measured on.

        Raises:
            InputError: the recording has no reference.
        """
        if self.reference is None:
            raise InputError(f"recording {self.serial} has no reference; give reference=, or name its column")
        return LabelledRecording(self.unlabelled, _numbers("reference", self.reference), self.reference_unit)

    @classmethod
    def from_frame(
        cls,
        frame: "pd.DataFrame",
        output: Hashable = "output",
        reference: Hashable | None = None,
        time_s: Hashable | None = None,
        stage_mm: Hashable | None = None,
        **facts: Any,
    ) -> "Recording":
        """Take columns of a table.

        Args:
            frame: one row a sample.
            output, reference, time_s, stage_mm: names of the columns; None takes `reference`, `t_s` and `stage_mm`
                where there are such. Without a column of time (in seconds) give `sample_rate_Hz`.
            facts: the other arguments of `Recording`.

        Raises:
            InputError: there is no column of that name; the message lists those there are.
        """
        columns: dict[str, Any] = {}
        for argument, name in (("output", output), ("reference", reference), ("t_s", time_s), ("stage_mm", stage_mm)):
            is_made = argument == "t_s" and facts.get("sample_rate_Hz") is not None
            if name is None and (is_made or argument not in frame.columns):
                continue
            name = argument if name is None else name
            if name not in frame.columns:
                there = ", ".join(map(str, list(frame.columns)[:12]))
                raise InputError(f"there is no column {name!r}; the table has {there}")
            columns[argument] = frame[name]
        return cls(**columns, **facts)

    @classmethod
    def read(
        cls,
        path: str | Path,
        output: str = "output",
        reference: str | None = None,
        time_s: str | None = None,
        stage_mm: str | None = None,
        **facts: Any,
    ) -> "Recording":
        """Read a CSV, Excel or Parquet file; its name without suffix is the serial unless `serial` is given.

        Raises:
            InputError: the file is no table, or lacks a column.
        """
        from softcal.app.files.recording_file import read_table

        try:
            return cls.from_frame(
                read_table(Path(path)), output, reference, time_s, stage_mm, **{"serial": Path(path).stem, **facts}
            )
        except InputError as error:
            raise InputError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from error

    def to_frame(self) -> "pd.DataFrame":
        """Return `t_s`, `output` and, where they are there, `stage_mm` and `reference`."""
        import pandas as pd

        return pd.DataFrame(self.unlabelled.arrays() if self.reference is None else self.labelled.arrays())


def recording_of(given: Any, name: str, **usual: Any) -> Recording:
    """Return a recording: as it is, out of a table with the columns of the contract, or out of the output alone.

    Args:
        given: a `Recording`, a DataFrame, or the output: (n,) array, list or Series.
        name: of the argument, for the message.
        usual: facts of `Recording` where the data state none; the rate counts where there is no column `t_s`.

    Raises:
        InputError: it is none of these.
    """
    if isinstance(given, Recording):
        return given
    if hasattr(given, "columns"):
        return Recording.from_frame(given, **usual | ({"sample_rate_Hz": None} if "t_s" in given.columns else {}))
    if isinstance(given, (str, bytes, dict)) or not hasattr(given, "__len__"):
        raise InputError(
            f"{name} is {_shown(given)}; a Recording, a DataFrame or the output itself was expected "
            "(Recording.read takes a file)"
        )
    return Recording(given, **usual)


def expect(name: str, value: Any, kind: Any, expected: str) -> None:
    """Refuse an argument of another type; a bool is no number."""
    if not isinstance(value, kind) or (kind is Real and isinstance(value, bool)):
        raise InputError(f"{name} is {_shown(value)}; {expected} was expected")


def _shown(value: Any) -> str:
    text = repr(value)
    return f"{text if len(text) <= 60 else text[:57] + '...'} ({type(value).__name__})"


def _numbers(name: str, values: Any) -> Array:
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} holds something that is no number ({error})") from error
