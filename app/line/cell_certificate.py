"""A load cell's calibration certificate: typed in, or read from its DCC (PTB's XML, schema 3)."""

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Mapping
from datetime import date
from pathlib import Path
from typing import Any

from softcal.core.errors import InputError
from softcal.core.unit.budget import COVERAGE
from softcal.db.entries import CellCertificate

REQUIRED_FIELDS = ("cell_serial", "number", "issued_on", "due_on", "capacity_N", "uncertainty_N")

PER_UNIT_N = {r"\newton": 1.0, r"\milli\newton": 1e-3, r"\kilo\newton": 1e3}
"""D-SI names of the units in which a load cell's certificate may state forces."""

RECALIBRATION, DATES = "basic_recalibration", ("date", "dateTime", "valueXMLList")


def certificate_from(options: Mapping[str, Any], dcc: Path | None) -> CellCertificate:
    """Return the certificate of the options, or None without options. The DCC gives the values that the options lack.

    Raises:
        InputError: the file is no DCC, or something is missing; all of it is named.
    """
    try:
        document = None if dcc is None else dcc.read_bytes()
    except OSError as error:
        raise InputError(f"{dcc}: {error.strerror}") from error
    fields = {} if document is None else dict(_dcc_fields(document, dcc))
    fields |= {name: value for name, value in options.items() if value is not None}
    missing = [name for name in REQUIRED_FIELDS if fields.get(name) is None]
    if missing:
        where = "" if dcc is None else f"{dcc}: "
        raise InputError(f"{where}the certificate lacks {', '.join(missing)}; state them beside it, nothing was stored")
    return CellCertificate(**{"laboratory": "", **fields}, document=document)


def _dcc_fields(document: bytes, path: Path | None) -> Iterator[tuple[str, Any]]:
    try:
        root = ET.fromstring(document)
    except ET.ParseError as error:
        raise InputError(f"{path}: is no XML: {error}") from error
    name = root.tag.rpartition("}")[2]
    if name != "digitalCalibrationCertificate":
        raise InputError(f"{path}: is no Digital Calibration Certificate, its root is {name!r}")
    readers: dict[str, Callable[[], Any]] = {
        "cell_serial": lambda: _serial(root),
        "number": lambda: _text(root, "uniqueIdentifier"),
        "laboratory": lambda: _text(root.find(".//{*}calibrationLaboratory"), "content"),
        "issued_on": lambda: _day(_text(root, "endPerformanceDate")),
        "due_on": lambda: _day(
            next(filter(None, (_text(each, *DATES) for each in _marked(root, RECALIBRATION))), None)
        ),
        "capacity_N": lambda: _largest(_in_N(each, "value") for each in _marked(root, "basic_validityRangeMax")),
        "uncertainty_N": lambda: _largest(_uncertainties_N(root)),
    }
    for name, read in readers.items():
        try:
            value = read()
        except ValueError as error:
            raise InputError(f"{path}: {name}: {error}") from error
        if value is not None:
            yield name, value


def _text(element: ET.Element | None, *names: str) -> str | None:
    """Return the text below an element, of the first of these names that has one; in any namespace."""
    texts = ("" if element is None else (element.findtext(f".//{{*}}{name}") or "").strip() for name in names)
    return next(filter(None, texts), None)


def _marked(root: ET.Element, ref_type: str) -> Iterator[ET.Element]:
    """Elements that carry one of PTB's reference types (good practice DCC)."""
    return (each for each in root.iter() if ref_type in each.get("refType", "").split())


def _day(text: str | None) -> date | None:
    return None if text is None else date.fromisoformat(text[:10])


def _serial(root: ET.Element) -> str | None:
    """Return the item's serial number: the marked identification, else the manufacturer's."""
    identifications = [] if (item := root.find(".//{*}item")) is None else item.findall(".//{*}identification")
    marked = [each for each in identifications if "basic_serialNumber" in each.get("refType", "").split()]
    makers = [each for each in identifications if _text(each, "issuer") == "manufacturer"]
    return next((_text(each, "value") for each in marked + makers), None)


def _in_N(element: ET.Element, *names: str) -> float | None:
    factor, value = PER_UNIT_N.get(_text(element, "unit") or ""), _text(element, *names)
    return None if factor is None or value is None else factor * float(value)


def _uncertainties_N(root: ET.Element) -> Iterator[float | None]:
    """Expanded uncertainties of forces in N, at k = 2; D-SI 1 and 2 name them differently."""
    for real in root.iterfind(".//{*}real"):
        expanded_N = _in_N(real, "uncertainty", "valueExpandedMU")
        if expanded_N is not None:
            yield expanded_N * COVERAGE / float(_text(real, "coverageFactor") or COVERAGE)


def _largest(values: Iterator[float | None]) -> float | None:
    return max((value for value in values if value is not None), default=None)
