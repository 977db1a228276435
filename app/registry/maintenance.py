"""Maintenance of the registry: upgrade, check, backup, restore, synchronisation."""

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from softcal.app.registry.anchors import read_anchor, read_recorded_heads, record_heads
from softcal.db.connection import open_registry
from softcal.db.entries import Heads
from softcal.db.maintenance.backup import back_up
from softcal.db.maintenance.maintenance import migrate
from softcal.db.maintenance.sync import SyncReport, synchronise
from softcal.db.registry import Registry
from softcal.db.schema.database import check_schema, open_database, schema_of


def upgrade(url: str) -> str | None:
    """Create the tables in an empty database; return the schema before, None of an empty database.

    `RegistryError`: it cannot be opened, or it has a schema that this version does not know; nothing changed.
    """
    with closing(open_database(url)) as database:
        before = schema_of(database)
        check_schema(database, migrate(database) if before is None else before)
        return before


@dataclass(frozen=True)
class Verification:
    """Result of `registry verify`.

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
    """Check a registry against its schema, its audit trail, and anchors outside it.

    Args:
        is_quick: leave out what reads every page and blob.
        files: backups and `audit.json` of exports to compare with.
    """
    anchors = [*read_recorded_heads(registry), *map(read_anchor, files)]
    faults = tuple(registry.verify(is_quick=is_quick, anchors=anchors, on_step=on_step))
    heads = registry.trail.heads()
    return Verification(faults, sum(seq for seq, _ in heads.values()), heads)


def back_up_registry(registry: Registry, path: Path) -> None:
    """Write a backup while the registry is in use."""
    back_up(registry.database, path)
    record_heads(registry, f"backup {path.absolute()}")


def synchronise_with(registry: Registry, other_url: str) -> SyncReport:
    """Synchronise a registry with the one at another URL, in both directions."""
    with open_registry(other_url, registry.settings) as other:
        return synchronise(registry, other)
