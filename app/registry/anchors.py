"""Anchors: the last rows of the audit trail stored outside the registry, which reveal a truncated trail."""

import json
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

from softcal.app.bootstrap import data_folder
from softcal.core.errors import InputError, RegistryError, SoftcalError
from softcal.core.json_input import parse_json
from softcal.db.entries import Anchor, Heads
from softcal.db.registry import Registry
from softcal.db.repositories import history
from softcal.db.schema.database import open_database

NAME = "audit-heads.jsonl"
SCHEMA = "softcal.audit-heads/1"


def anchor_json(registry: Registry, reason: str) -> dict[str, object]:
    """Return the last row of every chain as JSON values, to be stored elsewhere."""
    at = datetime.now(UTC).isoformat(timespec="seconds")
    return {"schema": SCHEMA, "registry": registry.origin, "at": at, "why": reason, "heads": registry.trail.heads()}


def record_heads(registry: Registry, reason: str) -> None:
    """Append the last rows to the anchor file of this computer, if it is writable."""
    line = json.dumps(anchor_json(registry, reason), sort_keys=True)
    try:
        with (data_folder() / NAME).open("a", encoding="utf-8") as file:
            file.write(line + "\n")
    except (OSError, SoftcalError):
        return


def read_recorded_heads(registry: Registry) -> list[Anchor]:
    """Return the anchors of a registry on this computer, as far as they can be read."""
    try:
        lines = (data_folder() / NAME).read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError, SoftcalError):
        return []
    anchors = []
    for line in lines:
        try:
            value = parse_json(line)
            if value["registry"] == registry.origin:
                anchors.append(Anchor(_heads(value), f"on this computer at {value['at']} ({value['why']})"))
        except (ValueError, TypeError, KeyError):
            continue
    return anchors


def read_anchor(path: Path) -> Anchor:
    """Read the last rows from a file that an export or `verify --json` wrote, or from a backup.

    Raises:
        InputError: it is neither.
    """
    try:
        if path.read_bytes()[:16] == b"SQLite format 3\0":
            with closing(open_database(f"sqlite:///{path}", create=False)) as database, database.reading():
                return Anchor(history.heads(database), f"in the backup {path}")
        return Anchor(_heads(parse_json(path.read_text(encoding="utf-8"))), f"in {path}")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, TypeError, KeyError, RegistryError) as error:
        raise InputError(f"{path}: holds no last rows of an audit trail; give a backup or an audit.json") from error


def _heads(value: dict[str, dict[str, tuple[int, str]]]) -> Heads:
    return {str(origin): (int(seq), str(sha256)) for origin, (seq, sha256) in value["heads"].items()}
