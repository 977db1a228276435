"""A few known loads on the unit refine any map."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softcal.core.errors import InputError
from softcal.core.identity import Settings
from softcal.core.maps.config import AnchorConfig
from softcal.core.maps.interface import Anchors, FitProblem, UnitMap
from softcal.core.recording import Array, LabelledRecording
from softcal.core.windows import resting


@dataclass(frozen=True, eq=False)
class AnchoredMap:
    """A map followed by a gain and an offset that known loads asked for.

    Args:
        inner: the map fitted without them.
        gain, offset: applied to what `inner` gives, in the source's output unit.
    """

    inner: UnitMap
    gain: float
    offset: float

    @property
    def family(self) -> str:
        return self.inner.family

    def apply(self, windows: Array) -> Array:
        """Carry (n, taps) target windows into the source's window space."""
        return self.offset + self.gain * self.inner.apply(windows)

    def apply_signal(self, signal: Array) -> Array:
        """Carry every full window of a gap-free signal: (n - taps + 1, taps)."""
        return self.offset + self.gain * self.inner.apply_signal(signal)

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """Return the arrays of the inner map with gain and offset."""
        own = {"anchor_gain": np.array(self.gain), "anchor_offset": np.array(self.offset)}
        return self.inner.arrays() | own

    def settings(self) -> Settings:
        """Return the settings of the inner map."""
        return self.inner.settings()


def refine(problem: FitProblem, unit_map: UnitMap, anchors: Anchors) -> AnchoredMap:
    """Correct gain and level of a map so that f reads the known loads.

    Minimises sum ((f(window at rest under load k) - load_k) / sigma)^2 + (dgain / gain_spread)^2 + (dlevel /
    level_spread range)^2, with the spreads of `AnchorConfig`. One anchor moves what it can see, several fix both
    numbers. The gain turns about the source's rest level.

    Args:
        problem: source and network.
        unit_map: fitted without anchors.
        anchors: outputs at rest under known loads.
    """
    network, config = problem.network, problem.config.anchors
    low, high = np.quantile(problem.source.unlabelled.output, problem.config.crossing.robust_range)
    # A known load is known to so much only; without it two anchors would overrule a good map exactly.
    sigma = config.load_error * network.reference_scale
    loaded = unit_map.apply(resting(np.asarray(anchors.output, np.float64)))

    def corrected(theta: Array) -> tuple[float, float]:
        # Scaled so that theta is in standard deviations of the prior: its residual is theta itself.
        gain = 1.0 + config.gain_spread * float(theta[0])
        # The gain turns about rest: both numbers would else be strongly correlated, and one anchor could move neither.
        return gain, float(low * (1.0 - gain) + config.level_spread * (high - low) * theta[1])

    def residuals(theta: Array) -> Array:
        gain, offset = corrected(theta)
        misread = (network.evaluate(offset + gain * loaded) - anchors.reference) / sigma
        return np.concatenate([misread, theta])

    def jacobian(theta: Array) -> Array:
        gain, offset = corrected(theta)
        slope = network.gradient(offset + gain * loaded)[1] / sigma
        by_gain = config.gain_spread * np.sum(slope * (loaded - low), axis=1)
        by_level = config.level_spread * (high - low) * slope.sum(axis=1)
        return np.concatenate([np.stack([by_gain, by_level], axis=1), np.eye(2)])

    # Imported here: whoever applies a map does not wait for scipy.
    from scipy.optimize import least_squares

    gain, offset = corrected(least_squares(residuals, np.zeros(2), jacobian).x)
    return AnchoredMap(unit_map, gain, offset)


def check_loads(source: LabelledRecording, loads: Anchors, nothing: str, config: AnchorConfig) -> None:
    """Refuse known loads that cannot be true: one twice, out of the source's range, or against its direction.

    Args:
        source: labelled recording of the lot's source.
        loads: outputs at rest under known loads.
        nothing: what was not done, the end of the message.
        config: which loads the source knows, and which are two.

    Raises:
        InputError: which row is wrong, what was expected, and that nothing was changed.
    """
    unit = source.reference_unit
    output, load = np.asarray(loads.output, np.float64), np.asarray(loads.reference, np.float64)
    low, high = float(source.reference.min()), float(source.reference.max())
    margin = config.beyond * (high - low)
    for row, value in enumerate(load, start=1):
        if not low - margin <= value <= high + margin:
            raise InputError(
                f"load {row}: {value:g} {unit} is outside what the source knows, {low:.3g} to "
                f"{high:.3g} {unit}; is it stated in another unit? {nothing}"
            )
    order = np.argsort(load)
    for earlier, later in zip(order[:-1], order[1:], strict=True):
        if load[later] - load[earlier] < config.same_load * (high - low):
            rows = sorted((int(earlier) + 1, int(later) + 1))
            raise InputError(
                f"loads {rows[0]} and {rows[1]} are the same, {load[earlier]:g} {unit}; state one "
                f"load once, as the mean of its readings; {nothing}"
            )
    rising = 1.0 if np.corrcoef(source.unlabelled.output, source.reference)[0, 1] >= 0 else -1.0
    steps = rising * np.diff(output[order])
    if np.any(steps <= 0):
        word = "rises" if rising > 0 else "falls"
        raise InputError(
            f"the output of a unit like the source {word} with the load, these do not in the order of their loads; "
            f"rows or columns are exchanged; {nothing}"
        )
