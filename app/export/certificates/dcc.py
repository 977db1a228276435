"""The certificate as a Digital Calibration Certificate of the PTB (XML, schema 3.1.2) with D-SI units."""

import xml.etree.ElementTree as ET
from collections.abc import Sequence

from softcal.app.export.certificates.content import DECISION_RULE, ONLY_THIS, SIMULATED, Certificate
from softcal.app.export.certificates.laboratory import NOT_STATED, Party
from softcal.core.unit.budget import Reference

SCHEMA_VERSION = "3.1.2"
"""Each schema accepts its own version alone: another one is another writer, never another number here."""

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

CONFORMITY = {
    "pass": "pass",
    "conditional pass": "conditionalPass",
    "fail": "fail",
}


def certificate_xml(facts: Certificate) -> bytes:
    """Return the document, indented, UTF-8; the same facts give the same bytes."""
    ET.register_namespace("dcc", DCC)
    ET.register_namespace("si", SI)
    root = ET.Element(f"{{{DCC}}}digitalCalibrationCertificate", {"schemaVersion": SCHEMA_VERSION})
    _administrative(_child(root, "administrativeData"), facts)
    _result(_child(_child(root, "measurementResults"), "measurementResult"), facts)
    ET.indent(root, "  ")
    content: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return content + b"\n"


def _child(parent: ET.Element, name: str, text: str | None = None, **attributes: str) -> ET.Element:
    element = ET.SubElement(parent, f"{{{DCC}}}{name}", attributes)
    # The PTB's strings neither begin nor end with a space.
    element.text = None if text is None else " ".join(text.split())
    return element


def _text(parent: ET.Element, name: str, content: str) -> ET.Element:
    element = _child(parent, name)
    _child(element, "content", content, lang="en")
    return element


def _administrative(parent: ET.Element, facts: Certificate) -> None:
    software = _child(_child(parent, "dccSoftware"), "software")
    _software(software, facts)
    core = _child(parent, "coreData")
    _child(core, "countryCodeISO3166_1", facts.laboratory.laboratory.country)
    _child(core, "usedLangCodeISO639_1", "en")
    _child(core, "mandatoryLangCodeISO639_1", "en")
    _child(core, "uniqueIdentifier", facts.identifier)
    performance = facts.laboratory.performance
    if performance.received_on is not None:
        _child(core, "receiptDate", performance.received_on.isoformat())
    _child(core, "beginPerformanceDate", facts.began_on.isoformat())
    _child(core, "endPerformanceDate", facts.ended_on.isoformat())
    # The schema wants one of five places; the scope says where nobody stated it.
    _child(core, "performanceLocation", "other" if performance.at == NOT_STATED else performance.at)
    _item(_child(_child(parent, "items"), "item"), facts)
    _contact(_child(_child(parent, "calibrationLaboratory"), "contact"), facts.laboratory.laboratory)
    _person(_child(_child(parent, "respPersons"), "respPerson"), facts)
    _contact(_child(parent, "customer"), facts.laboratory.customer)
    _statements(_child(parent, "statements"), facts)


def _software(parent: ET.Element, facts: Certificate) -> None:
    name, release = facts.software.split(" ", 1)
    _text(parent, "name", name)
    _child(parent, "release", release)
    _child(parent, "type", "application")


def _item(parent: ET.Element, facts: Certificate) -> None:
    simulated = "SIMULATED: " if facts.is_simulated else ""
    _text(parent, "name", f"{simulated}Soft sensor {facts.serial}")
    _text(parent, "description", f"Condition: {facts.laboratory.performance.condition}")
    _text(_child(parent, "manufacturer"), "name", NOT_STATED)
    if facts.sensor_model.strip():
        _child(parent, "model", facts.sensor_model)
    identifications = _child(parent, "identifications")
    _identification(identifications, "other", facts.serial, "Serial number")
    _identification(identifications, "other", facts.lot, "Lot")
    _identification(identifications, "calibrationLaboratory", str(facts.revision), "Revision of the calibration")


def _identification(parent: ET.Element, issuer: str, value: str, name: str) -> None:
    element = _child(parent, "identification")
    _child(element, "issuer", issuer)
    _child(element, "value", value)
    _text(element, "name", name)


def _contact(parent: ET.Element, party: Party) -> None:
    _text(parent, "name", party.name)
    _child(parent, "eMail", party.email)
    location = _child(parent, "location")
    _child(location, "city", party.city)
    _child(location, "countryCode", party.country)
    for name, value in (("postCode", party.post_code), ("street", party.street)):
        if value != NOT_STATED:
            _child(location, name, value)


def _person(parent: ET.Element, facts: Certificate) -> None:
    person = facts.laboratory.person
    _text(_child(parent, "person"), "name", person.name)
    if person.role != NOT_STATED:
        _child(parent, "role", person.role)
    if person.name != NOT_STATED:
        _child(parent, "mainSigner", "true")


def _statements(parent: ET.Element, facts: Certificate) -> None:
    if facts.is_simulated:
        _text(_child(parent, "statement"), "declaration", SIMULATED)
    decision = _child(parent, "statement", refType="basic_conformity")
    _child(decision, "norm", "ILAC-G8:09/2019")
    verdict = f"Verdict of the line: {facts.verdict}; {'; '.join(facts.reasons)}."
    _text(decision, "declaration", " ".join((facts.no_statement, DECISION_RULE, verdict)))
    if facts.conformity:
        _child(decision, "conformity", CONFORMITY[facts.conformity])
    trace = _child(parent, "statement")
    _child(trace, "traceable", "true" if facts.is_traceable else "false")
    _text(trace, "declaration", f"{facts.traceability} {facts.basis}")
    scope = _child(parent, "statement")
    _child(scope, "norm", "ISO/IEC 17025:2017")
    _text(scope, "declaration", f"{ONLY_THIS} Place: {facts.place}. Performance: {facts.performed}.")
    issue = _child(parent, "statement")
    _text(issue, "declaration", "Date of issue")
    _child(issue, "date", facts.issued_on.isoformat())


def _result(parent: ET.Element, facts: Certificate) -> None:
    simulated = "SIMULATED: " if facts.is_simulated else ""
    _text(parent, "name", f"{simulated}Calibration of {facts.quantity}, transferred from source unit {facts.source}")
    method = _child(_child(parent, "usedMethods"), "usedMethod")
    _text(method, "name", f"Transfer calibration: {facts.method_name}")
    because = f" Revision {facts.revision}: {facts.made_because}." if facts.made_because else ""
    _text(method, "description", facts.method + because)
    _software(_child(_child(parent, "usedSoftware"), "software"), facts)
    if facts.reference is not None and facts.reference.certificate and not facts.is_simulated:
        equipment = _child(_child(parent, "measuringEquipments"), "measuringEquipment", refType="basic_normalUsed")
        _load_cell(equipment, facts, facts.reference)
    _conditions(parent, facts)
    results = _child(parent, "results")
    _errors(results, facts)
    _expanded(results, facts)
    _budget(results, facts)
    _provenance(results, facts)


def _load_cell(parent: ET.Element, facts: Certificate, reference: Reference) -> None:
    cell = facts.laboratory.load_cell
    issuer = reference.laboratory or cell.laboratory
    _text(parent, "name", "Reference of the source's calibration")
    if cell.certificate_sha256:
        certificate = _child(parent, "certificate")
        _text(certificate, "referral", f"Calibration certificate by {issuer}")
        _child(certificate, "referralID", reference.certificate)
        _child(certificate, "procedure", "SHA-256")
        _child(certificate, "value", cell.certificate_sha256)
    if cell.manufacturer != NOT_STATED:
        _text(_child(parent, "manufacturer"), "name", cell.manufacturer)
    if cell.model != NOT_STATED:
        _child(parent, "model", cell.model)
    identifications = _child(parent, "identifications")
    serial = reference.cell or cell.serial
    if serial != NOT_STATED:
        _identification(identifications, "other", serial, "Serial number")
    _identification(identifications, "other", reference.certificate, f"Certificate of {issuer}")
    if reference.uncertainty is not None:
        quantities = _child(parent, "measuringEquipmentQuantities")
        name = f"U_cell: expanded uncertainty of its certificate, k = {reference.coverage_factor:g}"
        _quantity(
            quantities, facts, name, reference.uncertainty, None, "basic_uncertainty", "measuringEquipmentQuantity"
        )


def _conditions(parent: ET.Element, facts: Certificate) -> None:
    given = facts.laboratory.conditions
    rows = [
        ("Temperature", "basic_temperature", given.temperature_C, 273.15, 1.0, r"\kelvin"),
        ("Relative humidity", "basic_humidityRelative", given.humidity_pct, 0.0, 0.01, r"\one"),
    ]
    known = [row for row in rows if row[2] is not None]
    if not known:
        return
    conditions = _child(parent, "influenceConditions")
    for name, reference, value, shift, factor, unit in known:
        condition = _child(conditions, "influenceCondition", refType=reference)
        _text(condition, "name", name)
        quantity = _child(_child(condition, "data"), "quantity", refType=reference)
        _text(quantity, "name", name)
        _real(quantity, (value or 0.0) * factor + shift, unit)


def _errors(parent: ET.Element, facts: Certificate) -> None:
    result = _child(parent, "result")
    _text(result, "name", "Error of the unit")
    data = _child(result, "data")
    for told, found in (("Predicted", facts.forecast), ("Measured", facts.measured)):
        if found is not None:
            _quantity(data, facts, f"{told} root mean square error", found.rmse, facts.interval_of(found))
    for name, value, note in facts.deciding:
        _quantity(data, facts, f"{name} ({note})" if note else name, value)
    if facts.bands:
        _quantity(data, facts, "Lower end of the calibrated range", facts.low, reference="basic_validityRangeMin")
        _quantity(data, facts, "Upper end of the calibrated range", facts.high, reference="basic_validityRangeMax")


def _quantity(
    parent: ET.Element,
    facts: Certificate,
    name: str,
    value: float,
    interval: tuple[float, float] | None = None,
    reference: str | None = None,
    element: str = "quantity",
) -> None:
    quantity = _child(parent, element, **({"refType": reference} if reference else {}))
    _text(quantity, "name", name)
    if facts.reference_unit not in SI_UNITS:
        _text(quantity, "noQuantity", f"{value:.6g} {facts.reference_unit}")
        return
    factor, unit = SI_UNITS[facts.reference_unit]
    real = _real(quantity, value * factor, unit)
    if interval is not None:
        low, high = (end * factor for end in interval)
        coverage = ET.SubElement(real, f"{{{SI}}}coverageInterval")
        for tag, text in (
            ("standardUnc", _number((high - low) / 4)),
            ("intervalMin", _number(low)),
            ("intervalMax", _number(high)),
            ("coverageProbability", "0.95"),
        ):
            ET.SubElement(coverage, f"{{{SI}}}{tag}").text = text


def _budget(parent: ET.Element, facts: Certificate) -> None:
    if facts.budget is None:
        return
    result = _child(parent, "result")
    at = f"{facts.budget.load:.4g} {facts.reference_unit}"
    _text(result, "name", f"Uncertainty budget of an estimate at {at} (GUM, JCGM 100:2008)")
    data = _child(result, "data")
    for each in facts.budget.contributions:
        _quantity(data, facts, f"Standard uncertainty: {each.name} ({each.distribution})", each.standard)
    _quantity(data, facts, "Combined standard uncertainty", facts.budget.standard)
    _quantity(data, facts, "U_est: expanded uncertainty, k = 2", facts.budget.expanded)


def _expanded(parent: ET.Element, facts: Certificate) -> None:
    result = _child(parent, "result")
    _text(result, "name", "U_est: expanded uncertainty of an estimate, k = 2, by range of the estimate")
    data = _child(result, "data")
    if facts.reference_unit not in SI_UNITS or not facts.bands:
        told = "; ".join(f"{b.low:.4g} to {b.high:.4g}: U_est = {b.expanded:.3g}" for b in facts.bands)
        _text(data, "text", f"{told} {facts.reference_unit}" if told else "no estimate lies in the calibrated range")
        return
    factor, unit = SI_UNITS[facts.reference_unit]
    rows = _child(data, "list")
    columns: list[tuple[str, Sequence[float]]] = [
        ("Lower end of the range", [band.low for band in facts.bands]),
        ("Upper end of the range", [band.high for band in facts.bands]),
        ("U_est: expanded uncertainty, k = 2", [band.expanded for band in facts.bands]),
    ]
    for name, values in columns:
        quantity = _child(rows, "quantity")
        _text(quantity, "name", name)
        numbers = ET.SubElement(quantity, f"{{{SI}}}realListXMLList")
        ET.SubElement(numbers, f"{{{SI}}}valueXMLList").text = " ".join(_number(v * factor) for v in values)
        ET.SubElement(numbers, f"{{{SI}}}unitXMLList").text = unit


def _provenance(parent: ET.Element, facts: Certificate) -> None:
    result = _child(parent, "result")
    _text(result, "name", "Provenance")
    data = _child(result, "data")
    recorded = f"{facts.samples} samples at {facts.sample_rate_Hz:g} Hz, output in {facts.output_unit}"
    _text(data, "text", f"Map of family {facts.map_family}, from {recorded}.")
    for name, sha256 in facts.hashes:
        _text(data, "text", f"SHA-256 of the {name}: {sha256}")


def _real(parent: ET.Element, value: float, unit: str) -> ET.Element:
    real = ET.SubElement(parent, f"{{{SI}}}real")
    ET.SubElement(real, f"{{{SI}}}value").text = _number(value)
    ET.SubElement(real, f"{{{SI}}}unit").text = unit
    return real


def _number(value: float) -> str:
    """Return seven significant digits as D-SI decimals want them."""
    return f"{value:.7g}"
