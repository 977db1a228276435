"""Certificates: one set of facts, a DCC that is valid against its schema, a PDF that says the same."""

import os
import shutil
import subprocess
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pytest
import xmlschema

from softcal.app.export.certificates.content import Certificate, Uncertainty
from softcal.app.export.certificates.dcc import SI_UNITS, certificate_xml
from softcal.app.export.certificates.fonts import CANDIDATES
from softcal.app.export.certificates.laboratory import Conditions, Laboratory, LoadCell, Party, Person, read_laboratory
from softcal.app.export.certificates.pdf import certificate_pdf
from softcal.core.errors import InputError
from softcal.core.unit.estimate import Estimate

PROFILE = Path(__file__).parent / "dcc_profile"
NAMESPACES = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}


@pytest.fixture
def facts() -> Certificate:
    t_s = np.arange(1500) / 50
    force_N = 1.5 - 1.5 * np.cos(t_s)
    estimated = Estimate(t_s, force_N, force_N - 0.1, force_N + 0.1, np.full(1500, "", dtype="<U12"))
    return Certificate(
        identifier="softcal-A1-r2-01234567",
        made_on=date(2026, 3, 4),
        laboratory=Laboratory(
            Party("Press shop & Söhne", "lab@example.com", "KR", "Seoul"),
            Party("Glove maker", "quality@example.com", "DE", "Munich"),
            Person("K. Jeon", "head"),
            LoadCell("Futek", "LSB200", "LC-7", "D-K-1", "ab" * 32, "DAkkS", date(2026, 1, 1), date(2028, 1, 1), 0.012),
            Conditions(23.0, 41.0),
        ),
        serial="A1",
        revision=2,
        lot="lot-1",
        sensor_model="eGaIn <3 mm>",
        source="A0",
        quantity="force",
        output_unit="V",
        reference_unit="N",
        sample_rate_Hz=50.0,
        samples=1500,
        low=0.0,
        high=3.0,
        expected=0.21,
        expected_interval=(0.15, 0.3),
        limit=0.4,
        limit_origin="stated for the lot",
        conformity="pass",
        verdict="pass",
        reasons=("predicted error is within the limit",),
        before=0.8,
        measured=0.22,
        map_family="affine",
        hashes=(("network", "12" * 32), ("map", "34" * 32), ("unit's recording", "56" * 32)),
        bands=(Uncertainty(0.0, 1.5, 0.3), Uncertainty(1.5, 3.0, 0.4)),
        output=np.linspace(0.5, 0.7, 60),
        mapped=np.linspace(0.4, 0.8, 60),
        estimated=estimated,
        software="softcal 1.2.3",
    )


@pytest.fixture(scope="module")
def schema() -> xmlschema.XMLSchema:
    """The PTB's own schema where SOFTCAL_DCC_SCHEMA names its folder, else the stricter profile kept here."""
    folder = Path(os.environ.get("SOFTCAL_DCC_SCHEMA", PROFILE))
    return xmlschema.XMLSchema(folder / "dcc.xsd")


def _variants(facts: Certificate) -> list[Certificate]:
    bare = replace(facts, laboratory=Laboratory(), sensor_model="", measured=None, before=None)
    unknown = replace(bare, expected=None, expected_interval=None, limit=None, conformity="", verdict="retest")
    loose = replace(
        facts, sensor_model=" eGaIn\n3 mm ", laboratory=Laboratory(Party(" Works ", "a@b.c ", "KR", "\tSeoul"))
    )
    others = [
        replace(facts, reference_unit="strain counts"),
        replace(facts, bands=()),
        replace(facts, sensor_model=" "),
    ]
    return [facts, bare, unknown, loose, *others]


def test_every_certificate_is_valid_against_the_schema(facts: Certificate, schema: xmlschema.XMLSchema) -> None:
    for variant in _variants(facts):
        schema.validate(certificate_xml(variant))


def test_the_schema_used_here_refuses_what_is_wrong(facts: Certificate, schema: xmlschema.XMLSchema) -> None:
    good = certificate_xml(facts)
    for wrong in (
        good.replace(b'schemaVersion="3.1.2"', b'schemaVersion="3.1.1"'),
        good.replace(b"<dcc:conformity>pass", b"<dcc:conformity>perhaps"),
        good.replace(b"<si:value>0.21<", b"<si:value>0,21<"),
        good.replace(b"2026-03-04", b"4 March"),
    ):
        assert wrong != good
        assert not schema.is_valid(wrong)


@pytest.mark.parametrize(("unit", "value", "name"), [("N", 0.21, r"\newton"), ("bar", 21.0, r"\kilo\pascal")])
def test_numbers_are_in_si_units(facts: Certificate, unit: str, value: float, name: str) -> None:
    document = ET.fromstring(certificate_xml(replace(facts, reference_unit=unit)))
    real = document.find(".//dcc:results//si:real", NAMESPACES)
    assert real is not None
    found = {element.tag.rpartition("}")[2]: element.text for element in real.iter()}
    assert (float(str(found["value"])), found["unit"]) == (pytest.approx(value), name)
    assert found["coverageProbability"] == "0.95"


def test_units_of_the_measured_sensors_are_known_to_d_si() -> None:
    assert {"N", "bar", "1"} <= set(SI_UNITS)


def test_without_a_load_cell_it_says_that_nothing_is_traceable(facts: Certificate) -> None:
    bare = replace(facts, laboratory=Laboratory())
    text = certificate_xml(bare).decode()
    assert "<dcc:traceable>false" in text
    assert "not metrologically traceable" in text
    assert "<dcc:traceable>true" in certificate_xml(facts).decode()


def test_the_same_facts_give_the_same_pdf(facts: Certificate) -> None:
    assert certificate_pdf(facts) == certificate_pdf(replace(facts))


def test_the_pdf_says_what_an_auditor_asks_for(
    facts: Certificate, tmp_path: Path, require: Callable[[object, str], None]
) -> None:
    require(shutil.which("pdftotext"), "pdftotext is missing; apt-get install poppler-utils")
    for number, variant in enumerate(_variants(facts)):
        path = tmp_path / f"{number}.pdf"
        path.write_bytes(certificate_pdf(variant))
        text = subprocess.run(
            ["pdftotext", "-layout", str(path), "-"], capture_output=True, text=True, check=True
        ).stdout
        assert variant.identifier in text
        assert "ILAC-G8:09/2019" in text and "Page 1 of" in text
    first = subprocess.run(
        ["pdftotext", str(tmp_path / "0.pdf"), "-"], capture_output=True, text=True, check=True
    ).stdout
    wanted = ("Press shop & Söhne", "eGaIn <3 mm>", "D-K-1", "U = 0.012 N, k = 2", "0.21 N (95 %: 0.15 to 0.3 N)", "A0")
    assert all(word in first for word in wanted)


KOREAN = Laboratory(
    laboratory=Party("한국소프트센서 교정실", "lab@example.co.kr", "KR", "서울특별시"),
    customer=Party("Gesellschaft für Handschuhrobotik " * 4, "quality@example.com", "DE", "München"),
    person=Person("전상훈", "교정 책임자"),
)


def test_names_in_other_letters_and_long_serials_are_written_in_full(
    facts: Certificate, tmp_path: Path, require: Callable[[object, str], None]
) -> None:
    require(Path(CANDIDATES["linux"][0]).exists(), "a Korean font is missing; apt-get install fonts-nanum")
    serial = "LINE-4-UNIT-" + "0123456789" * 12
    named = replace(facts, laboratory=KOREAN, serial=serial)
    content = certificate_pdf(named)
    assert content == certificate_pdf(named)
    path = tmp_path / "korean.pdf"
    path.write_bytes(content)
    text = "".join(_text_of(path).split())
    assert "한국소프트센서교정실" in text and "전상훈,교정책임자" in text
    assert serial in text
    fonts = subprocess.run(["pdffonts", str(path)], capture_output=True, text=True, check=True).stdout.splitlines()[2:]
    used = [line.split() for line in fonts if "Helvetica" not in line]  # ReportLab lists it, no text is set in it
    assert len(used) == 3 and all(words[-5] == "yes" for words in used)  # embedded


def test_a_name_no_font_can_write_is_refused_with_what_to_do(
    facts: Certificate, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("SOFTCAL_FONT", str(tmp_path / "nowhere.ttf"))
    with pytest.raises(InputError, match="SOFTCAL_FONT"):
        certificate_pdf(replace(facts, laboratory=KOREAN))
    (tmp_path / "broken.ttf").write_bytes(b"no font")
    monkeypatch.setenv("SOFTCAL_FONT", str(tmp_path / "broken.ttf"))
    with pytest.raises(InputError, match="no TrueType font"):
        certificate_pdf(replace(facts, laboratory=KOREAN))


def test_what_is_not_stated_is_said_once(facts: Certificate, tmp_path: Path) -> None:
    path = tmp_path / "bare.pdf"
    path.write_bytes(certificate_pdf(replace(facts, laboratory=Laboratory())))
    text = _text_of(path)
    assert "not stated, not stated" not in text and "ZZ" not in text


def _text_of(pdf: Path) -> str:
    command = ["pdftotext", "-layout", str(pdf), "-"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


LABORATORY = """
[laboratory]
name = "Works"
country = "KR"
[load_cell]
certificate = "D-K-1"
due_on = 2028-02-02
uncertainty_N = 0.012
"""


def test_a_laboratory_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "laboratory.toml"
    path.write_text(LABORATORY)
    found = read_laboratory(path)
    assert found.laboratory.name == "Works"
    assert found.load_cell.due_on == date(2028, 2, 2)
    assert found.load_cell.is_stated and not Laboratory().load_cell.is_stated


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (('country = "KR"', 'country = "Korea"'), "two capital letters"),
        (("due_on = 2028-02-02", 'due_on = "soon"'), "a date"),
        (("uncertainty_N = 0.012", 'uncertainty_N = "small"'), "a number"),
        (("[load_cell]", "[loadcell]"), "known: laboratory"),
        (('name = "Works"', 'nane = "Works"'), "takes name"),
        (("[laboratory]", "[laboratory"), "TOML"),
    ],
)
def test_a_wrong_laboratory_file_is_refused(tmp_path: Path, changed: tuple[str, str], said: str) -> None:
    path = tmp_path / "laboratory.toml"
    path.write_text(LABORATORY.replace(*changed))
    with pytest.raises(InputError, match=said):
        read_laboratory(path)
