"""Plan of an import: columns, files, rows, the lot, and one imported unit."""

import fnmatch
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from softcal.app.files.recording_file import ColumnNames, FileRecording
from softcal.app.tables.options import DETECT, TableOptions
from softcal.app.tables.time_column import is_clock_heading, is_date_heading
from softcal.core.lot import Lot
from softcal.core.recording import Array, LabelledRecording, OutputRecording


@dataclass(frozen=True)
class Columns:
    """Column names of the tables.

    Args:
        output: the output column; with `*` or `?` many, each becomes a unit of that name. Brackets are those of a unit.
        time: name of the time column; None takes the one that a table has, else the sample rate makes the stamps.
        stage: column of the stage position in mm, None without; `stage_mm` may be missing.
    """

    output: str = "output"
    reference: str | None = None
    time: str | None = None
    stage: str | None = None

    @property
    def is_wide(self) -> bool:
        return any(c in self.output for c in "*?")

    def is_output(self, name: str) -> bool:
        """Whether a column of this name is an output."""
        # In `AIN0 [V]` the brackets hold a unit: to fnmatch they are a choice of letters.
        return fnmatch.fnmatchcase(name, self.output.replace("[", "[[]"))

    def is_requested(self, name: str) -> bool:
        """Whether a column of this name is needed; others are not read where possible."""
        if name in (self.reference, self.time, self.stage) or (
            is_clock_heading(name) if self.time is None else is_date_heading(name)
        ):
            return True
        return self.is_output(name)

    def names(self, output: str, table: TableOptions) -> ColumnNames:
        """Return the columns of one unit."""
        return ColumnNames(output, self.time, self.reference or "", self.stage, table=table)


@dataclass(frozen=True)
class ImportPlan:
    """Files to import and the lot to create.

    Args:
        lot: facts of the lot; stamps of a table must have its `sample_rate_Hz`, which makes them where it has none.
        audit: whether references of target units are kept in audit/: they decide.
        fit_rows, audit_rows: (start, stop) of data rows, counted from 0, for recordings that fit and that score;
            None takes all.
        table: the declared layout of the files.
        serials: serial of each file in order; None takes the file names.
        renames: name of a file or of a column of a wide table → serial.
    """

    files: Sequence[Path]
    columns: Columns
    lot: Lot
    audit: bool = False
    fit_rows: tuple[int, int] | None = None
    audit_rows: tuple[int, int] | None = None
    table: TableOptions = DETECT
    serials: Sequence[str] | None = None
    renames: Mapping[str, str] = field(default_factory=dict)
    without: frozenset[str] = frozenset()
    more_sources: Sequence[str] = ()

    @property
    def sources(self) -> tuple[str, ...]:
        """Serials of the units whose references train a network, the lot's own source first."""
        return (self.lot.source, *self.more_sources)


@dataclass(frozen=True, eq=False)
class ImportedUnit:
    """One unit as read from its file.

    Args:
        file: its output, and of a source its reference.
        audit: output and reference of a target where they are asked for; None where its table has no reference.
    """

    file: FileRecording
    audit: FileRecording | None = None

    @property
    def recording(self) -> OutputRecording:
        return self.file.recording

    @property
    def reference(self) -> Array | None:
        """Reference (n,) of the samples of `labelled`, or None."""
        return (self.audit or self.file).inspected.reference

    def labelled(self, reference_unit: str) -> LabelledRecording:
        """Return the recording with its reference."""
        return (self.audit or self.file).labelled(reference_unit)
