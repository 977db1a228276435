"""What somebody should look at now beside the units: said on the lot's page and sent."""

from dataclasses import dataclass, field
from datetime import datetime, timedelta

from softcal.app.views.common import percent
from softcal.app.views.lot import LotView
from softcal.core.orders import StationState
from softcal.db.queues.order_queue import STATION_SILENT_AFTER
from softcal.db.registry import Registry
from softcal.db.schema.deadline import is_silent

DUE_WITHIN = timedelta(days=30)
FORGOTTEN_AFTER = timedelta(days=7)
"""A station that has been silent for longer is no news any more."""


@dataclass(frozen=True)
class Alert:
    """One thing to look at: the text `alert.KIND`; urgent where what is made may be wrong."""

    kind: str
    values: dict[str, object] = field(default_factory=dict)
    is_urgent: bool = False


def alerts(registry: Registry, view: LotView, now: datetime) -> tuple[Alert, ...]:
    """Return what should be looked at now, the urgent first."""
    result = [*lot_alerts(view), *plant_alerts(registry, now, view.lot.id)]
    return tuple(sorted(result, key=lambda alert: not alert.is_urgent))


def plant_alerts(registry: Registry, now: datetime, lot_id: str | None = None) -> list[Alert]:
    """Return what should be looked at now, whichever lot is made; of units in use those of one lot, or all."""
    result = []
    # Of each station the newest check with a golden unit counts.
    golden = {run.station: run for run in sorted(registry.stations.golden_runs(), key=lambda run: run.made_at)}
    for run in golden.values():
        if not run.passed:
            result.append(Alert("golden", {"station": run.station, "serial": run.serial, "at": run.made_at}, True))
    for heartbeat in registry.order_queue.stations():
        # Who said goodbye is not missed.
        is_missed = is_silent(heartbeat.at, now, STATION_SILENT_AFTER) and now - heartbeat.at < FORGOTTEN_AFTER
        if heartbeat.state is not StationState.OFF and is_missed:
            result.append(Alert("station", {"station": heartbeat.station, "at": heartbeat.at}))
    # Of each load cell the newest certificate counts.
    issued = sorted(registry.stations.certificates(), key=lambda entry: entry.issued_on)
    for entry in {entry.cell_serial: entry for entry in issued}.values():
        remaining, values = entry.due_on - now.date(), {"cell": entry.cell_serial, "due": f"{entry.due_on}"}
        if remaining < timedelta(0):
            result.append(Alert("certificate_over", dict(values), True))
        elif remaining <= DUE_WITHIN:
            result.append(Alert("certificate_due", {**values, "days": remaining.days}))
    followed = [unit for unit in registry.adaptations.units() if lot_id in (None, unit.key.lot_id)]
    due = [str(unit.key) for unit in followed if unit.entry.get("alarm")]
    if due:
        result.append(Alert("units_due", {"count": len(due), "first": due[0]}))
    return result


def lot_alerts(view: LotView) -> list[Alert]:
    """Return what should be looked at in one lot."""
    result = []
    if view.drop is not None:
        drop = view.drop
        values = {"newest": percent(drop.newest), "before": percent(drop.before), "count": drop.count}
        result.append(Alert("yield", dict(values), is_urgent=True))
    if view.withdrawn:
        result.append(Alert("withdrawn", {"count": len(view.withdrawn), "first": view.withdrawn[0]}))
    if any(rule.forbids for rule in view.process.broken):
        last = next(rule for rule in view.process.broken if rule.forbids)
        result.append(Alert("process", {"last": last.last, "count": last.count}))
    return result
