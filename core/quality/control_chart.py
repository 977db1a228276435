"""Control charts of single values and process capability (NIST/SEMATECH e-Handbook, 6.1.6 and 6.3.2.2)."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import ndtri

from softcal.core.errors import InputError
from softcal.core.messages.reason import Reason, reason
from softcal.core.recording import Array, Mask

D2 = 1.128
"""Mean range of two normal values in standard deviations."""

FEWEST = 8
MIN_FOR_CAPABILITY = 25

FAR, MAX_FAR_SHARE = 4.0, 0.1
"""Values so many sigma out have a cause of their own and no part in the limits (Montgomery, Introduction to Statistical
Quality Control, on trial limits), up to this share of all: of more the process itself has moved. One would else widen
the limits, and move the centre until all others lie on one side of it."""

FORBIDDING = (1, 2, 3)
"""Rules that a process must keep to be called stable. All eight together would stop a quarter of the stable processes
at 30 values and most of them at 100, these three an eighth and somewhat under a half."""


@dataclass(frozen=True)
class ChartSignal:
    """The point, by its index, that completes a pattern which does not look like chance."""

    index: int
    rule: int
    text: str


@dataclass(frozen=True, eq=False)
class ControlChart:
    """A chart of individuals, its spread from their moving ranges.

    Args:
        values: (n,) in time order.
        centre: mean of the values the limits were made from, those far out left out.
        sigma: mean moving range / 1.128: the spread from one value to the next.
    """

    values: Array
    centre: float
    sigma: float

    @property
    def lower(self) -> float:
        return self.centre - 3.0 * self.sigma

    @property
    def upper(self) -> float:
        return self.centre + 3.0 * self.sigma

    @cached_property
    def signals(self) -> tuple[ChartSignal, ...]:
        """Every point that breaks one of Nelson's eight rules, in time order."""
        if self.sigma == 0:
            return ()
        signals, z = [], (self.values - self.centre) / self.sigma
        for number, (text, length, find) in enumerate(RULES, 1):
            if len(z) >= length:
                at = np.flatnonzero(find(np.lib.stride_tricks.sliding_window_view(z, length)))
                signals += [ChartSignal(int(k) + length - 1, number, str(text)) for k in at]
        return tuple(sorted(signals, key=lambda signal: (signal.index, signal.rule)))

    @property
    def instabilities(self) -> tuple[ChartSignal, ...]:
        """The signals that forbid to state a capability: beyond 3 sigma, long runs on one side, long trends."""
        return tuple(signal for signal in self.signals if signal.rule in FORBIDDING)

    @property
    def is_stable(self) -> bool:
        """Whether nothing forbids to state a capability; the other signals are hints to look."""
        return not self.instabilities


def control_chart(values: Array, baseline: int | None = None) -> ControlChart:
    """Make a chart of individuals.

    Args:
        baseline: the limits come from the first `baseline` values; None takes all of them.

    Raises:
        InputError: fewer than 8 values for the limits, or one that is not finite.
    """
    values = np.asarray(values, dtype=np.float64)
    first = values[: len(values) if baseline is None else baseline]
    if len(first) < FEWEST:
        raise InputError(reason("chart.few", count=len(first)))
    if not np.isfinite(values).all():
        raise InputError(reason("chart.not_a_number", value=int(np.flatnonzero(~np.isfinite(values))[0])))
    return ControlChart(values, *_centre_and_sigma(_without_far(first)))


def _centre_and_sigma(values: Array) -> tuple[float, float]:
    return float(values.mean()), float(np.abs(np.diff(values)).mean()) / D2


def _without_far(values: Array) -> Array:
    """Return the values without the few that are far out; all of them where they are more than a few."""
    near, count, min_count = values, 0, max(FEWEST, (1 - MAX_FAR_SHARE) * len(values))
    while count != len(near) >= min_count:
        count = len(near)
        centre, sigma = _centre_and_sigma(near)
        near = near[np.abs(near - centre) <= FAR * sigma]
    return near if len(near) >= min_count else values


@dataclass(frozen=True)
class Capability:
    """How well a stable process keeps its limits.

    Args:
        cp, cpk: with the spread from one value to the next; cp is None for a one-sided limit.
        pp, ppk: with the spread of all values.
        cpk_lower, cpk_upper: 95 % interval of cpk (Bissell 1990).
    """

    cp: float | None
    cpk: float
    pp: float | None
    ppk: float
    cpk_lower: float
    cpk_upper: float
    count: int


def capability(chart: ControlChart, minimum: float | None, maximum: float | None) -> Capability:
    """Return the capability against limits, at least one of them.

    Raises:
        InputError: the process is not stable, has too few values, or the limits make no sense: then a number would
            promise what nobody can keep.
    """
    count = len(chart.values)
    if minimum is None and maximum is None:
        raise InputError(Reason("chart.no_limit"))
    if minimum is not None and maximum is not None and minimum >= maximum:
        raise InputError(reason("chart.limits_crossed", minimum=minimum, maximum=maximum))
    if count < MIN_FOR_CAPABILITY:
        raise InputError(reason("chart.capability.few", count=count, least=MIN_FOR_CAPABILITY))
    if not chart.is_stable:
        first = chart.instabilities[0]
        raise InputError(reason("chart.unstable", rule=RULES[first.rule - 1][0], number=first.index + 1))
    mean, overall = float(chart.values.mean()), float(chart.values.std(ddof=1))
    if chart.sigma == 0 or overall == 0:
        raise InputError(Reason("chart.flat"))
    cpk = _nearest(mean, chart.sigma, minimum, maximum)
    half = float(ndtri(0.975)) * np.sqrt(1 / (9 * count) + cpk**2 / (2 * (count - 1)))
    width = maximum - minimum if minimum is not None and maximum is not None else None
    return Capability(
        cp=None if width is None else width / (6 * chart.sigma),
        cpk=cpk,
        pp=None if width is None else width / (6 * overall),
        ppk=_nearest(mean, overall, minimum, maximum),
        cpk_lower=float(cpk - half),
        cpk_upper=float(cpk + half),
        count=count,
    )


def _nearest(mean: float, sigma: float, minimum: float | None, maximum: float | None) -> float:
    distances = [maximum - mean] if maximum is not None else []
    distances += [mean - minimum] if minimum is not None else []
    return min(distances) / (3 * sigma)


def _same_side(windows: Array, beyond: float, count: int) -> Mask:
    above, below = (windows > beyond).sum(1) >= count, (windows < -beyond).sum(1) >= count
    # The point that completes the pattern is itself one of those that make it.
    return np.asarray((above & (windows[:, -1] > beyond)) | (below & (windows[:, -1] < -beyond)))


def _trend(windows: Array) -> Mask:
    steps = np.diff(windows, axis=1)
    return np.asarray((steps > 0).all(1) | (steps < 0).all(1))


def _alternates(windows: Array) -> Mask:
    steps = np.diff(windows, axis=1)
    return np.asarray((steps[:, 1:] * steps[:, :-1] < 0).all(1))


RULES: tuple[tuple[Reason, int, Callable[[Array], Mask]], ...] = (
    (Reason("chart.rule.1"), 1, lambda w: np.asarray((np.abs(w) > 3).all(1))),
    (Reason("chart.rule.2"), 9, lambda w: _same_side(w, 0.0, 9)),
    (Reason("chart.rule.3"), 6, _trend),
    (Reason("chart.rule.4"), 14, _alternates),
    (Reason("chart.rule.5"), 3, lambda w: _same_side(w, 2.0, 2)),
    (Reason("chart.rule.6"), 5, lambda w: _same_side(w, 1.0, 4)),
    (Reason("chart.rule.7"), 15, lambda w: np.asarray((np.abs(w) < 1).all(1))),
    (Reason("chart.rule.8"), 8, lambda w: np.asarray((np.abs(w) > 1).all(1))),
)
"""Nelson, Journal of Quality Technology 16 (1984) 237; the first, second, fifth and sixth are Western Electric's."""
