"""Where the stage touches the unit: seen by the load cell, or by the output where no load cell reads. No I/O here."""

from collections.abc import Callable, Sequence

import numpy as np

from softcal.core.errors import BadReply
from softcal.core.recording import Array
from softcal.station.clock import fit_clock
from softcal.station.config import FixtureConfig
from softcal.station.interfaces import Sample

UNLOADED_SAMPLES = 25

OUTPUT_AHEAD = 4.0
"""When the output has changed by so many thresholds and the force by none, the load cell is dead."""

REACH_MM, STEP_MM = 1.0, 0.001
"""The contact is looked for within REACH_MM above the deepest point of the search."""


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
        self._began_at = self._seen_cell = len(cell)
        self._seen_output = len(output)
        if not has_force:
            self._began_at = len(output)
        self._free_N, self._free_output = _unloaded(cell), _unloaded(output)
        self._is_felt = False

    def is_over(self) -> bool:
        """Whether what came since the last call shows the touch that was looked for.

        Raises:
            BadReply: the output shows contact, the load cell does not.
        """
        new, self._seen_cell = self._cell[self._seen_cell :], len(self._cell)
        for sample in new:
            change_N = abs(sample.values[0] - self._free_N)
            self._is_felt = self._is_felt or change_N > self._fixture.contact_N
            if change_N > self._fixture.touch_N:
                return True
        new, self._seen_output = self._output[self._seen_output :], len(self._output)
        for sample in new:
            change = abs(sample.values[0] - self._free_output)
            if not self._has_force and change > self._fixture.contact_output:
                return True
            if not self._is_felt and change > OUTPUT_AHEAD * self._fixture.contact_output:
                raise BadReply(
                    f"load cell: shows no contact although the output has changed by {change:.3g}; check the cell's "
                    "bridge and cable"
                )
        return False

    def contact_mm(self, stage_at: Callable[[Array], Array]) -> float:
        """Return the stage position at which the signal leaves its unloaded value.

        Args:
            stage_at: host times -> stage positions in mm during the search.
        """
        samples = self._cell if self._has_force else self._output
        host_s = np.array([sample.host_s for sample in samples])
        if samples[0].device_s is not None:
            # Lines come late; a line 20 ms late is a contact 10 µm too deep.
            device_s = np.array([sample.device_s for sample in samples], dtype=np.float64)
            host_s = fit_clock(device_s, host_s).to_host(device_s)
        values = np.array([sample.values[0] for sample in samples])
        return bend(stage_at(host_s[self._began_at :]), values[self._began_at :])


def bend(stage_mm: Array, values: Array) -> float:
    """Return where values that were constant begin to rise or fall in a straight line with the stage position.

    Least squares of values = b + k · max(0, stage_mm − x0) over b, k and x0. Unlike the crossing of a threshold it does
    not depend on the unit's stiffness, and noise is averaged.

    Args:
        stage_mm: (n,) positions of the search, mm, ending in contact.
        values: (n,) force or output there.

    Returns:
        x0 in mm.
    """
    deepest_mm = float(np.max(stage_mm))
    candidates_mm = np.arange(max(float(np.min(stage_mm)), deepest_mm - REACH_MM), deepest_mm, STEP_MM)
    pressed_mm = np.maximum(0.0, stage_mm - candidates_mm[:, None])  # (candidates, n)
    pressed_mm -= pressed_mm.mean(axis=1, keepdims=True)
    explained = (pressed_mm @ (values - values.mean())) ** 2 / np.maximum(np.sum(pressed_mm**2, axis=1), 1e-12)
    return float(candidates_mm[int(np.argmax(explained))])


def _unloaded(samples: Sequence[Sample]) -> float:
    values = [sample.values[0] for sample in samples[-UNLOADED_SAMPLES:]]
    return float(np.mean(values)) if values else 0.0
