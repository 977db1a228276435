"""One error of an audited unit: the RMSE of `estimate` on all rows of its audit, the same on every surface."""

import csv
import json
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import softcal
from softcal.app.cli.main import main
from softcal.app.export.calibrated_unit import ExportOptions, UnitLoader
from softcal.app.export.certificates.content import build_certificate
from softcal.app.export.certificates.dcc import certificate_xml
from softcal.app.views.audited import audited_view
from softcal.app.views.lot import lot_view
from softcal.core.windows import TAPS
from softcal.db.connection import open_registry

SMALL = ("--hidden", "16,8")
DCC = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}


def independent_rmse(audit: Path, estimate: Path) -> tuple[float, int]:
    """Return RMSE and rows by the files alone: what `estimate` wrote beside the reference of the audit."""
    estimated, reference = pd.read_parquet(estimate).estimate, pd.read_csv(audit).reference
    error = (estimated - reference).dropna()
    return float(np.sqrt(np.mean(np.square(error)))), len(error)


def estimated(url: str, audit: Path, out: Path) -> tuple[float, int]:
    command = ["estimate", "--registry", url, "--serial", audit.stem, str(audit), "--out", str(out)]
    assert main(command) == 0
    return independent_rmse(audit, out)


@pytest.fixture
def batched(lot_folder, registry_url, tmp_path):
    file, table = tmp_path / "batch.json", tmp_path / "table.csv"
    command = ["batch", str(lot_folder), "--registry", registry_url, "--json", str(file), "--csv", str(table), *SMALL]
    assert main(command) in (0, 1)
    with table.open() as rows:
        return json.loads(file.read_text()), {row["serial"]: row for row in csv.DictReader(rows)}


def test_every_surface_states_the_error_of_estimate_on_all_rows(batched, lot_folder, registry_url, tmp_path):
    report, table = batched
    listed = tmp_path / "list.json"
    assert main(["registry", "list", "--registry", registry_url, "--json", str(listed)]) == 0
    units = {unit["serial"]: unit for unit in json.loads(listed.read_text())["units"]}
    with open_registry(registry_url) as registry:
        view = lot_view(registry, "small")
        traces = audited_view(registry, view.lot, view.audited)
        assert traces is not None
        on_screen = {trace.serial: trace for trace in traces.units}
        for unit in report["units"]:
            serial = unit["serial"]
            audit = lot_folder / f"audit/{serial}.csv"
            rmse, rows = estimated(registry_url, audit, tmp_path / f"{serial}.parquet")
            assert rows == 600 - (TAPS - 1)
            assert unit["after_rmse"] == pytest.approx(rmse, rel=1e-12)
            scores = unit["audit_scores"]
            assert scores["after"] == {"rmse": unit["after_rmse"], "rows": rows}
            assert scores["unscored"] == {"warm-up": TAPS - 1, "gap": 0}
            assert scores["own"]["own"]["rmse"] == unit["own_rmse"] and scores["own"]["own"]["rows"] < rows
            trace = on_screen[serial]
            certificate = build_certificate(UnitLoader(registry, ExportOptions(failed_too=True)).load(serial))
            python = softcal.Unit.from_registry(registry, serial)
            rmse_by_surface = {
                "table": float(table[serial]["after"]),
                "list": units[serial]["after_rmse"],
                "report": next(row.after_rmse for row in view.audited if row.serial == serial),
                "figure": float(np.sqrt(np.mean((trace.estimate - trace.reference) ** 2))),
                "certificate": certificate.measured.rmse,
                "python": python.rmse(pd.read_csv(audit)),
                "frame": python.to_frame().after_rmse[0],
            }
            assert rmse_by_surface == pytest.approx(dict.fromkeys(rmse_by_surface, unit["after_rmse"]), rel=1e-12), (
                serial
            )
            why = registry.calibrations.get(serial).state.decision.measured.reasons
            (values,) = [one.values for one in why if one.code == "statement"]
            assert (values["lower"], values["upper"]) == (certificate.measured.lower, certificate.measured.upper)
            numbers = [
                float(one.findtext("si:real/si:value", "nan", DCC))
                for one in ET.fromstring(certificate_xml(certificate)).iterfind(".//dcc:quantity", DCC)
                if str(one.findtext("dcc:name/dcc:content", "", DCC)).startswith("Measured root mean square")
            ]
            assert numbers == [pytest.approx(rmse, rel=1e-6)]


def test_own_is_compared_on_the_rows_that_it_was_tested_on(batched, lot_folder, registry_url, tmp_path):
    """The last quarter by time: `estimate` on these rows over what the own network showed there."""
    report, table = batched
    for unit in report["units"]:
        serial, own_rmse = unit["serial"], unit["audit_scores"]["own"]
        estimated(registry_url, lot_folder / f"audit/{serial}.csv", tmp_path / "own.parquet")
        estimates = pd.read_parquet(tmp_path / "own.parquet").estimate
        error = (estimates - pd.read_csv(lot_folder / f"audit/{serial}.csv").reference)[-own_rmse["own"]["rows"] :]
        after = np.sqrt(np.mean(error**2))
        assert own_rmse["after"]["rmse"] == pytest.approx(after, rel=1e-12)
        (ratio,) = [float(cell) for name, cell in table[serial].items() if name.startswith("after/own")]
        assert ratio == pytest.approx(after / unit["own_rmse"], rel=1e-9)


@pytest.mark.long
def test_an_audited_unit_is_scored_with_the_corrected_map_that_estimate_uses(make_lot, registry_url, tmp_path):
    folder, file = make_lot(day_gain=1.2, limit_N=0.4), tmp_path / "batch.json"
    command = ["batch", str(folder), "--registry", registry_url, "--json", str(file), *SMALL, "--no-own"]
    assert main(command) in (0, 1)
    report = json.loads(file.read_text())
    assert report["release"]["corrected_by"] > 0
    audited = [unit for unit in report["units"] if unit["audited"]]
    with open_registry(registry_url) as registry:
        for unit in audited[:3]:
            audit = folder / f"audit/{unit['serial']}.csv"
            rmse, rows = estimated(registry_url, audit, tmp_path / "estimate.parquet")
            assert registry.calibrations.get(unit["serial"]).state.correction is not None
            assert (unit["after_rmse"], unit["audit_scores"]["after"]["rows"]) == (pytest.approx(rmse, rel=1e-12), rows)
            assert softcal.Unit.from_registry(registry, unit["serial"]).rmse(pd.read_csv(audit)) == unit["after_rmse"]
