"""Which causes another one imitates: what an unknown equation of the others would take away as well.

A rig does not follow the catalogue's equations. What the equation of one cause leaves often looks like a second cause.
So every further cause is held against a free form of those beside it: the same cause at other sizes and shapes, all
mixed, and with a size that changes with load and time. Where that explains the same nearly as well, these runs do not
tell a second cause from another equation of the first.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from softcal.core.gap.coordinates import from_fit, to_fit
from softcal.core.gap.fit import Fit
from softcal.core.gap.floor import projected
from softcal.core.gap.linear import dots
from softcal.core.recording import Array
from softcal.core.twin.catalogue import EFFECTS
from softcal.core.twin.effects import Effect
from softcal.core.twin.mechanics import elastic_force_at


@dataclass(frozen=True)
class FreeFormConfig:
    """How free a form is, and when it explains the same.

    Args:
        ratios: sizes and shapes mixed, as multiples of the fitted ones.
        imitated: share of what a cause takes away that a free form of the others must take away as well.
    """

    ratios: tuple[float, ...] = (0.2, 0.5, 2.0, 5.0)
    imitated: float = 0.8


CONFIG = FreeFormConfig()


def imitated_causes(best: Fit, smaller: Mapping[str, Fit]) -> list[str]:
    """Return the causes of a hypothesis that a free form of the others imitates, the weakest first.

    Args:
        smaller: the hypothesis without each cause, fitted, by that cause.
    """
    order = sorted(smaller, key=lambda effect_id: smaller[effect_id].chi2)
    return [effect_id for effect_id in order if imitation(smaller[effect_id], best) >= CONFIG.imitated]


def imitation(rest: Fit, best: Fit) -> float:
    """Return which share of what a larger hypothesis takes away a free form of a smaller one takes away as well."""
    gain = rest.chi2 - best.chi2
    if gain <= 0.0 or not rest.hypothesis.ids:
        return 0.0
    rows = [rest.problem.whitened(row) for effect in rest.hypothesis.effects for row in _directions(rest, effect)]
    seen = projected(rows, rest.jacobian)
    if not len(seen):
        return 0.0
    # Each direction takes 1 off χ² by chance.
    taken = float(np.sum(dots(seen, rest.residual) ** 2)) - len(seen)
    return taken / gain


def _directions(found: Fit, effect: Effect) -> Iterator[Array]:
    """Yield (samples,) changes of the prediction that another equation of one cause may bring."""
    problem, at = found.problem, found.hypothesis.slices[effect.id]
    own = range(at.start, at.stop)
    parameters = [problem.scale.sized(p) for p in effect.parameters]
    # A size without a shape is its own shape: a toe, a play, a delay.
    shapes = list(zip(own, parameters, strict=True))[1:] or list(zip(own, parameters, strict=True))
    # A hum at another pitch, or with other phases, is another hum.
    for k, parameter in () if EFFECTS[effect.id].belongs_to_run else shapes:
        for ratio in CONFIG.ratios:
            moved = found.coordinates.copy()
            value = from_fit(parameter, moved[k])
            if np.isfinite(value) and value != 0.0:
                moved[k] = to_fit(parameter, float(np.clip(ratio * value, parameter.low, parameter.high)))
            if moved[k] != found.coordinates[k]:
                yield problem.predict(found.hypothesis, moved) - found.predicted
    without, left = found.hypothesis.without(effect.id)
    signature = found.predicted - problem.predict(without, found.coordinates[left])
    of_load, of_time = _courses(found)
    # A delay that grows with time is a rate, a cause of its own.
    for course in of_load if effect.signs.clock is not None else of_load + of_time:
        yield signature * course


def _courses(found: Fit) -> tuple[list[Array], list[Array]]:
    """Return (samples,) load and its square, and time and its square, each relative to the largest."""
    problem = found.problem
    load, time = np.zeros(len(problem.measured)), np.zeros(len(problem.measured))
    for block in problem.blocks:
        run = problem.case.runs[block.run]
        time[block.place] = run.elapsed_s
        if run.stage_mm is not None:
            load[block.place] = elastic_force_at(run.stage_mm, found.base)
        elif run.force_N is not None:
            load[block.place] = run.force_N
    load, time = load / (np.max(np.abs(load)) or 1.0), time / (np.max(time) or 1.0)
    return [load, load**2], [time, time**2]
