"""Yields of a lot from the order in which each unit got its verdicts."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from softcal.core.messages.reason import PLAIN, Reason, plain
from softcal.core.metrics import wilson
from softcal.core.unit.verdict import Verdict

GOOD = frozenset({Verdict.PASS})
UNDECIDED = frozenset({Verdict.CONDITIONAL})
"""Units that wait for evidence are neither good nor bad: a lot that nobody audited has no yield yet, not one of 0 %."""


@dataclass(frozen=True)
class Share:
    """A part of a whole with its 95 % interval (Wilson 1927)."""

    count: int
    of: int

    @property
    def value(self) -> float | None:
        """None where there is nothing to take a part of."""
        return self.count / self.of if self.of else None

    @property
    def interval(self) -> tuple[float, float]:
        return wilson(self.count, self.of)


@dataclass(frozen=True)
class Yields:
    """Yields of units, each counted once, and what stands first where the newest verdict is not good.

    Kinds of reasons with how often they do, the most frequent first; each kind by the newest reason of it.
    """

    first_pass: Share
    second_pass: Share  # noqa: V107
    last_pass: Share
    runs: Share
    reasons: tuple[tuple[Reason, int], ...]


@dataclass(frozen=True)
class UnitRun:
    """One verdict of one unit."""

    verdict: str
    reasons: tuple[Reason, ...] = ()


def yields(runs: Mapping[str, Sequence[UnitRun]], golden: Collection[str] = (), good: Collection[str] = GOOD) -> Yields:
    """Count the yields of a lot from the decided runs of each unit in time order; golden units are left out."""
    units = [unit for serial, unit in runs.items() if unit and serial not in golden]
    decided = [[run.verdict in good for run in unit if run.verdict not in UNDECIDED - set(good)] for unit in units]
    verdicts = [unit for unit in decided if unit]
    firsts = [
        unit[-1].reasons[0] if unit[-1].reasons else plain("no reason given")
        for unit in units
        if unit[-1].verdict not in good
    ]
    kinds = {kind(first): first for first in firsts}
    counts = Counter(map(kind, firsts))
    return Yields(
        first_pass=Share(sum(unit[0] for unit in verdicts), len(verdicts)),
        second_pass=Share(sum(any(unit[:2]) for unit in verdicts), len(verdicts)),
        last_pass=Share(sum(unit[-1] for unit in verdicts), len(verdicts)),
        runs=Share(sum(sum(unit) for unit in verdicts), sum(map(len, verdicts))),
        reasons=tuple(
            (kinds[name], count) for name, count in sorted(counts.items(), key=lambda item: (-item[1], item[0]))
        ),
    )


def kind(reason: Reason) -> str:
    """Return what reasons are counted by: their code with the codes in it, as "statement measured above".

    The sentence itself where it was quoted from a file or a device.
    """
    if reason.code == PLAIN:
        return str(reason)
    parts = (value.code for value in reason.values.values() if isinstance(value, Reason) and value.code != PLAIN)
    return " ".join((reason.code, *parts))
