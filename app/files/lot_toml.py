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
from softcal.app.files.recording_file import PLAIN, ColumnNames, naming
from softcal.app.files.toml_file import read_toml, typed
from softcal.app.tables.options import TableOptions
from softcal.core.errors import InputError
from softcal.core.lot import Lot, check_serial
from softcal.core.maps.catalogue import check_family
from softcal.core.unit.budget import SIMULATED, Reference
from softcal.core.unit.line_spread import LineSpread

NAME = "lot.toml"

STATED = {one.name for one in fields(Reference)} - {"is_simulated"}
"""What lot.toml says of the instrument behind the reference."""

COLUMN_KEYS = ("output", "reference", "time", "stage")
LAYOUT_KEYS = ("delimiter", "decimal", "encoding", "header_row", "sheet", "time_format")
"""Keys of [table] that name a column, and those that state its layout."""

KNOWN_KEYS = {
    "": {"sample_rate_Hz", "source"},
    "lot": {"id", "sensor_model", "sample_rate_Hz", "source", "more_sources", "simulated"},
    "reference": {"quantity", "unit", *STATED},
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
    with naming(path):
        tables = {name: content.get(name, {}) for name in KNOWN_KEYS if name}
        for name, table in tables.items():
            if not isinstance(table, dict):
                raise InputError(f"[{name}] must be a table")
        names = {"load_spread": "load", "day_spread": "day"}
        spreads = {
            names[key]: typed(f"[line] {key}", float, tables["line"][key]) for key in names if key in tables["line"]
        }
        line, reference = LineSpread(**spreads) if spreads else None, None
        is_simulated = tables["lot"].get("simulated", False)
        if not isinstance(is_simulated, bool):
            raise InputError(f"[lot] simulated is {is_simulated!r}; true or false was expected")
        hints, stated = get_type_hints(Reference), tables["reference"].keys() & STATED
        if is_simulated:
            reference = SIMULATED
        elif stated:
            facts = {key: value for key, value in tables["reference"].items() if key in stated}
            reference = Reference(**{key: typed(f"[reference] {key}", hints[key], v) for key, v in facts.items()})
        places = content, tables["lot"], tables["output"]
        limit, family = tables["limit"].get("rmse"), tables["map"].get("family")
        lot = Lot(
            id=typed("[lot] id", str, tables["lot"].get("id")),
            source=typed("source", str, _only(places, "source")),
            sample_rate_Hz=typed("sample_rate_Hz", float, _only(places, "sample_rate_Hz")),
            sensor_model=str(tables["lot"].get("sensor_model", "")),
            reference_quantity=str(tables["reference"].get("quantity", "force")),
            reference_unit=str(tables["reference"].get("unit", "N")),
            output_unit=str(tables["output"].get("unit", "V")),
            limit_rmse=None if limit is None else typed("[limit] rmse", float, limit),
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
            family=None if family is None else check_family(typed("[map] family", str, family)),
            measured_at={check_serial(s): parse_instant(f"[audit] {s}", str(at)) for s, at in tables["audit"].items()},
            remarks=tuple(_unknown_keys(path, content)),
        )


def _column_names(stated: Mapping[str, object], rate_Hz: float) -> ColumnNames:
    """Return the columns and the layout that [table] states; the lot's rate makes stamps that such files lack."""
    if not stated:
        return PLAIN
    names = {key: typed(f"[table] {key}", str, stated[key]) for key in COLUMN_KEYS if key in stated}
    hints = get_type_hints(TableOptions)
    layout = {key: typed(f"[table] {key}", hints[key], stated[key]) for key in LAYOUT_KEYS if key in stated}
    if "missing" in stated:
        missing = stated["missing"] if isinstance(stated["missing"], list) else [stated["missing"]]
        layout["missing"] = tuple(str(text) for text in missing)
    return replace(PLAIN, **names, rate_Hz=rate_Hz, table=TableOptions(**layout))


def _only(places: tuple[Mapping[str, object], ...], key: str) -> object:
    given = [place[key] for place in places if key in place]
    if len(set(map(str, given))) > 1:
        raise InputError(f"{key} is given more than once, with different values")
    if not given:
        raise InputError(f"{key} is missing")
    return given[0]


def _unknown_keys(path: Path, content: Mapping[str, object]) -> Iterator[str]:
    for key, value in content.items():
        if key == "audit":
            continue
        if key in KNOWN_KEYS and isinstance(value, dict):
            unknown = sorted(set(value) - KNOWN_KEYS[key])
            if unknown:
                yield f"{path}: [{key}] {', '.join(unknown)} not used; known: {', '.join(sorted(KNOWN_KEYS[key]))}"
        elif key not in KNOWN_KEYS[""]:
            yield f"{path}: {key} not used; known: {', '.join(sorted(set(KNOWN_KEYS) - {''}))}, sample_rate_Hz, source"


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
    document["reference"] = {"quantity": lot.reference_quantity, "unit": lot.reference_unit, **_stated(reference)}
    document["output"] = {"unit": lot.output_unit}
    if lot.limit_rmse is not None:
        document["limit"] = {"rmse": lot.limit_rmse}
    if measured_at:
        document["audit"] = dict(measured_at)
    write_text(folder / NAME, tomlkit.dumps(document))


@contextmanager
def _opened(folder: Path) -> Iterator[tomlkit.TOMLDocument]:
    """Yield the document of `lot.toml` for changes, then write it; comments and other keys stay."""
    path = folder / NAME
    document = tomlkit.parse(path.read_text(encoding="utf-8"))
    yield document
    write_text(path, tomlkit.dumps(document))


def restate_limit(folder: Path, rmse: float) -> None:
    """Write a limit into `lot.toml`, in the reference's unit."""
    with _opened(folder) as document:
        document["limit"] = {"rmse": rmse}


def restate_measured_at(folder: Path, measured_at: Mapping[str, datetime | None]) -> None:
    """Write the times of audits into `lot.toml`, UTC; None removes the stated time of an older one."""
    with _opened(folder) as document:
        stated = {**document.get("audit", {}), **measured_at}
        if stated := {serial: at for serial, at in stated.items() if at is not None}:
            document["audit"] = stated
        else:
            document.pop("audit", None)


def restate_reference(folder: Path, reference: Reference | None) -> None:
    """Write the present reference of the source into `lot.toml`."""
    if stated := _stated(reference):
        with _opened(folder) as document:
            document.setdefault("reference", tomlkit.table()).update(stated)


def _stated(reference: Reference | None) -> dict[str, object]:
    if reference is None or reference.is_simulated:
        return {}
    default = vars(Reference())
    return {name: value for name, value in vars(reference).items() if value != default[name]}
