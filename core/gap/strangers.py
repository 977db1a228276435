"""Departures the catalogue does not have, in generic form: to tell when one of them explains more than the catalogue.

Each signal of the chain may have a gain or an offset that follows time or temperature, and the load cell a delay or a
share of the position. They are no causes a report can name; where one wins, the report says `unknown` and what it is
like.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from softcal.core.gap.ambiguity import RIVAL_LOG_ODDS
from softcal.core.gap.candidates import Probe
from softcal.core.gap.fit import Fit
from softcal.core.gap.posterior import Yardstick
from softcal.core.gap.residual import structure
from softcal.core.gap.screen import joined, screen
from softcal.core.twin.effects import ChainStage, Effect, Flow, Hook, Memory, Parameter, Step
from softcal.core.twin.signals import low_pass
from softcal.core.words.reason import Reason

CLEAN_LOG_ODDS = 2.0
"""Log evidence by which a stranger must beat a catalogue that leaves no structure; one that leaves some must be no
rival any more ..."""

LEAST_GAIN = 12.0
"""... and by how much it must lower χ² besides, unless it stands for two causes more than itself: fewer parameters
alone do not make a stranger, but three causes that together imitate one departure do."""

TIME, WARMTH, PLACE = "t_s", "warmed_K", "stage_mm"
"""What of the flow a departure may follow."""


def _gain(signal: str, follows: str) -> Step:
    def step(flow: Flow, values: Sequence[float], _: Memory) -> None:
        setattr(flow, signal, getattr(flow, signal) * (1.0 + values[0] * getattr(flow, follows)))

    return step


def _offset(signal: str, follows: str) -> Step:
    def step(flow: Flow, values: Sequence[float], _: Memory) -> None:
        setattr(flow, signal, getattr(flow, signal) + values[0] * getattr(flow, follows))

    return step


def _divider(flow: Flow, values: Sequence[float], _: Memory) -> None:
    # Only R/Rs enters the divider: a resistor that grows is a channel, dummy or not, that shrinks.
    flow.resistance_ohm = flow.resistance_ohm / (1.0 + values[0] * flow.warmed_K)


def _cell_lag(flow: Flow, values: Sequence[float], _: Memory) -> None:
    flow.reading_N = low_pass(flow.reading_N, flow.step_s, max(values[0], 1e-4), np.full(2, flow.reading_N[0]))


@dataclass(frozen=True)
class Stranger:
    """A generic departure.

    Args:
        like: what it is, in words.
        is_warming: it follows the temperature.
    """

    like: Reason
    effect: Effect
    is_warming: bool


def _stranger(
    code: str, stage: ChainStage, hook: Hook, step: Step, unit: str, usual: float, is_signed: bool = True
) -> Stranger:
    size = Parameter("size", unit, -30.0 * usual if is_signed else 0.0, 30.0 * usual, usual, neutral=0.0)
    effect = Effect(code, stage, hook, "", "no effect of the catalogue", (size,), step)
    return Stranger(Reason(code), effect, unit.endswith("/K"))


STRANGERS = (
    _stranger("gap.like.stiffness_in_time", "mechanics", Hook.FORCE, _gain("force_N", TIME), "1/s", 1e-3),
    _stranger("gap.like.stiffness_when_warm", "mechanics", Hook.FORCE, _gain("force_N", WARMTH), "1/K", 5e-3),
    _stranger("gap.like.sensitivity_in_time", "transduction", Hook.CHANNEL, _gain("drive", TIME), "1/s", 1e-3),
    _stranger("gap.like.sensitivity_when_warm", "transduction", Hook.CHANNEL, _gain("drive", WARMTH), "1/K", 5e-3),
    _stranger("gap.like.offset_in_time", "electronics", Hook.OUTPUT, _offset("output_V", TIME), "V/s", 2e-4),
    _stranger("gap.like.offset_when_warm", "electronics", Hook.OUTPUT, _offset("output_V", WARMTH), "V/K", 1e-3),
    _stranger("gap.like.cell_span_in_time", "load_cell", Hook.READING, _gain("reading_N", TIME), "1/s", 1e-3),
    _stranger("gap.like.cell_span_when_warm", "load_cell", Hook.READING, _gain("reading_N", WARMTH), "1/K", 5e-3),
    _stranger("gap.like.cell_zero_when_warm", "load_cell", Hook.READING, _offset("reading_N", WARMTH), "N/K", 0.01),
    _stranger("gap.like.cell_by_position", "load_cell", Hook.READING, _offset("reading_N", PLACE), "N/mm", 0.05),
    _stranger("gap.like.cell_late", "load_cell", Hook.READING, _cell_lag, "s", 0.1, is_signed=False),
)
"""Generic departures."""

WARM_DIVIDER = _stranger("gap.like.divider_when_warm", "electronics", Hook.REFERENCE, _divider, "1/K", 1e-3)
"""Looks like a channel that follows the temperature, sign reversed, as long as the channel itself is read."""


def stranger(best: Fit, parents: Sequence[Fit], fits: Sequence[Fit]) -> Fit | None:
    """Return the best hypothesis with a stranger in it, None where none beats the catalogue decisively.

    Args:
        best: of the catalogue.
        parents: hypotheses a stranger may stand beside, fitted under the noise level of `best`.
        fits: every hypothesis of the catalogue.
    """
    if best.problem.is_driven_by_force:
        return None
    found = [grown for parent in parents for grown in _grown(parent)]
    if not found:
        return None
    yardstick = Yardstick.of((*fits, *found))
    closest = max(found, key=yardstick.log_evidence)
    ahead = yardstick.log_evidence(closest) - yardstick.log_evidence(best)
    is_decisive = ahead > (RIVAL_LOG_ODDS if structure(closest).is_significant else CLEAN_LOG_ODDS)
    is_simpler = len(closest.hypothesis.ids) <= len(best.hypothesis.ids) - 2
    return closest if is_decisive and (is_simpler or closest.chi2 < best.chi2 - LEAST_GAIN) else None


def stranger_of(found: Fit) -> Stranger:
    """Return the stranger of a hypothesis that has one."""
    return next(one for one in (*STRANGERS, WARM_DIVIDER) if one.effect in found.hypothesis.effects)


def _grown(parent: Fit) -> list[Fit]:
    case, scale = parent.problem.case, parent.problem.scale
    is_warming = any(run.temperature_C is not None and np.ptp(run.temperature_C) > 0 for run in case.presses)
    felt = [one for one in STRANGERS if is_warming or not one.is_warming]
    seen = [one.effect for one in felt if one.effect.stage not in case.unseen_stages]
    seen += [WARM_DIVIDER.effect] if case.has_warmed_dummy else []
    probes = [Probe(e, (scale.sized(e.parameters[0]).usual,), e.parameters[0].low == 0.0) for e in seen]
    return [joined(parent, lead) for lead in screen(parent, probes)[:1]]
