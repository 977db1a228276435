"""Status of stations as JSON values, for REST, MQTT and OPC UA."""

from datetime import UTC, datetime
from typing import Any

from softcal.app.bootstrap import is_alive
from softcal.app.line.status import state_of
from softcal.core.orders import Heartbeat, Order, Progress
from softcal.db.registry import Registry

NEWEST = 20
"""So many of a station's newest orders are looked through for the last unit it decided."""


def stations_json(registry: Registry) -> list[dict[str, Any]]:
    """Return every station, by name."""
    return [station_json(registry, heartbeat) for heartbeat in registry.order_queue.stations()]


def station_json(registry: Registry, heartbeat: Heartbeat) -> dict[str, Any]:
    """Return a station: state, unit in the fixture, last decided unit and the lot of that unit."""
    queue = registry.order_queue
    active = queue.active(heartbeat.station)
    last_order = next((o for o, p in queue.runs(heartbeat.station, NEWEST) if o.kind.is_about_unit and p.verdict), None)
    lot_id = active[0].lot_id if active else last_order.lot_id if last_order else ""
    # As every page says it now; the run keeps what was decided when the unit was pressed.
    status = (
        registry.pages.unit_statuses(last_order.lot_id, [last_order.serial]).get(last_order.serial)
        if last_order
        else None
    )
    return {
        "station": heartbeat.station,
        "state": state_of(heartbeat, datetime.now(UTC), is_alive(heartbeat.process)),
        "at": heartbeat.at.isoformat(),
        "reasons": [str(reason) for reason in heartbeat.reasons],
        "serial": active[0].serial if active else None,
        "last_serial": last_order.serial if last_order else None,
        "last_lot": last_order.lot_id or None if last_order else None,
        "last_verdict": status.verdict if status else None,
        "lot": lot_id or None,
        "counts": registry.pages.verdict_counts(lot_id) if lot_id in registry.lots.ids() else {},
    }


def order_json(order: Order, progress: Progress) -> dict[str, Any]:
    """Return an order with its progress."""
    return {
        "order_id": order.order_id,
        "station": order.station,
        "kind": str(order.kind),
        "serial": order.serial or None,
        "lot": order.lot_id or None,
        "actor": order.actor,
        "created": order.created.isoformat() if order.created else None,
        "state": str(progress.state),
        "phase": progress.phase,
        "fraction": progress.fraction,
        "code": progress.code,
        "message": progress.text,
        "verdict": progress.verdict or None,
    }
