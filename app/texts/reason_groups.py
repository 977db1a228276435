"""Reasons of many units, each once with the units that it is of."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from softcal.core.messages.figures import format_error
from softcal.core.messages.reason import (
    ENGLISH,
    PLAIN,
    VALUES_IN_LIMIT_UNIT,
    Reason,
    Value,
    fill_sentence,
    format_number,
)

MAX_NAMES = 8
"""So many units are named where a reason is of many; the table and the JSON have all."""


class HasReasons(Protocol):
    """A unit with its verdict, and why."""

    @property
    def serial(self) -> str: ...

    @property
    def verdict(self) -> str | None: ...

    @property
    def reasons(self) -> Sequence[Reason]: ...


@dataclass(frozen=True)
class _Range:
    """A number of a sentence that differs from unit to unit."""

    low: float
    high: float

    def __format__(self, spec: str) -> str:
        return self._between(*(format_number(end, spec) for end in (self.low, self.high)))

    def format_errors(self, limit: float) -> str:
        return self._between(*(format_error(end, limit) for end in (self.low, self.high)))

    def _between(self, low: str, high: str) -> str:
        return low if low == high else f"{low} to {high}"


def reasons_by_verdict(units: Sequence[HasReasons], verdicts: Iterable[str]) -> list[tuple[str, list[str]]]:
    """Return for each of the verdicts its units and, each once, their reasons: those of most units first.

    A number that differs within a reason's units is given as its range.
    """
    sections = []
    for verdict in verdicts:
        matching = [unit for unit in units if unit.verdict == verdict]
        groups: dict[object, list[tuple[str, Reason, int]]] = {}
        for unit in matching:
            for rank, reason in enumerate(unit.reasons):
                groups.setdefault(_sentence_of(reason), []).append((unit.serial, reason, rank))
        by_weight = sorted(groups.values(), key=lambda group: (min(rank for *_, rank in group), -len(group)))
        lines = []
        for group in by_weight:
            names = dict.fromkeys(serial for serial, *_ in group)
            prefix = "" if len(names) == len(matching) else f"{name_serials(names)}: "
            lines.append(f"{prefix}{_render_group([reason for _, reason, _ in group])}")
        if matching:
            count = "" if len(matching) == 1 else f"{len(matching)} units {verdict}: "
            end = f" {verdict}" if len(matching) == 1 else ""
            sections.append((f"{count}{name_serials([unit.serial for unit in matching])}{end}", lines))
    return sections


def name_serials(serials: Collection[str]) -> str:
    """Return the first serials of many, and how many more there are."""
    more = f" and {len(serials) - MAX_NAMES} more" if len(serials) > MAX_NAMES else ""
    return ", ".join(list(serials)[:MAX_NAMES]) + more


def _sentence_of(reason: Reason) -> object:
    """Return what is equal for two reasons that one sentence says: their codes, and those of their phrases."""
    if reason.code == PLAIN:
        return str(reason)
    return reason.code, *(_sentence_of(value) for value in reason.values.values() if isinstance(value, Reason))


def _render_group(reasons: Sequence[Reason]) -> str:
    """Return one sentence for reasons of one sentence; of their intervals the one that holds all."""
    values = {name: _merge_values([one.values[name] for one in reasons]) for name in reasons[0].values}
    for name, end in (("lower", "low"), ("upper", "high")):
        values |= {name: getattr(values[name], end)} if isinstance(values.get(name), _Range) else {}
    if isinstance(limit := values.get("limit"), float):
        values |= {
            name: one.format_errors(limit)
            for name in VALUES_IN_LIMIT_UNIT
            if isinstance(one := values.get(name), _Range)
        }
    return fill_sentence(ENGLISH[reasons[0].code], values)


def _merge_values(values: Sequence[Value]) -> object:
    numbers = [value for value in values if isinstance(value, int | float)]
    phrases = [value for value in values if isinstance(value, Reason)]
    if len(numbers) == len(values):
        return numbers[0] if min(numbers) == max(numbers) else _Range(min(numbers), max(numbers))
    if len(phrases) == len(values):
        return _render_group(phrases)
    return name_serials(dict.fromkeys(map(str, values)))
