"""Where a lot stands: which units are released and by what, which wait, which were withdrawn, and why.

Every surface that speaks of a whole lot renders this and decides nothing.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum

from softcal.core.messages.reason import Reason
from softcal.core.quality.lot_release import LotRelease
from softcal.core.unit.verdict import VERDICTS, Limit


class Disposition(StrEnum):
    """Why a unit may leave the house, or what keeps it."""

    MEASURED = "measured"
    SAMPLED = "sampled"
    WAITING = "waiting"
    FAILED = "failed"
    OPEN = "open"


@dataclass(frozen=True)
class UnitInLot:
    """One unit of a lot.

    Args:
        audited_at: when its newest audit came into the registry, UTC; None without one, whether it counts or not.
        forecast_rmse, measured_rmse: in the reference unit; None where there is none.
        suspect_reason: why its audit is set aside; None where it is not.
    """

    serial: str
    verdict: str | None = None
    reasons: tuple[Reason, ...] = ()
    is_measured: bool = False
    had_passed: bool = False
    audited_at: datetime | None = None
    forecast_rmse: float | None = None
    measured_rmse: float | None = None
    suspect_reason: Reason | None = None

    @property
    def disposition(self) -> Disposition:
        """Whether it is released and by what, or what keeps it."""
        if self.verdict == "pass":
            return Disposition.MEASURED if self.is_measured else Disposition.SAMPLED
        if self.verdict is None:
            return Disposition.OPEN
        return Disposition.FAILED if self.verdict == "fail" else Disposition.WAITING

    @property
    def is_withdrawn(self) -> bool:
        """Whether it was released once and is no more: its files may be with somebody."""
        return self.had_passed and self.verdict != "pass"


@dataclass(frozen=True)
class LotStatus:
    """A lot as every page, paper and program tells it; nothing is decided while no unit has a forecast."""

    lot_id: str
    units: Sequence[UnitInLot]
    limit: Limit | None
    decided: LotRelease | None

    @property
    def counts(self) -> dict[str, int]:
        """Units by verdict, the worst last; `none` has no result yet."""
        units = Counter(unit.verdict or "none" for unit in self.units)
        return {word: units[word] for word in (*reversed(VERDICTS), "none")}

    @property
    def withdrawn(self) -> tuple[UnitInLot, ...]:
        """Units that were released once and are no more."""
        return tuple(unit for unit in self.units if unit.is_withdrawn)

    @property
    def audited(self) -> tuple[UnitInLot, ...]:
        """Units with an audit: those whose audit is set aside first, then by their error, the largest first."""
        audited = [unit for unit in self.units if unit.audited_at is not None]
        return tuple(sorted(audited, key=lambda u: (u.suspect_reason is None, -(u.measured_rmse or 0.0), u.serial)))

    @property
    def releasable(self) -> tuple[str, ...]:
        """Serials that a release of the lot would let pass and that do not pass yet."""
        decided = set(self.decided.released if self.decided else ())
        return tuple(unit.serial for unit in self.units if unit.serial in decided and unit.verdict != "pass")

    def on(self, disposition: Disposition) -> tuple[UnitInLot, ...]:
        return tuple(unit for unit in self.units if unit.disposition == disposition)

    def to_json(self) -> dict[str, object]:
        """Return it as JSON values: what is decided on unmeasured units, with the standing of all beside it.

        A statement that nobody has made yet is none: until then it would promise units that are not released.
        """
        return {
            **({} if self.decided is None else self.decided.to_json()),
            **({"statement": None, "statement_reason": None} if self.releasable else {}),
            "releasable": list(self.releasable),
            "released": [unit.serial for unit in self.units if unit.verdict == "pass"],
            "limit": None if self.limit is None else self.limit.to_json(),
            "counts": self.counts,
            "units": {str(disposition): [unit.serial for unit in self.on(disposition)] for disposition in Disposition},
            "waiting": {unit.serial: _reasons_json(unit) for unit in self.on(Disposition.WAITING)},
            "withdrawn": {unit.serial: _reasons_json(unit) for unit in self.withdrawn},
        }


def _reasons_json(unit: UnitInLot) -> list[Mapping[str, object]]:
    return [{"code": reason.code, "text": str(reason)} for reason in unit.reasons]
