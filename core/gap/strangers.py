"""Departures the catalogue does not have, in generic form: to tell when one of them explains more than the catalogue.

Each signal of the chain may have a gain or an offset that follows time or temperature, and the load cell a delay or a
share of the position. They are no causes a report can name; where one wins, the report says `unknown` and what it is
like.
"""

from collections.abc import Callable, Sequence

import numpy as np

from softcal.core.gap.candidates import Probe
from softcal.core.gap.case import Case
from softcal.core.gap.fit import Fit
from softcal.core.gap.posterior import Yardstick
from softcal.core.gap.residual import structure
from softcal.core.gap.scale import RigScale
from softcal.core.gap.screen import joined, screen
from softcal.core.recording import Array
from softcal.core.twin.effects import ChainStage, Effect, Flow, Hook, Memory, Parameter, Step
from softcal.core.twin.signals import low_pass

LOG_ODDS = 5.0
CLEAN_LOG_ODDS = 2.0
"""Log evidence by which a stranger must beat the catalogue: where it leaves structure, and where it leaves none ..."""

LEAST_GAIN = 12.0
"""... and by how much it must lower χ² besides, unless it stands for two causes more than itself: fewer parameters
alone do not make a stranger, but three causes that together imitate one departure do."""

Follow = Callable[[Flow], Array]


def _time(flow: Flow) -> Array:
    return flow.t_s


def _temperature(flow: Flow) -> Array:
    return np.zeros(len(flow.t_s)) if flow.temperature_rise_K is None else flow.temperature_rise_K


def _position(flow: Flow) -> Array:
    return flow.stage_mm


def _gain(signal: str, follow: Follow) -> Step:
    def step(flow: Flow, values: Sequence[float], _: Memory) -> None:
        setattr(flow, signal, getattr(flow, signal) * (1.0 + values[0] * follow(flow)))

    return step


def _offset(signal: str, follow: Follow) -> Step:
    def step(flow: Flow, values: Sequence[float], _: Memory) -> None:
        setattr(flow, signal, getattr(flow, signal) + values[0] * follow(flow))

    return step


def _divider(flow: Flow, values: Sequence[float], _: Memory) -> None:
    # Only R/Rs enters the divider: a resistor that grows is a channel, dummy or not, that shrinks.
    flow.resistance_ohm = flow.resistance_ohm / (1.0 + values[0] * _temperature(flow))


def _cell_lag(flow: Flow, values: Sequence[float], _: Memory) -> None:
    flow.reading_N = low_pass(flow.reading_N, flow.step_s, max(values[0], 1e-4), np.full(2, flow.reading_N[0]))


def _stranger(
    what: str, stage: ChainStage, hook: Hook, step: Step, unit: str, usual: float, is_signed: bool = True
) -> Effect:
    size = Parameter("size", unit, -30.0 * usual if is_signed else 0.0, 30.0 * usual, usual, neutral=0.0)
    return Effect(what, stage, hook, what, "no effect of the catalogue", (size,), step)


WARM = "follows the temperature"
STRANGERS = (
    _stranger("a stiffness that drifts", "mechanics", Hook.FORCE, _gain("force_N", _time), "1/s", 1e-3),
    _stranger(f"a stiffness that {WARM}", "mechanics", Hook.FORCE, _gain("force_N", _temperature), "1/K", 5e-3),
    _stranger("a sensitivity that drifts", "transduction", Hook.CHANNEL, _gain("drive", _time), "1/s", 1e-3),
    _stranger(f"a sensitivity that {WARM}", "transduction", Hook.CHANNEL, _gain("drive", _temperature), "1/K", 5e-3),
    _stranger("an output offset that drifts", "electronics", Hook.OUTPUT, _offset("output_V", _time), "V/s", 2e-4),
    _stranger(
        f"an output offset that {WARM}", "electronics", Hook.OUTPUT, _offset("output_V", _temperature), "V/K", 1e-3
    ),
    _stranger("a cell whose span drifts", "load_cell", Hook.READING, _gain("reading_N", _time), "1/s", 1e-3),
    _stranger(f"a cell whose span {WARM}", "load_cell", Hook.READING, _gain("reading_N", _temperature), "1/K", 5e-3),
    _stranger(f"a cell whose zero {WARM}", "load_cell", Hook.READING, _offset("reading_N", _temperature), "N/K", 0.01),
    _stranger(
        "a cell that reads the position", "load_cell", Hook.READING, _offset("reading_N", _position), "N/mm", 0.05
    ),
    _stranger("a cell that reads late", "load_cell", Hook.READING, _cell_lag, "s", 0.1, is_signed=False),
)
"""Generic departures; the identifier is the description."""

WARM_DIVIDER = _stranger(f"a divider resistor that {WARM}", "electronics", Hook.REFERENCE, _divider, "1/K", 1e-3)
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
    is_decisive = ahead > (LOG_ODDS if structure(closest).is_significant else CLEAN_LOG_ODDS)
    is_simpler = len(closest.hypothesis.ids) <= len(best.hypothesis.ids) - 2
    return closest if is_decisive and (is_simpler or closest.chi2 < best.chi2 - LEAST_GAIN) else None


def name_of(found: Fit) -> Effect:
    """Return the stranger of a hypothesis that has one."""
    return next(e for e in found.hypothesis.effects if e in (*STRANGERS, WARM_DIVIDER))


def _grown(parent: Fit) -> list[Fit]:
    leads = screen(parent, _probes(parent.problem.case, parent.problem.scale))[:1]
    return [joined(parent, lead) for lead in leads]


def _probes(case: Case, scale: RigScale) -> list[Probe]:
    is_warming = any(run.temperature_C is not None and np.ptp(run.temperature_C) > 0 for run in case.presses)
    seen = [e for e in STRANGERS if e.stage not in case.unseen_stages and (is_warming or WARM not in e.id)]
    seen += [WARM_DIVIDER] if case.has_warmed_dummy else []
    return [Probe(e, (scale.sized(e.parameters[0]).usual,), e.parameters[0].low == 0.0) for e in seen]
