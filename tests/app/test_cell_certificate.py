"""The load cell's certificate, typed in or read from a DCC in the form of PTB's good-practice examples."""

from datetime import date

import pytest

from softcal.app.cli.main import main
from softcal.app.line.cell_certificate import certificate_from
from softcal.core.errors import InputError
from softcal.db.connection import open_registry

DCC = r"""<?xml version="1.0" encoding="UTF-8"?>
<dcc:digitalCalibrationCertificate xmlns:dcc="https://ptb.de/dcc" xmlns:si="https://ptb.de/si" schemaVersion="3.2.1">
  <dcc:administrativeData>
    <dcc:coreData>
      <dcc:uniqueIdentifier>D-K-12345-2026-017</dcc:uniqueIdentifier>
      <dcc:beginPerformanceDate>2026-01-04</dcc:beginPerformanceDate>
      <dcc:endPerformanceDate>2026-01-05</dcc:endPerformanceDate>
    </dcc:coreData>
    <dcc:items>
      <dcc:item>
        <dcc:name><dcc:content lang="en">force transducer</dcc:content></dcc:name>
        <dcc:identifications>
          <dcc:identification><dcc:issuer>customer</dcc:issuer><dcc:value>INV-4711</dcc:value></dcc:identification>
          <dcc:identification refType="basic_serialNumber">
            <dcc:issuer>manufacturer</dcc:issuer><dcc:value>K-2041</dcc:value>
          </dcc:identification>
        </dcc:identifications>
      </dcc:item>
    </dcc:items>
    <dcc:calibrationLaboratory>
      <dcc:contact><dcc:name><dcc:content>Force Lab</dcc:content></dcc:name></dcc:contact>
    </dcc:calibrationLaboratory>
    <dcc:statements>
      <dcc:statement refType="basic_recalibration"><dcc:date>2027-01-05</dcc:date></dcc:statement>
    </dcc:statements>
  </dcc:administrativeData>
  <dcc:measurementResults><dcc:measurementResult><dcc:results><dcc:result><dcc:data>
    <dcc:quantity refType="basic_validityRangeMax">
      <si:real><si:value>0.05</si:value><si:unit>\kilo\newton</si:unit></si:real>
    </dcc:quantity>
    <dcc:quantity><si:real><si:value>10.003</si:value><si:unit>\newton</si:unit>
      <si:expandedUnc><si:uncertainty>0.012</si:uncertainty><si:coverageFactor>2</si:coverageFactor></si:expandedUnc>
    </si:real></dcc:quantity>
    <dcc:quantity><si:real><si:value>50.02</si:value><si:unit>\newton</si:unit>
      <si:measurementUncertaintyUnivariate><si:expandedMU>
        <si:valueExpandedMU>0.060</si:valueExpandedMU><si:coverageFactor>3</si:coverageFactor>
      </si:expandedMU></si:measurementUncertaintyUnivariate>
    </si:real></dcc:quantity>
    <dcc:quantity><si:real><si:value>23.1</si:value><si:unit>\degreecelsius</si:unit>
      <si:expandedUnc><si:uncertainty>0.5</si:uncertainty><si:coverageFactor>2</si:coverageFactor></si:expandedUnc>
    </si:real></dcc:quantity>
  </dcc:data></dcc:result></dcc:results></dcc:measurementResult></dcc:measurementResults>
</dcc:digitalCalibrationCertificate>
"""


@pytest.fixture
def dcc(tmp_path):
    path = tmp_path / "K-2041.xml"
    path.write_text(DCC)
    return path


def test_a_dcc_gives_everything_the_gate_needs(dcc):
    certificate = certificate_from({}, dcc)
    assert (certificate.cell_serial, certificate.number, certificate.laboratory) == (
        "K-2041",
        "D-K-12345-2026-017",
        "Force Lab",
    )
    assert (certificate.issued_on, certificate.due_on) == (date(2026, 1, 5), date(2027, 1, 5))
    assert certificate.capacity_N == pytest.approx(50.0)
    # The largest of all forces, at k = 2: 0.060 N at k = 3 is 0.040 N.
    assert certificate.uncertainty_N == pytest.approx(0.040)
    assert certificate.document == DCC.encode()


def test_an_option_outweighs_the_document(dcc):
    assert certificate_from({"due_on": date(2026, 7, 5), "number": None}, dcc).due_on == date(2026, 7, 5)


def test_everything_that_is_missing_is_named(dcc):
    dcc.write_text(DCC.replace("basic_recalibration", "other").replace("basic_validityRangeMax", "other"))
    with pytest.raises(InputError, match="due_on, capacity_N"):
        certificate_from({}, dcc)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("no xml", "K-2041.xml"),
        ("<html/>", "K-2041.xml"),
        (DCC.replace("2027-01-05", "next year"), "due_on"),
        (DCC.replace("0.05<", "much<"), "capacity_N"),
    ],
)
def test_a_file_that_cannot_be_read_is_one_clear_line(dcc, content, message):
    dcc.write_text(content)
    with pytest.raises(InputError, match=message):
        certificate_from({}, dcc)


def test_the_command_puts_a_dcc_on_file_and_lists_it(dcc, tmp_path, capsys):
    url = f"sqlite:///{tmp_path / 'r.db'}"
    assert main(["station", "certificate", "--dcc", str(dcc), "--registry", url]) == 0
    assert main(["station", "certificate", "--cell", "K-2041", "--registry", url]) == 0
    assert capsys.readouterr().out.count("D-K-12345-2026-017") == 2
    with open_registry(url) as registry:
        assert registry.stations.certificate("K-2041", date(2026, 6, 1)).document == DCC.encode()
        assert registry.stations.certificate("K-2041", date(2027, 1, 5)) is None
