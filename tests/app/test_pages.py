"""Seven pages: every address answers, a page that needs a role asks for it, a text in the bar finds what it names."""

import io
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from functools import partial

import pandas as pd
import pytest

from softcal.app.calibration.audit import draw_plan, lot_audit
from softcal.app.calibration.changes import change_limit
from softcal.app.calibration.release import outline_lot, read_lot_status
from softcal.app.jobs.launch import SIMULATED
from softcal.app.texts.catalogue import catalogue, text
from softcal.app.ui.components import station_run, unit_table
from softcal.app.ui.pages import PAGES, REDIRECTS, page_of, redirect
from softcal.app.views.common import number
from softcal.app.views.lot import lot_view
from softcal.app.views.lot_report import report_values
from softcal.app.views.lots import lot_list, proposed_lot_id
from softcal.app.views.next_step import next_step
from softcal.app.views.search import search
from softcal.core.lot import Lot
from softcal.core.orders import Heartbeat, Order, OrderKind, StationState
from softcal.core.quality.audit_plan import AuditConfig
from softcal.core.recording import LabelledRecording
from softcal.db.connection import open_registry
from softcal.db.entries import CellCertificate

pytestmark = pytest.mark.usefixtures("separate_data_folder")
TABS = [(page.name, tab.name) for page in PAGES for tab in page.tabs]


def test_there_are_seven_pages_and_five_in_the_bar() -> None:
    assert [page.name for page in PAGES] == ["line", "lots", "lot", "unit", "gap", "station", "settings"]
    assert [page.name for page in PAGES if page.icon] == ["line", "lots", "gap", "station", "settings"]


def test_every_page_and_tab_has_a_title() -> None:
    expected_keys = {f"page.{page.name}" for page in PAGES} | {f"tab.{tab}" for _, tab in TABS}
    assert not expected_keys - catalogue()["en"].keys()


@pytest.mark.parametrize("address", REDIRECTS)
def test_an_address_that_was_leads_to_a_page_and_a_tab_that_are(address: str) -> None:
    page, query = redirect(address, {"lot": ["small"]})
    assert not {"tab"} & query.keys() or query["tab"][0] in {tab.name for tab in page_of(page).tabs}
    assert query["lot"] == ["small"]


def test_a_comparison_of_two_units_keeps_both() -> None:
    page, query = redirect("compare", {"a": ["small/A1"], "b": ["small/A2"]})
    assert (page, query) == ("unit", {"unit": ["small/A1"], "with": ["small/A2"], "tab": ["compare"]})


@pytest.mark.parametrize(("page", "tab"), TABS)
@pytest.mark.parametrize("language", ["en", "ko"])
def test_every_tab_is_drawn(calibrated: str, show, page: str, tab: str, language: str) -> None:
    screen = show(calibrated, page, tab=tab, lot="small", unit="small/A1", lang=language)
    assert not screen.exception and not screen.error


@pytest.mark.parametrize(("page", "tab"), [("settings", "audit_trail"), ("lot", "limits"), ("lots", "files")])
def test_a_link_to_what_needs_a_role_asks_for_it_and_then_opens(
    calibrated: str, show, add_everybody, page, tab
) -> None:
    add_everybody(calibrated)
    screen = show(calibrated, page, role=None, tab=tab, lot="small")
    assert screen.info and not screen.dataframe and not screen.exception
    name, pin = ("Quinn", "7777") if page == "settings" else ("Erin", "2580")
    screen.text_input(key="sign-in-name").set_value(name)
    screen.text_input(key="sign-in-pin").set_value(pin)
    next(button for button in screen.button if button.label == text("en", "sign_in")).click().run()
    assert not screen.exception and not [field for field in screen.text_input if field.key == "sign-in-pin"]


def test_a_role_lists_the_tabs_it_may_open(calibrated: str, show) -> None:
    def tabs(role: str | None) -> set[str]:
        return {tab.label for tab in show(calibrated, "settings", role=role).tabs}

    trail = text("en", "tab.audit_trail")
    assert trail in tabs("quality") and trail not in tabs("engineer") and len(tabs(None)) == 1


def test_the_search_finds_units_lots_stations_and_certificates(calibrated: str) -> None:
    with open_registry(calibrated) as registry:
        registry.order_queue.write_heartbeat(Heartbeat("line-A", StationState.READY, datetime.now(UTC), process="a:1"))
        certificate = CellCertificate("K1", "A-17", "", date(2026, 1, 5), date(2099, 1, 5), 20.0, 0.02)
        registry.stations.add_certificate(certificate, actor="Erin")
        kinds = {hit.kind for hit in search(registry, "a")}
        (unit,) = search(registry, "a1")
        assert search(registry, " ") == [] and search(registry, "nothing") == []
    assert kinds == {"unit", "lot", "station", "certificate"}
    assert (unit.page, unit.query) == ("unit", {"unit": "small/A1"})


def step_of(url: str):
    with open_registry(url) as registry:
        audit = lot_audit(registry, "small")
        missing = None if audit is None else audit.missing
        steps = [next_step(registry, read(registry, "small"), missing) for read in (outline_lot, read_lot_status)]
    # What is read of every unit of a large lot suffices for the same sentence.
    assert steps[0] == steps[1]
    return steps[0]


def test_the_next_step_follows_from_where_the_lot_stands(calibrated: str) -> None:
    with open_registry(calibrated) as registry:
        registry.lots.add(Lot("new", "S1", 50.0))
        assert next_step(registry, read_lot_status(registry, "new"), None).kind == "source"
        lot = registry.lots.get("small")
        has_limit = lot.limit_rmse is not None
    first = step_of(calibrated)
    assert first.kind != "limit" or not has_limit
    with open_registry(calibrated) as registry:
        plan = draw_plan(registry, "small", AuditConfig(0, 1), actor="Erin").plan
    # What was measured before the draw is no part of the sample.
    step = step_of(calibrated)
    assert step.kind != "measure" or step.values["serials"] == ", ".join(plan.serials)
    sentence = step.render(lambda key, **values: text("en", key, **values))
    assert sentence and "{" not in sentence


def test_units_decided_against_another_limit_ask_for_a_calibration_not_a_press(calibrated: str) -> None:
    with open_registry(calibrated) as registry:
        registry.lots.set_limit("small", 0.5, reason="another drawing")
    assert step_of(calibrated).kind == "again"


def test_the_list_of_lots_says_how_far_each_is(calibrated: str, show) -> None:
    with open_registry(calibrated) as registry:
        registry.lots.add(replace(registry.lots.get("small"), id="other"))
        rows = {row.lot_id: row for row in lot_list(registry)}
        counts = registry.pages.verdict_counts("small")
    small = rows["small"]
    assert (small.units, small.decided, small.released) == (4, 4, counts["pass"])
    assert small.good is not None and small.good.of == small.decided
    assert rows["other"].good is None
    table = show(calibrated, "lots").table[0].value
    assert len(table) == 2 and any("lot?lot=small" in cell for cell in table.iloc[:, 0])


def test_a_new_lot_is_called_by_its_week_and_never_as_another(calibrated: str) -> None:
    day, names = date(2027, 1, 2), []
    with open_registry(calibrated) as registry:
        for _ in range(3):
            names.append(proposed_lot_id(registry, day))
            registry.lots.add(Lot(names[-1], "S1", 50.0))
    # 2 January 2027 lies in the last week of 2026 (ISO 8601).
    assert names == ["2026-53", "2026-53-2", "2026-53-3"]


def test_an_audit_that_measured_nothing_yet_is_counted_nowhere(calibrated: str) -> None:
    with open_registry(calibrated) as registry:
        unit = registry.recordings.get(registry.calibrations.get("A2").state.fit.recording_sha256)
        registry.recordings.add("small", LabelledRecording(unit, unit.output), "audit")
        (small,) = lot_list(registry)
        assert small.audited == len(lot_view(registry, "small").audited)


def test_a_unit_says_in_its_head_what_was_decided_when_by_whom_and_where(calibrated: str, show) -> None:
    screen = show(calibrated, "unit", role=None, unit="small/A1")
    assert screen.title[0].value == "A1"
    head = next(line.value for line in screen.markdown if text("en", "lot.limit") in line.value)
    for key in ("choose.lot", "column.made", "column.actor", "station.station"):
        assert text("en", key) in head
    assert "lot?lot=small" in head


@pytest.mark.parametrize("role", ["engineer", "operator"])
def test_a_release_says_what_it_would_change_before_its_button(calibrated: str, show, role: str) -> None:
    screen = show(calibrated, "lot", tab="release", lot="small", role=role)
    buttons = [button for button in screen.button if button.key == "release-do"]
    assert not screen.exception and not screen.error
    # Each button follows a table of serials; without a change there is none.
    assert not buttons or screen.table
    assert screen.success or screen.info or buttons


@pytest.mark.parametrize(
    ("value", "limit", "text"),
    [
        (0.2001, 0.2, "0.200 N"),
        (0.12341, 0.1234, "0.1234 N"),
        (0.7514, 0.2, "0.751 N"),
        (0.0671, 0.3, "0.067 N"),
        (12.3456, 20.0, "12.3 N"),
        (1234.5, 500.0, "1234 N"),
        (0.0671, None, "0.0671 N"),
        (None, 0.3, "–"),
    ],
)
def test_errors_of_a_lot_have_the_decimals_of_its_limit(value, limit, text) -> None:
    assert number(value, "N", limit) == text


@pytest.mark.parametrize("stated", ["0.3", "0.25", "0.3125", "2"])
def test_every_tab_of_a_lot_and_a_unit_writes_its_limit_as_stated_and_errors_alike(
    calibrated: str, show, stated: str
) -> None:
    with open_registry(calibrated) as registry:
        change_limit(registry, "small", float(stated), reason="drawing C", actor="test")
        written = report_values(lot_view(registry, "small"), partial(text, "en"))
    said, places = (
        [*written.values()],
        max(len(stated.partition(".")[2]), 3 - len(stated.partition(".")[0].lstrip("0"))),
    )
    for page, tab in [page for page in TABS if page[0] in ("lot", "unit")]:
        screen = show(calibrated, page, tab=tab, lot="small", unit="small/A1", role="engineer")
        said += [metric.value for metric in screen.metric]
        said += [one.value for kind in (screen.markdown, screen.caption, screen.info) for one in kind]
    quantities = [number for line in said for number in re.findall(r"([\d.]+) N\b", line)]
    assert stated in quantities
    assert {len(number.partition(".")[2]) for number in quantities if number != stated} == {places}


def test_a_downloaded_list_of_units_keeps_the_full_precision_of_errors(calibrated: str, show, monkeypatch) -> None:
    files: dict[str, bytes] = {}

    def read(label: str, name: str, content: bytes | Callable[[], bytes], key: str) -> None:
        files[name] = content() if callable(content) else content

    monkeypatch.setattr(unit_table, "download", read)
    show(calibrated, "lot", tab="units", lot="small", role="engineer")
    listed = pd.read_csv(io.BytesIO(files["small.csv"]))
    with open_registry(calibrated) as registry:
        stored = {unit.serial: unit.predicted_rmse for unit in registry.lots.units("small")}
    heads = {name: f"{text('en', f'column.{name}')}" for name in ("serial", "predicted")}
    predicted = listed.set_index(heads["serial"])[f"{heads['predicted']} [N]"]
    assert len(predicted) == len(listed) and predicted.dropna().to_dict() == {
        serial: rmse for serial, rmse in stored.items() if rmse is not None and serial in predicted.index
    }


def test_a_simulated_station_is_started_and_switched_off_by_one_button(calibrated: str, show, monkeypatch) -> None:
    """The service is played by a process that does nothing: what the button does to it is what counts."""
    service = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    started: list[str] = []
    monkeypatch.setattr(station_run, "start_simulated_station", started.append)

    def beat(state: StationState, ago_s: float = 0.0) -> None:
        process, at = f"{socket.gethostname()}:{service.pid}", datetime.now(UTC) - timedelta(seconds=ago_s)
        with open_registry(calibrated) as registry:
            registry.order_queue.write_heartbeat(Heartbeat(SIMULATED, state, at, process=process))

    try:
        beat(StationState.READY)
        screen = show(calibrated, "station", role="engineer")
        beat(StationState.READY)
        screen.button(key="station-simulated").click().run()
        assert service.wait(timeout=60) == -signal.SIGTERM and not started
        beat(StationState.OFF, ago_s=10.0)
        screen = show(calibrated, "station", role="engineer")
        screen.button(key="station-simulated").click().run()
        assert started == [SIMULATED]
        with open_registry(calibrated) as registry:
            assert {row.action for row in registry.trail.newest(20) if row.entity == "station"} == {"start", "stop"}
    finally:
        service.kill()
        service.wait()


def test_a_station_of_hardware_has_no_button_to_end_it(calibrated: str, show) -> None:
    with open_registry(calibrated) as registry:
        registry.order_queue.write_heartbeat(Heartbeat("line-1", StationState.READY, datetime.now(UTC)))
    assert "station-simulated" not in [one.key for one in show(calibrated, "station", role="engineer").button]


def test_every_serial_and_lot_in_a_table_is_a_link(calibrated: str, show) -> None:
    with open_registry(calibrated) as registry:
        registry.order_queue.write_heartbeat(Heartbeat("line-1", StationState.READY, datetime.now(UTC)))
        registry.order_queue.place(Order("run-1", "line-1", OrderKind.UNIT, "A1", "small", "Kim"))
    heads = {text("en", "column.serial"), text("en", "choose.lot")}
    pages, cells = set(), []
    for page, tab in [*TABS, ("lots", "")]:
        screen = show(calibrated, page, tab=tab, lot="small", unit="small/A1", role="engineer")
        for table in screen.table:
            found = [cell for head in heads & set(table.value.columns) for cell in table.value[head]]
            pages |= {(page, tab)} if found else set()
            cells += found
    assert {("lots", ""), ("lot", "audit"), ("station", "state")} <= pages
    assert [cell for cell in cells if not str(cell).startswith(("[", "–"))] == []
