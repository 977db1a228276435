"""One unit, one word: every surface says the verdict that was decided, whatever was forecast, found and measured."""

import shutil
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, date, datetime
from functools import partial
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from softcal.app.batch.report import BatchReport, report_json, table_row
from softcal.app.charts.explanation import explanation_figure
from softcal.app.charts.palette import palette
from softcal.app.cli.main import main
from softcal.app.export.calibrated_unit import ExportOptions, UnitLoader
from softcal.app.export.certificates.content import build_certificate
from softcal.app.export.certificates.dcc import certificate_xml
from softcal.app.export.certificates.pdf import certificate_pdf
from softcal.app.export.export import export_units, lot_serials
from softcal.app.export.manifest import read_manifest
from softcal.app.line.status import Screen, read_line
from softcal.app.registry.quality import lot_yields
from softcal.app.registry.unit_status import caution
from softcal.app.texts.catalogue import text
from softcal.app.views.line import LineView, line_view
from softcal.app.views.unit import unit_view
from softcal.core.errors import InputError
from softcal.core.export.blob import CONDITIONAL, FAILED
from softcal.core.lot import UnitKey
from softcal.core.messages.reason import reason
from softcal.core.orders import Heartbeat, Order, OrderKind, Progress, RunState, StationState
from softcal.core.unit.budget import Reference
from softcal.core.unit.measured_error import MeasuredError, Scores
from softcal.core.unit.state import UnitState
from softcal.core.unit.uncertainty import ErrorForecast
from softcal.core.unit.verdict import (
    Finding,
    Limit,
    Release,
    Verdict,
    worst_of,
)
from softcal.db.connection import open_registry
from softcal.db.entries import UnitResult
from softcal.db.registry import Registry
from softcal.db.repositories.lot_pages import UnitFilter
from tests.app.pdf_text import read_text
from tests.unit_states import audit_of

DRAWS = 200
DCC = {"dcc": "https://ptb.de/dcc"}
LIMIT = Limit("N", 0.3)
CELL = Reference("LC-7", "D-K-1", due_on=date(2099, 1, 1), used_on=date(2026, 2, 1), uncertainty=0.01)
TOO_LITTLE_DATA = reason("too_little_data", windows=3, presses=1, enough_windows=500, enough_presses=3)


@pytest.fixture(scope="module")
def lot(trained_lot: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Registry, str]]:
    """A registry in which the small lot is calibrated, and the lot's id."""
    folder = tmp_path_factory.mktemp("verdicts")
    shutil.copytree(trained_lot / "lot", folder / "lot")
    shutil.copy(trained_lot / "registry.db", folder / "registry.db")
    url = f"sqlite:///{folder / 'registry.db'}"
    toml = folder / "lot/lot.toml"
    toml.write_text(toml.read_text().replace("rmse = 0.16", f"rmse = {LIMIT.maximum_rmse}"))
    assert main(["batch", str(folder / "lot"), "--registry", url, "--hidden", "16,8", "--no-own"]) in (0, 1)
    with open_registry(url) as registry:
        yield registry, registry.lots.all()[0].id


def draw_state(rng: np.random.Generator, state: UnitState, number: int) -> UnitState:
    """Return the state with another forecast, finding and audit."""
    rmse = float(rng.uniform(0.02, 0.8))
    forecast = ErrorForecast(rmse, rmse * float(rng.uniform(0.3, 1)), rmse * float(rng.uniform(1, 3)))
    findings = tuple(Finding(TOO_LITTLE_DATA, Verdict(word)) for word in rng.choice(list(Verdict), rng.integers(0, 3)))
    audit = None
    if rng.random() < 0.5:
        before, after = (float(error) for error in rng.uniform(0.02, 0.8, 2))
        rows = int(rng.integers(50, 3000))
        fitted = replace(
            audit_of(state, before, after), scores=Scores(MeasuredError(before, rows), MeasuredError(after, rows))
        )
        audit = replace(fitted, map_id="")
    fit = replace(
        state.fit, id=f"{number:064x}", forecast=forecast, findings=findings, rule_findings=(), reference=CELL
    )
    fit = replace(fit, blocking_reasons=())
    unaudited = replace(state, fit=fit, limit=LIMIT, trim=None, correction=None, release=None, audit=None)
    return unaudited if audit is None else replace(unaudited, audit=replace(audit, map_id=unaudited.map_id))


def documents(registry: Registry) -> tuple[str, str, str]:
    """Return the words of certificate, its conformity and device file of the unit in use."""
    unit = UnitLoader(registry, ExportOptions(failed_too=True)).load("A1")
    certificate = build_certificate(unit)
    conformity = ET.fromstring(certificate_xml(certificate)).findtext(".//dcc:statement/dcc:conformity", None, DCC)
    assert certificate.error is not None and certificate.limit is not None
    assert conformity != "pass" or certificate.error.upper <= certificate.limit.acceptance_rmse
    assert (certificate.error.rmse > certificate.limit.maximum_rmse) <= (conformity in ("fail", None))
    return (
        certificate.verdict,
        {"pass": "pass", "conditionalPass": "conditional", "fail": "fail", None: "retest"}[conformity],
        {0: "pass", CONDITIONAL: "conditional", FAILED: "not released"}[unit.device_unit.file.flags],
    )


def store_press(registry: Registry, lot_id: str) -> None:
    """Leave what a station leaves once it has pressed A1 and found it good."""
    order = Order("press", "line-1", OrderKind.UNIT, "A1", lot_id, "kim")
    registry.order_queue.write_heartbeat(Heartbeat("line-1", StationState.READY, datetime.now(UTC)))
    registry.order_queue.place(order)
    registry.order_queue.take("line-1")
    registry.order_queue.report(Progress("press", RunState.DONE, "done", 1.0, verdict="pass"))


def line_card(registry: Registry) -> LineView:
    """Return what the operator's screen shows now."""
    registry.order_queue.write_heartbeat(Heartbeat("line-1", StationState.READY, datetime.now(UTC)))
    return line_view(read_line(registry, Screen("line-1")), "", partial(text, "en"))


@pytest.mark.long
def test_every_surface_says_the_same_word(lot, rng):
    registry, lot_id = lot
    first = registry.calibrations.get("A1").state
    verdicts = set()
    store_press(registry, lot_id)
    for number in range(DRAWS):
        state = draw_state(rng, first, number)
        registry.calibrations.add(lot_id, state)
        measured, predicted = state.decision.measured, state.decision.predicted.verdict
        # A forecast alone promises nothing: without an audit the best word is conditional.
        word = measured.verdict if measured else worst_of([predicted, Verdict.CONDITIONAL])
        verdicts.add(word)
        stored = registry.calibrations.get("A1")
        result = UnitResult(
            "A1",
            stored.state.verdict,
            stored.state.decision.reasons,
            calibration=replace(registry.pages.unit_statuses(lot_id, ["A1"])["A1"].calibration, state=state),
        )
        report = BatchReport(lot_id, None, (result,), 0.0)  # type: ignore[arg-type]
        (unit,) = registry.lots.units(lot_id, "A1")
        (page,) = [u for u in registry.pages.unit_page(lot_id, UnitFilter()).units if u.serial == "A1"]
        assert {stored.state.verdict, unit.verdict, page.verdict, result.verdict, str(table_row(result)[1])} == {word}
        card = line_card(registry)
        assert {card.state.removesuffix("_used_up"), card.word.lower(), card.chips[0].word.lower()} == {word}
        assert report.has_passed == (word is Verdict.PASS)
        assert report.counts == {str(v): int(v is word) for v in Verdict}
        assert report.releases(result) == (word is Verdict.PASS)
        assert replace(report, release=Release.CONDITIONAL).releases(result) == (word in ("pass", "conditional"))
        # Files may be asked for of conditional units; released they are not.
        (row,) = report_json(replace(report, release=Release.CONDITIONAL, network=Mock()))["units"]
        assert row["released"] == (word is Verdict.PASS)
        assert bool(caution(registry, stored, "test")) == (word is not Verdict.PASS)
        last = lot_yields(registry, lot_id).last_pass.count
        others = sum(
            u.verdict == "pass" for u in registry.lots.units(lot_id) if u.serial != "A1" and u.role == "target"
        )
        assert last - others == (word is Verdict.PASS)
    assert verdicts == set(Verdict)


@pytest.mark.parametrize("word", list(Verdict))
def test_documents_and_files_say_the_same_word(lot, word, tmp_path):
    registry, lot_id = lot
    rng = np.random.default_rng(7)
    first = registry.calibrations.get("A1", 1).state
    state = next(one for one in (draw_state(rng, first, 1000 + k) for k in range(500)) if one.verdict == word)
    registry.calibrations.add(lot_id, state)
    assert documents(registry) == (word, word, word if word in ("pass", "conditional") else "not released")
    unit = UnitLoader(registry, ExportOptions()).load("A1")
    read = read_text(certificate_pdf(build_certificate(unit))).split()
    verdicts_shown = {other for other in Verdict if other.upper() in read}
    assert verdicts_shown == {word} - {Verdict.RETEST}, "nothing can be stated of a unit that has to be tested again"
    title = explanation_figure(
        unit_view(registry, UnitKey("small", "A1")), palette("light"), partial(text, "en")
    ).layout.title.text
    assert text("en", f"verdict.{word}") in title
    (exported,) = export_units(registry, ["A1"], ("blob",), tmp_path / "out")
    assert bool(exported.files) == (word is Verdict.PASS)
    assert read_manifest(tmp_path / "out").units["A1"]["verdict"] == word
    assert "A1" in lot_serials(registry, lot_id, ExportOptions(failed_too=True))
    try:
        assert ("A1" in lot_serials(registry, lot_id, ExportOptions())) == (word is Verdict.PASS)
    except InputError:
        assert word is not Verdict.PASS


def test_a_worse_verdict_takes_the_files_back(trained_lot, tmp_path, capsys):
    shutil.copytree(trained_lot / "lot", tmp_path / "lot")
    url, out = f"sqlite:///{tmp_path / 'r.db'}", tmp_path / "out"
    batch = ["batch", str(tmp_path / "lot"), "--registry", url, "--hidden", "16,8", "--no-own", "--out", str(out)]
    main(batch)
    released = {path.name for path in out.iterdir() if path.name.startswith("unit-")}
    assert released
    main(["lot", "limit", "small", "--registry", url, "--rmse", "0.0001", "--reason", "too strict", "--yes"])
    assert not [path for path in out.iterdir() if path.name.startswith("unit-")]
    capsys.readouterr()
    assert main(batch) == 1
    assert "were taken back" not in capsys.readouterr().err, "they were gone already"
    assert not [path for path in out.iterdir() if path.name.startswith("unit-")]
    units = read_manifest(out).units.values()
    assert units and all(unit_row["verdict"] == "fail" and unit_row["withdrawn"] for unit_row in units)
    assert {file.serial for file in read_manifest(out).files.values()} == {None}
