"""A recording as Python users hold it: from arrays, pandas or a file, with or without a reference."""

from collections.abc import Hashable
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from softcal.app.api.arguments import (
    check_indexes,
    column,
    expect,
    file_path,
    first_instant,
    frame_column,
    has_dates,
    number,
    show_value,
    text,
    times,
    times_of_index,
)
from softcal.app.api.display import html_table, plotting
from softcal.app.files.measured_at import parse_instant
from softcal.app.tables.time_unit import find_seconds_problem
from softcal.app.tables.timestamps import median_rate_Hz
from softcal.core.errors import InputError
from softcal.core.inspection.build import InspectedRecording, build_recording
from softcal.core.inspection.inspection import Inspection
from softcal.core.inspection.reasons import summarise
from softcal.core.lot import check_serial
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.unit.method import Method

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

COLUMNS = ("t_s", "output", "stage_mm", "reference")
RATE = "a positive number of samples a second"


def check_rate(sample_rate_Hz: Any) -> float:
    """Return a sample rate as a float, `InputError` where it is no positive number."""
    rate_Hz = number("sample_rate_Hz", sample_rate_Hz, RATE)
    if rate_Hz <= 0:
        raise InputError(f"sample_rate_Hz is {show_value(sample_rate_Hz)}; {RATE} was expected")
    return rate_Hz


def _rate_of(stamps: Any, t_s: Array) -> float:
    """Return the sample rate that time stamps show, where they can be seconds."""
    steps = np.diff(t_s)
    if not np.any(steps > 0) or np.median(steps) < 0:
        raise InputError("t_s goes back or stands still; sort the rows by it, or leave it out and give sample_rate_Hz")
    if not has_dates("t_s", stamps) and (problem := find_seconds_problem(t_s, float(np.median(steps[steps > 0])))):
        raise InputError(f"t_s {problem}? give it in s, or confirm it with sample_rate_Hz={median_rate_Hz(t_s):g}")
    return median_rate_Hz(t_s)


@dataclass(frozen=True, eq=False, repr=False)
class Recording:
    """The output of one unit over time, and the reference beside it where one was read.

    Arrays are copied: what becomes of the caller's arrays later changes no recording. NaN, None and NA are missing
    samples: no fit sees them, and `inspection` counts them. `recording[0:800]` is a stretch of it.

    >>> import softcal
    >>> recording = softcal.Recording([0.50, 0.52, 0.55] * 10, sample_rate_Hz=50, serial="S2")
    >>> recording
    <Recording S2: 30 samples at 50 Hz (0.6 s), output in V>
    >>> len(recording[0:20])
    20

    Args:
        output: (n,) sensor output in `output_unit`: a list, an array or a pandas Series.
        reference: (n,) load in `reference_unit` read at the same instants; None for a unit that was only pressed.
        sample_rate_Hz: samples a second; by default what the time stamps show, and checked against them.
        t_s: (n,) time stamps, strictly increasing: seconds, or dates or durations of Python, NumPy or pandas, which
            become seconds. By default the output's DatetimeIndex or TimedeltaIndex, else made from `sample_rate_Hz`.
        serial: name of the unit: letters, digits, dot, dash and underscore.
        output_unit, reference_unit: physical units.
        stage_mm: (n,) stage position in mm, positive when it compresses, where the station knows it. Source and units
            that carry it are compared at equal stage histories.
        lines: (n,) line of its file of each sample, which remarks then name; `read` sets them.
        measured_at: when its first sample was taken: an ISO date or date and time, or a datetime; without a zone it is
            local time. By default the first stamp, where stamps are dates. Of an audit it says whether a draw came
            first.

    Raises:
        InputError: lengths differ, a value is no number, time goes back, or neither rate nor time is given.
    """

    output: Any
    reference: Any = None
    sample_rate_Hz: Any = None
    t_s: Any = None
    serial: str = "unit"
    output_unit: str = "V"
    reference_unit: str = "N"
    stage_mm: Any = None
    lines: Any = None
    measured_at: Any = None

    def __post_init__(self) -> None:
        # Whatever is wrong with it is reported here, not at the first use.
        attributes: dict[str, Any] = {name: text(name, getattr(self, name)) for name in _TEXTS}
        check_serial(attributes["serial"])
        check_indexes({name: getattr(self, name) for name in ("output", *_OPTIONAL_COLUMNS)})
        attributes["output"] = column("output", self.output)
        for name in _OPTIONAL_COLUMNS:
            if (values := getattr(self, name)) is not None:
                attributes[name] = column(name, values)
        rate_Hz = None if self.sample_rate_Hz is None else check_rate(self.sample_rate_Hz)
        stamps = self.t_s if self.t_s is not None else times_of_index(self.output)
        if stamps is not None:
            attributes["t_s"] = times("t_s", stamps)
            if rate_Hz is None:
                rate_Hz = _rate_of(stamps, attributes["t_s"])
        elif rate_Hz is not None:
            attributes["t_s"] = np.arange(len(attributes["output"])) / rate_Hz
        if isinstance(self.measured_at, str):
            attributes["measured_at"] = parse_instant("measured_at", self.measured_at)
        elif self.measured_at is not None:
            expect("measured_at", self.measured_at, datetime, "an ISO date or date and time, or a datetime,")
            attributes["measured_at"] = self.measured_at.astimezone(UTC)
        elif stamps is not None:
            attributes["measured_at"] = first_instant("t_s", stamps)
        if rate_Hz is None:
            raise InputError("neither sample_rate_Hz nor t_s says when samples were taken; give one of them")
        attributes["sample_rate_Hz"] = rate_Hz
        if self.lines is not None:
            attributes["lines"] = column("lines", self.lines).astype(np.int64)
        for name, value in attributes.items():
            object.__setattr__(self, name, value)
        _ = self.labelled if self.reference is not None else self.unlabelled

    def __len__(self) -> int:
        return len(self.output)

    # Without this, Python would call `recording[0]`, `recording[1]` ...
    __iter__ = None

    def __repr__(self) -> str:
        parts = [f"{len(self)} samples at {self.sample_rate_Hz:g} Hz ({self.duration_s:.4g} s)"]
        parts.append(f"output in {self.output_unit}")
        if self.reference is not None:
            parts.append(f"reference in {self.reference_unit}")
        if masked := len(self.inspection.masked):
            parts.append(f"{masked} masked")
        return f"<Recording {self.serial}: {', '.join(parts)}>"

    def _repr_html_(self) -> str:
        columns = {"output": (self.output, self.output_unit), "reference": (self.reference, self.reference_unit)}
        rows = [
            (name, f"{np.nanmin(values):.4g} to {np.nanmax(values):.4g} {unit}")
            for name, (values, unit) in columns.items()
            if values is not None
        ]
        span = f"{len(self)} at {self.sample_rate_Hz:g} Hz, {self.duration_s:.4g} s"
        remarks = [("", remark) for remark in self.remarks]
        return html_table(f"Recording {self.serial}", [("samples", span), *rows, *remarks])

    def __getitem__(self, rows: slice) -> "Recording":
        """Return a stretch of samples, `recording[0:800]`.

        Raises:
            InputError: it is no slice, leaves samples out, or is too short for a window.
        """
        if not isinstance(rows, slice):
            raise InputError(
                f"recording[{show_value(rows)}]: a slice was expected, recording[0:800], or between(2.0, 10.0)"
            )
        try:
            start, stop, step = rows.indices(len(self))
        except TypeError as error:
            raise InputError(
                f"recording[...] with {show_value(rows)}: samples are whole numbers; between(2.0, 10.0) takes seconds"
            ) from error
        if step != 1:
            raise InputError(f"a step of {step} would change the sample rate or the direction of time; leave it out")
        stop = max(start, stop)
        columns: dict[str, Any] = {name: values[start:stop] for name, values in self._columns.items()}
        columns["lines"] = None if self.lines is None else self.lines[start:stop]
        if self.measured_at is not None and start < stop:
            columns["measured_at"] = self.measured_at + timedelta(seconds=float(self.t_s[start] - self.t_s[0]))
        return replace(self, **columns)

    def between(self, start_s: float, stop_s: float) -> "Recording":
        """Return the stretch between two time stamps in s, both included.

        >>> import softcal
        >>> recording = softcal.Recording([0.50, 0.52, 0.55] * 10, sample_rate_Hz=50)
        >>> recording.between(0.1, 0.5)
        <Recording unit: 21 samples at 50 Hz (0.42 s), output in V>

        Raises:
            InputError: no number, or too few samples between them.
        """
        bounds = number("start_s", start_s, "a time in s"), number("stop_s", stop_s, "a time in s")
        start, stop = np.searchsorted(self.t_s, bounds[0]), np.searchsorted(self.t_s, bounds[1], side="right")
        if stop <= start:
            raise InputError(
                f"there is no sample between {bounds[0]:g} s and {bounds[1]:g} s; the recording is from "
                f"{self.t_s[0]:g} s to {self.t_s[-1]:g} s"
            )
        return self[int(start) : int(stop)]

    @property
    def duration_s(self) -> float:
        """Time that its samples take, without the gaps between them."""
        return len(self) / float(self.sample_rate_Hz)

    @property
    def _columns(self) -> dict[str, Array]:
        columns = {name: getattr(self, name) for name in COLUMNS}
        return {name: values for name, values in columns.items() if values is not None}

    @cached_property
    def _inspected(self) -> InspectedRecording:
        # Without the reference: what a fit of a map takes must not depend on it.
        return self._inspect(None)

    @cached_property
    def _inspected_labels(self) -> InspectedRecording:
        return self._inspect(self.reference)

    def _inspect(self, reference: Array | None) -> InspectedRecording:
        return build_recording(
            self.serial,
            self.t_s,
            self.output,
            sample_rate_Hz=self.sample_rate_Hz,
            output_unit=self.output_unit,
            stage_mm=self.stage_mm,
            reference=reference,
            lines=self.lines,
            config=Method().inspection,
        )

    @property
    def inspection(self) -> Inspection:
        """What a look at its samples shows: how many are masked, and the findings.

        >>> import softcal
        >>> softcal.Recording([0.50, 0.52, None] * 10, sample_rate_Hz=50).inspection.masked.counts
        {'missing': 10}
        """
        return (self._inspected if self.reference is None else self._inspected_labels).inspection

    @property
    def remarks(self) -> list[str]:
        """What a look at its samples shows, in sentences: missing and impossible samples, gaps, steps.

        >>> import softcal
        >>> softcal.Recording([0.50, 0.52, 0.55] * 10, sample_rate_Hz=50).remarks
        []
        """
        return [str(remark) for remark in summarise(self.inspection, self.lines)]

    @property
    def rows(self) -> Any:
        """(m,) rows of the valid samples of its output: those that a map and an estimate see."""
        return self._inspected.rows

    @property
    def unlabelled(self) -> OutputRecording:
        """The output alone: what every fit of a map takes."""
        return self._inspected.recording

    @cached_property
    def labelled(self) -> LabelledRecording:
        """Output and reference: what trains f, and what an error is measured on.

        Raises:
            InputError: the recording has no reference.
        """
        if self.reference is None:
            raise InputError(
                f"recording {self.serial} has no reference: softcal.Recording(..., reference=...) takes it"
            )
        inspected = self._inspected_labels
        return LabelledRecording(inspected.recording, self.reference[inspected.rows], self.reference_unit)

    @classmethod
    def from_frame(
        cls,
        frame: "pd.DataFrame",
        output: Hashable = "output",
        reference: Hashable | None = None,
        time_s: Hashable | None = None,
        stage_mm: Hashable | None = None,
        **extra: Any,
    ) -> "Recording":
        """Take columns of a table.

        >>> import pandas as pd, softcal
        >>> table = pd.DataFrame({"V": [0.50, 0.52, 0.55] * 10, "F": [0.0, 1.0, 2.0] * 10})
        >>> softcal.Recording.from_frame(table, output="V", reference="F", sample_rate_Hz=50, serial="S1")
        <Recording S1: 30 samples at 50 Hz (0.6 s), output in V, reference in N>

        Args:
            frame: one row a sample.
            output, reference, time_s, stage_mm: names of the columns; None takes `reference`, `t_s` and `stage_mm`
                where there are such. Time is in seconds, or of dates or durations; without such a column it is that of
                a DatetimeIndex or TimedeltaIndex, or made from `sample_rate_Hz`.
            extra: the other arguments of `Recording`.

        Raises:
            InputError: there is no column of that name, or several; the message lists those there are.
        """
        if not hasattr(frame, "columns"):
            raise InputError(f"frame is {show_value(frame)}; a pandas DataFrame was expected")
        columns: dict[str, Any] = {}
        for option, name in (("output", output), ("reference", reference), ("time_s", time_s), ("stage_mm", stage_mm)):
            argument = "t_s" if option == "time_s" else option
            if name is not None or argument in frame.columns:
                columns[argument] = frame_column(frame, option, argument if name is None else name)
        return cls(**columns, **extra)

    @classmethod
    def read(
        cls,
        path: str | Path,
        output: str = "output",
        reference: str | None = None,
        time_s: str | None = None,
        stage_mm: str | None = None,
        **extra: Any,
    ) -> "Recording":
        """Read a file with a table; its name without suffix is the serial unless `serial` is given.

        >>> import pathlib, tempfile, softcal
        >>> path = pathlib.Path(tempfile.mkdtemp(), "S2.csv")
        >>> _ = path.write_text("output_V\\n" + "0.50\\n0.52\\n0.55\\n" * 10)
        >>> softcal.Recording.read(path, output="output_V", sample_rate_Hz=50)
        <Recording S2: 30 samples at 50 Hz (0.6 s), output in V>

        Args:
            path: a table as loggers and laboratories write it.
            output, reference, time_s, stage_mm: as of `from_frame`; without a name the time is found by its heading.
            extra: the other arguments of `Recording`, and of the table's layout where it is not detected: `delimiter`,
                `decimal`, `encoding`, `header_row`, `sheet`, `time_format`, `missing`.

        Raises:
            InputError: the file is no table, or lacks a column.
        """
        from softcal.app.files.recording_file import STAGE, ColumnNames, prefix_errors, read_columns
        from softcal.app.tables.options import TableOptions
        from softcal.app.tables.read import column_names

        file = file_path("path", path)
        layout = {name: extra.pop(name) for name in TableOptions.__dataclass_fields__ if name in extra}
        table = TableOptions(**layout)
        # Without a name it is read where there is one.
        has_reference = reference is not None or "reference" in column_names(file, table)
        rate_Hz = extra.get("sample_rate_Hz")
        rate_Hz = None if rate_Hz is None else number("sample_rate_Hz", rate_Hz, RATE)
        names = ColumnNames(output, time_s, reference or "reference", stage_mm or STAGE, rate_Hz, table)
        columns, start = read_columns(file, names, with_reference=has_reference)
        extra = {"measured_at": None if start is None else start.at, **extra}
        with prefix_errors(file):
            return cls(**{"serial": file.stem, **extra, **columns})

    def to_frame(self) -> "pd.DataFrame":
        """Return `t_s`, `output` and, where they are there, `stage_mm` and `reference`; NaN where a value is missing.

        >>> import softcal
        >>> softcal.Recording([0.50, 0.52, 0.55] * 10, sample_rate_Hz=50).to_frame().head(2)
            t_s  output
        0  0.00    0.50
        1  0.02    0.52
        """
        import pandas as pd

        return pd.DataFrame(self._columns)

    def plot(self) -> "go.Figure":  # noqa: V105
        """Draw output and reference over time as a Plotly figure; missing samples are gaps.

        >>> import softcal
        >>> figure = softcal.Recording([0.50, 0.52, 0.55] * 10, sample_rate_Hz=50).plot()
        >>> figure.layout.yaxis.title.text
        'output [V]'

        Raises:
            ModuleNotFoundError: plotly is not installed; the line names the extra that brings it.
        """
        with plotting("Recording.plot"):
            from softcal.app.api.figures import draw_recording

        series = [(f"output [{self.output_unit}]", self.output)]
        if self.reference is not None:
            series.append((f"reference [{self.reference_unit}]", self.reference))
        return draw_recording(f"Recording {self.serial}", self.t_s, series)


_TEXTS = ("serial", "output_unit", "reference_unit")
_OPTIONAL_COLUMNS = ("reference", "stage_mm")
