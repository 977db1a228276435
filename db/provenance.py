"""Provenance of a result: version, build, method, hashes of inputs, time and actor."""

import hashlib
import os
import shutil
import subprocess
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import distribution, version
from pathlib import Path

from softcal.core.identity import content_sha256

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """Provenance of a result: what computed it, and from which inputs.

    Args:
        build: commit of a checkout; of an installed package the SHA-256 of its list of files.
        method: identity of every number of the method.
        inputs: SHA-256 of each thing that was read, by its name.
        made_at: instant at which the result was made, UTC, ISO 8601.
        actor: who made it.
    """

    version: str
    build: str
    method: str
    inputs: Mapping[str, str]
    made_at: str
    actor: str

    @property
    def id(self) -> str:
        """Content hash of the record."""
        return content_sha256({}, self.to_json())

    @property
    def software(self) -> str:
        """Name and version of the program."""
        return f"softcal {self.version}"

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Rows of (name, value) of the provenance, for people."""
        hashes = [(f"SHA-256 of the {name}", sha256) for name, sha256 in self.inputs.items()]
        creation = [("Made by", self.actor), ("Made at", self.made_at)]
        return [("Program", self.software), ("Build", self.build), ("Method", self.method), *creation, *hashes]

    def to_json(self) -> dict[str, object]:
        return asdict(self)


def software_now() -> dict[str, str]:
    """Return version and build of the program that runs, as every stored result holds them."""
    return {"version": version("softcal"), "build": build_id()}


def record_provenance(method: str, inputs: Mapping[str, str], actor: str) -> Provenance:
    """Return the provenance of a result that is computed now."""
    made_at = datetime.now(UTC).isoformat(timespec="seconds")
    return Provenance(method=method, inputs=inputs, made_at=made_at, actor=actor, **software_now())


def hash_files(root: Path, files: Iterable[Path]) -> dict[str, str]:
    """Return the SHA-256 of files by their path relative to a folder."""
    return {os.path.relpath(path, root): _sha256(path) for path in sorted(set(files))}


@cache
def build_id() -> str:
    """Return the commit of a checkout, with -dirty where files were changed, or the hash of an installed package's list
    of files; "" where neither is.
    """
    if (ROOT / ".git").exists() and (git := shutil.which("git")) is not None:
        describe = [git, "-C", str(ROOT), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
        answer = subprocess.run(describe, capture_output=True, text=True, check=False)
        if answer.returncode == 0:
            return answer.stdout.strip()
    record = distribution("softcal").read_text("RECORD")
    return "" if record is None else hashlib.sha256(record.encode()).hexdigest()


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
