"""What no equation of the catalogue says: departures of another kind, other equations of its causes.

A signal of the chain may have a gain or an offset that follows time or temperature, the load cell a
delay or a share of the position. They are no causes: where one wins, the report says `unknown`.

What the equation of one cause leaves on a rig often looks like a second cause. So every further one
is held against a free form of those beside it: other sizes and shapes, all mixed, and a size that
changes with load and time. Where that explains nearly as much, these runs do not tell the two.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from operator import attrgetter

import numpy as np

from softcal.core.gap.coordinates import from_fit, to_fit
from softcal.core.gap.fit import Fit
from softcal.core.gap.floor import projected
from softcal.core.gap.linear import dots
from softcal.core.gap.method import METHOD
from softcal.core.gap.posterior import Yardstick
from softcal.core.gap.residual import is_clean
from softcal.core.gap.screen import Probe, joined, screen
from softcal.core.recording import Array
from softcal.core.twin.catalogue import EFFECTS
from softcal.core.twin.effects import ChainStage, Effect, Flow, Hook, Memory, Parameter, Step
from softcal.core.twin.mechanics import elastic_force_at
from softcal.core.twin.signals import low_pass

CONFIG = METHOD.stranger

TIME, WARMTH, PLACE = attrgetter("t_s"), attrgetter("warmed_K"), attrgetter("stage_mm")
"""What of the flow a departure may follow."""


def changing(signal: str, follows: Callable[[Flow], Array | float], is_offset: bool = False) -> Step:
    """Return a step that raises a signal by its size, or such a share, times what it follows."""

    def step(flow: Flow, values: Sequence[float], _: Memory) -> None:
        now, change = getattr(flow, signal), values[0] * follows(flow)
        setattr(flow, signal, now + change if is_offset else now * (1.0 + change))

    return step


_offset = partial(changing, is_offset=True)


def _divider(flow: Flow, values: Sequence[float], _: Memory) -> None:
    # Only R/Rs enters the divider: a resistor that grows is a channel, dummy or not, that shrinks.
    flow.resistance_ohm = flow.resistance_ohm / (1.0 + values[0] * flow.warmed_K)


def _cell_lag(flow: Flow, values: Sequence[float], _: Memory) -> None:
    flow.reading_N = low_pass(flow.reading_N, flow.step_s, max(values[0], 1e-4), np.full(2, flow.reading_N[0]))


def _stranger(
    code: str, stage: ChainStage, hook: Hook, step: Step, unit: str, usual: float, is_signed: bool = True
) -> Effect:
    size = Parameter("size", unit, -30.0 * usual if is_signed else 0.0, 30.0 * usual, usual, neutral=0.0)
    return Effect(code, stage, hook, "", "no effect of the catalogue", (size,), step)


STRANGERS = (
    _stranger("gap.like.stiffness_in_time", "mechanics", Hook.FORCE, changing("force_N", TIME), "1/s", 1e-3),
    _stranger("gap.like.stiffness_when_warm", "mechanics", Hook.FORCE, changing("force_N", WARMTH), "1/K", 5e-3),
    _stranger("gap.like.sensitivity_in_time", "transduction", Hook.CHANNEL, changing("drive", TIME), "1/s", 1e-3),
    _stranger("gap.like.sensitivity_when_warm", "transduction", Hook.CHANNEL, changing("drive", WARMTH), "1/K", 5e-3),
    _stranger("gap.like.offset_in_time", "electronics", Hook.OUTPUT, _offset("output_V", TIME), "V/s", 2e-4),
    _stranger("gap.like.offset_when_warm", "electronics", Hook.OUTPUT, _offset("output_V", WARMTH), "V/K", 1e-3),
    _stranger("gap.like.cell_span_in_time", "load_cell", Hook.READING, changing("reading_N", TIME), "1/s", 1e-3),
    _stranger("gap.like.cell_span_when_warm", "load_cell", Hook.READING, changing("reading_N", WARMTH), "1/K", 5e-3),
    _stranger("gap.like.cell_zero_when_warm", "load_cell", Hook.READING, _offset("reading_N", WARMTH), "N/K", 0.01),
    _stranger("gap.like.cell_by_position", "load_cell", Hook.READING, _offset("reading_N", PLACE), "N/mm", 0.05),
    _stranger("gap.like.cell_late", "load_cell", Hook.READING, _cell_lag, "s", 0.1, is_signed=False),
)
"""Generic departures; the identifier is the reason that says what one is like."""

WARM_DIVIDER = _stranger("gap.like.divider_when_warm", "electronics", Hook.REFERENCE, _divider, "1/K", 1e-3)
"""Looks like a channel that follows the temperature, sign reversed, while the channel is read."""


def stranger(best: Fit, parents: Sequence[Fit], fits: Sequence[Fit]) -> Fit | None:
    """Return the best fit with a stranger beside a parent; None where none beats the catalogue."""
    if best.problem.is_driven_by_force:
        return None
    case, scale = best.problem.case, best.problem.scale
    is_warming = case.changes("temperature_C")
    seen = [e for e in STRANGERS if e.stage not in case.unseen_stages]
    seen = [e for e in seen if is_warming or not e.parameters[0].unit.endswith("/K")]
    seen += [WARM_DIVIDER] if case.has_warmed_dummy else []
    probes = [Probe(e, (scale.sized(e.parameters[0]).usual,), e.parameters[0].low == 0.0) for e in seen]
    found = [joined(parent, lead) for parent in parents for lead in screen(parent, probes)[:1]]
    if not found:
        return None
    yardstick = Yardstick.of((*fits, *found))
    closest = max(found, key=yardstick.log_evidence)
    ahead = yardstick.log_evidence(closest) - yardstick.log_evidence(best)
    is_decisive = ahead > (CONFIG.clean_odds if is_clean(closest) else METHOD.rival.odds)
    is_simpler = len(closest.ids) <= len(best.ids) - 2
    return closest if is_decisive and (is_simpler or closest.chi2 < best.chi2 - CONFIG.least_gain) else None


def stranger_of(found: Fit) -> Effect:
    """Return the stranger of a hypothesis that has one."""
    return next(one for one in (*STRANGERS, WARM_DIVIDER) if one in found.effects)


def imitated_causes(best: Fit, smaller: Mapping[str, Fit]) -> list[str]:
    """Return the causes that a free form of the others, `smaller`, imitates, the weakest first."""
    order = sorted(smaller, key=lambda effect_id: smaller[effect_id].chi2)
    return [effect_id for effect_id in order if imitation(smaller[effect_id], best) >= CONFIG.imitated]


def imitation(rest: Fit, best: Fit) -> float:
    """Return which share of a larger hypothesis's gain a free form of a smaller one has as well."""
    gain = rest.chi2 - best.chi2
    if gain <= 0.0 or not rest.ids:
        return 0.0
    rows = [rest.problem.whitened(row) for effect in rest.effects for row in _directions(rest, effect)]
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
    # Load and time relative to the largest, each with its square.
    load, time = np.zeros(len(problem.measured)), np.zeros(len(problem.measured))
    for block in problem.blocks:
        run = problem.case.runs[block.run]
        time[block.place] = run.elapsed_s
        if run.stage_mm is not None:
            load[block.place] = elastic_force_at(run.stage_mm, found.base)
        elif run.force_N is not None:
            load[block.place] = run.force_N
    load, time = load / (np.max(np.abs(load)) or 1.0), time / (np.max(time) or 1.0)
    of_load, of_time = [load, load**2], [time, time**2]
    # A delay that grows with time is a rate, a cause of its own.
    for course in of_load if effect.signs.clock is not None else of_load + of_time:
        yield signature * course
