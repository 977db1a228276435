"""A lot released on its audits: from the folder to verdicts, files, statement and page; and what stands in the way."""

import json
import re
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from sqlalchemy import Engine
from sqlalchemy import event as sqlalchemy_event

from softcal.app.calibration.audit import audited_sample
from softcal.app.calibration.audit_evidence import AuditReader
from softcal.app.calibration.lot_context import declared_line_spread
from softcal.app.calibration.lot_decision import decision_in_force
from softcal.app.calibration.redecision import redecide
from softcal.app.calibration.release import decide_lot, decide_unit, read_lot_status, statement_provenance
from softcal.app.cli.main import main
from softcal.app.export.calibrated_unit import ExportOptions, UnitLoader
from softcal.app.export.certificates.content import build_certificate
from softcal.app.export.certificates.lot_statement import build_lot_statement
from softcal.app.registry.lot_recordings import newest_audits
from softcal.app.texts.catalogue import text
from softcal.app.texts.reasons import render_reason
from softcal.core.messages.reason import Reason, reason
from softcal.core.quality.interval_inflation import AuditedSamples, fit_interval_inflation
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.line_spread import LineSpread
from softcal.core.unit.method import Method
from softcal.core.unit.uncertainty import IntervalInflation
from softcal.db.connection import open_registry
from softcal.db.entries import GoldenRun
from softcal.db.registry import Registry
from softcal.db.repositories.registry_base import RegistrySettings
from tests.layers import layered

SMALL = ("--hidden", "16,8", "--no-own")


@pytest.fixture
def registry(registry_url: str) -> Iterator[Registry]:
    with open_registry(registry_url) as registry:
        yield registry


@pytest.fixture
def batch(registry_url: str, tmp_path: Path) -> Callable[..., dict]:
    """`batch(folder, *more)`: calibrate a lot and return the report."""

    audit_files: set[Path] = set()

    def run(folder: Path, *more: str) -> dict:
        """The first time, units are fitted without their audits and drawn: a sample is drawn before it is measured."""
        file, audits, away = tmp_path / "batch.json", folder / "audit", tmp_path / f"{folder.name}-measured"
        if folder not in audit_files and audits.is_dir() and any(audits.iterdir()):
            audits.rename(away)
            main(["batch", str(folder), "--registry", registry_url, *SMALL])
            plan = ["lot", "audit-plan", str(folder), "--random", "99", "--registry", registry_url]
            assert main(plan) == 0
            away.rename(audits)
        audit_files.add(folder)
        assert main(["batch", str(folder), "--registry", registry_url, *SMALL, "--json", str(file), *more]) in (0, 1)
        return json.loads(file.read_text())

    return run


def _codes(registry: Registry, serial: str) -> set[str]:
    return {why.code for why in registry.lots.units("large", serial)[0].reasons}


def _released(report: dict) -> list[str]:
    """Serials released on the audits of others."""
    return [unit["serial"] for unit in report["units"] if unit["verdict"] == "pass" and not unit["audited"]]


def _unmeasured(report: dict) -> list[dict]:
    return [unit for unit in report["units"] if not unit["audited"]]


@pytest.mark.parametrize("barred_by", ["reference", "trim", "unreadable audit"])
def test_whoever_is_listed_as_released_has_the_verdict_pass(barred_by, make_lot, batch, registry, registry_url, capsys):
    folder = make_lot()
    unmeasured = [path.stem for path in (folder / "units").iterdir() if not (folder / "audit" / path.name).exists()]
    toml = folder / "lot.toml"
    if barred_by == "reference":
        toml.write_text(
            toml.read_text().replace("[reference]", '[reference]\ncell = "LC-1"').replace("simulated", "was")
        )
    if barred_by == "unreadable audit":
        (folder / "audit" / f"{unmeasured[0]}.csv").write_text("t_s,output,reference\n0,x,1\n")
    if barred_by == "trim":
        batch(folder)
        unit = pd.read_csv(folder / "units" / f"{unmeasured[0]}.csv")
        low, high = unit["output"].quantile([0.02, 0.98])
        loads = folder / "loads.csv"
        loads.write_text(f"output,reference\n{low},0.3\n{high},2.9\n")
        assert (
            main(["trim", "--registry", registry_url, "--serial", unmeasured[0], "--loads", str(loads), "--yes"]) == 0
        )
    report = batch(folder)
    passed = sorted(unit["serial"] for unit in report["units"] if unit["verdict"] == "pass" and not unit["audited"])
    measured = sorted(unit["serial"] for unit in report["units"] if unit["verdict"] == "pass" and unit["audited"])
    assert sorted(report["release"]["released"]) == sorted([*passed, *measured]) and (
        barred_by == "unreadable audit" or len(passed) < 4
    )
    capsys.readouterr()
    code = main(["lot", "release", "large", "--registry", registry_url, "--json", "-"])
    assert code == int(len(passed) + len(measured) < len(report["units"]))
    assert sorted(json.loads(capsys.readouterr().out)["released"]) == sorted([*passed, *measured])
    assert sorted(decision_in_force(registry, "large").released) == passed
    assert str(len(passed) or "no unit") in report["release"]["statement"]


def test_a_trim_of_an_audited_unit_changes_that_unit_alone(make_lot, batch, registry, registry_url, tmp_path):
    """Nine audits are not ten: the correction of the lot stands until somebody makes the next one."""
    folder = make_lot()
    batch(folder)
    serials = sorted(path.stem for path in (folder / "units").iterdir())
    before = {serial: registry.calibrations.get(serial) for serial in serials}
    trimmed = next(path.stem for path in sorted((folder / "audit").iterdir()))
    low, high = pd.read_csv(folder / "units" / f"{trimmed}.csv")["output"].quantile([0.02, 0.98])
    loads = tmp_path / "loads.csv"
    loads.write_text(f"output,reference\n{low},0.3\n{high},2.9\n")
    trim = ["trim", "--registry", registry_url, "--serial", trimmed, "--loads", str(loads)]
    assert before[trimmed].state.is_released and main(trim) == 2, "it withdraws a released unit: it asks"
    assert registry.calibrations.get(trimmed).revision == before[trimmed].revision
    assert main([*trim, "--yes"]) == 0
    for serial in serials:
        after = registry.calibrations.get(serial)
        assert (after.revision == before[serial].revision) == (serial != trimmed)
    now = registry.calibrations.get(trimmed).state
    codes = {why.code for why in now.decision.reasons}
    assert {"trimmed", "audited_before_trim"} <= codes and "common" not in codes
    # Of a map without the correction nothing is told of it; the lot's number stands for the others.
    assert {registry.calibrations.get(serial).state.correction.number for serial in serials if serial != trimmed} == {1}
    assert len(registry.decisions.of_lot("large")) == 1


def test_whoever_brings_audits_or_calls_a_batch_is_told_which_released_units_are_withdrawn(
    make_lot, batch, registry_url, tmp_path, capsys, registry
):
    folder = make_lot()
    report = batch(folder)
    released = _released(report)
    assert report["changes"]["released"] == 14 - sum(unit["verdict"] != "pass" for unit in report["units"])
    measured = tmp_path / f"{released[0]}.csv"
    table = pd.read_csv(folder / "audit/large-00.csv")
    table.assign(reference=3.0 * table["reference"]).to_csv(measured, index=False)
    capsys.readouterr()
    bring = ["lot", "audit", "large", str(measured), "--registry", registry_url, "--json", "-"]
    assert main(bring) == 0
    changes = json.loads(capsys.readouterr().out)["changes"]
    withdrawn = {row["serial"] for row in changes["changed"] if row["verdict"] == "pass"}
    now = {unit.serial for unit in registry.lots.units("large") if unit.verdict == "pass"}
    assert (
        released[0] in withdrawn
        and withdrawn == {unit["serial"] for unit in report["units"] if unit["verdict"] == "pass"} - now
    )
    (folder / "lot.toml").write_text((folder / "lot.toml").read_text().replace("rmse = 0.8", "rmse = 0.03"))
    report = batch(folder)
    assert report["changes"]["withdrawn"] == len(now) > 0 and "withdrawn: " in capsys.readouterr().out


def test_audits_that_were_not_drawn_first_release_nobody(make_lot, registry, registry_url, tmp_path):
    folder, report = make_lot(), tmp_path / "report.json"
    calibrate = ["batch", str(folder), "--registry", registry_url, *SMALL, "--json", str(report)]
    assert main(calibrate) == 1
    assert main(["lot", "audit-plan", "large", "--random", "99", "--registry", registry_url]) == 0
    assert main(calibrate) == 1
    units = json.loads(report.read_text())["units"]
    assert {unit["verdict"] for unit in units if not unit["audited"]} == {"conditional"}
    assert {unit["verdict"] for unit in units if unit["audited"]} == {"pass"}, "each decides about its own unit"
    sample = audited_sample(registry, "large")
    assert (sample.since, sample.before, sample.without_draw) == (0, 10, 0)


def test_units_nobody_measured_pass_on_the_audits_of_the_others(make_lot, batch, tmp_path, capsys, registry):
    folder = make_lot()
    report = batch(folder, "--out", str(tmp_path / "out"))
    release = report["release"]
    assert (release["audits"], release["risk"], release["confidence"]) == (10, 0.1, 0.9)
    assert [unit["verdict"] for unit in _unmeasured(report)] == ["pass"] * 4
    assert sorted(release["released"]) == sorted(
        unit["serial"] for unit in report["units"] if unit["verdict"] == "pass"
    )
    assert all(unit["released"] for unit in _unmeasured(report))
    assert release["statement"] in " ".join(capsys.readouterr().out.split())
    serial = _unmeasured(report)[0]["serial"]
    assert any(serial in file.name for file in (tmp_path / "out").rglob("*"))
    history = [stored.state for stored in registry.calibrations.history(serial)]
    first, second = history[0], history[-1]
    assert (second.map_sha256 == first.map_sha256) == (second.correction is None)
    assert second.verdict == "pass" != first.verdict and second.fit.id == first.fit.id
    widened = second.release.interval_inflation
    scaled = widened.scale * second.measured_interval.half_width
    assert np.allclose(second.interval.half_width, np.hypot(scaled, widened.added))
    audited = [unit["serial"] for unit in report["units"] if unit["audited"]]
    read = [unit.calibration.state.audit for unit in registry.pages.unit_statuses("large", audited).values()]
    inflation = fit_interval_inflation(
        [AuditedSamples(np.array(one.residual), np.array(one.half)) for one in read], 0.9, Method().release
    )
    assert (widened.scale, widened.added) == pytest.approx(
        (inflation.scale, inflation.added)
    ) and inflation != IntervalInflation()
    assert second.predicted_rmse == pytest.approx(first.predicted_rmse * second.release.scale)
    # What is promised of it is the bound that the audits give, not their mean.
    assert second.forecast.upper == pytest.approx(first.predicted_rmse * release["factor"])
    assert release["factor"] > second.release.scale
    again = batch(folder)
    assert again["release"] == release
    assert len(registry.calibrations.history(serial)) == len(history)


@pytest.mark.long
def test_a_unit_that_is_pressed_now_is_held_against_the_decisions_in_force_and_changes_no_other(
    make_lot, batch, registry
):
    folder = make_lot()
    report = batch(folder)
    serials = _released(report)
    number, before = len(registry.decisions.of_lot("large")), registry.pages.change_marker
    marker = before("large")
    decide_unit(registry, "large", serials[0])
    assert before("large") == marker, "what stands already is not written again"
    fitted = registry.calibrations.history(serials[0])[0]
    others = {s: registry.calibrations.get(s).revision for s in serials[1:]}
    registry.calibrations.put_state("large", fitted.state, "line", actor=None, reason="pressed again")
    assert registry.calibrations.get(serials[0]).state.verdict == "conditional"
    decide_unit(registry, "large", serials[0])
    assert registry.calibrations.get(serials[0]).state.verdict == "pass"
    assert {s: registry.calibrations.get(s).revision for s in serials[1:]} == others
    assert len(registry.decisions.of_lot("large")) == number


@pytest.mark.long
def test_without_audits_no_calibration_is_read_whole(make_lot, batch, monkeypatch, registry):
    batch(make_lot(audits=0))
    monkeypatch.setattr(registry.calibrations, "get", lambda *_, **__: pytest.fail("a calibration was read whole"))
    decided = decide_lot(registry, "large")
    assert decided is not None and decided.forecasts and decided.decision is None


def test_without_audits_nothing_passes_and_the_report_says_how_many_to_audit(make_lot, batch, tmp_path, registry):
    report = batch(make_lot(audits=0), "--out", str(tmp_path / "out"))
    assert not any(unit["released"] or unit["verdict"] == "pass" for unit in report["units"])
    assert report["release"]["released"] == [] and report["release"]["wanted"] == 9
    conditional = [unit for unit in registry.lots.units("large") if unit.verdict == "conditional"]
    assert conditional and all("forecast_only" in {why.code for why in unit.reasons} for unit in conditional)


def test_the_common_bias_of_audits_of_another_day_is_taken_off_the_maps(make_lot, batch, registry, tmp_path):
    folder = make_lot(day_gain=1.2, limit_N=0.4, audits=10)
    report = batch(folder, "--out", str(tmp_path / "out"))
    units = {unit["serial"]: unit for unit in report["units"]}
    assert report["release"]["corrected_by"] == 10 and len(_released(report)) == 4
    lines, fitted = {}, {}
    for serial, unit in units.items():
        history = [stored.state for stored in registry.calibrations.history(serial)]
        assert history[-1].map_sha256 != history[0].map_sha256 and history[-1].correction.number == 1
        lines[serial] = history[-1].correction.line
        # An audited unit is corrected by the others alone.
        assert history[-1].correction.audits == (9 if unit["audited"] else 10)
        fitted[serial] = next((one.scores.after.rmse for one in history if one.scores), None)
    assert np.median([line.gain for line in lines.values()]) == pytest.approx(1 / 1.2, abs=0.07)
    assert len({line.zero for line in lines.values()}) > 10, "a readout with another gain moves units by their rest"
    audited = [serial for serial, unit in units.items() if unit["audited"]]
    assert np.median([units[s]["after_rmse"] for s in audited]) < 0.7 * np.median([fitted[s] for s in audited])
    unit = UnitLoader(registry, ExportOptions(lot_id="large")).load(_released(report)[0])
    assert (
        build_certificate(unit).audit_correction
        and build_certificate(unit).audit_correction in build_certificate(unit).deviations
    )
    counts = [len(registry.calibrations.history(serial)) for serial in units]
    assert batch(folder)["release"] == report["release"]
    assert counts == [len(registry.calibrations.history(serial)) for serial in units]


def test_a_forecast_beyond_the_limit_does_not_stand_against_what_the_audits_measured(make_lot, batch, registry_url):
    folder = make_lot(limit_N=0.25)
    with (folder / "lot.toml").open("a") as file:
        file.write("[line]\nload_spread = 0.3\n")
    (folder / "audit").rename(folder.parent / "kept")
    before = {unit["serial"]: unit["verdict"] for unit in batch(folder)["units"]}
    assert set(before.values()) == {"fail"}
    # What forecasts cannot see is what audits are drawn for: the plan draws from these units, too.
    assert main(["lot", "audit-plan", "large", "--random", "99", "--registry", registry_url]) == 0
    (folder.parent / "kept").rename(folder / "audit")
    report = batch(folder)
    assert len(_released(report)) == 4 and report["counts"]["fail"] == 0


@pytest.mark.long
def test_a_lot_without_enough_audits_releases_nobody_and_one_of_two_is_left_as_it_was_fitted(make_lot, batch, registry):
    few = batch(make_lot(day_gain=1.35, limit_N=0.4, audits=6))
    assert all(unit["verdict"] != "pass" for unit in _unmeasured(few)) and few["release"]["corrected_by"] == 6
    two = batch(make_lot("two", day_gain=1.35, limit_N=0.4, audits=2))
    assert two["release"]["corrected_by"] == 0
    assert all(registry.calibrations.get(unit["serial"]).state.correction is None for unit in two["units"])


def test_more_audits_decide_the_lot_again(make_lot, batch):
    folder = make_lot()
    later_audits = sorted((folder / "audit").iterdir())[8:]
    contents = {path: path.read_text() for path in later_audits}
    for path in later_audits:
        path.unlink()
    report = batch(folder)
    assert report["release"]["wanted"] == 1 and _released(report) == []
    assert all(unit["verdict"] != "pass" for unit in _unmeasured(report))
    for path, content in contents.items():
        path.write_text(content)
    assert len(_released(batch(folder))) == 4


def _spoiled(folder: Path, how: str) -> set[str]:
    """Make audits of a lot wrong, and return the serials of those that are."""
    audit = folder / "audit"
    if how == "gf":
        frame = pd.read_csv(audit / "large-03.csv")
        frame.assign(reference=101.97 * frame["reference"]).to_csv(audit / "large-03.csv", index=False)
        return {"large-03"}
    if how == "one recording":
        shutil.copy(audit / "large-00.csv", audit / "large-01.csv")
        return {"large-00", "large-01"}
    # The two whose outputs at rest differ most: units that rest alike cannot be told apart by it.
    rest = {path: pd.read_csv(path)["output"].quantile(0.02) for path in audit.iterdir()}
    one, other = min(rest, key=rest.__getitem__), max(rest, key=rest.__getitem__)
    first = one.read_bytes()
    one.write_bytes(other.read_bytes())
    other.write_bytes(first)
    return {one.stem, other.stem}


SUSPICIONS = {"gf": "doubt.gain", "one recording": "doubt.one_recording", "exchanged": "doubt.exchanged"}


@pytest.mark.parametrize("how", layered(SUSPICIONS, ("exchanged",)))
def test_an_audit_that_may_be_wrong_is_set_aside_and_the_rest_of_the_lot_is_worked(make_lot, batch, how):
    folder = make_lot(audits=12)
    wrong = _spoiled(folder, how)
    report = batch(folder)
    units = {unit["serial"]: unit for unit in report["units"]}
    assert {serial for serial, unit in units.items() if unit["verdict"] == "retest"} == wrong
    assert {units[serial]["reason_codes"][0] for serial in wrong} == {SUSPICIONS[how]}
    assert not any(units[serial]["audited"] or units[serial]["released"] for serial in wrong)
    assert report["release"]["audited"] == 12 - len(wrong) and len(_released(report)) == 2
    assert batch(folder)["release"] == report["release"]


@pytest.mark.long
def test_a_person_can_confirm_a_suspect_audit_and_a_new_one_replaces_it(make_lot, batch, registry_url, registry):
    folder = make_lot(audits=12)
    right = (folder / "audit/large-03.csv").read_bytes()
    _spoiled(folder, "gf")
    batch(folder)
    confirm = ["lot", "audit", str(folder), "--confirm", "large-03", "--registry", registry_url]
    assert main(confirm) == 2, "without a reason"
    confirm += ["--reason", "the cell was read by hand"]
    assert main(confirm) == 2, "it withdraws released units, and nobody was asked"
    assert registry.pages.unit_statuses("large", ["large-03"])["large-03"].verdict == "retest"
    assert main([*confirm, "--yes"]) == 1
    assert registry.pages.unit_statuses("large", ["large-03"])["large-03"].verdict == "fail", (
        "it counts as it stands now"
    )
    assert batch(folder)["release"]["audited"] == 12
    (folder / "audit/large-03.csv").write_bytes(right)
    report = batch(folder)
    assert report["release"]["audited"] == 12 and report["counts"]["retest"] == 0


def test_audits_made_under_another_method_qualify_nothing(make_lot, batch, registry):
    folder = make_lot()
    batch(folder)
    evidence = AuditReader(registry, replace(Method(), range_margin=0.07)).evidence("large", datetime.now(UTC))
    assert not evidence.qualification.is_given and evidence.interval_inflation == IntervalInflation()


@pytest.mark.long
def test_a_golden_unit_of_another_sensor_model_withdraws_nothing(make_lot, batch, registry):
    for name in ("one", "three", "seventh"):
        batch(make_lot(name, audits=4))
    batch(make_lot("other", audits=0, model="XX"))
    batch(make_lot("fourteenth", audits=0))
    now = datetime.now(UTC)
    method = registry.pages.unit_statuses("one", ["one-00"])["one-00"].calibration.state.fit.method
    registry.stations.add_golden_run(GoldenRun("line", "other", "other-00", now, 9.0, "N", False))
    assert AuditReader(registry, method).evidence("fourteenth", now).qualification.is_given
    registry.stations.add_golden_run(GoldenRun("line", "seventh", "seventh-05", now, 9.0, "N", False))
    assert not AuditReader(registry, method).evidence("fourteenth", now).qualification.is_given


@pytest.mark.long
def test_a_lot_states_its_line_and_the_line_knows_it(make_lot, batch, registry_url, capsys, registry):
    folder = make_lot(audits=0)
    plain = {unit["serial"]: unit for unit in batch(folder)["units"]}
    assert declared_line_spread(registry, "large") is None
    assert all("line.open" in _codes(registry, serial) for serial in plain)
    with (folder / "lot.toml").open("a") as file:
        file.write("[line]\nload_spread = 0.05\n")
    for unit in batch(folder)["units"]:
        assert unit["predicted_rmse"] > plain[unit["serial"]]["predicted_rmse"]
    assert declared_line_spread(registry, "large") == LineSpread(0.05)
    assert all("line.stated" in _codes(registry, serial) for serial in plain)
    (folder / "lot.toml").write_text((folder / "lot.toml").read_text().replace("0.05\n", "5\n"))
    assert main(["batch", str(folder), "--registry", registry_url, *SMALL]) == 2
    assert "load_spread is 5" in capsys.readouterr().err


@pytest.mark.long
def test_golden_runs_of_several_days_are_kept_from_the_limit(make_lot, batch, registry_url, press_unit, registry):
    report = batch(make_lot(audits=10))
    serial = _unmeasured(report)[0]["serial"]
    start, gains = datetime.now(UTC), (1.0, 1.7, 0.6, 1.5)
    for day, gain in enumerate(gains):
        at = start + timedelta(days=day + 1)
        with open_registry(registry_url, RegistrySettings(clock=lambda at=at: at)) as registry:  # type: ignore[misc]
            table = press_unit(900, gain, 0.5, 70 + day)
            t_s, output, force_N = (table[name].to_numpy() for name in ("t_s", "output", "reference"))
            golden = LabelledRecording(OutputRecording(serial, t_s, output, 50.0), force_N)
            registry.recordings.add("large", golden, "audit")
            registry.stations.add_golden_run(GoldenRun("line", "large", serial, at, 0.1, "N", True))
    decided = decide_lot(registry, "large", now=start + timedelta(days=5))
    assert decided is not None and decided.released == () and min(decided.day_errors.values()) > 0
    assert registry.calibrations.get(serial).state.decision.reasons[0].code == "sampled.day"


@pytest.mark.long
def test_three_earlier_lots_qualify_one_without_audits(make_lot, batch):
    for name in ("one", "three", "seventh"):
        batch(make_lot(name, audits=4))
    report = batch(make_lot("fourteenth", audits=0))
    assert report["release"]["qualification"] == "earlier lots" and report["release"]["audits"] == 12
    other = batch(make_lot("othermodel", audits=0, model="XX"))
    assert other["release"]["qualification"] == "none"


@pytest.mark.long
def test_an_account_that_may_not_write_asks_what_stands_released(
    make_lot, batch, registry_url, tmp_path, request, capsys
):
    folder, file = make_lot(audits=12), tmp_path / "release.json"
    release = batch(folder)["release"]
    capsys.readouterr()

    def read_only(dialect: object, record: object, arguments: list[str], options: object) -> sqlite3.Connection:
        return sqlite3.connect(f"file:{arguments[0]}?mode=ro", uri=True, check_same_thread=False)

    sqlalchemy_event.listen(Engine, "do_connect", read_only)
    request.addfinalizer(lambda: sqlalchemy_event.remove(Engine, "do_connect", read_only))
    assert main(["lot", "release", "large", "--registry", registry_url, "--json", str(file)]) == 0
    assert json.loads(file.read_text())["released"] == release["released"] and not capsys.readouterr().err
    assert (
        main(["lot", "limit", "large", "--registry", registry_url, "--rmse", "0.3", "--reason", "drawn", "--yes"]) == 4
    )


def test_the_statement_is_one_page_and_kept_in_the_registry(make_lot, batch, registry_url, tmp_path, capsys, registry):
    folder = make_lot()
    batch(folder)
    pdf, file = tmp_path / "lot.pdf", tmp_path / "release.json"
    capsys.readouterr()
    command = ["lot", "release", str(folder), "--registry", registry_url, "--pdf", str(pdf), "--json", str(file)]
    assert main(command) == 0
    assert pdf.read_bytes().startswith(b"%PDF") and len(re.findall(rb"/Type /Page\b", pdf.read_bytes())) == 1
    content = json.loads(file.read_text())
    assert content["statement"] in capsys.readouterr().out and len(content["units"]["sampled"]) == 4
    assert len(registry.decisions.of_lot("large")) == 1


def test_the_statement_says_who_made_it_when_and_from_what_and_not_who_reads_it(
    make_lot, batch, registry_url, monkeypatch, registry, capsys
):
    batch(make_lot())
    (made_at,) = {one.made_at for one in registry.decisions.of_lot("large") if one.decision["released"]}
    audits = {f"audit of {serial}": one.sha256 for serial, one in newest_audits(registry, "large").items()}
    monkeypatch.setattr("softcal.app.calibration.release.current_user", lambda: "a reader")
    capsys.readouterr()
    main(["lot", "release", "large", "--registry", registry_url, "--json", "-"])
    provenance = json.loads(capsys.readouterr().out)["provenance"]
    assert provenance["actor"] != "a reader" and abs(
        datetime.fromisoformat(provenance["made_at"]) - made_at
    ) < timedelta(seconds=2)
    assert audits.items() <= provenance["inputs"].items()
    # The page and the programs read the same record.
    status = read_lot_status(registry, "large")
    assert statement_provenance(registry, status).to_json() == provenance
    assert build_lot_statement(registry, status, status.decided).provenance.to_json() == provenance


def test_the_plan_draws_as_many_audits_as_the_promise_takes(make_lot, batch, registry_url, tmp_path):
    folder = make_lot(audits=0)
    batch(folder)
    file = tmp_path / "plan.json"
    assert main(["lot", "audit-plan", str(folder), "--registry", registry_url, "--json", str(file)]) == 0
    plan = json.loads(file.read_text())
    assert len(plan["plan"]["random"]) == 10 and not plan["plan"]["doubtful"]


def test_a_lot_of_three_is_advised_to_measure_all_or_to_bring_earlier_lots(make_lot, batch, registry, registry_url):
    folder = make_lot(audits=3)
    for path in sorted((folder / "units").iterdir())[3:]:
        path.unlink()
    audits = {path: path.read_bytes() for path in (folder / "audit").iterdir()}
    for path in audits:
        path.unlink()
    release = batch(folder)["release"]
    assert release["wanted"] == 3 and release["released"] == []
    decided = read_lot_status(registry, "large").decided
    assert decided is not None
    why = decided.statement.values["why"]
    assert isinstance(why, Reason) and why.values["small"] == reason("part.small_lot", units=3, wanted=9, least=3)
    assert main(["lot", "audit-plan", "large", "--registry", registry_url]) == 0
    for path, content in audits.items():
        path.write_bytes(content)
    release = batch(folder)["release"]
    assert release["audited"] == 3


@pytest.mark.long
def test_the_statement_is_rendered_in_the_language_of_the_reader(make_lot, batch, registry_url, tmp_path, registry):
    folder, korean = make_lot(), partial(text, "ko")
    batch(folder)
    pages = {language: tmp_path / f"{language}.pdf" for language in ("en", "ko")}
    for language, pdf in pages.items():
        command = ["lot", "release", str(folder), "--registry", registry_url, "--pdf", str(pdf)]
        assert main([*command, "--language", language]) == 0
        assert len(re.findall(rb"/Type /Page\b", pdf.read_bytes())) == 1
    assert pages["en"].read_bytes() != pages["ko"].read_bytes()
    decided = read_lot_status(registry, "large").decided
    assert decided is not None
    statement_text = render_reason(decided.statement, korean)
    assert not re.findall(r"[a-z]{3,}", statement_text), "words of another language"
    assert render_reason(decision_in_force(registry, "large").statement, korean) == statement_text


def test_a_lot_with_a_golden_run_is_fitted_to_it_and_a_wrong_one_stops_the_batch(
    make_lot, batch, registry_url, press_unit, capsys, registry
):
    folder = make_lot(audits=0)
    for path in sorted((folder / "units").iterdir())[1:]:
        path.unlink()
    (golden := folder / "golden").mkdir()
    # The only unit, and the source in its sitting, under the same loads.
    press_unit(1500, 1.1, 0.52, 5).drop(columns="reference").to_csv(folder / "units/large-00.csv", index=False)
    press_unit(1500, 1.0, 0.5, 5).to_csv(golden / "A0.csv", index=False)
    (unit,) = batch(folder)["units"]
    assert unit["knowledge"] == "paired"
    assert "bridge.measured" in _codes(registry, "large-00")
    (golden / "A0.csv").rename(golden / "nobody.csv")
    assert main(["batch", str(folder), "--registry", registry_url, *SMALL]) == 2
    assert "A0" in capsys.readouterr().err
    shutil.copy(folder / "source/A0.csv", golden / "A0.csv")
    (golden / "nobody.csv").unlink()
    assert main(["batch", str(folder), "--registry", registry_url, *SMALL]) == 2
    assert "A0.csv" in capsys.readouterr().err


@pytest.mark.long
def test_another_limit_decides_every_unit_at_once_and_a_verdict_against_an_old_one_never_holds(
    make_lot, batch, registry_url, tmp_path, registry
):
    batch(make_lot(), "--out", str(tmp_path / "out"))
    before = {unit.serial: unit for unit in registry.lots.units("large") if unit.role == "target"}
    fits = [registry.calibrations.get(serial).state.fit.id for serial in before]
    measured = sorted(unit.after_rmse for unit in before.values() if unit.after_rmse is not None)
    limit = (measured[4] + measured[5]) / 2
    # The limit alone, as another registry would bring it: nothing that was judged against the old one stands.
    registry.lots.set_limit("large", limit, reason="drawing C")
    stale = {unit.serial: unit for unit in registry.lots.units("large") if unit.role == "target"}
    unit_statuses = registry.pages.unit_statuses("large", list(stale))
    assert {unit.verdict for unit in stale.values()} == {one.verdict for one in unit_statuses.values()} == {"retest"}
    assert registry.pages.verdict_counts("large")["retest"] == len(before)
    export = ["export", "--registry", registry_url, "--serial", next(iter(before)), "--format", "json"]
    assert main([*export, "--out", str(tmp_path / "files")]) != 0
    # The command judges at once; no unit is fitted again.
    command = ["lot", "limit", "large", "--rmse", repr(limit), "--reason", "drawing C", "--registry", registry_url]
    assert main([*command, "--yes"]) == 0
    after = {unit.serial: unit for unit in registry.lots.units("large") if unit.role == "target"}
    assert [registry.calibrations.get(serial).state.fit.id for serial in before] == fits
    beyond = {serial for serial, unit in after.items() if unit.after_rmse is not None and unit.after_rmse > limit}
    assert len(beyond) >= 5 and {after[serial].verdict for serial in beyond} == {"fail"}
    counts = registry.pages.verdict_counts("large")
    assert counts == {**dict.fromkeys(counts, 0), **pd.Series([u.verdict for u in after.values()]).value_counts()}
    # Back to the old limit, everything is as it was.
    assert main([*command[:4], "0.8", *command[5:], "--yes"]) == 0
    assert {serial: registry.pages.unit_statuses("large", [serial])[serial].verdict for serial in before} == {
        serial: unit.verdict for serial, unit in before.items()
    }


def test_what_was_measured_stands_although_its_file_is_gone_or_cannot_be_read(make_lot, batch, registry):
    folder = make_lot(limit_N=0.05)
    first = {unit["serial"]: unit for unit in batch(folder)["units"]}
    failed = [serial for serial, unit in first.items() if unit["audited"] and unit["verdict"] == "fail"]
    assert len(failed) > 2
    (folder / f"audit/{failed[0]}.csv").unlink()
    (folder / f"audit/{failed[1]}.csv").write_text("time,volt,newton\n0,1,2\n")
    second = {unit["serial"]: unit for unit in batch(folder)["units"]}
    for serial in failed[:2]:
        assert second[serial]["audited"] and second[serial]["verdict"] == "fail"
        assert second[serial]["after_rmse"] == first[serial]["after_rmse"]
    assert "audit.unreadable" in second[failed[1]]["reason_codes"]
    assert "audit.unreadable" not in second[failed[0]]["reason_codes"]


def test_an_audit_that_cannot_be_read_is_no_failed_run_of_its_unit(make_lot, batch, registry_url, registry):
    folder = make_lot(audits=1)
    names = {"t_s": "time", "output": "V", "reference": "N"}
    measured = folder.parent / "measured"
    measured.mkdir()
    pd.read_csv(folder / "audit/large-00.csv").rename(columns=names).to_csv(measured / "large-00.csv", index=False)
    shutil.copy(measured / "large-00.csv", folder / "audit/large-00.csv")
    unit = batch(folder)["units"][0]
    assert (unit["serial"], unit["verdict"], unit["audited"]) == ("large-00", "conditional", False)
    assert unit["reason_codes"][0] == "audit.unreadable"
    (measured / "stranger.csv").write_text("time,V,N\n0,1,2\n0.02,1,2\n")
    columns = ["--time-column", "time", "--output-column", "V", "--reference-column", "N"]
    assert main(["lot", "audit", str(folder), str(measured), *columns]) == 2, "the stranger is named, the other taken"
    assert main(["lot", "audit", str(folder), str(measured / "large-00.csv"), *columns]) == 0
    unit = batch(folder)["units"][0]
    assert (unit["verdict"], unit["audited"]) == ("pass", True)
    assert [run.verdict for run in registry.lots.runs("large", "large-00")] == ["pass"]


@pytest.mark.long
def test_an_audit_that_fails_takes_back_what_other_lots_released_on_it(make_lot, batch, registry, press_unit):
    for name in ("one", "three", "seventh"):
        batch(make_lot(name, audits=4))
    late = make_lot("fourteenth", audits=0)
    released = set(batch(late)["release"]["released"])
    assert released
    golden = GoldenRun("line", "one", "A0", datetime.now(UTC), 9.0, "N", False)
    registry.stations.add_golden_run(golden)
    redecide(registry, ["one"])
    unit_statuses = registry.pages.unit_statuses("fourteenth", sorted(released))
    assert {one.verdict for one in unit_statuses.values()} == {"conditional"}
    assert not {unit["serial"] for unit in batch(late)["units"] if unit["released"]}


def test_a_measured_fail_is_lifted_by_no_trim_no_rollback_and_no_older_revision(
    make_lot, batch, registry_url, tmp_path, registry
):
    folder = make_lot(audits=0, limit_N=0.2)
    batch(folder)
    serial = "large-00"
    assert registry.pages.unit_statuses("large", [serial])[serial].verdict != "fail"
    measured = tmp_path / f"{serial}.csv"
    table = pd.read_csv(make_lot("twin", audits=1).joinpath("audit/twin-00.csv"))
    table.assign(reference=2.0 * table["reference"]).to_csv(measured, index=False)
    at = ["--registry", registry_url]
    assert main(["lot", "audit", "large", str(measured), *at]) == 0
    failed = registry.pages.unit_statuses("large", [serial])[serial]
    assert failed.verdict == "fail" and failed.calibration is not None and failed.calibration.state.decision.is_audited
    loads = tmp_path / "loads.csv"
    pd.DataFrame({"output": [0.5, 0.75], "reference": [0.0, 4.0]}).to_csv(loads, index=False)
    trimmed = main(["trim", "--serial", serial, "--lot", "large", "--loads", str(loads), *at])
    assert registry.pages.unit_statuses("large", [serial])[serial].verdict == "fail"
    back = ["registry", "rollback", "--serial", serial, "--lot", "large", "--to", "1", "--reason", "drawn", *at]
    assert main(back) in ((0,) if trimmed == 0 else (0, 2))
    assert registry.pages.unit_statuses("large", [serial])[serial].verdict == "fail"
    export = ["export", "--serial", serial, "--lot", "large", "--revision", "1", "--release", "conditional", *at]
    assert main([*export, "--format", "blob", "--out", str(tmp_path / "out")]) == 2
    assert not list((tmp_path / "out").glob("unit-*"))
    # A new audit decides: of the map that the unit has now.
    pd.read_csv(measured).assign(reference=pd.read_csv(measured)["reference"] / 2.0).to_csv(measured, index=False)
    assert main(["lot", "audit", "large", str(measured), *at]) == 0
    measured_now = registry.pages.unit_statuses("large", [serial])[serial].calibration.state.scores
    assert measured_now.after != failed.calibration.state.scores.after
