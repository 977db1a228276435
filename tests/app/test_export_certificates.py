"""Certificates: one set of facts, a DCC that is valid against its schema, a PDF that says the same."""

import io
import re
import unicodedata
import xml.etree.ElementTree as ET
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
import pikepdf
import pytest
import xmlschema
from PIL import ImageCms
from pypdf import PdfReader

from softcal.app.export.certificates.content import Certificate, Uncertainty
from softcal.app.export.certificates.dcc import certificate_xml
from softcal.app.export.certificates.pdf import certificate_pdf
from softcal.app.export.certificates.statements import METHODS, WITHHOLDING_REASONS
from softcal.app.export.laboratory import (
    NOT_STATED,
    Conditions,
    Laboratory,
    LoadCell,
    Party,
    Performance,
    Person,
    read_laboratory,
)
from softcal.app.paper.fonts import KOREAN as KOREAN_FONT
from softcal.app.paper.fonts import PLAIN, has_all, register_file, writable
from softcal.app.texts.catalogue import catalogue
from softcal.core.errors import InputError
from softcal.core.lot import Lot
from softcal.core.maps.catalogue import FAMILIES
from softcal.core.unit.budget import SIMULATED, Reference, measured_budget
from softcal.core.unit.estimate import Estimate
from softcal.core.unit.measured_error import MeasuredError, Scores
from softcal.core.unit.method import DecisionConfig
from softcal.core.unit.uncertainty import ErrorForecast
from softcal.core.unit.verdict import Limit, compare_with_audit, default_limit
from softcal.db.provenance import Provenance
from tests.app.pdf_text import read_fonts, read_pages, read_text

CELL = Reference(
    "LC-7", "D-K-1", "DAkkS", date(2026, 1, 1), date(2028, 1, 1), date(2026, 2, 1), uncertainty=0.012, drift=0.01
)
NAMESPACES = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}


@pytest.fixture
def certificate() -> Certificate:
    t_s = np.arange(1500) / 50
    force_N = 1.5 - 1.5 * np.cos(t_s)
    estimated = Estimate(t_s, force_N, force_N - 0.1, force_N + 0.1, np.full(1500, "", dtype="<U12"))
    return Certificate(
        identifier="softcal-A1-r2-01234567",
        calculated_on=date(2026, 3, 4),
        in_registry_since=date(2026, 3, 2),
        source_since=date(2026, 2, 2),
        issued_on=date(2026, 3, 9),
        laboratory=Laboratory(
            Party("Press shop & Söhne", "lab@example.com", "KR", "Seoul", "Teheran-ro 1", "06234"),
            Party("Glove maker", "quality@example.com", "DE", "Munich"),
            Person("K. Jeon", "head"),
            LoadCell("Futek", "LSB200", certificate="D-K-1", certificate_sha256="ab" * 32),
            Conditions(23.0, 41.0),
            Performance(
                "customer", "Hall 3", "new, no visible damage", date(2026, 3, 1), deviations="no deviations at all"
            ),
        ),
        serial="A1",
        revision=2,
        lot=Lot("lot-1", "A0", 50.0, "eGaIn <3 mm>"),
        source="A0",
        samples=1500,
        low=0.0,
        high=3.0,
        forecast=ErrorForecast(0.21, 0.15, 0.3),
        limit=Limit("N", 0.4, reference_expanded=0.0283),
        verdict="pass",
        reasons=("predicted error is within the limit",),
        before=0.8,
        measured=ErrorForecast(0.22, 0.19, 0.25),
        is_sampled=False,
        is_trimmed=False,
        reference=CELL,
        blocking_reasons=(),
        budget=measured_budget(0.22, CELL, 2.0),
        map_family="affine",
        load_correction="",
        revision_reason="calibrated",
        map_sha256="34" * 32,
        provenance=Provenance(
            version="1.2.3",
            build="ab" * 20,
            method="78" * 32,
            inputs={"network": "12" * 32, "recording": "56" * 32},
            made_at="2026-03-02T09:00:00+00:00",
            actor="kim@line-2",
        ),
        bands=(Uncertainty(0.0, 1.5, 0.3), Uncertainty(1.5, 3.0, 0.4)),
        output=np.linspace(0.5, 0.7, 60),
        mapped=np.linspace(0.4, 0.8, 60),
        estimated=estimated,
    )


@pytest.fixture(scope="module")
def schema(measured_data: Path) -> xmlschema.XMLSchema:
    """The PTB's own schema, which lies beside the measured data; the profile's import points at the file beside it."""
    folder = measured_data / "dcc_schema"
    if not folder.is_dir():
        pytest.skip(f"no DCC schema in {folder}")
    return xmlschema.XMLSchema(folder / "dcc.xsd", locations={"https://ptb.de/si": str(folder / "SI_Format.xsd")})


def of_lot(certificate: Certificate, **changes: Any) -> Certificate:
    """Return the certificate of a unit of a lot with other properties."""
    return replace(certificate, lot=replace(certificate.lot, **changes))


def _variants(certificate: Certificate) -> list[Certificate]:
    bare = replace(of_lot(certificate, sensor_model=""), laboratory=Laboratory(), measured=None, before=None, **NOBODY)
    unknown = replace(bare, forecast=None, limit=None, verdict="retest", budget=None)
    loose = replace(
        of_lot(certificate, sensor_model=" eGaIn\n3 mm "),
        laboratory=Laboratory(Party(" Works ", "a@b.c ", "KR", "\tSeoul")),
    )
    others = [
        of_lot(certificate, reference_unit="strain counts"),
        replace(certificate, bands=()),
        of_lot(certificate, sensor_model=" "),
        replace(certificate, reference=SIMULATED),
        replace(certificate, limit=default_limit("N", 0.1, 3.0, DecisionConfig())),
        replace(certificate, load_correction="trimmed", measured=None),
        replace(certificate, measured=ErrorForecast(0.22, 0.0, np.inf)),
        expired(certificate),
    ]
    return [certificate, bare, unknown, loose, *others]


NOBODY = {"reference": None}


def expired(certificate: Certificate) -> Certificate:
    """The same unit, compared with a load cell whose certificate had ended."""
    cell = replace(CELL, used_on=date(2029, 1, 1))
    reasons = tuple(map(str, cell.blocking_reasons(certificate.high)))
    return replace(certificate, reference=cell, blocking_reasons=reasons, verdict="conditional", reasons=reasons)


def test_every_certificate_is_valid_against_the_schema(certificate: Certificate, schema: xmlschema.XMLSchema) -> None:
    for variant in _variants(certificate):
        schema.validate(certificate_xml(variant))


def test_the_schema_used_here_refuses_what_is_wrong(certificate: Certificate, schema: xmlschema.XMLSchema) -> None:
    good = certificate_xml(certificate)
    for wrong in (
        good.replace(b'schemaVersion="3.1.2"', b'schemaVersion="3.1.1"'),
        good.replace(b"<dcc:conformity>pass", b"<dcc:conformity>perhaps"),
        good.replace(b"<si:value>0.21<", b"<si:value>0,21<"),
        good.replace(b"2026-03-04", b"4 March"),
    ):
        assert wrong != good
        assert not schema.is_valid(wrong)


@pytest.mark.parametrize(
    ("unit", "value", "name"), [("N", 0.21, r"\newton"), ("bar", 21.0, r"\kilo\pascal"), ("1", 0.21, r"\one")]
)
def test_numbers_are_in_si_units(certificate: Certificate, unit: str, value: float, name: str) -> None:
    document = ET.fromstring(certificate_xml(of_lot(certificate, reference_unit=unit)))
    real = document.find(".//dcc:results//si:real", NAMESPACES)
    assert real is not None
    texts = {element.tag.rpartition("}")[2]: element.text for element in real.iter()}
    assert (float(str(texts["value"])), texts["unit"]) == (pytest.approx(value), name)
    assert texts["coverageProbability"] == "0.95"


def test_only_a_certificate_that_held_makes_a_result_traceable_and_conformity_stated(certificate: Certificate) -> None:
    text = certificate_xml(certificate).decode()
    assert "<dcc:traceable>true" in text and "<dcc:conformity>pass" in text
    for other in (replace(certificate, **NOBODY), expired(certificate), replace(certificate, **NOBODY, verdict="fail")):
        text = certificate_xml(other).decode()
        assert "<dcc:traceable>false" in text and "<dcc:conformity>" not in text
    assert "D-K-1" in certificate_xml(expired(certificate)).decode()
    simulated = certificate_xml(replace(certificate, reference=SIMULATED)).decode()
    assert "<dcc:traceable>false" in simulated and "SIMULATED" in simulated


def test_why_nothing_is_stated_is_reported_by_its_code(certificate: Certificate) -> None:
    derived = default_limit("N", 0.1, 3.0, DecisionConfig())
    cases: dict[str, Certificate] = {
        "simulated": replace(certificate, reference=SIMULATED),
        "no_limit": replace(certificate, limit=derived),
        "no_reference": replace(certificate, reference=None),
        "reference": expired(certificate),
        "known_loads": replace(certificate, load_correction="trimmed", measured=None),
        "no_interval": replace(certificate, measured=ErrorForecast(0.22, 0.0, np.inf)),
        "retest": replace(certificate, verdict="retest"),
    }
    assert set(cases) == set(WITHHOLDING_REASONS) and not certificate.withholding_codes
    for code, case in cases.items():
        assert case.withholding_codes == (code,) and not case.conformity
        assert escape(WITHHOLDING_REASONS[code]) in certificate_xml(case).decode()
    assert replace(certificate, load_correction="trimmed").conformity == "pass", "an audit since the trim decides"
    assert replace(certificate, load_correction="trimmed", is_trimmed=True).withholding_codes == ("known_loads",)
    assert str(derived.origin) in certificate_xml(cases["no_limit"]).decode()


def _draw_certificate(certificate: Certificate, rng: np.random.Generator) -> Certificate:
    """The unit with another measured error, limit and reference, judged as the line judges it."""
    limit = Limit("N", float(rng.uniform(0.05, 0.3)), reference_expanded=float(rng.choice([0.0, rng.uniform(0, 0.2)])))
    after = limit.maximum_rmse * float(rng.uniform(0.6, 1.3))
    before, rows = float(rng.uniform(1, 2)), int(rng.integers(50, 3000))
    scores = Scores(MeasuredError(before, rows), MeasuredError(after, rows))
    verdict, measured = compare_with_audit(scores, limit), scores.after.interval
    return replace(certificate, limit=limit, measured=measured, verdict=str(verdict.verdict))


def _by_rule(number: dict[str, float], within: float = 1e-5) -> str:
    """The statement, from the numbers on the page alone; AL follows from TL and U_ref within the digits shown."""
    acceptance = np.sqrt(max(number["TL"] ** 2 - number["U_ref"] ** 2, 0.0))
    assert acceptance == pytest.approx(number["AL"], abs=within)
    if number["E_upper"] <= number["AL"]:
        return "pass"
    return "conditional pass" if number["E"] <= number["TL"] else "fail"


def _numbers_of(dcc: ET.Element) -> dict[str, float]:
    """The numbers of the error's result by the symbol they are named with."""
    numbers = {}
    for quantity in dcc.iterfind(".//dcc:result/dcc:data/dcc:quantity", NAMESPACES):
        symbol, colon, _ = str(quantity.findtext("dcc:name/dcc:content", "", NAMESPACES)).partition(":")
        value = quantity.findtext("si:real/si:value", None, NAMESPACES)
        if colon and value is not None:
            assert symbol not in numbers or symbol in ("U_est", "Standard uncertainty"), symbol
            numbers[symbol] = float(value)
    return numbers


def test_the_statement_follows_from_the_numbers_on_the_page(
    certificate: Certificate, rng: np.random.Generator, tmp_path: Path
) -> None:
    verdicts = set()
    for k in range(300):
        drawn_certificate = _draw_certificate(certificate, rng)
        number = _numbers_of(ET.fromstring(certificate_xml(drawn_certificate)))
        assert _by_rule(number) == drawn_certificate.conformity
        verdicts.add(drawn_certificate.conformity)
        if k % 30:
            continue
        path = tmp_path / "drawn.pdf"
        path.write_bytes(certificate_pdf(drawn_certificate))
        rows = re.findall(r"^(E|E_lower|E_upper|TL|U_ref|AL):.*? ([\d.e-]+) ?N\b", "\n".join(read_pages(path)), re.M)
        assert len(rows) == 6
        # Whoever decides again by the rounded numbers of the page comes to the same statement.
        assert _by_rule({symbol: float(value) for symbol, value in rows}, np.inf) == drawn_certificate.conformity
        for symbol, value in rows:
            last_digit = 10.0 ** -len(value.partition(".")[2])
            assert float(value) == pytest.approx(number[symbol], abs=0.51 * last_digit + 1e-6), symbol
    assert verdicts == {"pass", "conditional pass", "fail"}


def test_no_symbol_stands_for_two_things(certificate: Certificate, tmp_path: Path) -> None:
    path = tmp_path / "facts.pdf"
    path.write_bytes(certificate_pdf(certificate))
    for text in (read_text(path), certificate_xml(certificate).decode()):
        assert not re.search(r"\bU\b(?! squared)", text)
        assert {"U_est", "U_ref", "U_cell"} <= set(re.findall(r"U_[a-z]+", text))


def test_days_are_those_that_somebody_stated_else_the_registrys(certificate: Certificate) -> None:
    def days(began: date | None, ended: date | None) -> tuple[date, date]:
        performance = replace(certificate.laboratory.performance, began_on=began, ended_on=ended)
        with_performance = replace(certificate, laboratory=replace(certificate.laboratory, performance=performance))
        assert with_performance.performance_days.count(NOT_STATED) == (began is None) + (ended is None)
        return with_performance.began_on, with_performance.ended_on

    early, late = date(2026, 1, 5), date(2026, 5, 5)
    assert days(None, None) == (date(2026, 3, 2), date(2026, 3, 4))
    assert days(early, None) == (early, date(2026, 3, 4)) and days(late, None) == (late, late)
    assert days(None, early) == (early, early) and days(None, late) == (date(2026, 3, 2), late)
    assert days(early, late) == (early, late)
    with pytest.raises(InputError, match="ended_on"):
        Performance(began_on=late, ended_on=early)
    assert CELL.used_on is not None
    assert replace(certificate, source_since=CELL.used_on).traceability != certificate.traceability


def test_what_audits_of_other_units_leave_open_is_no_95_percent_interval(certificate: Certificate) -> None:
    alone = replace(certificate, measured=None)
    for is_sampled, count in ((False, 1), (True, 0)):
        dcc = certificate_xml(replace(alone, is_sampled=is_sampled)).decode()
        assert dcc.count("<si:coverageProbability>") == count


def test_a_place_is_the_one_that_was_stated(certificate: Certificate) -> None:
    def location_of(at: str) -> str:
        performance = replace(certificate.laboratory.performance, at=at, place=NOT_STATED)
        return replace(certificate, laboratory=replace(certificate.laboratory, performance=performance)).location

    assert location_of(NOT_STATED) == NOT_STATED
    assert "Teheran-ro 1" in location_of("laboratory") and "Munich" in location_of("customer")
    assert "Teheran-ro 1" not in location_of("customer") + location_of("other") + location_of("laboratoryBranch")


def test_a_pass_is_read_on_no_page_where_nothing_vouches_for_the_reference(
    certificate: Certificate, tmp_path: Path
) -> None:
    path = tmp_path / "nobody.pdf"
    path.write_bytes(certificate_pdf(replace(certificate, **NOBODY)))
    assert "PASS" not in read_text(path).split()
    path.write_bytes(certificate_pdf(replace(certificate, reference=SIMULATED)))
    assert "PASS" not in read_text(path).split()
    path.write_bytes(certificate_pdf(certificate))
    assert "PASS" in read_text(path).split()


def test_every_page_of_a_simulated_lot_says_so(certificate: Certificate, tmp_path: Path) -> None:
    for name, reference, is_marked in (("simulated", SIMULATED, True), ("measured", CELL, False)):
        path = tmp_path / f"{name}.pdf"
        path.write_bytes(certificate_pdf(replace(certificate, reference=reference)))
        pages = read_pages(path)
        assert len(pages) > 1
        assert all(("SIMULATED" in page) == is_marked for page in pages)


def test_every_family_of_maps_has_a_name_on_paper_and_the_certificate_bears_it(certificate: Certificate) -> None:
    assert set(METHODS) == {*FAMILIES, "shared_load"}
    for family in FAMILIES:
        renamed = replace(certificate, map_family=family)
        assert escape(renamed.method) in certificate_xml(renamed).decode()
        assert ("optimal transport" in renamed.method) == (family in ("exact", "joint", "monotone"))


def test_the_pdf_is_archival_and_carries_the_dcc(certificate: Certificate, tmp_path: Path) -> None:
    for number, variant in enumerate([*_variants(certificate), replace(certificate, **NOBODY)]):
        path = tmp_path / f"{number}.pdf"
        path.write_bytes(certificate_pdf(variant))
        with pikepdf.open(path) as pdf:
            with pdf.open_metadata() as metadata:
                assert (metadata["pdfaid:part"], metadata["pdfaid:conformance"]) == ("3", "B")
                assert metadata["dc:title"] == str(pdf.docinfo["/Title"])
            (intent,) = pdf.Root.OutputIntents
            assert intent.S == "/GTS_PDFA1" and int(intent.DestOutputProfile.N) == 3
            ImageCms.ImageCmsProfile(io.BytesIO(intent.DestOutputProfile.read_bytes()))
            (file,) = pdf.Root.AF
            assert file.AFRelationship == "/Alternative" and str(file.UF) == "certificate-A1.xml"
            assert file.EF.F.read_bytes() == certificate_xml(variant)
            assert not pdf.is_encrypted and pdf.trailer["/ID"]
            assert all("/ca" not in str(page.obj.get("/Resources")) for page in pdf.pages)
        text = read_text(path)
        assert all(read_fonts(path).values()) and variant.identifier in text and "ZZ" not in text


def test_everything_that_iso_17025_asks_for_stands_on_it(certificate: Certificate, tmp_path: Path) -> None:
    """ISO/IEC 17025:2017, 7.8.2.1 a to p and 7.8.4.1."""
    path = tmp_path / "full.pdf"
    path.write_bytes(certificate_pdf(certificate))
    text = read_text(path)
    for required in (
        "Calibration certificate",  # a
        "Press shop & Söhne, Teheran-ro 1, 06234, Seoul, KR",  # b
        "Hall 3",  # c
        "softcal-A1-r2-01234567",  # d
        "Page 1 of",
        "End of the certificate",
        "Glove maker, Munich, DE, quality@example.com",  # e
        "time-delay network",  # f
        "condition: new, no visible damage",  # g
        "Received 2026-03-01",  # h
        "2026-03-02",  # i
        "issued on 2026-03-09",  # j
        "relate only to the item",  # l
        "no deviations at all",  # n
        "K. Jeon, head",  # o
        "U_est",  # 7.8.4.1 a
        "23 °C, 41 % relative humidity",  # b
        "certificate D-K-1 of DAkkS",  # c
        "Without calibration 0.800 N",  # d
        "ILAC-G8:09/2019",  # e
        "0.44",
        "eGaIn <3 mm>",
        "0.012 N",
        "0.210 N",
        "0.150 to 0.300 N",
        "A0",
    ):
        assert required in text, required
    assert "90 %" not in text


def test_equal_content_gives_an_equal_pdf(certificate: Certificate) -> None:
    assert certificate_pdf(certificate) == certificate_pdf(replace(certificate))


KOREAN = Laboratory(
    laboratory=Party("한국소프트센서 교정실", "lab@example.co.kr", "KR", "서울특별시"),
    customer=Party("Gesellschaft für Handschuhrobotik " * 4, "quality@example.com", "DE", "München"),
    person=Person("전상훈", "교정 책임자"),
)


def test_names_in_other_letters_and_long_serials_are_written_in_full(certificate: Certificate, tmp_path: Path) -> None:
    serial = "LINE-4-UNIT-" + "0123456789" * 12
    renamed = replace(certificate, laboratory=KOREAN, serial=serial)
    content = certificate_pdf(renamed)
    assert content == certificate_pdf(renamed)
    path = tmp_path / "korean.pdf"
    path.write_bytes(content)
    text = "".join(read_text(path).split())
    assert "한국소프트센서교정실" in text and "전상훈,교정책임자" in text
    assert serial in text
    fonts = read_fonts(path)
    assert len(fonts) == 3 and all(fonts.values())
    # The package's own: two computers write the same bytes.
    assert any("KoreanSans" in name for name in fonts)


def test_the_packages_font_has_every_korean_syllable_and_all_that_the_korean_texts_say() -> None:
    font = register_file(KOREAN_FONT)
    assert has_all(font, "".join(map(chr, range(0xAC00, 0xD7A4))))
    for sentence in catalogue()["ko"].values():
        assert all(has_all(PLAIN, letter) or has_all(font, letter) for letter in writable(sentence)), sentence
    assert Path(KOREAN_FONT).with_name("OFL.txt").is_file() and Path(KOREAN_FONT).stat().st_size < 2_000_000


@pytest.mark.parametrize(
    ("name", "printed_name"),
    [
        ("A\t1", "A 1"),
        ("A\r\n1", "A 1"),
        ("A\u00a01\u2009x\u2028y", "A 1 x y"),
        ("\ufeffA\u200b1\u202e", "A1"),
        ("A\x00\x1b[2J1", r"A\x00\x1b[2J1"),
        ("A\udc801", r"A\udc801"),
        (unicodedata.normalize("NFD", "로트 é"), "로트 é"),
        ("뉴턴 µ Ω α Ж ㎜ × ≤", "뉴턴 µ Ω α Ж ㎜ × ≤"),
        ("<b>&amp;", "<b>&amp;"),
    ],
)
def test_no_character_of_a_name_breaks_a_paper(certificate: Certificate, name: str, printed_name: str) -> None:
    laboratory = replace(KOREAN, laboratory=replace(KOREAN.laboratory, name=name), person=Person(name, name))
    lot = of_lot(certificate, sensor_model=name, reference_unit=name, output_unit=name)
    renamed = replace(lot, laboratory=laboratory, identifier=name, reasons=(name,))
    pdf = certificate_pdf(renamed)
    text = "".join(read_text(pdf).split())
    # Sensor model, laboratory, person, and the footer.
    assert text.count("".join(printed_name.split())) >= 4
    dcc = " ".join(ET.fromstring(certificate_xml(renamed)).itertext())
    assert printed_name in unicodedata.normalize("NFC", dcc) or not name.isprintable()
    with pikepdf.open(io.BytesIO(pdf)) as opened, opened.open_metadata() as metadata:
        assert printed_name in " ".join(str(metadata["dc:title"]).split())


def test_a_name_no_font_can_write_is_refused_with_what_to_do(
    certificate: Certificate, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("SOFTCAL_FONT", str(tmp_path / "nowhere.ttf"))
    with pytest.raises(InputError, match="SOFTCAL_FONT"):
        certificate_pdf(replace(certificate, laboratory=KOREAN))
    (tmp_path / "broken.ttf").write_bytes(b"no font")
    monkeypatch.setenv("SOFTCAL_FONT", str(tmp_path / "broken.ttf"))
    with pytest.raises(InputError, match="broken.ttf"):
        certificate_pdf(replace(certificate, laboratory=KOREAN))
    monkeypatch.delenv("SOFTCAL_FONT")
    with pytest.raises(InputError, match="SOFTCAL_FONT"):
        certificate_pdf(
            replace(
                certificate,
                laboratory=replace(KOREAN, laboratory=Party("\N{GOTHIC LETTER AHSA}", "a@b.c", "DE", "Ulm")),
            )
        )


LABORATORY = """
[laboratory]
name = "Works"
country = "KR"
[load_cell]
certificate = "D-K-1"
due_on = 2028-02-02
uncertainty_N = 0.012
[performance]
at = "other"
"""


def test_a_laboratory_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "laboratory.toml"
    path.write_text(LABORATORY)
    laboratory = read_laboratory(path)
    assert laboratory.laboratory.name == "Works"
    assert laboratory.load_cell.due_on == date(2028, 2, 2)
    assert laboratory.load_cell.certificate == "D-K-1" and laboratory.performance.at == "other"


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (('country = "KR"', 'country = "Korea"'), "Korea"),
        (("due_on = 2028-02-02", 'due_on = "soon"'), "due_on"),
        (("uncertainty_N = 0.012", 'uncertainty_N = "small"'), "uncertainty_N"),
        (("[load_cell]", "[loadcell]"), "loadcell"),
        (('name = "Works"', 'nane = "Works"'), r"\[laboratory\]"),
        (("[laboratory]", "[laboratory"), "laboratory.toml"),
        (('at = "other"', 'at = "the moon"'), "the moon"),
    ],
)
def test_a_wrong_laboratory_file_is_refused(tmp_path: Path, changed: tuple[str, str], message: str) -> None:
    path = tmp_path / "laboratory.toml"
    path.write_text(LABORATORY.replace(*changed))
    with pytest.raises(InputError, match=message):
        read_laboratory(path)


def _page_text(pdf: bytes) -> str:
    pages = PdfReader(io.BytesIO(pdf)).pages
    return " ".join(" ".join(page.extract_text() for page in pages).split())


def test_what_nobody_stated_of_the_reference_is_not_stated_and_never_zero(certificate: Certificate) -> None:
    unstated = replace(certificate, limit=Limit("N", 0.4), reference=None, budget=measured_budget(0.22, None, 2.0))
    assert unstated.limit is not None and unstated.limit.acceptance_rmse == unstated.limit.maximum_rmse
    for content in (certificate_xml(unstated).decode(), _page_text(certificate_pdf(unstated))):
        (budget_line,) = re.findall(r"U_ref: reference(?:(?!AL:).)*", content, re.S)[:1]
        assert "not stated" in budget_line and not re.search(r"\b0 N\b|>0<", budget_line)
