"""Laboratory, customer, place and conditions of a calibration: from a TOML file, or from the registry."""

from dataclasses import dataclass, fields
from datetime import date
from pathlib import Path
from typing import Any

import msgspec

from softcal.app.files.toml_file import check_names, read_section, read_toml
from softcal.core.errors import InputError
from softcal.db.registry import Registry

NOT_STATED = "not stated"
NO_COUNTRY = "ZZ"
"""ISO 3166-1: no country, by agreement of its users."""

PLACES = ("laboratory", "customer", "laboratoryBranch", "customerBranch", "other")
"""Where a calibration may be performed, in the words of the DCC."""


@dataclass(frozen=True)
class Party:
    """A laboratory or customer; `country` is the ISO 3166-1 code."""

    name: str = NOT_STATED
    email: str = NOT_STATED
    country: str = NO_COUNTRY
    city: str = NOT_STATED
    street: str = NOT_STATED
    post_code: str = NOT_STATED

    def __post_init__(self) -> None:
        if len(self.country) != 2 or not self.country.isascii() or not self.country.isupper():
            raise InputError(f"country {self.country!r}: two capital letters such as KR were expected")


@dataclass(frozen=True)
class Person:
    """Person responsible for the certificate."""

    name: str = NOT_STATED
    role: str = NOT_STATED


@dataclass(frozen=True)
class LoadCell:
    """Data of the reference for readers, in addition to the lot's statement.

    Args:
        certificate: must be the one the lot states, where it states one.
        certificate_sha256: of the certificate's own file, hex.
    """

    manufacturer: str = NOT_STATED
    model: str = NOT_STATED
    serial: str = NOT_STATED
    certificate: str = NOT_STATED
    certificate_sha256: str = ""
    laboratory: str = NOT_STATED
    issued_on: date | None = None
    due_on: date | None = None
    uncertainty_N: float | None = None
    coverage_factor: float = 2.0


@dataclass(frozen=True)
class Conditions:
    """Ambient conditions of the calibration."""

    temperature_C: float | None = None
    humidity_pct: float | None = None


@dataclass(frozen=True)
class Performance:
    """Performance of the calibration, in addition to the recordings (ISO/IEC 17025:2017, 7.8.2.1).

    Args:
        at: one of `PLACES`.
        place: address or room; left out, the address of who `at` names.
        condition: of the item when it was received.
        received_on: day the item was received.
        issued_on: day of issue; the day of the export where it is left out.
        deviations: from the method, in addition to those of the registry.
        began_on, ended_on: first and last day the units were pressed.
    """

    at: str = NOT_STATED
    place: str = NOT_STATED
    condition: str = NOT_STATED
    received_on: date | None = None
    issued_on: date | None = None
    deviations: str = NOT_STATED
    began_on: date | None = None
    ended_on: date | None = None

    def __post_init__(self) -> None:
        if self.at not in (*PLACES, NOT_STATED):
            raise InputError(f"performance at {self.at!r}; one of {', '.join(PLACES)} was expected")
        if self.began_on and self.ended_on and self.ended_on < self.began_on:
            raise InputError(f"performance ended_on {self.ended_on} is before began_on {self.began_on}")


@dataclass(frozen=True)
class Laboratory:
    """All data of a certificate that no recording contains."""

    laboratory: Party = Party()
    customer: Party = Party()
    person: Person = Person()
    load_cell: LoadCell = LoadCell()
    conditions: Conditions = Conditions()
    performance: Performance = Performance()


def read_laboratory(path: Path | None) -> Laboratory:
    """Return the laboratory data of a file (`InputError`: unusable); without a file everything is "not stated"."""
    if path is None:
        return Laboratory()
    values = read_toml(path)
    kinds: dict[str, type[Any]] = {field.name: type(field.default) for field in fields(Laboratory)}
    check_names(f"{path}: section", values, tuple(kinds))
    sections: dict[str, Any] = {n: read_section(f"{path}: [{n}]", kinds[n], table) for n, table in values.items()}
    return Laboratory(**sections)


def registry_laboratory(registry: Registry) -> Laboratory:
    """Return the laboratory data in the registry; "not stated" before they were stored."""
    rows = registry.declarations.in_force("laboratories")
    return msgspec.convert({row["section"]: row["statements"] for row in rows}, Laboratory)


def store_laboratory(registry: Registry, laboratory: Laboratory, actor: str | None = None) -> None:
    """Store the laboratory data for every later certificate."""
    with registry.transaction():
        for section, values in msgspec.to_builtins(laboratory).items():
            registry.declarations.declare("laboratories", {"section": section, "statements": values}, actor=actor)
