"""Several labelled units as sources of one lot: each is calibrated by the one nearest to it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from softcal.core.errors import UnitRefused
from softcal.core.maps.config import MapConfig
from softcal.core.maps.crossing import robust_range
from softcal.core.maps.ends import match_ends
from softcal.core.maps.monotone import between_steps
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.unit_problem import UnitProblem


def shape_distance(source: LabelledRecording, target: OutputRecording, config: MapConfig) -> float:
    """Return how far two outputs are from one another once rest and peak are matched, as a share of the source's range.

    The mean distance of equal quantiles (Wasserstein distance of order 1). It holds how the units are bent and how
    their time was spent. Sources that were pressed alike share the second, so the nearest of them is the one that is
    bent most like the unit.

    Raises:
        UnitRefused: the unit's output makes no swing that stands out of its noise.
    """
    match = match_ends(source, target, config)
    shares = np.linspace(*config.choice.shape_shares, config.curve.knots)
    mapped = match.offset + match.gain * between_steps(target.output, shares)
    known = source.unlabelled.output
    span = robust_range(known, config.crossing)
    return float(np.mean(np.abs(between_steps(known, shares) - mapped))) / span


def nearest(problems: Sequence[UnitProblem]) -> UnitProblem:
    """Choose the source of one unit by evidence that needs no label of it.

    Where pairs with a source are to be had, at equal time or stage position, the forecast says which source reads the
    unit best. Where nothing is shared, a forecast is a guess: there the source is taken that the unit's output is bent
    most like.

    Args:
        problems: the unit with each source, in the order of the lot; every one names the others in `beside`.

    Returns:
        The problem to calibrate; the first where no source allows a map, so that its reason is told.
    """
    ranked = []
    for place, problem in enumerate(problems):
        try:
            ranked.append((*_rank(problem), place))
        except UnitRefused:
            continue
    return problems[min(ranked)[-1]] if ranked else problems[0]


def _rank(problem: UnitProblem) -> tuple[int, float]:
    made = calibrate(replace(problem, audit=None, own=None))
    if made.forecast is not None and made.knowledge.is_placed:
        return 0, made.forecast.rmse
    return 1, shape_distance(problem.source.source, problem.recording, problem.source.method.map)
