"""The explained twin: the refitted base with the named causes, as the station and simulated lots take it."""

import numpy as np

from softcal.core.gap.coordinates import start_coordinates
from softcal.core.gap.fit import BASE, Fit, Hypothesis, fit
from softcal.core.gap.forms import FORMS
from softcal.core.twin.catalogue import EFFECTS
from softcal.core.twin.effects import Effect
from softcal.core.twin.simulate import EffectSetting, Twin


def explained_twin(found: Fit) -> Twin:
    """Return base parameters, noise and causes of a fitted hypothesis as a twin.

    A cause that was fitted in another realisation than the catalogue's is fitted once more by the catalogue's equation,
    for a twin has no other. Episodes belong to the recording they were found in and are left out: losses of samples and
    bad contacts are repaired, not simulated.
    """
    found = in_catalogue_form(found)
    readout = found.problem.case.readout
    base = found.base.with_values(
        sigma_output_V=_white(_floor(found, "output_V"), found.problem.dither_V, readout.step_V),
        sigma_force_N=_floor(found, "force_N"),
    )
    return Twin(base, tuple(_settings(found)), readout)


def _floor(found: Fit, channel: str) -> float:
    return found.problem.floor(channel) if channel in found.problem.sigma else 0.0


def in_catalogue_form(found: Fit) -> Fit:
    """Return the fit with every cause by the catalogue's equation; the same fit where it already is."""
    effects = tuple(EFFECTS[e.id] if _is_other_form(e) else e for e in found.hypothesis.effects)
    if effects == found.hypothesis.effects:
        return found
    rows = []
    for effect, fitted, values in zip(effects, found.hypothesis.effects, found.effect_values, strict=True):
        given = {p.name: v for p, v in zip(fitted.parameters, values, strict=True)}
        rows.append([given.get(p.name, p.usual) for p in effect.parameters])
    start = np.append(found.coordinates[: len(BASE)], start_coordinates(effects, rows))
    return fit(found.problem, Hypothesis(effects, found.hypothesis.episodes), start, steps=40)


def _is_other_form(effect: Effect) -> bool:
    return any(form.effect is effect for form in FORMS.get(effect.id, ()))


def _white(sigma_V: float, dither_V: float | None, step_V: float) -> float:
    """Return σV without the share of rounding, q²/12 where the noise is not small against a step."""
    return float(np.sqrt(max(sigma_V**2 - step_V**2 / 12, 0.0))) if dither_V is None else dither_V


def _settings(found: Fit) -> list[EffectSetting]:
    out = []
    for effect, values in zip(found.hypothesis.effects, found.effect_values, strict=True):
        if EFFECTS[effect.id].is_episodic:
            continue
        given = {p.name: v for p, v in zip(effect.parameters, values, strict=True)}
        # What belongs to a recording alone, as the phase of a hum in each run, is no parameter of the twin.
        known = {p.name for p in EFFECTS[effect.id].side_with([effect.parameters[0].name]).parameters}
        out.append(EffectSetting(effect.id, {k: v for k, v in given.items() if k in known and np.isfinite(v)}))
    return out
