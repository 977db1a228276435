"""Where the stage touches the unit: seen by the load cell, or by the output where no load cell reads. No I/O here."""

from collections.abc import Callable, Sequence

import numpy as np

from softcal.core.errors import BadReply
from softcal.core.recording import Array
from softcal.core.words.reason import reason
from softcal.station.clock import fit_clock
from softcal.station.config import FixtureConfig
from softcal.station.interfaces import Sample

UNLOADED_SAMPLES = 25

OUTPUT_AHEAD = 4.0
"""When the output has changed by so many thresholds and the force by none, the load cell is dead."""

REACH_MM, STEP_MM, COARSE_STEPS = 1.5, 0.001, 20
"""The contact is looked for within REACH_MM above the deepest point of the search."""

POWERS = (1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6, 1.7, 1.8, 1.9, 2.0)
"""Force laws from a flat pad to a cone."""

CURVED = 9.0
"""A curve must leave this much less than a line, in variances of one sample."""

STRETCH_MM = 0.1


class ContactSearch:
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
        self._is_felt = self.has_found = False

    def is_over(self) -> bool:
        """Whether the touch that was looked for has come; `has_found` keeps the answer.

        Raises:
            BadReply: the output shows contact, the load cell does not.
        """
        self.has_found = self.has_found or self._is_touched()
        return self.has_found

    def _is_touched(self) -> bool:
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
                raise BadReply(reason("rig.no_contact.cell", change=change))
        return False

    def contact_mm(self, stage_at: Callable[[Array], Array], late_s: float = 0.0) -> float:
        """Return the stage position at which the signal leaves its unloaded value.

        Args:
            stage_at: host times -> stage positions in mm during the search.
            late_s: how late the load cell is.
        """
        samples = self._cell if self._has_force else self._output
        host_s = np.array([sample.host_s for sample in samples])
        if samples[0].device_s is not None:
            # Lines come late; a line 20 ms late is a contact 10 µm too deep.
            device_s = np.array([sample.device_s for sample in samples], dtype=np.float64)
            host_s = fit_clock(device_s, host_s).to_host(device_s)
        if self._has_force:
            host_s = host_s - late_s
        values = np.array([sample.values[0] for sample in samples])
        return bend(stage_at(host_s[self._began_at :]), values[self._began_at :])


def bend(stage_mm: Array, values: Array) -> float:
    """Return where values that were constant begin to rise or fall as a power of the way that follows.

    Least squares of values = b + k · max(0, stage_mm − x0)^p over b, k, x0 and p in POWERS: a flat pad rises with
    p = 1, a ball on soft rubber with 1.5, a cone with 2. Unlike the crossing of a threshold it does not depend on
    the unit's stiffness, and noise is averaged.

    Args:
        stage_mm: (n,) positions of the search, mm, ending in contact.
        values: (n,) force or output there.

    Returns:
        x0 in mm.
    """
    deepest_mm = float(np.max(stage_mm))
    shallowest_mm = max(float(np.min(stage_mm)), deepest_mm - REACH_MM)
    coarse = np.arange(shallowest_mm, deepest_mm, COARSE_STEPS * STEP_MM)
    total = float(np.sum((values - values.mean()) ** 2))
    found = [_foot(stage_mm, values, coarse, deepest_mm, power) for power in POWERS]
    left = np.array([total - explained for _, explained in found])
    # A straight line unless a curve is clearly better: a free power costs certainty where it is not needed.
    best = int(np.argmin(left))
    is_curved = left[best] < left[0] * (1.0 - CURVED / len(values))
    return found[best if is_curved else 0][0]


def _foot(stage_mm: Array, values: Array, coarse_mm: Array, deepest_mm: float, power: float) -> tuple[float, float]:
    """Return x0 of one power, and how much of the values it explains."""
    near, _ = _best(stage_mm, values, coarse_mm, power)
    around = np.arange(near - COARSE_STEPS * STEP_MM, near + COARSE_STEPS * STEP_MM, STEP_MM)
    return _best(stage_mm, values, around[around < deepest_mm], power)


def _best(stage_mm: Array, values: Array, candidates_mm: Array, power: float) -> tuple[float, float]:
    """Return the candidate that explains most of the values, and how much that is."""
    shape = np.maximum(0.0, stage_mm - candidates_mm[:, None]) ** power  # (candidates, n)
    shape -= shape.mean(axis=1, keepdims=True)
    explained = (shape @ (values - values.mean())) ** 2 / np.maximum(np.sum(shape**2, axis=1), 1e-300)
    k = int(np.argmax(explained))
    return float(candidates_mm[k]), float(explained[k])


def stiffest_N_mm(stage_mm: Array, force_N: Array) -> float:
    """Return the steepest slope of force against position, over stretches of STRETCH_MM.

    Args:
        stage_mm: (n,) positions of a slow press downward.
        force_N: (n,) force there.
    """
    bins = np.floor((stage_mm - np.min(stage_mm)) / STRETCH_MM).astype(int)
    means = np.array([(stage_mm[bins == k].mean(), force_N[bins == k].mean()) for k in np.unique(bins)])
    if len(means) < 2:
        return 0.0
    # The last stretch may be a short one, full of readings at rest.
    way_mm = np.maximum(np.diff(means[:, 0]), 0.5 * STRETCH_MM)
    return float(np.max(np.diff(means[:, 1]) / way_mm))


def _unloaded(samples: Sequence[Sample]) -> float:
    values = [sample.values[0] for sample in samples[-UNLOADED_SAMPLES:]]
    return float(np.mean(values)) if values else 0.0
