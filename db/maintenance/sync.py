"""Synchronisation of two registries in both directions: a station's SQLite file and the line's PostgreSQL.

The audit trail is the list of what to send. A registry gets, per chain, the rows behind the last
one it has, together with what they tell of. Each chunk is one transaction, so that a broken line
loses nothing, and sending twice changes nothing. Work items, orders and people stay where they are.
"""

import json
from dataclasses import dataclass
from datetime import date, datetime, timedelta
from typing import Any

from sqlalchemy import Date, Table, and_, func, insert, select

from softcal.core.errors import InputError, RegistryError
from softcal.db.entries import AuditRow
from softcal.db.repositories import history
from softcal.db.repositories.in_use import conflict_line, conflicts_of
from softcal.db.repositories.lot_decisions import decision_conflicts
from softcal.db.repositories.registry_base import RegistryBase
from softcal.db.schema.arrays import copy_blob
from softcal.db.schema.column_types import UtcTime
from softcal.db.schema.database import Database
from softcal.db.schema.tables import AUDITED, audit, blobs, limits, line_rules, metadata
from softcal.db.schema.transaction_cache import HAS_AUDIT_ROWS, clear_cache

ROWS_AT_ONCE = 200
CLOCKS_AGREE = timedelta(minutes=2)
RowKey = tuple[object, ...]
"""Table and primary key of a row."""

LOT_FIELDS = ("source", "sample_rate_Hz", "sensor_model", "reference_quantity", "reference_unit", "output_unit")


@dataclass(frozen=True)
class SyncReport:
    """Counts of a synchronisation.

    Args:
        sent, received: rows of the audit trail that went to the other registry and came from there.
        conflicts: what two registries did to the same thing, for a person to decide.
        clocks: registries whose clocks are wrong; their order is not to be trusted.
    """

    sent: int
    received: int
    conflicts: tuple[str, ...]
    clocks: tuple[str, ...] = ()


def synchronise(local: RegistryBase, remote: RegistryBase) -> SyncReport:
    """Send what `remote` does not have, take what `local` does not have.

    `InputError`: both are one registry, or copies of one file that were both written to. `RegistryError`: a chain is
    damaged or a connection broke; run it again.
    """
    if local.origin == remote.origin:
        raise InputError(
            "both registries are one and the same, or one is a plain copy of the other's file; "
            "make copies with `softcal registry backup` and `restore`"
        )
    sent, received = _send(local.database, remote.database), _send(remote.database, local.database)
    now, clocks = local.settings.clock(), list[str]()
    # Of a server its clock now, of a registry its newest row.
    for side in (local, remote):
        if not side.database.is_sqlite:
            server: datetime = side.database.value(select(func.clock_timestamp()))
            if abs(server - now) > CLOCKS_AGREE:
                name = side.database.name
                clocks.append(f"the clock of this computer and the server's of {name} are {server - now} apart")
    for origin in history.origins(local.database):
        newest = select(audit.c.at).where(audit.c.origin == origin).order_by(audit.c.seq.desc()).limit(1)
        at: datetime = local.database.value(newest)
        if at - now > CLOCKS_AGREE:
            clocks.append(
                f"registry {origin} wrote its newest row at {at:%Y-%m-%d %H:%M:%S} UTC, {at - now} ahead of this "
                "computer's clock; set that station's clock, and do not trust which of two results is the newer"
            )
    return SyncReport(sent, received, tuple(conflicts(local)), tuple(clocks))


def conflicts(registry: RegistryBase) -> list[str]:
    """Return one line for everything that two registries did differently."""
    database = registry.database
    with database.reading():
        map_conflicts = [conflict_line(database, lot_id, serial) for lot_id, serial in conflicts_of(database)]
        set_twice = [
            *_version_conflicts(database, limits, "limit"),
            *_version_conflicts(database, line_rules, "rules of the line"),
        ]
        decided = decision_conflicts(database)
        chains: dict[str, set[str]] = {}
        for key, after in database.tuples(select(audit.c.key, audit.c.after).where(audit.c.entity == "lots")):
            settings = json.loads(after)
            chains.setdefault(key, set()).add(json.dumps([settings[name] for name in LOT_FIELDS]))
    differing = [
        f"lot {json.loads(key)[0]!r} was registered with other facts elsewhere; give one of them another id"
        for key, versions in sorted(chains.items())
        if len(versions) > 1
    ]
    return [*map_conflicts, *set_twice, *decided, *differing]


def _version_conflicts(database: Database, versions: Table, noun: str) -> list[str]:
    """Return a line for each lot whose newest version two registries set to different values."""
    c = versions.c
    newest = select(c.lot_id, func.max(c.version).label("version")).group_by(c.lot_id).subquery()
    is_newest = and_(newest.c.lot_id == c.lot_id, newest.c.version == c.version)
    values: dict[tuple[str, int], set[tuple[object, ...]]] = {}
    for row in database.rows(select(versions).join(newest, is_newest).order_by(c.lot_id)):
        of_version = values.setdefault((row["lot_id"], row["version"]), set())
        # Who set it, and when, is no part of what it says.
        of_version.add(tuple(row[name] for name in c.keys() if name not in ("origin", "made_at", "actor", "reason")))
    return [
        f"lot {lot_id!r} {noun} version {number} was set by two registries; the newer one holds"
        for (lot_id, number), different in values.items()
        if len(different) > 1
    ]


def _send(source: Database, target: Database) -> int:
    sent = 0
    copied: set[RowKey] = set()
    for origin in history.origins(source):
        while chunk := _missing(source, target, origin):
            with source.reading(), target.writing() as connection:
                for entry in chunk:
                    if entry.entity in AUDITED:
                        table = metadata.tables[entry.entity]
                        key = dict(zip(table.primary_key.columns.keys(), json.loads(entry.key), strict=True))
                        for name, value in key.items():
                            if isinstance(kind := table.c[name].type, UtcTime | Date):
                                day_or_time = datetime if isinstance(kind, UtcTime) else date
                                key[name] = day_or_time.fromisoformat(value)
                        _copy(source, target, table, key, copied)
                target.change(insert(audit), [vars(entry) for entry in chunk])
                connection.info[HAS_AUDIT_ROWS] = True
                clear_cache(connection)
            sent += len(chunk)
    return sent


def _missing(source: Database, target: Database, origin: str) -> list[AuditRow]:
    """Return the next rows of a chain that the target lacks, after a check that they continue its chain."""
    seq, sha256 = history.head(target, origin)
    with source.reading():
        newest, _ = history.head(source, origin)
        if newest < seq:
            return []
        if seq:
            query = select(audit.c.hash).where(audit.c.origin == origin, audit.c.seq == seq)
            if source.value(query) != sha256:
                raise InputError(
                    f"the history of registry {origin} parts at row {seq}: two copies of one file were both written "
                    "to; bring one of them in with `softcal registry restore`"
                )
        rows = list(history.rows(source, origin, seq, ROWS_AT_ONCE))
    for entry in rows:
        if entry.prev_hash != sha256 or entry.hash != history.row_hash(entry):
            raise RegistryError(f"audit {origin} row {entry.seq} is damaged; run `softcal registry verify` there")
        sha256 = entry.hash
    return rows


def _copy(source: Database, target: Database, table: Table, key: dict[str, Any], copied: set[RowKey]) -> None:
    """Copy a row after the rows that it refers to, unless the target has it; `copied` are the rows of the target."""
    row_key = (table.name, *key.values())
    if row_key in copied:
        return
    copied.add(row_key)
    where = and_(*(table.c[name] == value for name, value in key.items()))
    if target.row(select(table.primary_key.columns[0]).where(where)) is not None:
        return
    row = source.row(select(table).where(where))
    if row is None:
        raise RegistryError(f"{table.name} {list(key.values())} is missing; run `softcal registry verify` there")
    for constraint in table.foreign_key_constraints:
        parent = {element.column.name: row[element.parent.name] for element in constraint.elements}
        if None in parent.values():
            continue
        if constraint.referred_table is blobs:
            copy_blob(source, target, parent["sha256"])
        else:
            _copy(source, target, constraint.referred_table, parent, copied)
    target.change(insert(table), dict(row))
