"""What the wall board shows: a lot at one glance, read from across the hall. No Streamlit."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from softcal.app.bootstrap import is_alive
from softcal.app.line.status import state_of
from softcal.app.texts.reasons import Translator
from softcal.app.views.alerts import Alert
from softcal.app.views.common import limit_number, number, percent
from softcal.app.views.line import Chip
from softcal.app.views.line_states import STATES
from softcal.app.views.lot import LotView
from softcal.app.views.lot_runs import YieldAt
from softcal.core.orders import StationState
from softcal.core.quality.yields import Share
from softcal.db.registry import Registry

WELL = (StationState.READY, StationState.RUNNING)
LAST_UNITS = 12
MAX_ALERTS = 3
"""So many sentences are read from afar; the page of the lot has all."""


@dataclass(frozen=True)
class WallView:
    """The wall board.

    Args:
        tiles: (label, value, what stands below it), the largest first.
        verdicts: (verdict, word, number of units).
        stations: (name, what it does, whether that is well) of each that did not say goodbye.
        alerts: sentences with whether each is urgent.
    """

    lot: str
    tiles: tuple[tuple[str, str, str], ...]
    verdicts: tuple[tuple[str, str, int], ...]
    stations: tuple[tuple[str, str, bool], ...]
    chips: tuple[Chip, ...]
    alerts: tuple[tuple[str, bool], ...]
    drawn_text: str


def wall_view(
    registry: Registry,
    view: LotView,
    current_alerts: Sequence[Alert],
    translate: Translator,
    now: datetime | None = None,
) -> WallView:
    """Read what the wall board shows of a lot, the urgent first, in the time zone of `now`."""
    now = now or datetime.now(UTC).astimezone()
    target = registry.lots.line_rules(view.lot).target or view.total
    nothing = YieldAt("", Share(0, 0), 0)
    today = next((day for day in view.days if day.name == now.date().isoformat()), nothing)
    of_today = {"good": today.share.count, "of": today.share.of}
    first = view.yields.first_pass
    low, high = (percent(end) for end in first.interval)
    limit = view.limit_rmse
    tiles = (
        (translate("wall.done"), f"{view.decided} / {target}", translate("lot.units")),
        (translate("lot.first_pass"), percent(first.value), f"{low} – {high}" if first.of else ""),
        (translate("wall.today"), str(today.units), translate("wall.today.good", **of_today) if today.share.of else ""),
        (
            translate("lot.predicted"),
            number(view.median_predicted, view.lot.reference_unit, limit),
            "" if limit is None else translate("chart.limit.named", limit=limit_number(limit, view.lot.reference_unit)),
        ),
    )
    verdicts = tuple(
        (word, translate(f"verdict.{word}"), count) for word, count in view.counts.items() if word != "none"
    )
    heartbeats = [heartbeat for heartbeat in registry.order_queue.stations() if heartbeat.state is not StationState.OFF]
    states = [(heartbeat.station, state_of(heartbeat, now, is_alive(heartbeat.process))) for heartbeat in heartbeats]
    stations = tuple((name, translate(f"station.state.{state}"), state in WELL) for name, state in states)
    alert_texts = [
        (translate(f"alert.{alert.kind}", **alert.values), alert.is_urgent) for alert in current_alerts[:MAX_ALERTS]
    ]
    if len(current_alerts) > MAX_ALERTS:
        alert_texts.append((translate("wall.more", count=len(current_alerts) - MAX_ALERTS), False))
    last: dict[str, None] = {}
    for run in reversed(registry.lots.runs(view.lot.id)):
        last.setdefault(run.serial, None)
        if len(last) == LAST_UNITS:
            break
    unit_statuses = registry.pages.unit_statuses(view.lot.id, list(last))
    statuses = [unit_statuses[serial] for serial in last if serial in unit_statuses]
    return WallView(
        view.lot.id,
        tiles,
        verdicts,
        stations,
        tuple(Chip(one.serial, STATES[one.verdict].tone, translate(f"verdict.{one.verdict}")) for one in statuses),
        tuple(alert_texts),
        translate("wall.drawn", at=now),
    )
