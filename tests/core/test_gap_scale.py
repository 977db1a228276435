"""A diagnosis does not depend on the size of a rig: the same recordings in larger or smaller units say the same."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softcal.core import profiles
from softcal.core.gap.case import Case, Run
from softcal.core.gap.diagnosis import diagnose
from softcal.core.gap.fit import BASE as PARAMETERS
from softcal.core.gap.scale import COMMON, RigScale
from softcal.core.twin.catalogue import EFFECTS
from softcal.core.twin.effects import Parameter
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin, simulate

READOUT = ReadoutMetadata(vref_V=3.3, adc_bits=14, r_series_ohm=10.0, sample_rate_Hz=50.0)
BASE = BaseParameters(
    u0_mm=0.35, k1_N_mm=1.5, k3_N_mm3=0.12, kappa_per_N=0.06, sigma_output_V=0.0012, sigma_force_N=0.012
)
DEPTH_mm = 3.1
CASES = {
    "none": (),
    "channel_collapse": (EffectSetting("channel_collapse", {"beta": 0.03, "Fc": 3.5}),),
    "backlash": (EffectSetting("backlash", {"b": 0.05}),),
    "wiring_resistance": (EffectSetting("wiring_resistance", {"Rw": 0.8}),),
    "loadcell_saturation": (EffectSetting("loadcell_saturation", {"F_sat": 16.0}),),
    "loadcell_nonlinearity": (EffectSetting("loadcell_nonlinearity", {"lambda": 0.05}),),
    "contact_shift": (EffectSetting("contact_shift", {"s": 0.06, "tau": 15.0}),),
}


def _case(*effects: EffectSetting) -> Case:
    rng, runs = np.random.default_rng(2), []
    pressed = (
        profiles.ramps([DEPTH_mm] * 3, 0.5),
        profiles.ramps([DEPTH_mm] * 8, 4.0),
        profiles.steps_with_holds([1.2, 2.4, DEPTH_mm, 1.8], hold_s=4.0),
    )
    for profile in pressed:
        t_s, stage_mm = profile.sample(50.0)
        force_N, output_V = simulate(Twin(BASE, effects, READOUT), t_s, stage_mm, rng, np.full(len(t_s), 22.0))
        runs.append(Run(profile.name, t_s, READOUT, stage_mm, force_N, output_V, profile=profile.name))
    return Case("G1", tuple(runs), stiffness_N_mm=(0.4, 25.0))


def scaled(case: Case, force: float, stroke: float, volts: float, ohms: float) -> Case:
    """Return the same recordings of a rig that is larger by these factors."""
    readout = replace(case.readout, vref_V=case.readout.vref_V * volts, r_series_ohm=case.readout.r_series_ohm * ohms)
    factors = {"stage_mm": stroke, "force_N": force, "output_V": volts}
    runs = [replace(r, readout=readout, **{n: getattr(r, n) * by for n, by in factors.items()}) for r in case.runs]
    low, high = case.stiffness_N_mm or (0.4, 25.0)
    return Case(case.serial, tuple(runs), stiffness_N_mm=(low * force / stroke, high * force / stroke))


def _said(case: Case) -> dict[str, Any]:
    found = diagnose(case)
    assert found.verdict != "data"
    named = found.best.hypothesis.ids
    likely = {c.effect: c.probability for c in found.causes if c.effect in named}
    return {"verdict": found.verdict, "named": named} | likely | vars(found.shrink)


@pytest.fixture(scope="module")
def said() -> dict[str, dict[str, Any]]:
    return {name: _said(_case(*effects)) for name, effects in CASES.items()}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize(
    "factors",
    [(0.02, 1.0, 1.0, 1.0), (1.0, 8.0, 0.01, 50.0), (18.75, 0.1, 1.9, 0.3)],
    ids=["0.16 N", "millivolts", "150 N and 0.3 mm"],
)
def test_a_larger_rig_is_told_the_same(
    said: dict[str, dict[str, Any]], name: str, factors: tuple[float, float, float, float]
) -> None:
    found, first = _said(scaled(_case(*CASES[name]), *factors)), said[name]
    assert set(found) == set(first)
    for key, value in first.items():
        # Derivatives are taken in steps: what is read off a fit agrees to some digits.
        assert found[key] == (pytest.approx(value, abs=0.003) if isinstance(value, float) else value), key


def test_the_planted_effects_are_named(said: dict[str, dict[str, Any]]) -> None:
    assert {name: said[name]["named"] for name in CASES} == {n: () if n == "none" else (n,) for n in CASES}


@given(st.floats(1e-3, 1e3), st.floats(1e-3, 1e3), st.sampled_from(["N", "mm", "N/mm", "N/mm³", "1/N²", "mm/N", "V/s"]))
@settings(max_examples=40, deadline=None)
def test_bounds_scale_as_their_units_do(force: float, stroke: float, unit: str) -> None:
    scale = RigScale((("N", force), ("mm", stroke)))
    powers = {"N": (1, 0), "mm": (0, 1), "N/mm": (1, -1), "N/mm³": (1, -3), "1/N²": (-2, 0), "mm/N": (-1, 1)}
    n, mm = powers.get(unit, (0, 0))
    sized = scale.sized(Parameter("p", unit, -1.0, 2.0, 0.5))
    assert (sized.low, sized.high, sized.usual) == pytest.approx(
        tuple(force**n * stroke**mm * x for x in (-1.0, 2.0, 0.5)), rel=1e-9
    )


def test_the_common_rig_has_the_bounds_of_the_catalogue() -> None:
    scale = RigScale(tuple((unit, 1.0) for unit in COMMON))
    for parameter in (*PARAMETERS, *(p for effect in EFFECTS.values() for p in effect.parameters)):
        assert scale.sized(parameter) == parameter
