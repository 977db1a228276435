"""Inspection of a table for `softcal inspect`: layout, time, and findings of the recording."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from softcal.app.files.recording_file import ColumnNames, FileRecording, inspect_recording
from softcal.app.tables.read import read_table
from softcal.core.inspection.comparison import compare_recordings
from softcal.core.inspection.inspection import InspectionFinding
from softcal.core.inspection.reasons import finding_reason
from softcal.core.messages.reason import Reason
from softcal.core.unit.findings import contradictions
from softcal.core.unit.health import output_limits
from softcal.core.unit.method import Method

FINDINGS_HEADER = ("line", "t_s", "column", "finding", "value", "times or share", "rows", "what it shows")


def inspect_file(path: Path, names: ColumnNames, reference: str | None) -> FileRecording:
    """Read and inspect the table of one recording, whatever its findings.

    Args:
        reference: name of the column of the reference; None takes `reference` where the table has one.

    Raises:
        InputError: it is no table, lacks a column, or its time goes back.
    """
    is_requested = partial(names.is_requested, with_reference=True)
    has_reference = names.reference in read_table(path, names.table, is_requested=is_requested).names
    if reference is not None:
        names = replace(names, reference=reference)
    with_reference = has_reference or reference is not None
    return inspect_recording(path, "unit", None, names=names, with_reference=with_reference)


def summary_rows(file: FileRecording) -> list[tuple[str, object]]:
    """Return the inspection of a table as rows of name and value."""
    recording, inspection = file.recording, file.inspected.inspection
    masked = ", ".join(f"{count} {kind.replace('_', ' ')}" for kind, count in inspection.masked.counts.items())
    ranges = [(f"range of {name}", _range(file, name)) for name in file.columns if name != "t_s"]
    return [
        ("layout", file.table.layout or "plain"),
        ("columns", ", ".join(file.table.names)),
        ("rows", inspection.samples),
        ("rate", f"{recording.sample_rate_Hz:.6g} Hz"),
        ("time", f"{recording.t_s[0]:.6g} to {recording.t_s[-1]:.6g} s"),
        *ranges,
        ("gaps", _gaps(inspection.of_kind("gap"))),
        ("pauses", _gaps(inspection.of_kind("pause"), "at rest")),
        ("left out", masked or "none"),
        ("rows that fill a window", f"{inspection.window_share:.1%}"),
    ]


def finding_rows(file: FileRecording) -> list[tuple[object, ...]]:
    """Return the findings as rows under `FINDINGS_HEADER`."""
    return [tuple(values.values()) for values in _findings(file)]


def compare_files(source: FileRecording, file: FileRecording) -> list[str]:
    """Return findings of a recording relative to the source: unit of measure, sign, level of its output.

    Raises:
        InputError: the source has no reference, or its reference can label nothing.
    """
    labelled_source = source.labelled("N")
    method, output = Method(), file.recording
    limits = output_limits(output, labelled_source.unlabelled, labelled_source.direction > 0, method)
    reasons: list[Reason] = [one.reason for one in contradictions(labelled_source.unlabelled, output, limits, method)]
    if file.inspected.reference is not None:
        reasons += compare_recordings(labelled_source, file.labelled("N"))
    return list(map(str, reasons))


def inspection_json(file: FileRecording, source_remarks: Sequence[str] = ()) -> dict[str, object]:
    """Return the inspection of a table as the JSON of `softcal inspect --json` (schema `softcal.inspection/1`).

    Args:
        source_remarks: findings relative to the source's recording.
    """
    inspection = file.inspected.inspection
    return {
        "schema": "softcal.inspection/1",
        "file": str(file.table.path),
        "layout": file.table.layout,
        "columns": list(file.table.names),
        "remarks": list(file.reading_remarks),
        "rows": inspection.samples,
        "sample_rate_Hz": file.recording.sample_rate_Hz,
        "masked": inspection.masked.counts,
        "window_share": inspection.window_share,
        "findings": _findings(file),
        "beside_source": list(source_remarks),
    }


def _findings(file: FileRecording) -> list[dict[str, object]]:
    lines = file.lines
    return [
        {
            "line": int(lines[one.start]),
            "time_s": one.time_s,
            "column": one.column,
            "kind": one.kind,
            "value": _number(one.value),
            "amount": _number(one.amount),
            "rows": one.stop - one.start,
            "text": str(finding_reason(one, lines)),
        }
        for one in file.inspected.inspection.findings
    ]


def _number(value: float) -> float | str | None:
    """Return a number for JSON; None for an empty cell."""
    if np.isnan(value):
        return None
    return value if np.isfinite(value) else str(value)


def _range(file: FileRecording, name: str) -> str:
    values = file.columns[name][file.rows]
    return f"{values.min():.6g} to {values.max():.6g}"


def _gaps(gaps: tuple[InspectionFinding, ...], description: str = "") -> str:
    missing = sum(gap.amount for gap in gaps)
    longest = max((gap.value for gap in gaps), default=0.0)
    description = description or f"samples missing {missing:.0f}"
    return f"{len(gaps)}, longest {longest:.2f} s, {description}" if gaps else "none"
