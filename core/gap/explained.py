"""The explained twin, for station and simulated lots: the refitted base with the named causes; what its runs have of
their own."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from softcal.core.errors import InputError
from softcal.core.gap.coordinates import start_coordinates
from softcal.core.gap.fit import Fit, fit, form_of
from softcal.core.gap.forward import dither_of
from softcal.core.gap.problem import Nearby
from softcal.core.twin.catalogue import EFFECTS
from softcal.core.twin.effects import Effect, Flow, Memory
from softcal.core.twin.empirical_terms import EmpiricalTerm
from softcal.core.twin.simulate import EffectSetting, Twin

if TYPE_CHECKING:
    from softcal.core.gap.diagnosis import Diagnosis
    from softcal.core.gap.twin import TwinModel


def explained_twin(found: Fit, terms: Sequence[EmpiricalTerm] = ()) -> Twin:
    """Return base parameters, noise and causes of a fitted hypothesis as a twin.

    A cause enters by the equation it was fitted by. Episodes belong to the recording they were found in
    and are left out: losses of samples and bad contacts are repaired, not simulated.
    """
    found = with_constants(found)
    readout = found.problem.case.readout
    # σV without the share of rounding, q²/12 where the noise is not small against a step.
    sigma_V = dither_of(found.problem)
    if sigma_V is None:
        sigma_V = float(np.sqrt(max(_floor(found, "output_V") ** 2 - readout.step_V**2 / 12, 0.0)))
    base = found.base.with_values(sigma_output_V=sigma_V, sigma_force_N=_floor(found, "force_N"))
    settings = []
    for effect, values in zip(found.effects, found.effect_values, strict=True):
        if effect.id not in EFFECTS or EFFECTS[effect.id].is_episodic:
            continue
        given = {p.name: v for p, v in zip(effect.parameters, values, strict=True)} | dict(effect.constants)
        form = form_of(found, effect)
        # What belongs to a recording alone, as the phase of a hum, is no parameter of the twin.
        known = effect if form else EFFECTS[effect.id].side_with([effect.parameters[0].name])
        fitted = {k: v for k, v in given.items() if k in known.value_names and np.isfinite(v)}
        settings.append(EffectSetting(effect.id, fitted, form=form))
    return Twin(base, tuple(settings), readout, tuple(terms))


def repaired_twin(diagnosis: "Diagnosis[TwinModel]") -> Twin:
    """Return the twin to go on with: the refitted base with the set of causes.

    Raises:
        InputError: the recordings hold a mistake; a twin of them would hold it too.
    """
    if diagnosis.verdict == "data":
        repairs = "; ".join(f"{f.evidence}: {f.repair}" for f in diagnosis.mistakes)
        raise InputError(f"the recordings hold a mistake, so there is no twin of them: {repairs}")
    return explained_twin(diagnosis.best)


def described_twin(diagnosis: "Diagnosis[TwinModel]") -> Twin | None:
    """Return the twin with empirical terms and the causes they stand beside, no diagnosis; None without."""
    if diagnosis.residual is None:
        return None
    return explained_twin(diagnosis.residual.fit, [one.term for one in diagnosis.residual.terms])


def _floor(found: Fit, channel: str) -> float:
    return found.problem.floor(channel) if channel in found.problem.sigma else 0.0


def in_catalogue_form(found: Fit) -> Fit:
    """Return the fit with every cause by the catalogue's equation; itself where it already is."""
    listed = {e.id: e for e in found.problem.model.candidates}
    effects = tuple(listed[e.id] if form_of(found, e) else e for e in found.effects)
    if effects == found.effects:
        return found
    rows = []
    for effect, fitted, values in zip(effects, found.effects, found.effect_values, strict=True):
        given = {p.name: v for p, v in zip(fitted.parameters, values, strict=True)}
        rows.append([given.get(p.name, p.usual) for p in effect.parameters])
    start = np.append(found.coordinates[found.hypothesis.of_base], start_coordinates(effects, rows))
    return fit(found.problem, replace(found.hypothesis, effects=effects), start, steps=40)


def with_constants(found: Fit) -> Fit:
    """Return the fit with the constants of every form set to one value for all runs.

    A fit reads them off each run: its largest force, of which strokes are shares. A twin has one number,
    the largest of the runs. Base and causes are refitted with it.
    """
    effects = found.effects
    if not any(_is_open(effect) for effect in effects):
        return found
    seen = {effect.id: dict.fromkeys((name for name, _ in effect.constants), 0.0) for effect in effects}

    def watched(effect: Effect) -> Effect:
        largest = seen[effect.id]

        def step(flow: Flow, values: Sequence[float], state: Memory) -> None:
            effect.step(flow, values, state)
            largest.update({name: max(most, float(state[name][0])) for name, most in largest.items()})

        return replace(effect, step=step)

    def fixed(effect: Effect) -> Effect:
        def step(flow: Flow, own: Sequence[float], state: Memory) -> None:
            effect.step(flow, (*own, *seen[effect.id].values()), state)

        return replace(effect, step=step, constants=tuple(seen[effect.id].items()))

    open_ = tuple(watched(e) if _is_open(e) else e for e in effects)
    found.problem.bare.predict(replace(found.hypothesis, effects=open_), found.coordinates)
    closed = tuple(fixed(e) if _is_open(e) else e for e in effects)
    return fit(found.problem, replace(found.hypothesis, effects=closed), found.coordinates, steps=40)


def _is_open(effect: Effect) -> bool:
    return any(not np.isfinite(value) for _, value in effect.constants)


@dataclass(frozen=True)
class Offsets:
    """What one run has of its own.

    Args:
        run: its index in the case.
        force_N: what the cell reads at rest.
        resistance: by what share R0 differs from that of the middle run.
        seat_mm: by how much the surface lies lower than in the middle run.
    """

    run: int
    force_N: float = 0.0
    resistance: float = 0.0
    seat_mm: float = 0.0


def offsets(found: Fit) -> list[Offsets]:
    """Return the least-squares offsets of every run within their bounds: the rest stays a gap.

    Of resistance and seat only what the runs differ by is taken: the rest is the base's R0 and u0.
    """
    problem = found.problem
    clean = problem.bare.predict(found.hypothesis, found.coordinates)
    sizes = Nearby(problem.directions(found.hypothesis, found.coordinates, clean, {})).sizes(problem, clean)
    return [Offsets(run, *map(float, row)) for run, row in sizes.items()]
