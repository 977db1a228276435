"""What a diagnosis must reach on a few fresh cases of every line, so that one that says nothing fails.

The floors lie far below what is measured on many cases, and above what an answer reaches that does not look at the
recording. With a handful of cases a line, a sound diagnosis fails once in hundreds of times, and silence never passes.
"""

from collections.abc import Mapping
from types import MappingProxyType

from softcal.core.challenge.score import ScoreSheet

FLOORS: Mapping[str, float] = MappingProxyType(
    {
        "usual": 0.7,
        "none": 0.7,
        "pair": 0.5,
        "form": 0.5,
        "outside": 0.5,
        "mistakes": 0.7,
        "untared": 0.6,
        "reseated": 0.6,
        "published_form": 0.15,
        "published_outside": 0.15,
    }
)
"""Least share of cases of a line that are right: exactly the true causes, `no_gap`, `unknown` or `data`."""

CASES_OF_FLOOR = 4
"""Cases that a mixed draw has of each of these lines, where it has as many: fewer could miss a floor by chance."""

POOLED = 0.6
"""Least share over all these lines together."""


def shortfalls(sheet: ScoreSheet) -> list[str]:
    """Return one sentence for every floor that is not reached; empty where all are.

    What was drawn is judged, all of it: a case without a report counts as wrong. A line that nobody drew says nothing.
    """
    said, hits, total = [], 0, 0
    for line, floor in FLOORS.items():
        cases = [judged for judged in sheet.judged if judged.label.case.line == line]
        right = sum(judged.outcome == "right" for judged in cases)
        hits, total = hits + right, total + len(cases)
        if right < floor * len(cases):
            said.append(f"{line}: {right} of {len(cases)} right; at least {floor:.0%} were expected")
    if total and hits < POOLED * total:
        said.append(f"all lines: {hits} of {total} right; at least {POOLED:.0%} were expected")
    return said
