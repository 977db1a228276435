"""A lot folder: lot.toml, source/, units/, audit/, golden/ into core values."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from softcal.app.files.anchors import read_anchors
from softcal.app.files.lot_toml import NAME, LotToml, read_lot_toml
from softcal.app.files.recording_file import FileRecording, inspect_recording
from softcal.app.files.regular import read_regular
from softcal.app.files.unused_input import UnusedInput
from softcal.app.files.unused_parts import unused_of_lot
from softcal.app.tables.read import READERS
from softcal.core.errors import InputError
from softcal.core.lot import check_serial, row_name, serial_key
from softcal.core.maps.interface import Anchors
from softcal.core.messages.reason import Reason, reason
from softcal.core.recording import LabelledRecording, OutputRecording

ANCHOR_FILES = ("anchors.csv", "anchors.parquet")
"""Where a lot folder holds known loads of its units."""

FOLDER_OF = {"source": "source", "unit": "units", "audit": "audit"}
"""Kind of a recording → where it lies in a lot folder."""

GOLDEN = "golden"
"""Where the source's run in the units' sitting lies."""


@dataclass(frozen=True, kw_only=True)
class LotFolder(LotToml):
    """Content of a lot's `lot.toml`, and the paths of its recordings, which are read on request.

    Args:
        root: the folder; nothing outside it is read as a recording of a unit.
        audit_paths: labelled recordings of target units; no map is fitted to them.
        golden_path, golden_serial: the source pressed again in the units' sitting, or one of the units under the load
            cell; None without.
        anchors_path: known loads of units (`serial, output, reference`); None without.
        problems: why recordings of `unit_paths` are not used, by their row: no serial, or one that is given twice.
    """

    root: Path
    source_path: Path
    unit_paths: Mapping[str, Path]
    audit_paths: Mapping[str, Path]
    not_used: tuple[UnusedInput, ...] = ()
    golden_path: Path | None = None
    golden_serial: str = ""
    anchors_path: Path | None = None
    more_source_paths: Mapping[str, Path] = field(default_factory=dict)
    problems: Mapping[str, Reason] = field(default_factory=dict)

    def read_anchors(self) -> Mapping[str, Anchors]:
        """Return the known loads of the lot's units by serial; empty without any.

        Raises:
            InputError: the table cannot be read, or names a unit that the lot does not have.
        """
        return {} if self.anchors_path is None else read_anchors(self.anchors_path, self.unit_paths)

    def read_source(self) -> LabelledRecording:
        return self._labelled(self.source_path, self.lot.source)

    def inspect_sources(self) -> dict[str, FileRecording]:
        """Return the inspected recordings of the sources by serial, the lot's own source first."""
        paths = {self.lot.source: self.source_path, **self.more_source_paths}
        return {serial: self._inspect(path, serial) for serial, path in paths.items()}

    def source_remarks(self) -> list[str]:
        """Return the findings of the recordings of the sources, one line each with file and line."""
        return [f"{one.table.path.name}: {remark}" for one in self.inspect_sources().values() for remark in one.remarks]

    def check_name(self, row: str) -> None:
        """Raise `InputError` if a unit's file name is no serial, or the serial of another file."""
        if row in self.problems:
            raise InputError(self.problems[row])

    def read_unit(self, serial: str) -> OutputRecording:
        """Read a target unit's output; a reference column in its file is never looked at."""
        self.check_name(serial)
        return self._inspect(self.unit_paths[serial], serial, with_reference=False).recording

    def read_audit(self, serial: str) -> LabelledRecording | None:
        path = self.audit_paths.get(serial)
        return None if path is None else self._labelled(path, serial)

    def readable_audits(self) -> Iterator[LabelledRecording]:
        """Yield every readable audit; an unreadable audit is reported in its unit's result."""
        for serial, path in self.audit_paths.items():
            with suppress(InputError):
                yield self._labelled(path, serial)

    def read_golden(self) -> OutputRecording | LabelledRecording | None:
        """Return the golden run, with its reference if it has one."""
        if self.golden_path is None:
            return None
        golden = self._inspect(self.golden_path, self.golden_serial, with_reference=False)
        has_reference = self.names.reference in golden.table.names
        return self._labelled(self.golden_path, self.golden_serial) if has_reference else golden.recording

    def _labelled(self, path: Path, serial: str) -> LabelledRecording:
        return self._inspect(path, serial).labelled(self.lot.reference_unit)

    def _inspect(self, path: Path, serial: str, *, with_reference: bool = True) -> FileRecording:
        identity = (serial, self.lot.sample_rate_Hz, self.lot.output_unit, read_regular(path, self.root))
        return inspect_recording(path, *identity, self.names, with_reference=with_reference)


def open_lot_folder(folder: Path) -> LotFolder:
    """Read `lot.toml` and list the recordings.

    Raises:
        InputError: no such folder, no or a wrong `lot.toml`, no source recording, a serial given twice, or a golden run
            that is not of the source or one of the units.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such lot folder; make one with `softcal import`")
    lot_toml = read_lot_toml(folder)
    lot, more = lot_toml.lot, lot_toml.more_sources
    listings = {name: _recordings(folder / name) for name in ("source", "units", "audit", GOLDEN)}
    sources = listings["source"].usable
    for serial in (lot.source, *more):
        if problem := listings["source"].problems.get(serial):
            raise InputError(problem)
        if serial not in sources:
            names = ", ".join(sources) or "nothing"
            raise InputError(f"{folder / 'source'}: no recording of the source unit {serial!r}; found {names}")
    units, audits, problems = listings["units"].paths, listings["audit"].usable, listings["units"].problems
    remarks = [*lot_toml.remarks]
    absent = sorted(set(lot_toml.measured_at) - set(audits))
    remarks += [f"{NAME}: [audit] {serial}: audit/ has no such recording" for serial in absent]
    remarks += [line for name in ("source", "audit", GOLDEN) for line in listings[name].remarks(name)]
    golden = listings[GOLDEN].usable
    if len(golden) > 1 or set(golden) - {lot.source, *units}:
        raise InputError(
            f"{folder / GOLDEN}: golden run of {', '.join(sorted(golden)[:5])}; one run was expected, of the source "
            f"{lot.source} or of one of the units; nothing was fitted"
        )
    loads = next((path for path in map(folder.joinpath, ANCHOR_FILES) if path.is_file()), None)
    further, source = {serial: sources[serial] for serial in more}, sources[lot.source]
    golden_serial = next(iter(golden), "")
    not_used = unused_of_lot(folder, {lot.source: source, **further}, units)
    return LotFolder(
        **vars(lot_toml) | {"remarks": tuple(remarks)},
        root=folder,
        source_path=source,
        unit_paths=units,
        audit_paths=audits,
        not_used=not_used,
        golden_path=golden.get(golden_serial),
        golden_serial=golden_serial,
        anchors_path=loads,
        more_source_paths=further,
        problems=problems,
    )


@dataclass(frozen=True)
class _Listing:
    """Recordings of one folder by row of a report (their serial where they have one), and why some are not used."""

    paths: Mapping[str, Path]
    problems: Mapping[str, Reason]

    @property
    def usable(self) -> dict[str, Path]:
        return {row: path for row, path in self.paths.items() if row not in self.problems}

    def remarks(self, folder: str) -> tuple[str, ...]:
        return tuple(f"{folder}/{self.paths[row].name}: not used: {cause}" for row, cause in self.problems.items())


def _recordings(folder: Path) -> _Listing:
    paths: dict[str, Path] = {}
    problems: dict[str, Reason] = {}
    files: dict[str, list[tuple[str, str]]] = {}
    entries = sorted(folder.iterdir()) if folder.is_dir() else ()
    for path in (one for one in entries if one.suffix.lower() in READERS and not one.name.startswith(".")):
        try:
            row = check_serial(path.stem)
            files.setdefault(serial_key(row), []).append((row, path.name))
        except InputError as error:
            row = row_name(path.stem)
            problems[row] = error.reason
        paths[row] = path
    for entries_of_serial in files.values():
        names = ", ".join(row_name(name) for _, name in entries_of_serial)
        if len(entries_of_serial) > 1:
            problems |= {row: reason("name.twice", serial=repr(row), files=names) for row, _ in entries_of_serial}
    return _Listing(paths, problems)
