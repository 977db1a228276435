"""What the page of a lot warns of: each kind when it holds, and none when it does not."""

from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from functools import partial
from types import SimpleNamespace

import plotly.graph_objects as go
import pytest

from softcal.app.charts.style import integer_ticks
from softcal.app.texts.catalogue import LANGUAGES, text
from softcal.app.views.alerts import Alert, alerts
from softcal.app.views.lot import ProcessView, RuleBroken, yield_drop
from softcal.core.lot import UnitKey
from softcal.core.orders import Heartbeat, StationState
from softcal.db.connection import open_registry
from softcal.db.entries import CellCertificate, GoldenRun, RunEntry

pytestmark = pytest.mark.usefixtures("separate_data_folder")
NOW = datetime(2026, 5, 4, 8, 0, tzinfo=UTC)
STILL = ProcessView((), None, (), None, "")


def runs(*verdicts: str) -> list[RunEntry]:
    return [RunEntry(f"A{k}", NOW + timedelta(minutes=k), verdict, ()) for k, verdict in enumerate(verdicts)]


def alerts_of(
    process: ProcessView = STILL, drop=None, golden=(), heartbeats=(), certificates=(), adapted=(), withdrawn=()
) -> list[Alert]:
    registry = SimpleNamespace(
        stations=SimpleNamespace(golden_runs=lambda: list(golden), certificates=lambda: list(certificates)),
        adaptations=SimpleNamespace(units=lambda: list(adapted)),
        order_queue=SimpleNamespace(stations=lambda: list(heartbeats)),
    )
    view = SimpleNamespace(lot=SimpleNamespace(id="small"), process=process, drop=drop, withdrawn=withdrawn)
    return list(alerts(registry, view, NOW))  # type: ignore[arg-type]


def test_a_drop_of_the_yield_is_reported_and_chance_is_not() -> None:
    assert yield_drop(runs(*["pass"] * 80)) is None
    assert yield_drop(runs(*["fail"] * 20)) is None
    assert yield_drop(runs(*["pass", "pass", "pass", "fail"] * 25)) is None
    drop = yield_drop(runs(*["pass"] * 60, *["pass", "fail"] * 10))
    assert drop is not None and (drop.newest, drop.before, drop.count) == (0.5, 1.0, 20)
    assert yield_drop(runs(*["fail"] * 60, *["pass"] * 20)) is None


def test_chance_alone_seldom_tells_of_a_drop(rng) -> None:
    lots = [runs(*("pass" if good else "fail" for good in rng.random(100) < 0.8)) for _ in range(400)]
    # Fisher's test keeps its level; 400 lots at 0.5 % leave 2, and more than 8 with a chance below 0.1 %.
    assert sum(yield_drop(lot) is not None for lot in lots) <= 8


def test_a_station_that_failed_with_its_golden_unit_is_reported_until_it_passes() -> None:
    bad = GoldenRun("line-1", "small", "G1", NOW - timedelta(hours=2), 0.3, "N", False)
    assert [alert.kind for alert in alerts_of(golden=[bad])] == ["golden"]
    assert alerts_of(golden=[bad, replace(bad, made_at=NOW - timedelta(hours=1), passed=True)]) == []


def test_a_station_that_went_silent_is_reported_and_one_that_ended_well_is_not() -> None:
    heartbeat = Heartbeat("line-1", StationState.READY, NOW - timedelta(minutes=1))
    assert [alert.kind for alert in alerts_of(heartbeats=[heartbeat])] == ["station"]
    assert alerts_of(heartbeats=[replace(heartbeat, at=NOW - timedelta(seconds=1))]) == []
    assert alerts_of(heartbeats=[replace(heartbeat, state=StationState.OFF)]) == []
    assert alerts_of(heartbeats=[replace(heartbeat, at=NOW - timedelta(days=30))]) == []


@pytest.mark.parametrize(("due", "kinds"), [(400, []), (30, ["certificate_due"]), (-1, ["certificate_over"])])
def test_a_certificate_that_ends_is_reported_and_its_successor_counts(due: int, kinds: list[str]) -> None:
    entry = CellCertificate("LC", "K1", "KRISS", date(2025, 1, 1), NOW.date() + timedelta(days=due), 50.0, 0.1)
    assert [alert.kind for alert in alerts_of(certificates=[entry])] == kinds
    newer = replace(entry, issued_on=date(2026, 1, 1), due_on=date(2028, 1, 1))
    assert alerts_of(certificates=[newer, entry]) == []


def test_drift_and_units_that_need_a_reference_are_reported_and_the_urgent_come_first() -> None:
    broken = replace(STILL, broken=(RuleBroken(1, 3, "A9", True), RuleBroken(3, 1, "A2", False)))
    adapted = [
        SimpleNamespace(key=UnitKey("small", "A7"), entry={"alarm": "moved"}),
        SimpleNamespace(key=UnitKey("small", "A8"), entry={"alarm": ""}),
    ]
    drop = yield_drop(runs(*["pass"] * 60, *["fail"] * 20))
    alerts = alerts_of(process=broken, drop=drop, adapted=adapted)
    assert [alert.kind for alert in alerts] == ["yield", "process", "units_due"]
    assert alerts[2].values == {"count": 1, "first": "small/A7"}


def test_a_unit_in_use_that_needs_a_reference_is_told_at_its_own_lot() -> None:
    other = SimpleNamespace(key=UnitKey("large", "A7"), entry={"alarm": "moved"})
    assert alerts_of(adapted=[other]) == []


@pytest.mark.parametrize("language", LANGUAGES)
def test_every_alert_is_a_sentence(language: str) -> None:
    every = {"count": 1, "newest": "1 %", "before": "2 %", "last": "A", "station": "s", "serial": "G", "at": "now"}
    every |= {"cell": "LC", "due": "2026-01-01", "days": 3, "first": "A1"}
    translate = partial(text, language)
    for kind in ("yield", "process", "golden", "station", "certificate_due", "certificate_over", "units_due"):
        assert translate(f"alert.{kind}", **every).endswith(".")


def test_the_lot_page_shows_its_alerts(calibrated: str, open_page) -> None:
    def page() -> None:
        from softcal.app.ui.app_pages import lot

        lot.render()

    with open_registry(calibrated) as registry:
        registry.order_queue.write_heartbeat(
            Heartbeat("line-1", StationState.READY, datetime.now(UTC) - timedelta(minutes=5))
        )
        registry.stations.add_golden_run(
            GoldenRun("line-1", "small", "G1", datetime.now(UTC), 0.3, "N", False, ("too large",), "Oh")
        )
    screen = open_page(calibrated, page, lot="small")
    assert "line-1" in screen.error[0].value and "line-1" in screen.warning[0].value


def test_counts_have_whole_numbers_at_their_axis() -> None:
    for largest in (0, 1, 2, 3, 7, 40, 999):
        figure = go.Figure()
        integer_ticks(figure, largest)
        step = figure.layout.yaxis.dtick
        assert step >= 1 and step == int(step)
