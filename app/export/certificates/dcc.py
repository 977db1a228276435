"""The certificate as a Digital Calibration Certificate (PTB, XML, schema 3.1.2) with D-SI units."""

import xml.etree.ElementTree as ET
from functools import partial

from softcal.app.export.certificates.content import Certificate, band_range
from softcal.app.export.certificates.statements import DECISION_RULE, ONLY_THIS, SIMULATED
from softcal.app.export.laboratory import NOT_STATED, Party
from softcal.core.errors import printable
from softcal.core.messages.figures import format_uncertainty

SCHEMA_VERSION = "3.1.2"
"""Each schema accepts its own version alone: another one is another writer."""

DCC, SI = "https://ptb.de/dcc", "https://ptb.de/si"

SI_UNITS = {
    "N": (1.0, r"\newton"),
    "mN": (1.0, r"\milli\newton"),
    "Pa": (1.0, r"\pascal"),
    "kPa": (1.0, r"\kilo\pascal"),
    "bar": (100.0, r"\kilo\pascal"),
    "V": (1.0, r"\volt"),
    "mm": (1.0, r"\milli\metre"),
    "1": (1.0, r"\one"),
    "%": (0.01, r"\one"),
}
"""Factor and D-SI name of the units sensors are calibrated in; others are told as text."""

CONFORMITY = {"pass": "pass", "conditional pass": "conditionalPass", "fail": "fail"}


def certificate_xml(certificate: Certificate) -> bytes:
    """Return the document, indented, UTF-8; the same facts give the same bytes."""
    ET.register_namespace("dcc", DCC)
    ET.register_namespace("si", SI)
    results = _node("measurementResults", _result(certificate))
    root = _node("digitalCalibrationCertificate", _administrative(certificate), results, schemaVersion=SCHEMA_VERSION)
    ET.indent(root, "  ")
    content: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return content + b"\n"


def _node(name: str, *content: ET.Element | str | None, **attributes: str) -> ET.Element:
    """Return an element of the DCC (D-SI: "si:" before its name) with a text or elements; None is left out."""
    space, _, tag = name.rpartition(":")
    element = ET.Element(f"{{{SI if space else DCC}}}{tag}", attributes)
    for part in content:
        if isinstance(part, str):
            # The PTB's strings neither begin nor end with a space.
            element.text = printable(" ".join(part.split()))
        elif part is not None:
            element.append(part)
    return element


def _text(name: str, content: str) -> ET.Element:
    return _node(name, _node("content", content, lang="en"))


def _optional_node(name: str, value: str) -> ET.Element | None:
    return None if value == NOT_STATED else _node(name, value)


def _administrative(certificate: Certificate) -> ET.Element:
    laboratory, performance = certificate.laboratory.laboratory, certificate.laboratory.performance
    person, customer = certificate.laboratory.person, certificate.laboratory.customer
    received = performance.received_on
    core = _node(
        "coreData",
        _node("countryCodeISO3166_1", laboratory.country),
        _node("usedLangCodeISO639_1", "en"),
        _node("mandatoryLangCodeISO639_1", "en"),
        _node("uniqueIdentifier", certificate.identifier),
        None if received is None else _node("receiptDate", received.isoformat()),
        _node("beginPerformanceDate", certificate.began_on.isoformat()),
        _node("endPerformanceDate", certificate.ended_on.isoformat()),
        # The schema wants one of five places; the scope says where nobody stated it.
        _node("performanceLocation", "other" if performance.at == NOT_STATED else performance.at),
    )
    item = _node(
        "item",
        _text("name", f"{_simulation_prefix(certificate)}Soft sensor {certificate.serial}"),
        _text("description", f"Condition: {performance.condition}"),
        _node("manufacturer", _text("name", NOT_STATED)),
        _node("model", certificate.lot.sensor_model) if certificate.lot.sensor_model.strip() else None,
        _node(
            "identifications",
            _identification("other", certificate.serial, "Serial number"),
            _identification("other", certificate.lot.id, "Lot"),
            _identification("calibrationLaboratory", str(certificate.revision), "Revision of the calibration"),
        ),
    )
    responsible = _node(
        "respPerson",
        _node("person", _text("name", person.name)),
        _optional_node("role", person.role),
        None if person.name == NOT_STATED else _node("mainSigner", "true"),
    )
    return _node(
        "administrativeData",
        _node("dccSoftware", _software(certificate)),
        core,
        _node("items", item),
        _node("calibrationLaboratory", _contact("contact", laboratory)),
        _node("respPersons", responsible),
        _contact("customer", customer),
        _statements(certificate),
    )


def _simulation_prefix(certificate: Certificate) -> str:
    return "SIMULATED: " if certificate.is_simulated else ""


def _software(certificate: Certificate) -> ET.Element:
    name, release = certificate.provenance.software.split(" ", 1)
    return _node("software", _text("name", name), _node("release", release), _node("type", "application"))


def _identification(issuer: str, value: str, name: str) -> ET.Element:
    return _node("identification", _node("issuer", issuer), _node("value", value), _text("name", name))


def _contact(name: str, party: Party) -> ET.Element:
    city, country = _node("city", party.city), _node("countryCode", party.country)
    location = _node(
        "location", city, country, _optional_node("postCode", party.post_code), _optional_node("street", party.street)
    )
    return _node(name, _text("name", party.name), _node("eMail", party.email), location)


def _statements(certificate: Certificate) -> ET.Element:
    verdict = f"Verdict of the line: {certificate.verdict}; {'; '.join(certificate.reasons)}."
    performance_days = f"{ONLY_THIS} Place: {certificate.location}. Performance: {certificate.performance_days}."
    return _node(
        "statements",
        _node("statement", _text("declaration", SIMULATED)) if certificate.is_simulated else None,
        _node(
            "statement",
            _node("norm", "ILAC-G8:09/2019"),
            _text("declaration", " ".join((certificate.no_statement, DECISION_RULE, verdict))),
            _node("conformity", CONFORMITY[certificate.conformity]) if certificate.conformity else None,
            refType="basic_conformity",
        ),
        _node(
            "statement",
            _node("traceable", "true" if certificate.is_traceable else "false"),
            _text("declaration", f"{certificate.traceability} {certificate.basis}"),
        ),
        _node("statement", _node("norm", "ISO/IEC 17025:2017"), _text("declaration", performance_days)),
        _node("statement", _text("declaration", "Date of issue"), _node("date", certificate.issued_on.isoformat())),
    )


def _result(certificate: Certificate) -> ET.Element:
    revision_text = (
        f" Revision {certificate.revision}: {certificate.revision_reason}." if certificate.revision_reason else ""
    )
    title = f"{_simulation_prefix(certificate)}Calibration of {certificate.lot.reference_quantity}, "
    method = _node(
        "usedMethod",
        _text("name", f"Transfer calibration: {certificate.method_name}"),
        _text("description", certificate.method + revision_text),
    )
    ambient, conditions = certificate.laboratory.conditions, []
    for name, kind, value, shift, factor, unit in (
        ("Temperature", "basic_temperature", ambient.temperature_C, 273.15, 1.0, r"\kelvin"),
        ("Relative humidity", "basic_humidityRelative", ambient.humidity_pct, 0.0, 0.01, r"\one"),
    ):
        if value is not None:
            quantity = _node("quantity", _text("name", name), _real(value * factor + shift, unit), refType=kind)
            condition = _node("influenceCondition", _text("name", name), _node("data", quantity), refType=kind)
            conditions.append(condition)
    recording_summary = f"{certificate.recording_summary}, output in {certificate.lot.output_unit}"
    quantity_of = partial(_quantity, certificate.lot.reference_unit)
    provenance = [f"Map of family {certificate.map_family}, from {recording_summary}."]
    provenance += [f"{name}: {value}" for name, value in certificate.provenance_rows]
    errors = [
        quantity_of(f"{kind} root mean square error", error.rmse, certificate.interval_of(error))
        for kind, error in (("Predicted", certificate.forecast), ("Measured", certificate.measured))
        if error is not None
    ]
    for name, value, note in certificate.decision_numbers:
        errors.append(quantity_of(f"{name} ({note})" if note else name, value))
    if certificate.bands:
        errors.append(quantity_of("Lower end of the calibrated range", certificate.low, kind="basic_validityRangeMin"))
        errors.append(quantity_of("Upper end of the calibrated range", certificate.high, kind="basic_validityRangeMax"))
    budget = None
    if (of := certificate.budget) is not None:
        head = (
            f"Uncertainty budget of an estimate at {of.load:.4g} {certificate.lot.reference_unit} (GUM, JCGM 100:2008)"
        )
        values = [(f"Standard uncertainty: {c.name} ({c.distribution})", c.standard) for c in of.contributions]
        values.append(("Combined standard uncertainty", of.standard))
        values.append(("U_est: expanded uncertainty, k = 2", of.expanded))
        budget = _result_node(head, *(quantity_of(name, value) for name, value in values))
    results = (
        _result_node("Error of the unit", *errors),
        _result_node(
            "U_est: expanded uncertainty of an estimate, k = 2, by range of the estimate",
            _expanded_uncertainties(certificate),
        ),
        budget,
        _result_node("Provenance", *(_text("text", message) for message in provenance)),
    )
    return _node(
        "measurementResult",
        _text("name", f"{title}transferred from source unit {certificate.source}"),
        _node("usedMethods", method),
        _node("usedSoftware", _software(certificate)),
        _load_cell(certificate),
        _node("influenceConditions", *conditions) if conditions else None,
        _node("results", *results),
    )


def _result_node(name: str, *data: ET.Element) -> ET.Element:
    return _node("result", _text("name", name), _node("data", *data))


def _load_cell(certificate: Certificate) -> ET.Element | None:
    cell, reference = certificate.laboratory.load_cell, certificate.reference
    if reference is None or not reference.certificate or certificate.is_simulated:
        return None
    issuer, serial = reference.laboratory or cell.laboratory, reference.cell or cell.serial
    certificate_node = quantities = None
    if cell.certificate_sha256:
        certificate_node = _node(
            "certificate",
            _text("referral", f"Calibration certificate by {issuer}"),
            _node("referralID", reference.certificate),
            _node("procedure", "SHA-256"),
            _node("value", cell.certificate_sha256),
        )
    if reference.uncertainty is not None:
        name = f"U_cell: expanded uncertainty of its certificate, k = {reference.coverage_factor:g}"
        quantity = _quantity(
            certificate.lot.reference_unit,
            name,
            reference.uncertainty,
            kind="basic_uncertainty",
            element="measuringEquipmentQuantity",
        )
        quantities = _node("measuringEquipmentQuantities", quantity)
    identifications = _node(
        "identifications",
        None if serial == NOT_STATED else _identification("other", serial, "Serial number"),
        _identification("other", reference.certificate, f"Certificate of {issuer}"),
    )
    equipment = _node(
        "measuringEquipment",
        _text("name", "Reference of the source's calibration"),
        certificate_node,
        None if cell.manufacturer == NOT_STATED else _node("manufacturer", _text("name", cell.manufacturer)),
        _optional_node("model", cell.model),
        identifications,
        quantities,
        refType="basic_normalUsed",
    )
    return _node("measuringEquipments", equipment)


def _quantity(
    reference_unit: str,
    name: str,
    value: float | None,
    interval: tuple[float, float] | None = None,
    kind: str = "",
    element: str = "quantity",
) -> ET.Element:
    if value is None:
        message = _text("noQuantity", NOT_STATED)
    elif reference_unit not in SI_UNITS:
        message = _text("noQuantity", f"{value:.6g} {reference_unit}")
    else:
        factor, unit = SI_UNITS[reference_unit]
        coverage = None
        if interval is not None:
            low, high = (end * factor for end in interval)
            coverage = _node(
                "si:coverageInterval",
                _node("si:standardUnc", _number((high - low) / 4)),
                _node("si:intervalMin", _number(low)),
                _node("si:intervalMax", _number(high)),
                _node("si:coverageProbability", "0.95"),
            )
        message = _real(value * factor, unit, coverage)
    return _node(element, _text("name", name), message, **({"refType": kind} if kind else {}))


def _expanded_uncertainties(certificate: Certificate) -> ET.Element:
    if certificate.lot.reference_unit not in SI_UNITS or not certificate.bands:
        bands = "; ".join(f"{band_range(b)}: U_est = {format_uncertainty(b.expanded)}" for b in certificate.bands)
        return _text(
            "text", f"{bands} {certificate.lot.reference_unit}" if bands else "no estimate lies in the calibrated range"
        )
    factor, unit = SI_UNITS[certificate.lot.reference_unit]
    quantities = []
    for name, values in (
        ("Lower end of the range", [band.low for band in certificate.bands]),
        ("Upper end of the range", [band.high for band in certificate.bands]),
        ("U_est: expanded uncertainty, k = 2", [band.expanded for band in certificate.bands]),
    ):
        numbers = _node("si:valueXMLList", " ".join(_number(value * factor) for value in values))
        real = _node("si:realListXMLList", numbers, _node("si:unitXMLList", unit))
        quantities.append(_node("quantity", _text("name", name), real))
    return _node("list", *quantities)


def _real(value: float, unit: str, coverage: ET.Element | None = None) -> ET.Element:
    return _node("si:real", _node("si:value", _number(value)), _node("si:unit", unit), coverage)


def _number(value: float) -> str:
    """Return seven significant digits: programs decide again by them; only what people read is rounded."""
    return f"{value:.7g}"
