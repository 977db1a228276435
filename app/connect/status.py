"""How far every destination is: sent, waiting, failing."""

from typing import Any

from softcal.db.registry import Registry


def status_json(registry: Registry) -> list[dict[str, Any]]:
    """Return where every destination stands. `waits`: changes behind its cursor, whichever of them it will get."""
    end = registry.outbox.end()
    return [
        {
            "destination": one.destination,
            "sent": one.delivered,
            "waits": sum(seq - one.cursor.get(origin, 0) for origin, seq in end.items()),
            "failures": one.failures,
            "next_try": one.not_before and one.not_before.isoformat(),
            "error": one.error or None,
            "served_by": one.holder,
        }
        for one in registry.outbox.deliveries()
    ]


def status_rows(found: list[dict[str, Any]]) -> list[list[object]]:
    """Return the rows of the table a person reads."""
    names = ("destination", "sent", "waits", "failures", "next_try", "error", "served_by")
    return [[one[name] for name in names] for one in found]
