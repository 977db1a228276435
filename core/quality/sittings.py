"""For which unmeasured units a sample of audits speaks, where units of one sitting share an error."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from softcal.core.messages.reason import Reason, reason
from softcal.core.quality.acceptance import min_units
from softcal.core.quality.release import AuditedUnit
from softcal.core.unit.method import ReleaseConfig


@dataclass(frozen=True)
class SampledUnits:
    """A sample of audits, and the units that it speaks for.

    Args:
        serials: of the unmeasured ones.
        sitting: whose units these are alone; empty where they are of any.
        reason: how sittings count; None where no unit shares an error with others.
    """

    audits: tuple[AuditedUnit, ...]
    serials: frozenset[str]
    sitting: str = ""
    reason: Reason | None = None


def sampled_units(audits: Sequence[AuditedUnit], sittings: Mapping[str, str], config: ReleaseConfig) -> SampledUnits:
    """Return for which units audits speak, and how they are grouped.

    The error that a sitting shares is one number, however many of its units are measured. Enough audits of one sitting
    know it, and speak for that sitting. Else sittings are what varies, and they are counted as lots are (`release.py`);
    a unit that shares its error with none is one of its own.

    Args:
        sittings: of the unmeasured units, by serial; empty where a unit shares its error with none.
    """
    counts = Counter(one.sitting for one in audits)
    if not audits or {*counts, *sittings.values()} == {""}:
        return SampledUnits(tuple(audits), frozenset(sittings))
    sitting, count = max(
        ((one, counts[one]) for one in sittings.values() if one), key=lambda item: item[1], default=("", 0)
    )
    if count >= min_units(config.risk):
        serials = frozenset(serial for serial, one in sittings.items() if one == sitting)
        cause = reason("release.sitting", audits=count, others=len(sittings) - len(serials))
        return SampledUnits(tuple(one for one in audits if one.sitting == sitting), serials, sitting, cause)
    separate = tuple(replace(one, sitting=one.sitting or one.serial) for one in audits)
    counted = len({(one.lot_id, one.sitting) for one in separate})
    cause = reason("release.sittings", audits=len(audits), sittings=counted, least=config.min_lots)
    return SampledUnits(separate, frozenset(sittings), "", cause)
