"""What a job says while it works, and what it leaves."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from softcal.db.queues.job_board import JobBoard

if TYPE_CHECKING:
    from softcal.db.schema.arrays import Arrays

REPORT_S = 0.4
"""Between two reports; each is one transaction."""


@dataclass(frozen=True)
class Outcome:
    """What a job leaves: a sentence, JSON values, arrays."""

    message: str
    result: Mapping[str, Any] = field(default_factory=dict)
    arrays: "Arrays | None" = None


class Teller:
    """Writes how far a job is, at most every `REPORT_S`."""

    def __init__(self, board: JobBoard, job_id: str) -> None:
        self._board, self._job_id, self._told_s = board, job_id, 0.0

    def __call__(self, fraction: float, message: str, trace: Mapping[str, Any] | None = None) -> None:
        """Tell fraction (0 ... 1), a sentence and live values."""
        if time.monotonic() - self._told_s >= REPORT_S:
            self._told_s = time.monotonic()
            self._board.report(self._job_id, fraction, message, trace)

    def step(self, fraction: float, name: str, **values: object) -> None:
        """Tell a step by the key of its text, `step.NAME`, for screens of any language."""
        self(fraction, "", {"step": name, "values": values})
