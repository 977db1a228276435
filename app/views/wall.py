"""What the wall board shows: a lot at one glance, read from across the hall. No Streamlit."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from softcal.app.bootstrap import is_alive
from softcal.app.line.facts import state_of
from softcal.app.texts.reasons import Words
from softcal.app.views.alerts import Alert
from softcal.app.views.common import number, percent
from softcal.app.views.line import Chip
from softcal.app.views.line_states import STATES
from softcal.app.views.lot import LotView
from softcal.app.views.lot_runs import YieldAt
from softcal.core.orders import StationState
from softcal.core.quality.yields import Share
from softcal.db.registry import Registry

WELL = (StationState.READY, StationState.RUNNING)
LAST_UNITS = 12
MOST_ALERTS = 3
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
    drawn: str


def wall_view(
    registry: Registry, view: LotView, found: Sequence[Alert], words: Words, now: datetime | None = None
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
        (words("wall.done"), f"{view.judged} / {target}", words("lot.units")),
        (words("lot.first_pass"), percent(first.value), f"{low} – {high}" if first.of else ""),
        (words("wall.today"), str(today.units), words("wall.today.good", **of_today) if today.share.of else ""),
        (
            words("lot.predicted"),
            number(view.median_predicted, view.lot.reference_unit, limit),
            "" if limit is None else words("chart.limit.named", limit=number(limit, view.lot.reference_unit, limit)),
        ),
    )
    verdicts = tuple((word, words(f"verdict.{word}"), count) for word, count in view.counts.items() if word != "none")
    beats = [beat for beat in registry.order_queue.stations() if beat.state is not StationState.OFF]
    states = [(beat.station, state_of(beat, now, is_alive(beat.process))) for beat in beats]
    stations = tuple((name, words(f"station.state.{state}"), state in WELL) for name, state in states)
    said = [(words(f"alert.{alert.kind}", **alert.values), alert.is_urgent) for alert in found[:MOST_ALERTS]]
    if len(found) > MOST_ALERTS:
        said.append((words("wall.more", count=len(found) - MOST_ALERTS), False))
    last: dict[str, None] = {}
    for run in reversed(registry.lots.runs(view.lot.id)):
        last.setdefault(run.serial, None)
        if len(last) == LAST_UNITS:
            break
    standings = registry.pages.standings(view.lot.id, list(last))
    standing = [standings[serial] for serial in last if serial in standings]
    return WallView(
        view.lot.id,
        tiles,
        verdicts,
        stations,
        tuple(Chip(one.serial, STATES[one.verdict].tone, words(f"verdict.{one.verdict}")) for one in standing),
        tuple(said),
        words("wall.drawn", at=now),
    )
