"""What keeps the registry whole: upgrade, check, backup, restore, synchronisation."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from softcal.app.registry.anchors import read_anchor, remember, remembered
from softcal.core.errors import RegistryError
from softcal.db.care.backup import back_up
from softcal.db.care.maintenance import migrate
from softcal.db.care.sync import SyncReport, synchronise
from softcal.db.connection import open_registry
from softcal.db.entries import Heads
from softcal.db.registry import Registry
from softcal.db.schema.database import open_database, schema_of
from softcal.db.schema.tables import SCHEMA


@dataclass(frozen=True)
class Upgrade:
    """What an upgrade did: from which schema (None: empty) to which, and the backup of the old."""

    before: str | None
    after: str
    backup: Path | None


def upgrade(url: str) -> Upgrade:
    """Bring a registry to this version's schema; an SQLite one is backed up beside itself.

    Raises:
        RegistryError: it cannot be opened, is newer, or the upgrade failed; nothing changed.
    """
    database = open_database(url)
    try:
        before = schema_of(database)
        if before is not None and before > SCHEMA:
            raise RegistryError(f"registry {database.name} has schema {before}, newer than {SCHEMA}; update softcal")
        if before == SCHEMA:
            return Upgrade(before, SCHEMA, None)
        backup = None
        # On PostgreSQL the upgrade is one transaction, and the server has backups of its own.
        if before is not None and (path := database.path) is not None:
            backup = path.with_name(f"{path.stem}-schema-{before}-{datetime.now(UTC):%Y%m%d-%H%M%S}.db")
            back_up(database, backup)
        return Upgrade(before, migrate(database), backup)
    finally:
        database.close()


@dataclass(frozen=True)
class Verification:
    """What `registry verify` found.

    Args:
        heads: last row of each chain; written down elsewhere they prove that nothing was cut.
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
    """Check a registry against its schema, its audit trail, and what is written elsewhere.

    Args:
        is_quick: leave out what reads every page and blob.
        files: backups and `audit.json` of exports to compare with.
    """
    anchors = [*remembered(registry), *map(read_anchor, files)]
    faults = tuple(registry.verify(is_quick=is_quick, anchors=anchors, on_step=on_step))
    heads = registry.trail.heads()
    return Verification(faults, sum(seq for seq, _ in heads.values()), heads)


def back_up_registry(registry: Registry, path: Path) -> None:
    """Write a backup while the registry is in use."""
    back_up(registry.database, path)
    remember(registry, f"backup {path.absolute()}")


def synchronise_with(registry: Registry, other_url: str) -> SyncReport:
    """Bring a registry and the one behind another URL together, both ways."""
    with open_registry(other_url, registry.settings) as other:
        return synchronise(registry, other)
