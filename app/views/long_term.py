"""Units in use: who needs a calibration, and the course of one over time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from softcal.db.registry import Registry
from softcal.db.truth.adaptations import AdaptedUnit


@dataclass(frozen=True)
class UnitInUseView:
    """One unit in use.

    Args:
        drift: shift of its output, in scales of the calibrated use.
        predicted_rmse: of its estimates now, in the reference unit.
        alarm: why a calibration with a reference is due; empty while it is not.
        reference_unit: of its lot.
    """

    serial: str
    made_at: datetime
    steps: int
    drift: float
    predicted_rmse: float
    verdict: str
    alarm: str
    reference_unit: str


@dataclass(frozen=True)
class Course:
    """The steps of one stream of one unit, in time order, with the units of its lot."""

    serial: str
    stream: str
    steps: tuple[Mapping[str, Any], ...]
    output_unit: str
    reference_unit: str

    @property
    def alarm(self) -> str:
        """Why a calibration is due at the end of the stream; empty while it is not."""
        return str(self.steps[-1]["alarm"]) if self.steps else ""

    def column(self, name: str) -> list[Any]:
        """Return one value of every step."""
        return [step[name] for step in self.steps]


def units_in_use(registry: Registry) -> list[UnitInUseView]:
    """Return the units in use: those with an alarm first, then by predicted error."""
    units = {lot.id: lot.reference_unit for lot in registry.lots.all()}
    # Mostly all lots have one unit; then no lot of a unit is looked up.
    only = next(iter(units.values())) if len(set(units.values())) == 1 else ""
    found = [_unit(entry, only or units[_lot_of(registry, entry.serial)]) for entry in registry.adaptations.units()]
    return sorted(found, key=lambda unit: (not unit.alarm, -unit.predicted_rmse))


def _lot_of(registry: Registry, serial: str) -> str:
    return registry.lots.units(serial=serial)[-1].lot_id


def _unit(entry: AdaptedUnit, reference_unit: str) -> UnitInUseView:
    step = entry.entry
    return UnitInUseView(
        entry.serial,
        entry.made_at,
        entry.steps,
        float(step["shift"]),
        float(step["predicted_rmse"]),
        str(step["verdict"]),
        str(step["alarm"]),
        reference_unit,
    )


def course(registry: Registry, serial: str, stream: str) -> Course:
    """Return the course of a unit on one stream."""
    steps: Sequence[Mapping[str, Any]] = registry.adaptations.all(serial, stream)
    seen = tuple(step for step in steps if step.get("t_s") is not None)
    lot = registry.lots.get(_lot_of(registry, serial))
    return Course(serial, stream, seen, lot.output_unit, lot.reference_unit)
