"""What is stated of a lot or a unit, as rows of the audit trail: the newest is in force."""

import json
from collections.abc import Mapping
from typing import Any

from softcal.db.registry import Registry

Key = tuple[str, ...]


def statements(registry: Registry, entity: str, *keys: Key) -> list[dict[str, Any]]:
    """Return all that was stated under these keys, in time order."""
    return [json.loads(row.after or "{}") for row in registry.trail.of_several(entity, keys)]


def stated(registry: Registry, entity: str, key: Key) -> dict[str, Any] | None:
    """Return what was stated last; None where nothing was."""
    return next(reversed(statements(registry, entity, key)), None)


def is_stated(registry: Registry, entity: str, key: Key, facts: Mapping[str, object]) -> bool:
    """Return whether these very facts are the last that were stated."""
    return bool(stated(registry, entity, key) == json.loads(json.dumps(facts)))


def state(
    registry: Registry,
    entity: str,
    key: Key,
    facts: Mapping[str, object],
    *,
    action: str = "state",
    reason: str = "",
    actor: str | None = None,
) -> None:
    """Keep facts that say something new."""
    if not is_stated(registry, entity, key, facts):
        registry.trail.add(action, entity, key, facts, reason=reason, actor=actor)
