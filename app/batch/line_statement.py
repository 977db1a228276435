"""How differently a line presses units, as it was stated for a lot: kept in the registry, so that the line knows it."""

import json

from softcal.core.unit.line_spread import LineSpread
from softcal.db.registry import Registry

STATEMENT = "line_spread"


def state_line(registry: Registry, lot_id: str, line: LineSpread | None, actor: str | None = None) -> LineSpread | None:
    """Keep what a lot folder states, where it is new; return what stands for the lot."""
    known = stated_line(registry, lot_id)
    if line is None or line == known:
        return known
    registry.add_event("state", STATEMENT, (lot_id,), line.to_json(), reason="stated with the lot", actor=actor)
    return line


def stated_line(registry: Registry, lot_id: str) -> LineSpread | None:
    """Return what was stated last for a lot; None where nothing was."""
    told = registry.events(STATEMENT, (lot_id,))
    return LineSpread.of(json.loads(told[-1].after or "{}")) if told else None
