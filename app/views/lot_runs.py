"""The runs of a lot with day, station and operator, and the first-pass yield over each."""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import date, tzinfo

from softcal.core.quality.yields import GOOD, UNDECIDED, Share
from softcal.db.entries import RunEntry
from softcal.db.queues.order_queue import UnitPress
from softcal.db.registry import Registry

FROM_FILE = ""
"""Station and operator of a result whose recording came as a file."""


@dataclass(frozen=True)
class AttributedRun:
    """One result of one unit: when it was made, where its recording was pressed and by whom."""

    run: RunEntry
    station: str = FROM_FILE
    operator: str = FROM_FILE

    def day(self, zone: tzinfo | None) -> date:
        """Return the day of the result in a time zone; None is that of this machine."""
        return self.run.made_at.astimezone(zone).date()


@dataclass(frozen=True)
class LotFilter:
    """Which runs of a lot; days are both included, and what is empty takes all.

    Args:
        stations, operators: names; `FROM_FILE` for results of files.
        zone: time zone of the days; None is that of this machine.
    """

    since: date | None = None
    until: date | None = None
    stations: tuple[str, ...] = ()
    operators: tuple[str, ...] = ()
    zone: tzinfo | None = None

    @property
    def is_open(self) -> bool:
        """Whether it takes every run."""
        return self == LotFilter(zone=self.zone)

    def takes(self, run: AttributedRun) -> bool:
        return (
            (self.since is None or run.day(self.zone) >= self.since)
            and (self.until is None or run.day(self.zone) <= self.until)
            and (not self.stations or run.station in self.stations)
            and (not self.operators or run.operator in self.operators)
        )


def lot_runs(registry: Registry, lot_id: str) -> tuple[AttributedRun, ...]:
    """Return every result of a lot in time order with where its recording was pressed."""
    return attribute_runs(registry.lots.runs(lot_id), registry.order_queue.list_presses(lot_id))


def attribute_runs(runs: Sequence[RunEntry], pressed: Sequence[UnitPress]) -> tuple[AttributedRun, ...]:
    """Return each run with the press of its unit that began last before the result."""
    by_serial: dict[str, list[UnitPress]] = {}
    for one in sorted(pressed, key=lambda press: press.begun):
        by_serial.setdefault(one.serial, []).append(one)
    result = []
    for run in runs:
        presses = by_serial.get(run.serial, [])
        at = bisect_right([press.begun for press in presses], run.made_at)
        result.append(AttributedRun(run, presses[at - 1].station, presses[at - 1].actor) if at else AttributedRun(run))
    return tuple(result)


@dataclass(frozen=True)
class YieldAt:
    """First-pass yield of the units first run on one day, at one station or by one operator.

    Args:
        share: of the decided ones.
        units: all of them.
    """

    name: str
    share: Share
    units: int


def yield_over(runs: Sequence[AttributedRun], group_of: Callable[[AttributedRun], str]) -> tuple[YieldAt, ...]:
    """Return the first-pass yield by the place of each unit's first decided run."""
    firsts: dict[str, AttributedRun] = {}
    for run in runs:
        if run.run.serial not in firsts or firsts[run.run.serial].run.verdict in UNDECIDED:
            firsts[run.run.serial] = run
    groups: dict[str, list[str]] = {}
    for run in firsts.values():
        groups.setdefault(group_of(run), []).append(run.run.verdict)
    return tuple(YieldAt(name, _share(group), len(group)) for name, group in sorted(groups.items()))


def _share(verdicts: Sequence[str]) -> Share:
    return Share(sum(one in GOOD for one in verdicts), sum(one not in UNDECIDED for one in verdicts))
