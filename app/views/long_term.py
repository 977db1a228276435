"""Units in use: who needs a calibration, and the course of one over time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from softcal.core.lot import UnitKey
from softcal.core.recording import Array
from softcal.core.unit.estimate import Estimate
from softcal.db.registry import Registry
from softcal.db.repositories.adaptations import AdaptedUnit

MAX_ROWS = 6000
"""Of a stream that is drawn."""


@dataclass(frozen=True)
class Course:
    """The steps of one stream of one unit, in time order, with the units and the stated limit of its lot."""

    serial: str
    stream: str
    steps: tuple[Mapping[str, Any], ...]
    output_unit: str
    reference_unit: str
    limit_rmse: float | None = None

    @property
    def alarm(self) -> str:
        """Why a calibration is due at the end of the stream; empty while it is not."""
        return str(self.steps[-1]["alarm"]) if self.steps else ""

    def column(self, name: str) -> list[Any]:
        """Return one value of every step."""
        return [step[name] for step in self.steps]


@dataclass
class Trace:
    """Columns of equal length, evenly thinned over the rows of a stream."""

    t_s: list[float] = field(default_factory=list)
    output: list[float] = field(default_factory=list)
    estimate: list[float] = field(default_factory=list)
    lower: list[float] = field(default_factory=list)
    upper: list[float] = field(default_factory=list)
    stride: int = 1
    rows: int = 0

    def add(self, rows: Estimate, output: Array) -> None:
        """Add rows with their estimates."""
        selected = slice(-self.rows % self.stride, None, self.stride)
        self.rows += len(output)
        self.t_s += rows.t_s[selected].tolist()
        self.output += output[selected].tolist()
        self.estimate += rows.estimate[selected].tolist()
        self.lower += rows.lower[selected].tolist()
        self.upper += rows.upper[selected].tolist()
        while len(self.t_s) > MAX_ROWS:
            self.stride *= 2
            for name, values in vars(self).items():
                if isinstance(values, list):
                    setattr(self, name, values[::2])


def units_in_use(registry: Registry) -> list[tuple[AdaptedUnit, str]]:
    """Return units in use with their reference units: with an alarm first, then by predicted error."""
    units = {lot.id: lot.reference_unit for lot in registry.lots.all()}
    followed = [(unit, units[unit.lot_id]) for unit in registry.adaptations.units()]
    return sorted(followed, key=lambda one: (not one[0].entry["alarm"], -float(one[0].entry["predicted_rmse"])))


def course(registry: Registry, unit: UnitKey, stream: str) -> Course:
    """Return the course of a unit on one stream."""
    steps: Sequence[Mapping[str, Any]] = registry.adaptations.all(unit, stream)
    observed = tuple(step for step in steps if step.get("t_s") is not None)
    lot = registry.lots.get(unit.lot_id)
    return Course(unit.serial, stream, observed, lot.output_unit, lot.reference_unit, lot.limit_rmse)
