"""Onset of contact, from the force, or from the output without a load cell. No I/O."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from softcal.core.errors import BadReply
from softcal.core.messages.reason import reason
from softcal.core.recording import Array
from softcal.station.devices.config import FixtureConfig
from softcal.station.interfaces import Sample
from softcal.station.record.recording import device_times_s

UNLOADED_SAMPLES = 25

OUTPUT_AHEAD = 4.0
"""When the output has changed by so many thresholds and the force by none, the cell is dead."""

ONSET_RANGE_MM, GRID_MM = 1.5, 0.02
"""The contact is sought within ONSET_RANGE_MM above the deepest point of the search, first on a grid."""

POWERS = (1.0, 1.25, 1.5, 1.75, 2.0)
"""Force laws from a flat pad to a cone, to begin with."""

CURVED = 9.0
"""A curve must leave this much less than a line, in variances of one sample."""

MAX_UNCERTAINTY_MM, SECOND_APPROACH_MM, MIN_SEARCH_MM_S = 0.0033, 0.15, 0.08
"""A contact of a larger standard deviation (three are 10 µm) is touched again, from so far above it and more slowly,
but not slower than this: a soft cone would take half a minute."""

STRETCH_MM = 0.1


@dataclass(frozen=True)
class ContactOnset:
    """Position of the onset of contact with its standard deviation, from the residual of the fit."""

    at_mm: float
    uncertainty_mm: float


@dataclass(frozen=True, eq=False)
class Approach:
    """Readings of one approach until the onset of contact.

    Args:
        stage_at: host times -> stage positions in mm on that way.
        host_s: (n,) when the readings came, host clock.
        values: (n,) force or output.
    """

    stage_at: Callable[[Array], Array]
    host_s: Array
    values: Array

    def fit_onset(self, late_s: float) -> ContactOnset:
        """Return where the signal leaves its unloaded value; the readings are late by so much."""
        return fit_contact_onset(self.stage_at(self.host_s - late_s), self.values)


class ContactSearch:
    """A search for contact over samples that keep coming.

    Args:
        cell, output: everything read so far; both lists grow while the search goes on.
        late_s: how late the load cell may be: so long the output may be ahead of it.
    """

    def __init__(
        self,
        fixture: FixtureConfig,
        has_force: bool,
        cell: Sequence[Sample],
        output: Sequence[Sample],
        late_s: float = 0.0,
    ) -> None:
        self._fixture, self._has_force, self._late_s = fixture, has_force, late_s
        self._cell, self._output = cell, output
        self._free_N, self._free_output = unloaded(cell), unloaded(output)
        self.begin()

    def begin(self) -> None:
        """Search from here on, against the unloaded values of the first time."""
        self._cell_count, self._output_count = len(self._cell), len(self._output)
        self._began_at = self._cell_count if self._has_force else self._output_count
        self._has_cell_contact = self.has_contact = False
        self._ahead_since_s: float | None = None

    def is_over(self) -> bool:
        """Return whether the onset of contact was reached; `has_contact` stores the result.

        Raises:
            BadReply: the output shows contact, the load cell does not.
        """
        if self.has_contact:
            return True
        new, self._cell_count = self._cell[self._cell_count :], len(self._cell)
        for sample in new:
            change_N = abs(sample.values[0] - self._free_N)
            self._has_cell_contact = self._has_cell_contact or change_N > self._fixture.contact_N
            if change_N > self._fixture.touch_N:
                self.has_contact = True
                return True
        new, self._output_count = self._output[self._output_count :], len(self._output)
        for sample in new:
            change = abs(sample.values[0] - self._free_output)
            if not self._has_force and change > self._fixture.contact_output:
                self.has_contact = True
                return True
            if self._has_cell_contact or change <= OUTPUT_AHEAD * self._fixture.contact_output:
                self._ahead_since_s = None
                continue
            if self._ahead_since_s is None:
                self._ahead_since_s = sample.host_s
            if sample.host_s - self._ahead_since_s >= self._late_s:
                raise BadReply(reason("rig.no_contact.cell", change=change))
        return False

    def approach(self, stage_at: Callable[[Array], Array]) -> Approach:
        """Return the readings since then; `stage_at`: host times -> stage positions in mm."""
        samples = self._cell if self._has_force else self._output
        host_s = device_times_s(samples)  # Lines come late; a line 20 ms late is a contact 10 µm too deep.
        values = np.array([sample.values[0] for sample in samples])
        return Approach(stage_at, host_s[self._began_at :], values[self._began_at :])


def fit_contact_onset(stage_mm: Array, values: Array) -> ContactOnset:
    """Return where values that were constant begin to rise or fall as a power of the way that follows.

    Least squares of values = b + k · max(0, stage_mm − x0)^p over b, k, x0 and p in [1, 2]: a flat pad rises with
    p = 1, a ball on soft rubber with 1.5, a cone with 2. Unlike the crossing of a threshold it does not depend on
    the unit's stiffness, and noise is averaged.

    Args:
        stage_mm: (n,) positions of the search, mm, ending in contact.
        values: (n,) force or output there.
    """
    deepest_mm = float(np.max(stage_mm))
    shallowest_mm = max(float(np.min(stage_mm)), deepest_mm - ONSET_RANGE_MM)
    candidates_mm = np.arange(shallowest_mm, deepest_mm, GRID_MM)
    starts = []
    for power in POWERS:
        shape = np.maximum(0.0, stage_mm - candidates_mm[:, None]) ** power  # (candidates, n)
        shape -= shape.mean(axis=1, keepdims=True)
        explained = (shape @ (values - values.mean())) ** 2 / np.maximum(np.sum(shape**2, axis=1), 1e-300)
        k = int(np.argmax(explained))
        starts.append(_Start(float(explained[k]), float(candidates_mm[k]), power))
    line, line_squares = _fit_power(stage_mm, values, starts[0], is_linear=True)
    curve, curve_squares = _fit_power(stage_mm, values, max(starts), is_linear=False)
    # A straight line unless a curve is clearly better: a free power costs certainty where it is not needed.
    return curve if curve_squares < line_squares * (1.0 - CURVED / len(values)) else line


class _Start(NamedTuple):
    """Starting point of a fit, and the share of variance that it explains."""

    explained: float
    at_mm: float
    power: float


def _fit_power(stage_mm: Array, values: Array, start: _Start, is_linear: bool) -> tuple[ContactOnset, float]:
    """Return the onset of contact by a line or a free power law, and the residual sum of squares."""

    def residuals(parameters: Array) -> Array:
        level, slope, at_mm = parameters[:3]
        power = 1.0 if is_linear else parameters[3]
        return np.asarray(level + slope * np.maximum(0.0, stage_mm - at_mm) ** power - values)

    power = 1.0 if is_linear else float(np.clip(start.power, 1.05, 1.95))
    slope, level = np.polyfit(np.maximum(0.0, stage_mm - start.at_mm) ** power, values, 1)
    low, high = [-np.inf, -np.inf, float(np.min(stage_mm)) - 1e-6], [np.inf, np.inf, float(np.max(stage_mm))]
    first = [level, slope, start.at_mm]
    if not is_linear:
        first, low, high = [*first, power], [*low, POWERS[0]], [*high, POWERS[-1]]
    solution = least_squares(residuals, first, bounds=(low, high), x_scale="jac")
    squares = float(2.0 * solution.cost)
    variance = squares / max(1, len(values) - len(first))
    uncertainty_mm = float(np.sqrt(np.linalg.pinv(solution.jac.T @ solution.jac)[2, 2] * variance))
    return ContactOnset(float(solution.x[2]), uncertainty_mm), squares


def slower_mm_s(speed_mm_s: float, uncertainty_mm: float) -> float:
    """Return the speed of a search that is sure enough: more readings average the noise."""
    return max(MIN_SEARCH_MM_S, speed_mm_s * (MAX_UNCERTAINTY_MM / uncertainty_mm) ** 2)


def stiffest_N_mm(stage_mm: Array, force_N: Array) -> float:
    """Return the steepest slope of force against position, both (n,), over stretches of STRETCH_MM."""
    bins = np.floor((stage_mm - np.min(stage_mm)) / STRETCH_MM).astype(int)
    means = np.array([(stage_mm[bins == k].mean(), force_N[bins == k].mean()) for k in np.unique(bins)])
    if len(means) < 2:
        return 0.0
    # The last stretch may be a short one, full of readings at rest.
    way_mm = np.maximum(np.diff(means[:, 0]), 0.5 * STRETCH_MM)
    return float(np.max(np.diff(means[:, 1]) / way_mm))


def unloaded(samples: Sequence[Sample]) -> float:
    """Return the mean of the last samples of an unloaded channel; 0 without samples."""
    values = [sample.values[0] for sample in samples[-UNLOADED_SAMPLES:]]
    return float(np.mean(values)) if values else 0.0
