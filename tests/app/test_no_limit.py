"""Without a stated limit nothing passes: no word, no file, no paper and no release by sample says so."""

import json
import re
import xml.etree.ElementTree as ET
from functools import partial

import pytest

import softcal
from softcal.app.calibration.release import read_lot_status
from softcal.app.charts.explanation import explanation_page
from softcal.app.cli.main import main
from softcal.app.export.calibrated_unit import ExportOptions, UnitLoader
from softcal.app.export.certificates.content import build_certificate
from softcal.app.export.certificates.dcc import certificate_xml
from softcal.app.export.certificates.lot_statement import build_lot_statement, lot_statement_pdf
from softcal.app.texts.catalogue import text
from softcal.app.views.lot import lot_view
from softcal.app.views.unit import unit_view
from softcal.core.lot import UnitKey
from softcal.db.connection import open_registry
from tests.app.pdf_text import read_text

SMALL = ("--hidden", "16,8", "--no-own")
LIMIT = "[limit]\nrmse = 0.16\n"


def batch(folder, url, file, *more):
    code = main(["batch", str(folder), "--registry", url, "--json", str(file), *SMALL, *more])
    return code, json.loads(file.read_text())


@pytest.fixture
def unlimited(lot_folder, trained_lot, tmp_path):
    """The small lot without its limit, and a registry that never heard of one."""
    toml = lot_folder / "lot.toml"
    assert LIMIT in toml.read_text()
    toml.write_text(toml.read_text().replace(LIMIT, ""))
    return lot_folder, f"sqlite:///{tmp_path / 'unlimited.db'}"


def test_no_unit_passes_and_no_file_is_written_whatever_was_measured(unlimited, tmp_path):
    folder, url = unlimited
    out = tmp_path / "out"
    code, report = batch(folder, url, tmp_path / "batch.json", "--out", str(out))
    assert code == 1 and report["counts"]["pass"] == 0 and report["release"]["released"] == []
    assert {unit["verdict"] for unit in report["units"]} == {"conditional"}
    assert not any(unit["released"] for unit in report["units"])
    for unit in report["units"]:
        (reason,) = [why for why, code in zip(unit["reasons"], unit["reason_codes"], strict=True) if code == "no_limit"]
        assert "no limit was stated" in reason and "% of the range" in reason
    assert not [file for file in out.rglob("*") if any(unit["serial"] in file.name for unit in report["units"])]
    with open_registry(url) as registry:
        certificate = build_certificate(UnitLoader(registry, ExportOptions()).load("A1"))
        assert (
            certificate.withholding_codes[0] in ("simulated", "no_limit")
            and "no_limit" in certificate.withholding_codes
        )
        assert certificate.verdict == "conditional" and not certificate.conformity
        assert ET.fromstring(certificate_xml(certificate)).find(".//{https://ptb.de/dcc}conformity") is None
        assert softcal.Unit.from_registry(registry, "A1").verdict == "conditional"
    _, report = batch(folder, url, tmp_path / "batch.json", "--out", str(out), "--release", "conditional")
    assert [file for file in out.rglob("*") if "A1" in file.name]
    # The number that was derived, confirmed as it is, is another limit: a person agreed on it.
    with open_registry(url) as registry:
        derived = registry.calibrations.get("A1").state.limit.maximum_rmse
    (folder / "lot.toml").write_text((folder / "lot.toml").read_text() + f"[limit]\nrmse = {derived!r}\n")
    _, report = batch(folder, url, tmp_path / "batch.json")
    assert {unit["verdict"] for unit in report["units"]} == {"pass"}


def test_no_page_and_no_paper_holds_an_error_against_a_limit_that_nobody_stated(unlimited, tmp_path, capsys):
    folder, url = unlimited
    (folder / "audit").rename(folder.parent / "measured")
    batch(folder, url, tmp_path / "batch.json")
    assert main(["lot", "audit-plan", "small", "--random", "3", "--registry", url]) == 0
    (folder.parent / "measured").rename(folder / "audit")
    batch(folder, url, tmp_path / "batch.json")
    with open_registry(url) as registry:
        view, status = lot_view(registry, "small"), read_lot_status(registry, "small")
        assert view.limit_rmse is None and view.process.capability is None
        page = explanation_page(unit_view(registry, UnitKey("small", "A1")), script=False)
        assert len(status.decided.audits) == 3
        statement = build_lot_statement(registry, status, status.decided)
        paper = lot_statement_pdf(statement, partial(text, "en"))
    assert not re.search(r"[Ll]imit [0-9]", page)
    assert "within" not in read_text(paper).split("What it means")[0]
    capsys.readouterr()
    main(["lot", "release", "small", "--registry", url])
    assert not {"within", "beyond"} & set(capsys.readouterr().out.split())


@pytest.mark.long
def test_audits_release_no_unmeasured_unit_where_no_limit_is_stated(make_lot, registry_url, tmp_path):
    folder = make_lot()
    toml = (folder / "lot.toml").read_text()
    (folder / "lot.toml").write_text(toml.split("[limit]")[0])
    (folder / "audit").rename(folder.parent / "measured")
    batch(folder, registry_url, tmp_path / "batch.json")
    assert main(["lot", "audit-plan", "large", "--random", "99", "--registry", registry_url]) == 0
    (folder.parent / "measured").rename(folder / "audit")
    _, report = batch(folder, registry_url, tmp_path / "batch.json")
    assert report["release"]["released"] == [] and report["counts"]["pass"] == 0
    assert "no limit was stated" in report["release"]["statement"]
    (folder / "lot.toml").write_text(toml)
    _, report = batch(folder, registry_url, tmp_path / "batch.json")
    assert sum(unit["verdict"] == "pass" and not unit["audited"] for unit in report["units"]) == 4


def test_python_passes_nothing_without_a_limit(press_unit):
    network = softcal.fit_network(press_unit(1500, 1.0, 0.5, 1), hidden=(16, 8))
    target, audit = press_unit(1500, 1.2, 0.55, 11), press_unit(600, 1.2, 0.55, 51)
    verdicts = [softcal.fit_map(network, target, audit=audit, limit_rmse=limit).verdict for limit in (None, 0.5)]
    assert verdicts == ["conditional", "pass"]
