"""Several labelled units as sources of one lot: each unit is calibrated by the one that suits it best."""

from collections.abc import Sequence
from dataclasses import replace

from softcal.core.errors import UnitRefused
from softcal.core.maps.nearest import shape_distance
from softcal.core.unit.calibrate import UnitProblem, calibrate


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
