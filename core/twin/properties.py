"""Properties that every effect must satisfy, in the catalogue or in the tests of a plug-in.

import pytest
from softcal.core.twin.properties import PROPERTIES

@pytest.mark.parametrize("holds", PROPERTIES, ids=lambda holds: holds.__name__)
def test_my_effect(holds):
    holds(MY_EFFECT)
"""

from collections.abc import Callable, Sequence

import numpy as np

from softcal.core.recording import Array
from softcal.core.twin.effects import ChainStage, Effect, Flow, Hook, SearchTarget
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.probes import ExcitationRange
from softcal.core.twin.simulate import Chain

RATE_Hz = 50.0
STAGE_OF: dict[Hook, ChainStage] = {
    Hook.MOTION: "motion",
    Hook.CONTACT: "mechanics",
    Hook.FORCE: "mechanics",
    Hook.CHANNEL: "transduction",
    Hook.RESISTANCE: "transduction",
    Hook.REFERENCE: "electronics",
    Hook.OUTPUT: "electronics",
    Hook.CLOCK: "acquisition",
    Hook.READING: "load_cell",
}
RANGE = ExcitationRange(depth_mm=3.0, force_N=6.5, lowest_V=1.43, highest_V=2.1, duration_s=40.0, period_s=1 / RATE_Hz)
EPISODES = np.array([[5.0, 7.0], [21.0, 22.0]])


class Violation(AssertionError):
    """An effect violates a property; the message names the property and the deviation."""


def _run(effect: Effect, values: Sequence[float], cuts: Sequence[int] = ()) -> Array:
    """(3, n) force, reading and output of a press with this effect, cut in pieces."""
    readout = ReadoutMetadata(5.0, 32, 10.0, RATE_Hz)
    t_s = np.arange(int(40 * RATE_Hz)) / RATE_Hz
    stage_mm = 3.0 * np.abs(np.sin(np.pi * t_s / 8.0)) * (0.6 + 0.4 * np.sin(t_s / 5.0))
    chain = Chain([effect])
    memories, parts = chain.fresh_memories(), []
    for part in np.split(np.arange(len(t_s)), list(cuts)):
        step_s = np.diff(t_s, prepend=0.0)[part]
        warm_K = 3.0 * np.sin(t_s[part] / 9.0)
        rows = {effect.id: EPISODES} if effect.is_episodic else {}
        flow = Flow(t_s[part], step_s, stage_mm[part], warm_K, readout.vref_V, rows)
        chain.run(flow, BaseParameters(), readout, [values], memories)
        parts.append(np.array([flow.force_N, flow.reading_N, flow.output_V]))
    return np.concatenate(parts, axis=1)


def _change(effect: Effect, values: Sequence[float]) -> Array:
    """(3, n) by how much the signals of a press differ from the base twin's."""
    return np.abs(_run(effect, values) - _run(_idle(effect), []))


def _usual(effect: Effect) -> list[float]:
    return [p.usual for p in effect.parameters]


def switched_off_it_changes_nothing(effect: Effect) -> None:
    """Check that at the neutral size, or a small one without a neutral size of 0, signals are the base twin's."""
    size = effect.parameters[0]
    values = list(effect.neutral_values)
    if values[0] == 0.0 and size.low > 0.0:
        values[0] = 1e-9
    if effect.signs.search_target == SearchTarget.LOSSES:
        # Its size is read off the episodes: none lost, none missing.
        return
    change = np.max(_change(effect, values))
    if not change < 1e-6:
        raise Violation(f"{effect.id}: at its neutral size it changes the signals by {change:.3g}")


def _idle(effect: Effect) -> Effect:
    return Effect(effect.id, effect.stage, effect.hook, "", "", (), lambda flow, values, memory: None)


def at_its_usual_size_it_shows(effect: Effect) -> None:
    """Check that the usual size changes a signal by a thousandth of its span; levels lie amid the output."""
    values = _usual(effect)
    if effect.signs.search_target in (SearchTarget.CEILING, SearchTarget.FLOOR):
        values[0] = 0.5 * (RANGE.lowest_V + RANGE.highest_V)
    span = np.ptp(_run(_idle(effect), []), axis=1)
    if not np.max(np.max(_change(effect, values), axis=1) / span) > 1e-3:
        raise Violation(f"{effect.id}: at its usual size nothing moves by a thousandth of its span")


def it_stays_finite_within_its_bounds(effect: Effect) -> None:
    """Check that every value within the bounds gives finite numbers."""
    for k, p in enumerate(effect.parameters):
        for end in (p.low, p.high):
            values = _usual(effect)
            values[k] = end
            with np.errstate(all="ignore"):
                signals = _run(effect, values)
            if not np.all(np.isfinite(signals)):
                raise Violation(f"{effect.id}: {p.name} = {end:.4g} {p.unit} gives numbers that are not finite")


def chunks_of_a_stream_give_the_same(effect: Effect) -> None:
    """Samples in pieces give the numbers of one call, but for a shifted clock's at the cuts."""
    for one in (effect, *(form.effect for form in effect.forms)):
        # Any number will do for a constant, as long as it is the same for all pieces.
        values = [*_usual(one), *(1.0 for _ in one.constants)]
        one_call, pieces = (_run(one, values, cuts) for cuts in ((), (1, 2, 77, 500, 1200)))
        rows = slice(0, 2) if one.hook == Hook.CLOCK else slice(0, 3)
        change = np.max(np.abs(one_call[rows] - pieces[rows]))
        if not change < 1e-9:
            label = (
                f"{one.id}: a stream in pieces" if one is effect else f"{one.id}: its form {one.equation!r} in pieces"
            )
            raise Violation(f"{label} differs from one call by {change:.3g}; keep state in `memory`")


def it_acts_where_it_says(effect: Effect) -> None:
    """Check that the stage is that of the hook, and that signals of earlier stages do not change."""
    if effect.stage != STAGE_OF[effect.hook]:
        raise Violation(f"{effect.id}: stage {effect.stage} does not belong to the hook {effect.hook.name}")
    change = np.max(_change(effect, _usual(effect)), axis=1)
    untouched = [2] if effect.hook == Hook.READING else [0, 1] if effect.hook >= Hook.CHANNEL else []
    for row in untouched:
        if change[row] > 0:
            raise Violation(
                f"{effect.id}: it acts at {effect.hook.name}, yet changes {('force', 'reading', 'output')[row]}"
            )


def a_search_finds_where_to_begin(effect: Effect) -> None:
    """Check that the effect has starting points within its bounds, or estimates its place first."""
    rows = effect.probes(RANGE)
    if not rows and effect.signs.search_target is None:
        raise Violation(f"{effect.id}: it has neither probes nor a way to be placed")
    if effect.is_episodic and effect.signs.search_target is None:
        raise Violation(f"{effect.id}: it is episodic, but says not how its episodes are placed")
    for row in rows:
        for p, value in zip(effect.parameters, row, strict=True):
            if not p.low <= value <= p.high:
                raise Violation(f"{effect.id}: a search would begin at {p.name} = {value:.4g}, outside its bounds")


def other_forms_carry_its_name(effect: Effect) -> None:
    """Check that every form has the identifier and stage of its cause, and starts within its own bounds."""
    for form in effect.forms:
        if (form.effect.id, form.effect.stage) != (effect.id, effect.stage):
            raise Violation(f"{effect.id}: its form {form.effect.equation!r} is of another cause")
        for p, value in zip(form.effect.parameters, form.start(_usual(effect)), strict=True):
            if not p.low <= value <= p.high:
                raise Violation(f"{effect.id}: its form {form.effect.equation!r} begins at {p.name} = {value:.4g}")


PROPERTIES: tuple[Callable[[Effect], None], ...] = (  # noqa: V107
    switched_off_it_changes_nothing,
    at_its_usual_size_it_shows,
    it_stays_finite_within_its_bounds,
    chunks_of_a_stream_give_the_same,
    it_acts_where_it_says,
    a_search_finds_where_to_begin,
    other_forms_carry_its_name,
)
"""Each raises `Violation` with one line where an effect does not satisfy it."""
