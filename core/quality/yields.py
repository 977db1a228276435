"""Yields of a lot from the order in which each unit got its verdicts."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

GOOD = frozenset({"pass"})


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
        if not self.of:
            return 0.0, 1.0
        z = float(stats.norm.ppf(0.975))
        p, n = self.count / self.of, self.of
        centre = (p + z**2 / (2 * n)) / (1 + z**2 / n)
        half = z / (1 + z**2 / n) * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
        return max(0.0, float(centre - half)), min(1.0, float(centre + half))


@dataclass(frozen=True)
class Yields:
    """Yields of units, each counted once.

    Args:
        first_pass: units good in their first run.
        second_pass: units good in their first or second run.
        last_pass: units whose newest verdict is good.
        runs: runs that were good, of all runs.
        reasons: how often each reason stands first where the newest verdict is not good, most frequent first.
    """

    first_pass: Share
    second_pass: Share
    last_pass: Share
    runs: Share
    reasons: tuple[tuple[str, int], ...]


@dataclass(frozen=True)
class Run:
    """One verdict of one unit."""

    verdict: str
    reasons: tuple[str, ...] = ()


def yields(runs: Mapping[str, Sequence[Run]], golden: Collection[str] = (), good: Collection[str] = GOOD) -> Yields:
    """Count the yields of a lot.

    Args:
        runs: per serial its runs in time order; a unit without a run does not count.
        golden: serials that check the station; they are left out.
        good: verdicts that count as good.
    """
    kept = [unit for serial, unit in runs.items() if unit and serial not in golden]
    verdicts = [[run.verdict in good for run in unit] for unit in kept]
    reasons: dict[str, int] = {}
    for unit in kept:
        if unit[-1].verdict not in good:
            first = unit[-1].reasons[0] if unit[-1].reasons else "no reason given"
            reasons[first] = reasons.get(first, 0) + 1
    return Yields(
        first_pass=Share(sum(unit[0] for unit in verdicts), len(kept)),
        second_pass=Share(sum(any(unit[:2]) for unit in verdicts), len(kept)),
        last_pass=Share(sum(unit[-1] for unit in verdicts), len(kept)),
        runs=Share(sum(sum(unit) for unit in verdicts), sum(map(len, verdicts))),
        reasons=tuple(sorted(reasons.items(), key=lambda item: (-item[1], item[0]))),
    )


def rolled_throughput(shares: Sequence[Share]) -> float | None:
    """Return the product of first-pass yields over processes in a row; None where one of them saw no unit."""
    values = [share.value for share in shares]
    return None if None in values else float(np.prod([value for value in values if value is not None]))
