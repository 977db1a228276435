"""The audit trail in words: who did what, what was before and after, and why. No Streamlit."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from softcal.app.texts.reasons import Translator
from softcal.app.views.common import percent
from softcal.core.messages.figures import format_limit
from softcal.db.entries import ROLES, AuditRow
from softcal.db.repositories.lots import parse_rules

_ENTITIES = {
    "results": "calibrations refusals in_use adaptations unit fits lot_decisions draws drawn_units "
    "lot_statements checked_units confirmed_audits trims corrections sample_releases audits",
    "rules": "limits line_rules",
    "networks": "networks network_releases",
    "people": "users tokens",
    "station": "certificates golden_runs station station_gate station_qualifications alerts",
    "papers": "laboratories exports",
    "lots": "lots units recordings known_loads load_readings unit_golden_runs map_families lot_references line_spreads "
    "lot_sources source_networks",
    "registry": "",
}
SECTIONS = {entity: heading for heading, entities in _ENTITIES.items() for entity in entities.split()}
"""What a row is about → its heading; files that were taken stand under `papers`."""

HEADINGS = tuple(_ENTITIES)
FIELDS = (
    "rmse limit_rmse verdict revision rolled_back_to predicted_rmse after_rmse family state role is_active "
    "serial_pattern letters target is_badge_needed retests loads kind passed file formats units number due_on "
    "decided_by sensor_model source rig account purpose ends_at is_withdrawn"
).split()
"""What of a row is said; everything else is for who asks for the row itself."""

LIMITS = ("rmse", "limit_rmse")


@dataclass(frozen=True)
class Entry:
    """One line of the trail: what was done to what, and (name, before, after) of what changed."""

    row: AuditRow
    section: str
    action_text: str
    changes: tuple[tuple[str, str, str], ...]

    @property
    def changes_text(self) -> str:
        return "; ".join(f"{name}: {old} → {new}" if old else f"{name}: {new}" for name, old, new in self.changes)

    @property
    def search_text(self) -> str:
        return " ".join((self.row.actor, self.action_text, self.changes_text, self.row.reason)).lower()


@dataclass(frozen=True)
class TrailFilter:
    """Which lines: with all words of a text in any order, from and to an instant; empty takes all."""

    text: str = ""
    actors: tuple[str, ...] = ()
    sections: tuple[str, ...] = ()
    since: datetime | None = None
    until: datetime | None = None

    def takes(self, entry: Entry) -> bool:
        return (
            (not self.actors or entry.row.actor in self.actors)
            and (not self.sections or entry.section in self.sections)
            and (self.since is None or entry.row.at >= self.since)
            and (self.until is None or entry.row.at <= self.until)
            and all(word in entry.search_text for word in self.text.lower().split())
        )


def trail(rows: Sequence[AuditRow], translate: Translator) -> list[Entry]:
    """Return the rows as lines in the language of `translate`, in their order."""
    return [entry_of(row, translate) for row in rows]


def entry_of(row: AuditRow, translate: Translator) -> Entry:
    """Return one row as a line."""
    before, after = _values(row.before), _values(row.after)
    changes = []
    for name in FIELDS:
        old, new = before.get(name), after.get(name)
        if name not in after or new == old or (new in (None, "") and old in (None, "")):
            continue
        old_text = _render_value(name, old, translate) if name in before else ""
        changes.append((translate(f"trail.field.{name}"), old_text, _render_value(name, new, translate)))

    key = json.loads(row.key)
    name, *more = [str(part) for part in key] if isinstance(key, list) else [str(key)]
    names = {"name": name, "second": more[0] if more else "", "lot": str(after.get("lot_id", "")) or name}
    names["serial"] = str(after.get("serial", "")) or (more[0] if more else name)
    names["kind"] = translate(f"kind.{after['kind']}") if after.get("kind") in ("source", "unit", "audit") else ""
    try:
        action_text = translate(f"trail.{row.action}.{row.entity}", **names)
    except KeyError:
        action_text = translate("trail.other", action=row.action, entity=row.entity, name=", ".join((name, *more)))
    section = "papers" if row.action == "export" else SECTIONS.get(row.entity, "registry")
    return Entry(row, section, action_text, tuple(changes))


def _values(stored: str | None) -> Mapping[str, Any]:
    values = json.loads(stored) if stored else {}
    flat: dict[str, Any] = dict(values) if isinstance(values, dict) else {}
    if "serial_pattern" not in flat:
        return flat
    # Re-tests and known loads of a line's rules are several columns, and one value for people each.
    rules = parse_rules(flat)
    return flat | {"retests": rules.retests, "loads": [str(load) for load in rules.loads]}


def _render_value(name: str, value: object, translate: Translator) -> str:
    if value in (None, "", [], {}):
        return translate("trail.nothing")
    if isinstance(value, bool):
        return translate("trail.yes" if value else "trail.no")
    if name == "verdict":
        return translate(f"verdict.{value}")
    if name == "role" and value in ROLES:
        return translate(f"role.{value}")
    if isinstance(value, float) and name in LIMITS:
        return format_limit(value)
    if isinstance(value, float):
        return percent(value) if name == "share" else f"{value:.4g}"
    if isinstance(value, dict):
        return ", ".join(f"{key} {count}" for key, count in value.items())
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)
