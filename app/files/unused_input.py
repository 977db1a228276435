"""Unused inputs with reasons: files, rows, columns and audits; and their list on a terminal."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from softcal.core.messages.reason import Reason

Kind = Literal["file", "rows", "column", "audit"]

MAX_NAMES = 8
"""So many names are listed where a reason is of many."""


@dataclass(frozen=True)
class UnusedInput:
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


def unused_input_lines(items: Iterable[UnusedInput]) -> list[str]:
    """Return the unused inputs, a line for each kind and reason: `not used: columns a, b of 3 files: ...`."""
    groups: dict[tuple[str, str], list[UnusedInput]] = {}
    for item in items:
        groups.setdefault((item.kind, str(item.why)), []).append(item)
    return [_line(kind, cause, group) for (kind, cause), group in groups.items()]


def _line(kind: str, cause: str, group: Sequence[UnusedInput]) -> str:
    names = list(dict.fromkeys(item.name for item in group))
    more = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
    files = {item.file for item in group if item.file and kind == "column"}
    of_files = f" of {len(files)} files" if len(files) > 1 else f" of {min(files)}" if files else ""
    subject = "rows of" if kind == "rows" else kind if len(names) == 1 else f"{kind}s"
    return f"not used: {subject} {', '.join(names[:MAX_NAMES])}{more}{of_files}: {cause}"
