"""The course of a stream, thinned evenly to what a figure can show; constant memory."""

from dataclasses import dataclass, field

from softcal.core.recording import Array
from softcal.core.unit.estimate import Estimate
from softcal.core.use.batches import MapUpdate

KEPT = 6000


@dataclass
class Trace:
    """Columns of equal length, evenly thinned over the rows of a stream."""

    t_s: list[float] = field(default_factory=list)
    output: list[float] = field(default_factory=list)
    estimate: list[float] = field(default_factory=list)
    lower: list[float] = field(default_factory=list)
    upper: list[float] = field(default_factory=list)
    predicted_rmse: list[float] = field(default_factory=list)
    stride: int = 1
    rows: int = 0

    def add(self, rows: Estimate, output: Array, update: MapUpdate) -> None:
        """Add rows that were estimated up to the given map."""
        places = slice(-self.rows % self.stride, None, self.stride)
        self.rows += len(output)
        self.t_s += rows.t_s[places].tolist()
        self.output += output[places].tolist()
        self.estimate += rows.estimate[places].tolist()
        self.lower += rows.lower[places].tolist()
        self.upper += rows.upper[places].tolist()
        self.predicted_rmse += [update.predicted_rmse] * len(output[places])
        while len(self.t_s) > KEPT:
            self._thin()

    def _thin(self) -> None:
        self.stride *= 2
        for name, values in vars(self).items():
            if isinstance(values, list):
                setattr(self, name, values[::2])
