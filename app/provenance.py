"""Where a result comes from: version, build, method, hashes of what was read, when and by whom it was made."""

import hashlib
import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import distribution, version
from pathlib import Path

from softcal.app.bootstrap import current_user

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """What made a result, and from what.

    Args:
        build: commit of a checkout; of an installed package the SHA-256 of its list of files.
        method: identity of every number of the method.
        inputs: SHA-256 of each file that was read, by its path relative to what was asked for.
        made_at: instant at which the result was made, UTC, ISO 8601.
        actor: who made it.
    """

    version: str
    build: str
    method: str
    inputs: Mapping[str, str]
    made_at: str
    actor: str

    def to_json(self) -> dict[str, object]:
        return asdict(self)


def record_provenance(method: str, root: Path, files: Iterable[Path]) -> Provenance:
    """Return the provenance of a result that is made now.

    Args:
        root: folder that paths of inputs are relative to.
        files: files that were read.
    """
    inputs = {os.path.relpath(path, root): _sha256(path) for path in sorted(set(files))}
    return Provenance(
        version=version("softcal"),
        build=build_id(),
        method=method,
        inputs=inputs,
        made_at=datetime.now(UTC).isoformat(timespec="seconds"),
        actor=current_user(),
    )


@cache
def build_id() -> str:
    """Return the commit of a checkout, or the hash of an installed package's list of files; "" where neither is."""
    git = ROOT / ".git"
    if (git / "HEAD").is_file():
        ref = (git / "HEAD").read_text(encoding="utf-8").strip().removeprefix("ref: ")
        if (git / ref).is_file():
            return (git / ref).read_text(encoding="utf-8").strip()
        packed = (git / "packed-refs").read_text(encoding="utf-8") if (git / "packed-refs").is_file() else ""
        return next((line.split()[0] for line in packed.splitlines() if line.endswith(f" {ref}")), ref)
    record = distribution("softcal").read_text("RECORD")
    return "" if record is None else hashlib.sha256(record.encode()).hexdigest()


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
