"""Trim a calibrated unit at its place of use: two or more known loads re-anchor its map. No file, no registry here."""

from dataclasses import dataclass

import numpy as np

from softcal.core.errors import InputError
from softcal.core.maps.anchors import AnchoredMap, check_loads, firmness, refine
from softcal.core.maps.interface import Anchors, FitProblem, UnitMap
from softcal.core.metrics import rmse
from softcal.core.network.network import Network
from softcal.core.recording import Array, LabelledRecording
from softcal.core.unit.method import LEVELS
from softcal.core.unit.uncertainty import Interval
from softcal.core.use.method import TrimConfig
from softcal.core.windows import resting

NOTHING = "nothing was changed"


@dataclass(frozen=True, eq=False)
class Trimmed:
    """A map after a trim.

    Args:
        unit_map: the map with the new gain and offset behind it.
        gain_error: standard uncertainty of the gain, as a share of it.
        rest_error: the same of the level at rest, in the source's output unit.
        covariance: (2, 2) of the two.
        before_rmse, after_rmse: error of the estimates at the loads, without and with the trim, in the reference unit.
    """

    unit_map: AnchoredMap
    gain_error: float
    rest_error: float
    covariance: Array
    before_rmse: float
    after_rmse: float

    def variance(self, interval: Interval, source: LabelledRecording) -> Array:
        """Return the (LEVELS,) variance of the trim at the load levels of an interval, in squares of the reference.

        An error of the level at rest moves every estimate alike, one of the gain grows with the load; between the
        loads of the trim they cancel in part.
        """
        load = (interval.high - interval.low) * (np.arange(LEVELS) + 0.5) / LEVELS
        rise = float(np.ptp(source.unlabelled.output) / np.ptp(source.reference))
        if np.corrcoef(source.unlabelled.output, source.reference)[0, 1] < 0:
            rise = -rise
        line = np.stack([rise * load, np.ones(LEVELS)], axis=1)
        return np.asarray(np.sum((line @ self.covariance) * line, axis=1) / rise**2)


def trim(
    problem: FitProblem,
    unit_map: UnitMap,
    loads: Anchors,
    kind: str = "",
    config: TrimConfig = TrimConfig(),  # noqa: B008 - frozen
) -> Trimmed:
    """Re-anchor a map by known loads at the place of use.

    Args:
        problem: source, network and recording of the unit the map was fitted with.
        unit_map: in use now; an earlier trim of it is trimmed further, not stacked.
        loads: outputs at rest under known loads, at least two different ones.
        kind: how the loads behind the map were known (`LoadKnowledge.kind`): two loads do not outvote many pairs.
        config: which loads, and which gain, can be of this unit.

    Raises:
        InputError: the loads cannot be of this unit as they stand; the message says which and why.
    """
    if len(loads.reference) < 2:
        raise InputError(f"{len(loads.reference)} known load; zero and span take two different ones; {NOTHING}")
    check_loads(problem.source, loads, NOTHING, problem.config.anchors)
    network = problem.network
    before = _error(network, unit_map, loads)
    anchors = problem.config.anchors
    found = refine(problem, unit_map, loads, firmness(kind, anchors))
    gain = found.unit_map.gain
    if not 1 / config.most_gain <= gain <= config.most_gain:
        raise InputError(
            f"the loads ask for {gain:.2g} x the gain of unit {problem.target.serial}; that is another unit, or "
            f"other units of load or output; {NOTHING}"
        )
    if found.misfit > anchors.most_misfit:
        raise InputError(
            f"no gain and offset read these loads as the source reads its own: {found.misfit:.2g} standard "
            f"uncertainties are left; they contradict one another or are of another unit; {NOTHING}"
        )
    after = _error(network, found.unit_map, loads)
    return Trimmed(_joined(found.unit_map), found.gain_error, found.rest_error, found.covariance, before, after)


def _error(network: Network, unit_map: UnitMap, loads: Anchors) -> float:
    estimate = network.evaluate(unit_map.apply(resting(np.asarray(loads.output, np.float64))))
    return rmse(estimate, np.asarray(loads.reference, np.float64))


def _joined(found: AnchoredMap) -> AnchoredMap:
    """Return one gain and offset in place of two behind one another."""
    if not isinstance(found.inner, AnchoredMap):
        return found
    earlier = found.inner
    return AnchoredMap(earlier.inner, found.gain * earlier.gain, found.offset + found.gain * earlier.offset)
