"""TOML files that people write, into dataclasses; errors name file, section and key."""

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, fields
from datetime import date
from difflib import get_close_matches
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from softcal.app.files.regular import read_regular
from softcal.core.errors import InputError

Section = TypeVar("Section")

MAX_BYTES = 1_000_000
"""What people write by hand has some ten lines."""

TYPE_LABELS = {int: "a whole number", float: "a number", date: "a date such as 2026-01-31"}


def read_toml(path: Path, hint: str = "", folder: Path | None = None) -> dict[str, Any]:
    """Return the tables of a file; a link is followed inside `folder` only, everywhere without one.
    The hint says what to do where there is no such file.

    Raises:
        InputError: it cannot be read, or is no TOML.
    """
    if not path.exists():
        raise InputError(f"{path}: there is no such file{hint and f'; {hint}'}")
    try:
        return tomllib.loads(read_regular(path, folder or path.resolve().parent, MAX_BYTES).decode())
    # A thousand brackets inside one another are no table of anybody's.
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{path}: not valid TOML: {error}") from error


def read_section(where: str, kind: type[Section], table: object, folder: Path = Path()) -> Section:
    """Return a dataclass from a table of its fields; `where` is file and section, for errors.

    Raises:
        InputError: no table, a key unknown or missing, or a value not what its field holds.
    """
    if not isinstance(table, Mapping):
        raise InputError(f"{where}: must be a section")
    section_fields = {field.name: field for field in fields(kind)}  # type: ignore[arg-type]
    check_names(where, table, tuple(section_fields))
    if missing := [n for n, f in section_fields.items() if f.default is MISSING and n not in table]:
        raise InputError(f"{where} lacks {missing[0]}")
    hints = get_type_hints(kind)
    try:
        return kind(**{key: parse_value(key, hints[key], value, folder) for key, value in table.items()})
    except InputError as error:
        raise InputError(f"{where} {error}") from error


def parse_value(key: str, hint: Any, value: object, folder: Path = Path()) -> Any:
    """Return a TOML value in the type of its field; a relative path refers to the folder of the file.

    Raises:
        InputError: it is something else.
    """
    expected_type = (
        next(part for part in get_args(hint) if part is not type(None)) if isinstance(hint, UnionType) else hint
    )
    if get_origin(expected_type) is tuple:
        if isinstance(value, list) and all(isinstance(part, str) for part in value):
            return tuple(value)
        raise InputError(f"{key} is {value!r}; a list of texts was expected")
    if expected_type is Path and isinstance(value, str):
        return folder / value
    if expected_type is float and isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    if expected_type is int and type(value) is int:
        return value
    # A date with a time is a date, too, and a text of nothing says nothing.
    if expected_type in (date, str) and type(value) is expected_type and str(value).strip():
        return value
    raise InputError(f"{key} is {value!r}; {TYPE_LABELS.get(expected_type, 'a text')} was expected")


def check_names(where: str, names: Iterable[str], allowed: tuple[str, ...]) -> None:
    """Raise `InputError` for a name outside the valid names."""
    for name in names:
        if name not in allowed:
            near = get_close_matches(name, allowed, n=1)
            hint = f"; did you mean {near[0]}?" if near else ""
            raise InputError(f"{where}: {name!r} is unknown; known: {', '.join(allowed)}{hint}")
