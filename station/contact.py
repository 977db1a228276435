"""Has the stage touched the unit: decided by the load cell, or by the output where no load cell reads. No I/O here."""

from collections.abc import Sequence

import numpy as np

from softcal.core.errors import BadReply
from softcal.station.config import FixtureConfig
from softcal.station.interfaces import Sample

UNLOADED_SAMPLES = 25

OUTPUT_AHEAD = 4.0
"""When the output has changed by so many thresholds and the force by none, the load cell is dead."""


class Search:
    """A search for contact over samples that keep coming.

    Args:
        fixture: what counts as contact.
        has_force: whether a load cell reads.
        cell, output: everything read so far; both lists grow while the search goes on.
    """

    def __init__(
        self, fixture: FixtureConfig, has_force: bool, cell: Sequence[Sample], output: Sequence[Sample]
    ) -> None:
        self._fixture, self._has_force = fixture, has_force
        self._cell, self._output = cell, output
        self._seen_cell, self._seen_output = len(cell), len(output)
        self._free_N, self._free_output = _unloaded(cell), _unloaded(output)

    def contact_s(self) -> float | None:
        """Return the host time of the first sample that shows contact, None while there is none.

        Raises:
            BadReply: the output shows contact, the load cell does not.
        """
        new, self._seen_cell = self._cell[self._seen_cell :], len(self._cell)
        for sample in new:
            if abs(sample.values[0] - self._free_N) > self._fixture.contact_N:
                return sample.host_s
        new, self._seen_output = self._output[self._seen_output :], len(self._output)
        for sample in new:
            change = abs(sample.values[0] - self._free_output)
            if not self._has_force and change > self._fixture.contact_output:
                return sample.host_s
            if change > OUTPUT_AHEAD * self._fixture.contact_output:
                raise BadReply(
                    f"load cell: shows no contact although the output has changed by {change:.3g}; check the cell's "
                    "bridge and cable"
                )
        return None


def _unloaded(samples: Sequence[Sample]) -> float:
    values = [sample.values[0] for sample in samples[-UNLOADED_SAMPLES:]]
    return float(np.mean(values)) if values else 0.0
