"""Source of events: rows of the audit trail in a form on which a program can act.

An event is written in the transaction of the change it tells of, so none is lost and none is made
up. Its id is the position of its row in the trail: a program that gets it twice knows it by that.
"""

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any
from urllib.parse import quote

from softcal.core.lot import UnitKey
from softcal.core.messages.reason import Reason
from softcal.db.entries import UNIT_ERRORS, AuditRow
from softcal.db.queues.outbox import Cursor
from softcal.db.registry import Registry

VERDICT, RAISED, CLEARED, CHANGE = "verdict", "alert.raised", "alert.cleared", "change"
KINDS = (VERDICT, "alert", CHANGE)
"""What a destination may ask for; `alert` takes both that one was raised and that it is over."""

PUBLIC_KINDS = (VERDICT, "alert")
"""What everybody may read who may look; the rest of the audit trail is for who may read that."""

VERDICT_ENTITIES = ("in_use", "refusals")
"""What the audit trail calls the entities of a verdict."""

ALERTS = "alerts"
"""What the audit trail calls the entity of an alert."""

ALERT_KEY = ("kind", "lot_id", "about")

ABOUT = ("station", "cell")
"""Values of an alert that say which one is meant, beside its kind and lot."""

ROWS_AT_ONCE = 500
MAX_ROWS = 20_000
"""So many rows are looked at for one page of events; who asks again goes on where it ended."""


@dataclass(frozen=True)
class RegistryEvent:
    """One event.

    Args:
        event_id: `ORIGIN:SEQ`, the row of the audit trail; the same for ever and everywhere.
        kind: verdict, alert.raised, alert.cleared, or change for everything else.
        at: when, UTC.
        subject: path of its subject.
        data: JSON values.
    """

    event_id: str
    kind: str
    at: datetime
    subject: str
    data: Mapping[str, Any]
    after: Cursor

    def to_json(self) -> dict[str, Any]:
        """Return the event as CloudEvents 1.0 (CNCF, JSON event format, section 3)."""
        return {
            "specversion": "1.0",
            "id": self.event_id,
            "source": f"/softcal/{self.event_id.partition(':')[0]}",
            "type": f"softcal.{self.kind}",
            "time": self.at.isoformat(),
            "subject": self.subject,
            "datacontenttype": "application/json",
            "data": dict(self.data),
        }


@dataclass(frozen=True)
class EventPage:
    """Events in order, the cursor behind all that was looked at, and whether that is the end."""

    events: tuple[RegistryEvent, ...]
    cursor: Cursor
    is_end: bool


def events_after(registry: Registry, cursor: Cursor, count: int, kinds: Collection[str] = KINDS) -> EventPage:
    """Return the next events of some kinds behind a cursor, at most `count`."""
    events: list[RegistryEvent] = []
    position, row_count = dict(cursor), 0
    while row_count < MAX_ROWS:
        rows = registry.outbox.after(position, ROWS_AT_ONCE)
        for row in rows:
            position[row.origin] = row.seq
            if event_kind(row).partition(".")[0] in kinds:
                events.append(_event(registry, row, dict(position)))
                if len(events) == count:
                    return EventPage(tuple(events), position, False)
        row_count += len(rows)
        if len(rows) < ROWS_AT_ONCE:
            return EventPage(tuple(events), position, True)
    return EventPage(tuple(events), position, False)


def list_current_events(registry: Registry, cursor: Cursor, kinds: Collection[str]) -> list[RegistryEvent]:
    """Return the events up to a cursor that still hold: the newest verdict of each unit, and open alerts."""
    newest: dict[tuple[str, ...], AuditRow] = {}
    for entity in (*VERDICT_ENTITIES, ALERTS):
        for row in registry.trail.of_kind(entity):
            kind = event_kind(row)
            if kind.partition(".")[0] not in kinds or row.seq > cursor.get(row.origin, 0):
                continue
            content = json.loads(row.after or "{}")
            key = tuple(content[name] for name in (("lot_id", "serial") if kind == VERDICT else ALERT_KEY))
            about = (kind.partition(".")[0], *key)
            if about not in newest or newest[about].at <= row.at:
                newest[about] = row
    rows = sorted(newest.values(), key=lambda row: (row.at, row.origin, row.seq))
    return [_event(registry, row, cursor) for row in rows if event_kind(row) != CLEARED]


def list_decided_lots(registry: Registry, cursor: Cursor | None) -> tuple[set[str], Cursor]:
    """Return the lots with verdicts behind a cursor, and the present cursor; None takes all lots."""
    if cursor is None:
        now = registry.outbox.end()
        return set(registry.lots.ids()), now
    lots, position = set(), dict(cursor)
    while rows := registry.outbox.after(position, ROWS_AT_ONCE):
        lots |= {json.loads(row.after or "{}")["lot_id"] for row in rows if event_kind(row) == VERDICT}
        position |= {row.origin: row.seq for row in rows}
    return lots, position


def event_kind(row: AuditRow) -> str:
    """Return what kind of event a row of the audit trail is."""
    if row.entity in VERDICT_ENTITIES:
        return VERDICT
    if row.entity == ALERTS:
        return RAISED if row.action == "raise" else CLEARED
    return CHANGE


def _event(registry: Registry, row: AuditRow, after: Cursor) -> RegistryEvent:
    kind = event_kind(row)
    key, content = json.loads(row.key), json.loads(row.after or "{}")
    about = {"actor": row.actor, "reason": row.reason}
    if kind == VERDICT:
        data = _verdict(registry, row.entity, content) | about
        subject = unit_path(UnitKey(data["lot"], data["serial"]))
    elif kind == CHANGE:
        before = json.loads(row.before or "null")
        data = {"action": row.action, "entity": row.entity, "key": key, "before": before, "after": content} | about
        subject = "/".join([row.entity, *(path_part(str(part)) for part in key)])
    else:
        data, subject = content["content"], f"{ALERTS}/{path_part(content['kind'])}"
    return RegistryEvent(f"{row.origin}:{row.seq}", kind, row.at, subject, data, after)


def _verdict(registry: Registry, entity: str, content: Mapping[str, Any]) -> dict[str, Any]:
    lot_id, serial = content["lot_id"], content["serial"]
    calibration, revision = dict(content), None
    if entity == "in_use":
        revision = content["revision"]
        rows = registry.trail.list_rows("calibrations", (serial, revision, content["made_by"]))
        calibration = json.loads(rows[0].after or "{}")
    reasons = [Reason.parse(reason) for reason in calibration["reasons"]]
    data = {
        "lot": lot_id,
        "serial": serial,
        "verdict": calibration["verdict"],
        "reasons": [str(entry) for entry in reasons],
        "reason_codes": [entry.code for entry in reasons],
        "revision": revision,
        "family": calibration.get("family"),
        "map_sha256": calibration.get("map_sha256"),
        **{name: calibration.get(name) for name in UNIT_ERRORS},
        "decided_by": content.get("decided_by", "batch"),
        "is_conflict": False,
    }
    # Two registries that put different maps into use stand against a verdict.
    now = registry.lots.units(lot_id, serial) if len(registry.outbox.end()) > 1 else []
    for unit in (unit for unit in now if unit.is_conflict):
        conflict = {
            "reasons": [str(entry) for entry in unit.reasons],
            "reason_codes": [entry.code for entry in unit.reasons],
        }
        return data | {"verdict": unit.verdict, "is_conflict": True, **conflict}
    return data


def unit_path(unit: UnitKey) -> str:
    """Return the path or topic of a unit."""
    return f"lots/{path_part(unit.lot_id)}/units/{path_part(unit.serial)}"


def path_part(name: str) -> str:
    """Return a name as one part of a path or topic, with any characters escaped."""
    return quote(name, safe="")
