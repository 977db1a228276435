"""The explained twin: the refitted base with the named causes, as the station and simulated lots take it."""

import numpy as np

from softcal.core.gap.diagnosis import Diagnosis
from softcal.core.gap.fit import Fit
from softcal.core.twin.catalogue import EFFECTS
from softcal.core.twin.simulate import EffectSetting, Twin


def explained_twin(diagnosis: Diagnosis) -> Twin:
    """Return base parameters, noise and causes of a diagnosis as a twin.

    A cause that was fitted in another realisation than the catalogue's stands with its catalogue equation as far as
    its parameters have the catalogue's names. Episodes belong to the recording they were found in and are left out:
    losses of samples and bad contacts are repaired, not simulated.
    """
    best = diagnosis.best
    sigma = best.problem.sigma
    base = best.base.with_values(
        sigma_output_V=_white(sigma.get("output_V", 0.0), diagnosis.case.readout.step_V),
        sigma_force_N=sigma.get("force_N", 0.0),
    )
    return Twin(base, tuple(_settings(best)), diagnosis.case.readout)


def _white(sigma_V: float, step_V: float) -> float:
    """Return σV without the share of rounding, q²/12."""
    return float(np.sqrt(max(sigma_V**2 - step_V**2 / 12, 0.0)))


def _settings(best: Fit) -> list[EffectSetting]:
    out = []
    for effect, values in zip(best.hypothesis.effects, best.effect_values, strict=True):
        if EFFECTS[effect.id].is_episodic:
            continue
        given = {p.name: v for p, v in zip(effect.parameters, values, strict=True)}
        known = {p.name for p in EFFECTS[effect.id].parameters}
        out.append(EffectSetting(effect.id, {k: v for k, v in given.items() if k in known and np.isfinite(v)}))
    return out
