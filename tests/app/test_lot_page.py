"""What the lot's page and its report say beyond the whole lot: filters, yields over places, audited units, the PDF."""

from datetime import UTC, date, datetime, timedelta, timezone
from functools import partial

import numpy as np
import pytest

from softcal.app.charts.audited import error_over_load, estimate_over_reference
from softcal.app.charts.lot import yield_figure
from softcal.app.charts.palette import LIGHT
from softcal.app.texts.catalogue import text
from softcal.app.ui.lot_report_pdf import lot_report_pdf
from softcal.app.views.audited import BANDS, AuditedView, AuditTrace, audited_view
from softcal.app.views.lot import lot_view
from softcal.app.views.lot_report import lot_rows
from softcal.app.views.lot_runs import FROM_FILE, LotFilter, attribute_runs, yield_over
from softcal.core.lot import Lot
from softcal.core.orders import Order, OrderKind, Progress, RunState
from softcal.core.unit.verdict import Verdict
from softcal.db.connection import open_registry
from softcal.db.entries import RunEntry
from softcal.db.queues.order_queue import UnitPress
from tests.app.pdf_text import read_text

DAY = timedelta(days=1)
MONDAY = datetime(2026, 5, 4, 8, 0, tzinfo=UTC)


translate = partial(text, "en")


def run(serial: str, at: datetime, verdict: str = "pass") -> RunEntry:
    return RunEntry(serial, at, verdict, ())


def press(serial: str, station: str, actor: str, at: datetime) -> UnitPress:
    return UnitPress(serial, station, actor, at, at + timedelta(minutes=1))


def test_a_result_stands_where_its_unit_was_pressed_last_before_it() -> None:
    presses = [
        press("U2", "line-2", "Oh", MONDAY + DAY),
        press("U1", "line-1", "Kim", MONDAY),
        press("U1", "line-2", "Oh", MONDAY + 2 * DAY),
    ]
    late = timedelta(minutes=1)
    runs = [run("U1", MONDAY + late), run("U1", MONDAY + DAY), run("U1", MONDAY + 2 * DAY + late), run("U3", MONDAY)]
    attributed = [(one.station, one.operator) for one in attribute_runs(runs, presses)]
    assert attributed == [("line-1", "Kim"), ("line-1", "Kim"), ("line-2", "Oh"), (FROM_FILE, FROM_FILE)]


def test_a_unit_counts_once_on_the_day_and_at_the_station_of_its_first_run() -> None:
    runs = attribute_runs(
        [run("U1", MONDAY, "fail"), run("U1", MONDAY + DAY), run("U2", MONDAY + DAY), run("U3", MONDAY + DAY, "fail")],
        [press("U1", "line-1", "Kim", MONDAY - DAY), press("U3", "line-1", "Kim", MONDAY)],
    )
    by_day = [(at.name, at.share.count, at.share.of) for at in yield_over(runs, lambda one: one.day(UTC).isoformat())]
    assert by_day == [("2026-05-04", 0, 1), ("2026-05-05", 1, 2)]
    by_station = {at.name: (at.share.count, at.share.of) for at in yield_over(runs, lambda one: one.station)}
    assert by_station == {FROM_FILE: (1, 1), "line-1": (0, 2)}


@pytest.mark.parametrize(
    ("lot_filter", "takes"),
    [
        (LotFilter(), True),
        (LotFilter(since=date(2026, 5, 4), until=date(2026, 5, 4), zone=UTC), True),
        (LotFilter(since=date(2026, 5, 5), zone=UTC), False),
        (LotFilter(until=date(2026, 5, 3), zone=UTC), False),
        # While it is eight in the morning in London it is still Sunday in Alaska.
        (LotFilter(until=date(2026, 5, 3), zone=timezone(timedelta(hours=-9))), True),
        (LotFilter(since=date(2026, 5, 4), zone=timezone(timedelta(hours=-9))), False),
        (LotFilter(stations=("line-2", "line-1")), True),
        (LotFilter(stations=("line-2",)), False),
        (LotFilter(operators=("Oh",)), False),
        (LotFilter(stations=("line-1",), operators=("Kim",), until=date(2026, 5, 4)), True),
    ],
)
def test_a_filter_takes_what_it_says(lot_filter: LotFilter, takes: bool) -> None:
    (one,) = attribute_runs([run("U1", MONDAY)], [press("U1", "line-1", "Kim", MONDAY - DAY)])
    assert lot_filter.takes(one) is takes


@pytest.fixture
def two_stations(calibrated: str) -> str:
    """The small lot, as if its first unit had been pressed at a line by Kim."""
    with open_registry(calibrated) as registry:
        first = registry.lots.runs("small")[0]
        begun = first.made_at - timedelta(minutes=1)
        registry.order_queue.place(Order("o1", "line-1", OrderKind.UNIT, first.serial, "small", "Kim", created=begun))
        order = registry.order_queue.take("line-1")
        assert order is not None
        registry.order_queue.report(Progress(order.order_id, RunState.DONE, verdict=first.verdict))
    return calibrated


def test_a_filtered_lot_holds_only_the_units_that_the_filter_leaves(two_stations: str) -> None:
    with open_registry(two_stations) as registry:
        whole = lot_view(registry, "small")
        line = lot_view(registry, "small", LotFilter(stations=("line-1",)))
        files = lot_view(registry, "small", LotFilter(operators=(FROM_FILE,)))
    assert whole.every_station == (FROM_FILE, "line-1") and whole.chosen is None
    assert line.total == 1 and files.total == whole.decided - 1
    assert not set(line.chosen or ()) & set(files.chosen or ())
    for word in Verdict:
        assert line.counts[word] + files.counts[word] == whole.counts[word]
    assert {row.serial for row in files.errors} <= set(files.chosen or ())


def test_the_page_is_filtered_by_station(two_stations: str, show) -> None:
    screen = show(two_stations, "lot", tab="units", lot="small")
    screen.multiselect(key="lot-station-small").set_value(["line-1"]).run()
    assert not screen.exception and not screen.error
    assert len(screen.dataframe[0].value) == 1


def trace(serial: str, load: np.ndarray, estimate: np.ndarray) -> AuditTrace:
    return AuditTrace(serial, np.arange(len(load)) / 50, 0.1 * load, load, estimate)


def audited(limit: float | None = 0.2) -> AuditedView:
    load = np.linspace(0.0, 8.0, 400)
    units = (trace("bad", load, load + 1.0), trace("good", load, load + 0.05 * load))
    return AuditedView(Lot("L", "S", 50.0), units, 2, np.linspace(0.0, 8.0, BANDS + 1), limit)


def test_the_error_over_load_is_that_of_each_band() -> None:
    view = audited()
    assert view.band_errors(view.units[0]) == pytest.approx([1.0] * BANDS)
    assert view.band_errors(view.units[1]) == pytest.approx(0.05 * view.middles, rel=0.2, abs=0.01)


def test_a_band_that_was_hardly_pressed_has_no_error() -> None:
    load = np.r_[np.zeros(100), 8.0]
    view = AuditedView(Lot("L", "S", 50.0), (trace("U", load, load),), 1, np.linspace(0.0, 8.0, BANDS + 1))
    errors = view.band_errors(view.units[0])
    assert errors[0] == 0.0 and np.all(np.isnan(errors[1:]))


def test_limits_are_drawn_and_named_and_units_stand_at_the_axes() -> None:
    for draw in (estimate_over_reference, error_over_load):
        figure = draw(audited(), LIGHT, translate)
        labels = [trace.name for trace in figure.data] + [note.text for note in figure.layout.annotations]
        assert any("limit 0.2 N" in str(name) for name in labels)
        assert "[N]" in figure.layout.xaxis.title.text and "[N]" in figure.layout.yaxis.title.text
        without = draw(audited(None), LIGHT, translate)
        assert not any("limit" in str(trace.name) for trace in without.data)


def test_audited_units_are_scored_on_the_stretch_their_error_is_stated_on(calibrated: str) -> None:
    with open_registry(calibrated) as registry:
        view = lot_view(registry, "small")
        audits = audited_view(registry, view.lot, view.audited)
    assert audits is not None and view.audited
    rmse = {row.serial: row.after_rmse for row in view.audited}
    for unit in audits.units:
        assert float(np.sqrt(np.mean((unit.estimate - unit.reference) ** 2))) == pytest.approx(
            rmse[unit.serial], rel=1e-6
        )


def test_the_axis_of_a_yield_says_of_how_many_units_it_is() -> None:
    runs = attribute_runs([run("U1", MONDAY), run("U2", MONDAY, "fail")], [])
    figure = yield_figure(yield_over(runs, lambda one: one.station), "station", LIGHT, translate)
    assert "1 of 2" in figure.layout.xaxis.ticktext[0]
    assert figure.data[0].y[0] == pytest.approx(50.0)


@pytest.mark.parametrize("language", ["en", "ko"])
def test_the_report_holds_what_the_page_says(calibrated: str, language: str) -> None:
    with open_registry(calibrated) as registry:
        view = lot_view(registry, "small")
        pdf = lot_report_pdf(registry, view, language, MONDAY)
        assert pdf == lot_report_pdf(registry, view, language, MONDAY)
    pdf_text = read_text(pdf)
    assert text(language, "lot.first_pass").replace(" ", "") in pdf_text.replace(" ", "")
    assert f"{view.decided}/{view.total}" in pdf_text.replace(" ", "")
    assert "A4" in pdf_text


def test_lots_stand_side_by_side(calibrated: str, show) -> None:
    with open_registry(calibrated) as registry:
        view = lot_view(registry, "small")
        rows = lot_rows([view, view], translate)
    assert all(set(row) == {translate("compare.fact.lot"), "small"} for row in rows)
    screen = show(calibrated, "lot", tab="compare", lot="small")
    assert not screen.exception and not screen.error
    assert "small" in list(screen.table[0].value.columns)
