"""The explained twin: the refitted base with the named causes, as the station and simulated lots take it."""

import numpy as np

from softcal.core.gap.fit import Fit
from softcal.core.twin.catalogue import EFFECTS
from softcal.core.twin.simulate import EffectSetting, Twin


def explained_twin(found: Fit) -> Twin:
    """Return base parameters, noise and causes of a fitted hypothesis as a twin.

    A cause that was fitted in another realisation than the catalogue's stands with its catalogue equation as far as
    its parameters have the catalogue's names. Episodes belong to the recording they were found in and are left out:
    losses of samples and bad contacts are repaired, not simulated.
    """
    sigma, readout = found.problem.sigma, found.problem.case.readout
    base = found.base.with_values(
        sigma_output_V=_white(sigma.get("output_V", 0.0), found.problem.dither_V, readout.step_V),
        sigma_force_N=sigma.get("force_N", 0.0),
    )
    return Twin(base, tuple(_settings(found)), readout)


def _white(sigma_V: float, dither_V: float | None, step_V: float) -> float:
    """Return σV without the share of rounding, q²/12 where the noise is not small against a step."""
    return float(np.sqrt(max(sigma_V**2 - step_V**2 / 12, 0.0))) if dither_V is None else dither_V


def _settings(found: Fit) -> list[EffectSetting]:
    out = []
    for effect, values in zip(found.hypothesis.effects, found.effect_values, strict=True):
        if EFFECTS[effect.id].is_episodic:
            continue
        given = {p.name: v for p, v in zip(effect.parameters, values, strict=True)}
        known = {p.name for p in EFFECTS[effect.id].parameters}
        out.append(EffectSetting(effect.id, {k: v for k, v in given.items() if k in known and np.isfinite(v)}))
    return out
