"""lot.toml: reading, writing, and changing of its parts."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from datetime import datetime
from pathlib import Path
from typing import get_type_hints

import tomlkit

from softcal.app.files.atomic import write_text
from softcal.app.files.measured_at import parse_instant
from softcal.app.files.recording_file import PLAIN, ColumnNames, prefix_errors
from softcal.app.files.toml_file import parse_value, read_toml
from softcal.app.tables.options import TableOptions
from softcal.core.errors import InputError
from softcal.core.lot import Lot, check_serial
from softcal.core.maps.catalogue import check_family
from softcal.core.unit.budget import SIMULATED, Reference
from softcal.core.unit.line_spread import LineSpread

NAME = "lot.toml"

REFERENCE_KEYS = {one.name for one in fields(Reference)} - {"is_simulated"}
"""What lot.toml says of the instrument behind the reference."""

COLUMN_KEYS = ("output", "reference", "time", "stage")
LAYOUT_KEYS = ("delimiter", "decimal", "encoding", "header_row", "sheet", "time_format")
"""Keys of [table] that name a column, and those that state its layout."""

VALID_KEYS = {
    "": {"sample_rate_Hz", "source"},
    "lot": {"id", "sensor_model", "sample_rate_Hz", "source", "more_sources", "simulated"},
    "reference": {"quantity", "unit", *REFERENCE_KEYS},
    "output": {"unit", "sample_rate_Hz", "source"},
    "limit": {"rmse"},
    "line": {"load_spread", "day_spread"},
    "map": {"family"},
    "audit": set(),
    "table": {*COLUMN_KEYS, *LAYOUT_KEYS, "missing"},
}
"""Keys of lot.toml by table; those of [audit] are serials. Two bare keys may stand where TOML puts what follows."""


@dataclass(frozen=True, kw_only=True)
class LotToml:
    """Content of `lot.toml`.

    Args:
        line: how differently the line presses units, where it states that.
        reference: what the source was compared with; None where it does not say.
        more_sources: serials of further sources.
        names: columns and layout of the recordings, where it states them.
        family: of every unit's map, or `auto`; None where it states none.
        measured_at: when audits were measured, UTC, where it states that.
        remarks: keys that nothing reads.
    """

    lot: Lot
    line: LineSpread | None = None
    reference: Reference | None = None
    more_sources: tuple[str, ...] = ()
    names: ColumnNames = PLAIN
    family: str | None = None
    measured_at: Mapping[str, datetime] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()


def read_lot_toml(folder: Path) -> LotToml:
    """Return the content of a folder's `lot.toml`.

    Raises:
        InputError: the file is missing or unreadable.
    """
    path = folder / NAME
    content = read_toml(path, "`softcal import` writes one", folder)
    with prefix_errors(path):
        tables = {name: content.get(name, {}) for name in VALID_KEYS if name}
        for name, table in tables.items():
            if not isinstance(table, dict):
                raise InputError(f"[{name}] must be a table")
        names = {"load_spread": "load", "day_spread": "day"}
        spreads = {
            names[key]: parse_value(f"[line] {key}", float, tables["line"][key])
            for key in names
            if key in tables["line"]
        }
        line, reference = LineSpread(**spreads) if spreads else None, None
        is_simulated = tables["lot"].get("simulated", False)
        if not isinstance(is_simulated, bool):
            raise InputError(f"[lot] simulated is {is_simulated!r}; true or false was expected")
        hints, declared_keys = get_type_hints(Reference), tables["reference"].keys() & REFERENCE_KEYS
        if is_simulated:
            reference = SIMULATED
        elif declared_keys:
            declared = {key: value for key, value in tables["reference"].items() if key in declared_keys}
            reference = Reference(
                **{key: parse_value(f"[reference] {key}", hints[key], v) for key, v in declared.items()}
            )
        sections = content, tables["lot"], tables["output"]
        limit, family = tables["limit"].get("rmse"), tables["map"].get("family")
        lot = Lot(
            id=parse_value("[lot] id", str, tables["lot"].get("id")),
            source=parse_value("source", str, _require_single(sections, "source")),
            sample_rate_Hz=parse_value("sample_rate_Hz", float, _require_single(sections, "sample_rate_Hz")),
            sensor_model=str(tables["lot"].get("sensor_model", "")),
            reference_quantity=str(tables["reference"].get("quantity", "force")),
            reference_unit=str(tables["reference"].get("unit", "N")),
            output_unit=str(tables["output"].get("unit", "V")),
            limit_rmse=None if limit is None else parse_value("[limit] rmse", float, limit),
        )
        more = tables["lot"].get("more_sources", [])
        if not isinstance(more, list) or not all(isinstance(serial, str) for serial in more):
            raise InputError(f"[lot] more_sources is {more!r}; a list of serials was expected")
        serials = tuple(map(check_serial, more))
        if len({lot.source, *serials}) <= len(serials):
            raise InputError(f"[lot] more_sources is {more!r}; each source once, and {lot.source!r} is the first")
        return LotToml(
            lot=lot,
            line=line,
            reference=reference,
            more_sources=serials,
            names=_column_names(tables["table"], lot.sample_rate_Hz),
            family=None if family is None else check_family(parse_value("[map] family", str, family)),
            measured_at={check_serial(s): parse_instant(f"[audit] {s}", str(at)) for s, at in tables["audit"].items()},
            remarks=tuple(_unknown_keys(path, content)),
        )


def _column_names(declared: Mapping[str, object], rate_Hz: float) -> ColumnNames:
    """Return the columns and the layout that [table] states; the lot's rate makes stamps that such files lack."""
    if not declared:
        return PLAIN
    names = {key: parse_value(f"[table] {key}", str, declared[key]) for key in COLUMN_KEYS if key in declared}
    hints = get_type_hints(TableOptions)
    layout = {key: parse_value(f"[table] {key}", hints[key], declared[key]) for key in LAYOUT_KEYS if key in declared}
    if "missing" in declared:
        missing = declared["missing"] if isinstance(declared["missing"], list) else [declared["missing"]]
        layout["missing"] = tuple(str(text) for text in missing)
    return replace(PLAIN, **names, rate_Hz=rate_Hz, table=TableOptions(**layout))


def _require_single(sections: tuple[Mapping[str, object], ...], key: str) -> object:
    values = [section[key] for section in sections if key in section]
    if len(set(map(str, values))) > 1:
        raise InputError(f"{key} is given more than once, with different values")
    if not values:
        raise InputError(f"{key} is missing")
    return values[0]


def _unknown_keys(path: Path, content: Mapping[str, object]) -> Iterator[str]:
    for key, value in content.items():
        if key == "audit":
            continue
        if key in VALID_KEYS and isinstance(value, dict):
            unknown = sorted(set(value) - VALID_KEYS[key])
            if unknown:
                yield f"{path}: [{key}] {', '.join(unknown)} not used; known: {', '.join(sorted(VALID_KEYS[key]))}"
        elif key not in VALID_KEYS[""]:
            yield f"{path}: {key} not used; known: {', '.join(sorted(set(VALID_KEYS) - {''}))}, sample_rate_Hz, source"


def write_lot_toml(
    folder: Path,
    lot: Lot,
    reference: Reference | None = None,
    more_sources: Sequence[str] = (),
    measured_at: Mapping[str, datetime] | None = None,
) -> None:
    """Write `lot.toml`, with what its source was compared with, further sources, and when audits were measured."""
    document = tomlkit.document()
    document["sample_rate_Hz"] = lot.sample_rate_Hz
    document["source"] = lot.source
    simulated = {"simulated": True} if reference is not None and reference.is_simulated else {}
    more = {"more_sources": list(more_sources)} if more_sources else {}
    document["lot"] = {"id": lot.id, "sensor_model": lot.sensor_model, **more, **simulated}
    document["reference"] = {
        "quantity": lot.reference_quantity,
        "unit": lot.reference_unit,
        **_reference_table(reference),
    }
    document["output"] = {"unit": lot.output_unit}
    if lot.limit_rmse is not None:
        document["limit"] = {"rmse": lot.limit_rmse}
    if measured_at:
        document["audit"] = dict(measured_at)
    write_text(folder / NAME, tomlkit.dumps(document))


@contextmanager
def _edit_document(folder: Path) -> Iterator[tomlkit.TOMLDocument]:
    """Yield the document of `lot.toml` for changes, then write it; comments and other keys stay."""
    path = folder / NAME
    document = tomlkit.parse(path.read_text(encoding="utf-8"))
    yield document
    write_text(path, tomlkit.dumps(document))


def update_limit(folder: Path, rmse: float) -> None:
    """Write a limit into `lot.toml`, in the reference's unit."""
    with _edit_document(folder) as document:
        document["limit"] = {"rmse": rmse}


def update_measured_at(folder: Path, measured_at: Mapping[str, datetime | None]) -> None:
    """Write the times of audits into `lot.toml`, UTC; None removes the stated time of an older one."""
    with _edit_document(folder) as document:
        instants = {**document.get("audit", {}), **measured_at}
        if instants := {serial: at for serial, at in instants.items() if at is not None}:
            document["audit"] = instants
        else:
            document.pop("audit", None)


def update_reference(folder: Path, reference: Reference | None) -> None:
    """Write the present reference of the source into `lot.toml`."""
    if declared := _reference_table(reference):
        with _edit_document(folder) as document:
            document.setdefault("reference", tomlkit.table()).update(declared)


def _reference_table(reference: Reference | None) -> dict[str, object]:
    if reference is None or reference.is_simulated:
        return {}
    default = vars(Reference())
    return {name: value for name, value in vars(reference).items() if value != default[name]}
