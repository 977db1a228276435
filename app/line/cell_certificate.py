"""A load cell's calibration certificate: typed in, or read from its DCC (PTB's XML, schema 3)."""

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Mapping
from datetime import date
from pathlib import Path
from typing import Any

from softcal.core.errors import InputError
from softcal.db.entries import CellCertificate

NEEDED = ("cell_serial", "number", "issued_on", "due_on", "capacity_N", "uncertainty_N")

PER_UNIT_N = {r"\newton": 1.0, r"\milli\newton": 1e-3, r"\kilo\newton": 1e3}
"""D-SI names of the units in which a load cell's certificate may state forces."""

COVERAGE = 2.0


def certificate_from(given: Mapping[str, Any], dcc: Path | None) -> CellCertificate:
    """Return the certificate that options give; what they leave out comes from the DCC.

    Args:
        given: fields of `CellCertificate`; None where nothing was given.

    Raises:
        InputError: the file is no DCC, or something is missing; all of it is named.
    """
    try:
        document = None if dcc is None else dcc.read_bytes()
    except OSError as error:
        raise InputError(f"{dcc}: {error.strerror}") from error
    facts = {} if document is None else _facts(document, dcc)
    facts |= {name: value for name, value in given.items() if value is not None}
    missing = [name for name in NEEDED if facts.get(name) is None]
    if missing:
        where = "" if dcc is None else f"{dcc}: "
        raise InputError(f"{where}the certificate lacks {', '.join(missing)}; state them beside it, nothing was stored")
    return CellCertificate(**{"laboratory": "", **facts}, document=document)


def _facts(document: bytes, path: Path | None) -> dict[str, Any]:
    try:
        root = ET.fromstring(document)
    except ET.ParseError as error:
        raise InputError(f"{path}: is no XML: {error}") from error
    if _local(root) != "digitalCalibrationCertificate":
        raise InputError(f"{path}: is no Digital Calibration Certificate, its root is {_local(root)!r}")
    readers: dict[str, Callable[[], Any]] = {
        "cell_serial": lambda: _serial(root),
        "number": lambda: _text(_first(root, "uniqueIdentifier")),
        "laboratory": lambda: _text(_first(_first(root, "calibrationLaboratory"), "content")),
        "issued_on": lambda: _day(_text(_first(root, "endPerformanceDate"))),
        "due_on": lambda: _due(root),
        "capacity_N": lambda: _largest(
            _in_N(each, _text(_first(each, "value"))) for each in _marked(root, "basic_validityRangeMax")
        ),
        "uncertainty_N": lambda: _largest(_uncertainties_N(root)),
    }
    facts = {}
    for name, read in readers.items():
        try:
            value = read()
        except ValueError as error:
            raise InputError(f"{path}: {name}: {error}") from error
        if value is not None:
            facts[name] = value
    return facts


def _local(element: ET.Element) -> str:
    return element.tag.rpartition("}")[2]


def _all(element: ET.Element | None, name: str) -> Iterator[ET.Element]:
    return (each for each in element.iter() if _local(each) == name) if element is not None else iter(())


def _first(element: ET.Element | None, name: str) -> ET.Element | None:
    return next(_all(element, name), None)


def _text(element: ET.Element | None) -> str | None:
    return (element.text or "").strip() or None if element is not None else None


def _marked(root: ET.Element, ref_type: str) -> Iterator[ET.Element]:
    """Elements that carry one of PTB's reference types (good practice DCC)."""
    return (each for each in root.iter() if ref_type in each.get("refType", "").split())


def _day(text: str | None) -> date | None:
    return None if text is None else date.fromisoformat(text[:10])


def _serial(root: ET.Element) -> str | None:
    """The item's serial number: what is marked as one, else what the manufacturer calls it."""
    item = _first(root, "item")
    identifications = list(_all(item, "identification"))
    marked = [each for each in identifications if "basic_serialNumber" in each.get("refType", "").split()]
    makers = [each for each in identifications if _text(_first(each, "issuer")) == "manufacturer"]
    return next((_text(_first(each, "value")) for each in marked + makers), None)


def _due(root: ET.Element) -> date | None:
    for each in _marked(root, "basic_recalibration"):
        day = _text(_first(each, "date")) or _text(_first(each, "dateTime")) or _text(_first(each, "valueXMLList"))
        if day:
            return _day(day)
    return None


def _in_N(element: ET.Element, value: str | None) -> float | None:
    factor = PER_UNIT_N.get(_text(_first(element, "unit")) or "")
    return None if factor is None or value is None else factor * float(value)


def _uncertainties_N(root: ET.Element) -> Iterator[float | None]:
    """Expanded uncertainties of forces in N, at k = 2; D-SI 1 and 2 name them differently."""
    for real in _all(root, "real"):
        expanded_N = _in_N(real, _text(_first(real, "uncertainty")) or _text(_first(real, "valueExpandedMU")))
        if expanded_N is not None:
            yield expanded_N * COVERAGE / float(_text(_first(real, "coverageFactor")) or COVERAGE)


def _largest(values: Iterator[float | None]) -> float | None:
    return max((value for value in values if value is not None), default=None)
