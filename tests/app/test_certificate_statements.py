"""What a certificate states: only what somebody stated or the line measured, from the lot folder to PDF and DCC."""

import re
import xml.etree.ElementTree as ET
from datetime import UTC, datetime
from pathlib import Path

import pandas as pd
import pytest

from softcal.app.cli.main import main
from tests.app.pdf_text import read_text

DCC = {"dcc": "https://ptb.de/dcc"}
TOP = 'sample_rate_Hz = 50.0\nsource = "A0"\n[lot]\nid = "small"\n'
CELL = (
    '[reference]\nunit = "N"\ncell = "LC-7"\ncertificate = "D-K-1"\ndue_on = 2099-01-01\nuncertainty = 0.012\n'
    "used_on = {used_on}\n"
)
DECLARED_CELL = CELL.format(used_on="2026-06-01")
LIMIT = "[limit]\nrmse = 0.5\n"
OUTPUT = '[output]\nunit = "V"\n'
SIMULATED = 'simulated = true\n[reference]\nunit = "N"\n'


class Exported:
    """PDF and DCC of A1 as `softcal export` writes them."""

    def __init__(self, folder: Path, url: str) -> None:
        self.folder, self.url = folder, url

    def __call__(self, toml_text: str, laboratory: str = "") -> tuple[str, ET.Element]:
        """Calibrate the lot with these facts in `lot.toml`, export A1; the words of its PDF, and its DCC."""
        (self.folder / "lot.toml").write_text(TOP + toml_text + OUTPUT)
        batch = ["batch", str(self.folder), "--registry", self.url, "--hidden", "16,8", "--no-own"]
        assert main(batch) in (0, 1)
        return self.again(laboratory)

    def again(self, laboratory: str = "") -> tuple[str, ET.Element]:
        """Export A1 as it stands."""
        out, file = self.folder / "out", self.folder / "laboratory.toml"
        file.write_text(laboratory)
        command = ["export", "--registry", self.url, "--serial", "A1", "--format", "pdf", "--format", "dcc"]
        assert main([*command, "--laboratory", str(file), "--out", str(out)]) == 0
        return read_text(out / "certificate-A1.pdf"), ET.parse(out / "certificate-A1.xml").getroot()


@pytest.fixture
def exported(lot_folder: Path, registry_url: str) -> Exported:
    return Exported(lot_folder, registry_url)


def conformity(dcc: ET.Element) -> str | None:
    return dcc.findtext(".//dcc:conformity", None, DCC)


def limit_N(dcc: ET.Element) -> float:
    """Return the limit as the DCC shows it."""
    (value,) = (
        quantity.findtext(".//{https://ptb.de/si}value")
        for quantity in dcc.iter(f"{{{DCC['dcc']}}}quantity")
        if str(quantity.findtext("dcc:name/dcc:content", "", DCC)).startswith("TL")
    )
    return float(str(value))


def test_conformity_is_stated_only_against_a_limit_that_somebody_stated(exported: Exported) -> None:
    text, dcc = exported(DECLARED_CELL)
    assert conformity(dcc) is None and "PASS" not in text.split()
    assert 0 < limit_N(dcc) != 0.5
    text, dcc = exported(DECLARED_CELL + LIMIT)
    assert conformity(dcc) == "pass" and "PASS" in text.split()
    assert limit_N(dcc) == 0.5


def test_a_fail_against_a_limit_that_nobody_stated_is_no_statement_either(exported: Exported) -> None:
    audit = exported.folder / "audit" / "A1.csv"
    table = pd.read_csv(audit)
    table.assign(reference=1.5 * table["reference"]).to_csv(audit, index=False)
    text, dcc = exported(DECLARED_CELL)
    assert conformity(dcc) is None and "FAIL" not in text.split()
    text, dcc = exported(DECLARED_CELL + "[limit]\nrmse = 0.2\n")
    assert conformity(dcc) == "fail" and "FAIL" in text.split()


def test_a_simulated_unit_conforms_to_nothing(exported: Exported) -> None:
    text, dcc = exported(SIMULATED + LIMIT)
    assert conformity(dcc) is None and "PASS" not in text.split() and "SIMULATED" in text


def test_days_and_places_are_those_that_somebody_stated(exported: Exported) -> None:
    toml_text = 'at = "customer"\nbegan_on = 2026-02-02\nended_on = 2026-02-03\n'
    _, dcc = exported(DECLARED_CELL + LIMIT, f"[performance]\n{toml_text}")
    core = dcc.find(".//dcc:coreData", DCC)
    assert core is not None
    days = [core.findtext(f"dcc:{name}PerformanceDate", "", DCC) for name in ("begin", "end")]
    assert days == ["2026-02-02", "2026-02-03"]
    assert core.findtext("dcc:performanceLocation", "", DCC) == "customer"
    text, dcc = exported.again()
    today = datetime.now(UTC).date().isoformat()
    assert dcc.findtext(".//dcc:beginPerformanceDate", "", DCC) == today
    assert dcc.findtext(".//dcc:performanceLocation", "", DCC) == "other"
    assert not re.search(r"recorded\s+on\s+" + today, " ".join(text.split()))


def test_what_nobody_stated_about_people_and_makers_is_not_said(exported: Exported) -> None:
    toml_text = '[laboratory]\nname = "Works"\n'
    _, dcc = exported(DECLARED_CELL + LIMIT, toml_text)
    item = dcc.find(".//dcc:items/dcc:item", DCC)
    assert item is not None and item.findtext("dcc:manufacturer/dcc:name/dcc:content", "", DCC) != "Works"
    assert {issuer.text for issuer in dcc.iterfind(".//dcc:identification/dcc:issuer", DCC)}.isdisjoint(
        {"manufacturer", "customer", "owner"}
    )
    assert dcc.find(".//dcc:mainSigner", DCC) is None
    _, dcc = exported.again(f'{toml_text}[person]\nname = "K. Jeon"\n')
    assert dcc.findtext(".//dcc:mainSigner", "", DCC) == "true"


def test_the_range_is_what_the_unit_itself_was_pressed_over(exported: Exported) -> None:
    _, dcc = exported(DECLARED_CELL + LIMIT)
    units, out = exported.folder / "units" / "A1.csv", exported.folder / "estimates.csv"
    assert main(["estimate", "--registry", exported.url, "--serial", "A1", str(units), "--out", str(out)]) == 0
    highest_N = pd.read_csv(exported.folder / "source" / "A0.csv")["reference"].max()
    estimate = pd.read_csv(out)["estimate"]
    assert validity(dcc) == pytest.approx(estimate[estimate <= highest_N].max(), rel=1e-4)
    assert validity(dcc) < 0.999 * highest_N


def validity(dcc: ET.Element) -> float:
    """Return the upper end of the calibrated range."""
    limit_text = dcc.find(".//dcc:quantity[@refType='basic_validityRangeMax']", DCC)
    assert limit_text is not None
    return float(str(limit_text.findtext(".//{https://ptb.de/si}value")))


@pytest.mark.long
def test_what_known_loads_did_to_a_map_stands_on_the_certificate(exported: Exported, tmp_path: Path) -> None:
    toml_text = '[performance]\ndeviations = "no reference room"\n'
    _, dcc = exported(DECLARED_CELL + LIMIT, toml_text)
    assert [name for name in names(dcc) if name.startswith("Combined")]
    before = str(dcc.findtext(".//dcc:usedMethod/dcc:description/dcc:content", "", DCC))
    loads = tmp_path / "loads.csv"
    rise = [0.1 * load_N + 0.02 * load_N**2 for load_N in (0.0, 2.5)]
    output = [0.56 + 1.265 * value for value in rise]
    pd.DataFrame({"output": output, "reference": [0.0, 2.5]}).to_csv(loads, index=False)
    assert main(["trim", "--registry", exported.url, "--serial", "A1", "--loads", str(loads), "--yes"]) == 0
    _, dcc = exported.again(toml_text)
    after = str(dcc.findtext(".//dcc:usedMethod/dcc:description/dcc:content", "", DCC))
    assert after != before and "no reference room" in after
    assert not [name for name in names(dcc) if name.startswith("Combined")], (
        "no budget of the map before stands for this"
    )
    assert conformity(dcc) is None and dcc.findtext(".//dcc:traceable", "", DCC) == "false"


def names(dcc: ET.Element) -> list[str]:
    """Return what the quantities of the DCC are called."""
    return [str(one.text) for one in dcc.iterfind(".//dcc:quantity/dcc:name/dcc:content", DCC)]


def test_another_instrument_than_the_lots_is_refused(exported: Exported) -> None:
    exported(DECLARED_CELL + LIMIT, '[load_cell]\nserial = "LC-7"\n')
    (exported.folder / "laboratory.toml").write_text('[load_cell]\nserial = "LC-8"\nmodel = "another"\n')
    command = ["export", "--registry", exported.url, "--serial", "A1", "--format", "dcc"]
    laboratory = ["--laboratory", str(exported.folder / "laboratory.toml"), "--out", str(exported.folder / "out")]
    assert main([*command, *laboratory]) == 2
