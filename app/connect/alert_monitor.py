"""Writes into the audit trail when an alert begins and ends, so that each is an event."""

from collections.abc import Mapping
from datetime import datetime
from typing import Any

from softcal.app.connect.events import ABOUT, ALERT_KEY, list_decided_lots
from softcal.app.texts.catalogue import LANGUAGES, format_instant, text
from softcal.app.views.alerts import Alert, lot_alerts, plant_alerts
from softcal.app.views.lot import lot_view
from softcal.db.queues.outbox import Cursor
from softcal.db.registry import Registry

ACTOR = "softcal connect"
"""Who stands in the audit trail."""

AlertKey = tuple[str, str, str]
"""Kind, lot and what it is about; "" where it has none."""


class AlertMonitor:
    """Compares what should be looked at with the alerts that the audit trail left open."""

    def __init__(self, registry: Registry) -> None:
        self._registry = registry
        self._cursor: Cursor | None = None
        self._lot_alerts: dict[str, list[Alert]] = {}

    def update(self, now: datetime) -> int:
        """Raise new alerts and clear ended ones; return the number of events."""
        changed, self._cursor = list_decided_lots(self._registry, self._cursor)
        for lot_id in changed:
            self._lot_alerts[lot_id] = lot_alerts(lot_view(self._registry, lot_id))
        alerts = {alert_key(alert, ""): (alert, "") for alert in plant_alerts(self._registry, now)}
        for lot_id, of_lot in self._lot_alerts.items():
            alerts |= {alert_key(alert, lot_id): (alert, lot_id) for alert in of_lot}
        if alerts.keys() == open_alerts(self._registry).keys():
            return 0
        # Another process may watch, too: what is open is read in the transaction that changes it.
        with self._registry.transaction():
            raised = open_alerts(self._registry)
            for key in alerts.keys() - raised.keys():
                store_alert(self._registry, key, alert_payload(*alerts[key]), is_open=True)
            for key in raised.keys() - alerts.keys():
                store_alert(self._registry, key, raised[key], is_open=False)
        return len(alerts.keys() ^ raised.keys())


def open_alerts(registry: Registry) -> dict[AlertKey, dict[str, Any]]:
    """Return the alerts that were raised and not cleared, by key, with their payloads."""
    return {
        (row["kind"], row["lot_id"], row["about"]): row["content"] | {"since": row["made_at"].isoformat()}
        for row in registry.declarations.in_force("alerts")
        if row["is_open"]
    }


def store_alert(registry: Registry, key: AlertKey, content: Mapping[str, Any], *, is_open: bool) -> None:
    """Store that an alert began or is over."""
    values = dict(zip(ALERT_KEY, key, strict=True), is_open=is_open, content=dict(content))
    registry.declarations.declare("alerts", values, action="raise" if is_open else "clear", actor=ACTOR)


def alert_key(alert: Alert, lot_id: str) -> AlertKey:
    """Return the key of an alert, constant while it lasts, whatever its values."""
    return alert.kind, lot_id, next((str(alert.values[name]) for name in ABOUT if name in alert.values), "")


def alert_payload(alert: Alert, lot_id: str) -> dict[str, Any]:
    """Return an alert as JSON values, with its sentence in every language."""
    return {
        "kind": alert.kind,
        "lot": lot_id or None,
        "is_urgent": alert.is_urgent,
        "values": {k: format_instant(v) if isinstance(v, datetime) else v for k, v in alert.values.items()},
        "text": {language: text(language, f"alert.{alert.kind}", **alert.values) for language in LANGUAGES},
    }
