"""The runs of a lot with day, station and operator, and the first-pass yield over each."""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import date, tzinfo

from softcal.core.quality.yields import GOOD, UNDECIDED, Share
from softcal.db.entries import RunEntry
from softcal.db.queues.order_queue import Pressed
from softcal.db.registry import Registry

DESK = ""
"""Station and operator of a result whose recording came as a file."""


@dataclass(frozen=True)
class PlacedRun:
    """One result of one unit: when it was made, where its recording was pressed and by whom."""

    run: RunEntry
    station: str = DESK
    operator: str = DESK

    def day(self, zone: tzinfo | None) -> date:
        """Return the day of the result in a time zone; None is that of this machine."""
        return self.run.made_at.astimezone(zone).date()


@dataclass(frozen=True)
class LotFilter:
    """Which runs of a lot; days are both included, and what is empty takes all.

    Args:
        stations, operators: names; `DESK` for results of files.
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

    def takes(self, run: PlacedRun) -> bool:
        return (
            (self.since is None or run.day(self.zone) >= self.since)
            and (self.until is None or run.day(self.zone) <= self.until)
            and (not self.stations or run.station in self.stations)
            and (not self.operators or run.operator in self.operators)
        )


def lot_runs(registry: Registry, lot_id: str) -> tuple[PlacedRun, ...]:
    """Return every result of a lot in time order with where its recording was pressed."""
    return placed(registry.lots.runs(lot_id), registry.order_queue.pressed(lot_id))


def placed(runs: Sequence[RunEntry], pressed: Sequence[Pressed]) -> tuple[PlacedRun, ...]:
    """Return each run with the press of its unit that began last before the result."""
    by_serial: dict[str, list[Pressed]] = {}
    for one in sorted(pressed, key=lambda press: press.begun):
        by_serial.setdefault(one.serial, []).append(one)
    found = []
    for run in runs:
        known = by_serial.get(run.serial, [])
        at = bisect_right([press.begun for press in known], run.made_at)
        found.append(PlacedRun(run, known[at - 1].station, known[at - 1].actor) if at else PlacedRun(run))
    return tuple(found)


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


def yield_over(runs: Sequence[PlacedRun], place: Callable[[PlacedRun], str]) -> tuple[YieldAt, ...]:
    """Return the first-pass yield by the place of each unit's first decided run."""
    firsts: dict[str, PlacedRun] = {}
    for run in runs:
        if run.run.serial not in firsts or firsts[run.run.serial].run.verdict in UNDECIDED:
            firsts[run.run.serial] = run
    groups: dict[str, list[str]] = {}
    for run in firsts.values():
        groups.setdefault(place(run), []).append(run.run.verdict)
    return tuple(YieldAt(name, _share(group), len(group)) for name, group in sorted(groups.items()))


def _share(verdicts: Sequence[str]) -> Share:
    return Share(sum(one in GOOD for one in verdicts), sum(one not in UNDECIDED for one in verdicts))
