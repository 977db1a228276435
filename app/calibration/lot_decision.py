"""Decisions on a lot as a whole, as the registry stores them: one of a number holds all that is in force."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import msgspec

from softcal.core.messages.reason import Reason
from softcal.core.unit.adjustments import SampleRelease
from softcal.core.unit.lot_correction import LotCorrection
from softcal.db.provenance import Provenance
from softcal.db.registry import Registry


@dataclass(frozen=True)
class LotFitDecision:
    """The fit of a lot in force.

    Args:
        number: 1, 2, 3 ... of the fits of this lot, and of their withdrawals; 0 before the first.
        sittings: serials of the units whose maps rest on one common load each.
        alone: why others that share one stand alone.
        sources: which networks read the lot otherwise than those of its other sources.
        is_withdrawn: whether a person took it back: then a person makes the next one.
    """

    number: int = 0
    sittings: tuple[tuple[str, ...], ...] = ()
    alone: Mapping[str, Reason] = field(default_factory=dict)
    is_withdrawn: bool = False
    sources: tuple[Reason, ...] = ()


@dataclass(frozen=True)
class LotDecision:
    """What was decided on a lot as a whole.

    Args:
        fit: which units are mapped together.
        correction: what audited units misread alike, taken off the maps of the lot.
        next_unit: what the statement says of a unit that is to come; None where none is released by sample.
        released: units released by sample.
        limit_rmse: stated limit that the statement was made for; None without one.
        source: which audits the statement rests on.
        statement: the statement itself.
        provenance: what made the statement, from which networks and audits; None before the first.
    """

    fit: LotFitDecision = LotFitDecision()
    correction: LotCorrection = LotCorrection(0)
    next_unit: SampleRelease | None = None
    released: tuple[str, ...] = ()
    limit_rmse: float | None = None
    source: str = ""
    statement: Reason | None = None
    provenance: Provenance | None = None

    def is_as(self, other: "LotDecision") -> bool:
        """Whether another decision says the same, whatever its number and whoever made it."""
        return self._without_numbers() == other._without_numbers()

    def _without_numbers(self) -> "LotDecision":
        following = self.next_unit and replace(self.next_unit, number=0)
        return replace(self, correction=replace(self.correction, number=0), next_unit=following, provenance=None)


def decision_in_force(registry: Registry, lot_id: str) -> LotDecision:
    """Return the newest decision on a lot; an empty one before the first."""
    entry = registry.decisions.in_force(lot_id)
    return LotDecision() if entry is None else msgspec.convert(dict(entry.decision), LotDecision)


def next_number(registry: Registry, lot_id: str) -> int:
    """Return the number that the next decision on a lot gets."""
    decisions = registry.decisions.of_lot(lot_id)
    return max((one.number for one in decisions), default=0) + 1
