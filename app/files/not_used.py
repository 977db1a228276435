"""Unused inputs with reasons: files, rows, columns and audits; and their list on a terminal."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from softcal.core.messages.reason import Reason

Kind = Literal["file", "rows", "column", "audit"]

MAX_NAMES = 8
"""So many names are listed where a reason is of many."""


@dataclass(frozen=True)
class NotUsed:
    """One unused input.

    Args:
        name: of the file or the column, else the serial whose rows or audit these are.
        file: the file that holds it; empty where it is the file.
    """

    kind: Kind
    name: str
    why: Reason
    file: str = ""

    def to_json(self) -> dict[str, object]:
        file = {"file": self.file} if self.file else {}
        return {"kind": self.kind, "name": self.name, **file, "why": str(self.why), "code": self.why.code}


def not_used_lines(items: Iterable[NotUsed]) -> list[str]:
    """Return the unused inputs, a line for each kind and reason: `not used: columns a, b of 3 files: ...`."""
    groups: dict[tuple[str, str], list[NotUsed]] = {}
    for item in items:
        groups.setdefault((item.kind, str(item.why)), []).append(item)
    return [_line(kind, why, group) for (kind, why), group in groups.items()]


def _line(kind: str, why: str, group: Sequence[NotUsed]) -> str:
    names = list(dict.fromkeys(item.name for item in group))
    more = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
    files = {item.file for item in group if item.file and kind == "column"}
    of = f" of {len(files)} files" if len(files) > 1 else f" of {min(files)}" if files else ""
    what = "rows of" if kind == "rows" else kind if len(names) == 1 else f"{kind}s"
    return f"not used: {what} {', '.join(names[:MAX_NAMES])}{more}{of}: {why}"
