"""What the registry says of itself as rows and JSON, and what keeps it whole: upgrade, check, backup, restore."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from softcal.app.registry.anchors import read_anchor, remember, remembered
from softcal.core.errors import InputError, RegistryError
from softcal.db.backup import back_up, restore
from softcal.db.connection import open_registry
from softcal.db.database import Database, open_database, schema_of
from softcal.db.entries import StoredCalibration, UnitEntry
from softcal.db.maintenance import Heads, migrate
from softcal.db.registry import Registry
from softcal.db.sync import SyncReport, synchronise
from softcal.db.tables import SCHEMA

UNIT_HEADER = (
    "lot",
    "serial",
    "role",
    "verdict",
    "rev",
    "map",
    "predicted",
    "before",
    "after",
    "own",
    "made",
    "reason",
)
HISTORY_HEADER = (
    "rev",
    "registry",
    "in use",
    "made (UTC)",
    "by",
    "lot",
    "verdict",
    "map",
    "predicted",
    "after",
    "remark",
)


@dataclass(frozen=True)
class Upgrade:
    """What `registry upgrade` did: from which schema (None: empty) to which, and where the old one was backed up."""

    before: str | None
    after: str
    backup: Path | None


def upgrade(url: str) -> Upgrade:
    """Bring a registry to the schema of this version; an SQLite registry with data is backed up beside itself first.

    Raises:
        RegistryError: it cannot be opened, was made by a newer version, or the upgrade failed and nothing was changed.
    """
    database = open_database(url)
    try:
        before = schema_of(database)
        if before is not None and before > SCHEMA:
            raise RegistryError(f"registry {database.name} has schema {before}, newer than {SCHEMA}; update softcal")
        if before == SCHEMA:
            return Upgrade(before, SCHEMA, None)
        backup = _backup_before_upgrade(database, before)
        return Upgrade(before, migrate(database), backup)
    finally:
        database.close()


def _backup_before_upgrade(database: Database, schema: str | None) -> Path | None:
    # On PostgreSQL the upgrade is one transaction, and the server has backups of its own.
    path = database.path
    if schema is None or path is None:
        return None
    backup = path.with_name(f"{path.stem}-schema-{schema}-{datetime.now(UTC):%Y%m%d-%H%M%S}.db")
    back_up(database, backup)
    return backup


@dataclass(frozen=True)
class Verification:
    """What `registry verify` found.

    Args:
        faults: a line each.
        audit_rows: rows of the audit trail, of all chains.
        heads: number and hash of the last row of each chain; written down elsewhere they prove that nothing was cut.
    """

    faults: tuple[str, ...]
    audit_rows: int
    heads: Heads


def verify(
    registry: Registry,
    *,
    is_quick: bool = False,
    files: Sequence[Path] = (),
    on_step: Callable[[str], None] = lambda _: None,
) -> Verification:
    """Check a registry against its schema, its audit trail, and what was written down of the trail elsewhere.

    Args:
        is_quick: leave out what reads every page and blob.
        files: backups and `audit.json` of exports to compare with, beside what this computer remembers.
    """
    anchors = [*remembered(registry), *map(read_anchor, files)]
    faults = tuple(registry.verify(is_quick=is_quick, anchors=anchors, on_step=on_step))
    heads = registry.heads()
    return Verification(faults, sum(seq for seq, _ in heads.values()), heads)


def back_up_registry(registry: Registry, path: Path) -> None:
    """Write a backup while the registry is in use."""
    back_up(registry.database, path)
    remember(registry, f"backup {path.absolute()}")


def restore_registry(path: Path, url: str) -> None:
    """Fill an empty registry from a backup."""
    restore(path, url)


def synchronise_with(registry: Registry, other_url: str) -> SyncReport:
    """Bring a registry and the one behind another URL together, both ways."""
    with open_registry(other_url, registry.settings) as other:
        return synchronise(registry, other)


def unit_row(unit: UnitEntry) -> list[object]:
    """Return one row of the table under `UNIT_HEADER`."""
    conflict = "two registries put different maps into use; see history" if unit.is_conflict else ""
    stale = "stale: made with another method than this version's; run the batch again" if unit.is_stale else ""
    reason = "; ".join(filter(None, (conflict, stale, *map(str, unit.reasons))))
    errors = [unit.predicted_rmse, unit.before_rmse, unit.after_rmse, unit.own_rmse]
    made = unit.made_at and f"{unit.made_at:%Y-%m-%d %H:%M}"
    return [unit.lot_id, unit.serial, unit.role, unit.verdict, unit.revision, unit.family, *errors, made, reason]


def unit_json(unit: UnitEntry) -> dict[str, object]:
    """Return a unit as JSON values."""
    return vars(unit) | {
        "reasons": [str(why) for why in unit.reasons],
        "made_at": unit.made_at and unit.made_at.isoformat(),
    }


def only_lot(serial: str, lots: Sequence[str], wanted: str | None) -> str:
    """Return the lot of a serial.

    Args:
        lots: those the serial stands in, of `wanted` only where it is given.

    Raises:
        InputError: none, or several.
    """
    if not lots:
        raise InputError(f"serial {serial!r} is not in lot {wanted!r}")
    if len(lots) > 1:
        raise InputError(f"serial {serial!r} stands in the lots {', '.join(map(repr, lots))}; say which with --lot")
    return lots[0]


def history_row(stored: StoredCalibration) -> list[object]:
    """Return one row of the table under `HISTORY_HEADER`."""
    record = stored.record
    remarks = [
        f"back to revision {stored.rolled_back_to}" if stored.rolled_back_to else "",
        "put into use by one of two registries" if stored.is_conflict else "",
        stored.reason,
    ]
    return [
        stored.revision,
        stored.origin,
        "yes" if stored.is_current else "",
        f"{stored.made_at:%Y-%m-%d %H:%M:%S}",
        stored.actor,
        stored.lot_id,
        record.verdict,
        record.family,
        record.predicted_rmse,
        record.after_rmse,
        "; ".join(filter(None, remarks)),
    ]


def history_json(stored: StoredCalibration) -> dict[str, object]:
    """Return a revision as JSON values, without its arrays."""
    facts = {name: value for name, value in vars(stored).items() if name != "record"}
    record = {name: value for name, value in vars(stored.record).items() if name not in ("arrays", "settings")}
    texts = {"reasons": [str(why) for why in stored.record.reasons], "evidence": dict(stored.record.evidence)}
    return facts | record | texts | {"made_at": stored.made_at.isoformat()}
