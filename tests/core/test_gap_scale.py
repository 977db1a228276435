"""A diagnosis does not depend on the size of a rig: the same recordings in larger or smaller units say the same."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softcal.core import profiles
from softcal.core.gap.case import COMMON, Case, RigScale, Run
from softcal.core.gap.hypothesis import BASE as PARAMETERS
from softcal.core.gap.twin import diagnose
from softcal.core.twin.catalogue import EFFECTS
from softcal.core.twin.effects import Parameter
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin, simulate
from tests.layers import layered

READOUT = ReadoutMetadata(vref_V=3.3, adc_bits=14, r_series_ohm=10.0, sample_rate_Hz=50.0)
BASE = BaseParameters(
    u0_mm=0.35, k1_N_mm=1.5, k3_N_mm3=0.12, kappa_per_N=0.06, sigma_output_V=0.0012, sigma_force_N=0.012
)
DEPTH_mm = 3.1
SIZES = {
    "channel_collapse": {"beta": 0.03, "Fc": 3.5},
    "wiring_resistance": {"Rw": 0.8},
    "loadcell_saturation": {"F_sat": 16.0},
    "loadcell_nonlinearity": {"lambda": 0.05},
    "contact_shift": {"s": 0.06, "tau": 15.0},
    "thermal_drift": {"alpha": 0.003},
    "mains_hum": {"A": 0.004, "f": 10.0},
    "adc_saturation": {"V_max": 1.25},
}
EPISODES = {"dropped_samples": ((6.0, 5.0), (9.0, 8.0)), "intermittent_contact": ((4.0, 5.2), (11.0, 11.5))}
CASES: dict[str, tuple[EffectSetting, ...]] = {"none": ()} | {
    i: (EffectSetting(i, SIZES.get(i, {}), EPISODES.get(i, ())),) for i in EFFECTS
}
QUICK = ("none", "loadcell_nonlinearity")
"""Cases of three kinds of size (none, resistor, cell) that take seconds; the others are long."""


def _case(*effects: EffectSetting) -> Case:
    rng, runs = np.random.default_rng(2), []
    press_profiles = (
        profiles.ramps([DEPTH_mm] * 3, 0.5),
        profiles.ramps([DEPTH_mm] * 8, 4.0),
        profiles.steps_with_holds([1.2, 2.4, DEPTH_mm, 1.8], hold_s=4.0),
    )
    for profile in press_profiles:
        t_s, stage_mm = profile.sample(50.0)
        warm_C = 22.0 + 3.0 * (1.0 - np.exp(-t_s / 10.0)) + 0.3 * np.sin(t_s / 3.0)
        force_N, output_V = simulate(Twin(BASE, effects, READOUT), t_s, stage_mm, rng, warm_C)
        runs.append(Run(profile.name, t_s, READOUT, stage_mm, force_N, output_V, warm_C, profile=profile.name))
    return Case("G1", tuple(runs))


def scaled(case: Case, force: float, stroke: float, volts: float, ohms: float) -> Case:
    """Return the same recordings of a rig that is larger by these factors."""
    readout = replace(case.readout, vref_V=case.readout.vref_V * volts, r_series_ohm=case.readout.r_series_ohm * ohms)
    factors = {"stage_mm": stroke, "force_N": force, "output_V": volts}
    runs = [replace(r, readout=readout, **{n: getattr(r, n) * by for n, by in factors.items()}) for r in case.runs]
    return Case(case.serial, tuple(runs))


def _summarise(case: Case) -> dict[str, Any]:
    diagnosis = diagnose(case)
    summary = {
        "verdict": diagnosis.verdict,
        "named": diagnosis.best.hypothesis.ids,
        "explained": diagnosis.explained_share,
    }
    summary |= {c.effect: c.probability for c in diagnosis.causes} | {
        f"{c.effect}: shrink": c.shrink for c in diagnosis.causes
    }
    return (
        summary
        | vars(diagnosis.explained_fraction)
        | {f"{p.stage} {p.channel} {p.regime}": p.share for p in diagnosis.locations}
    )


@cache
def _first(name: str) -> dict[str, Any]:
    return _summarise(_case(*CASES[name]))


def _agrees(name: str, factors: tuple[float, ...]) -> None:
    summary, first = _summarise(scaled(_case(*CASES[name]), *factors)), _first(name)
    assert set(summary) == set(first)
    for key, value in first.items():
        # What a power of ten rounds off differently moves a fit in its tenth digit; kinked effects carry it further.
        assert summary[key] == (pytest.approx(value, abs=1e-4) if isinstance(value, float) else value), key


@pytest.mark.parametrize("name", layered(CASES, QUICK))
def test_a_rig_larger_by_powers_of_ten_gets_the_same_diagnosis(name: str) -> None:
    powers = np.random.default_rng(list(CASES).index(name)).integers(-3, 4, 4)
    _agrees(name, tuple(10.0**powers))


@pytest.mark.parametrize("name", layered(["none", "loadcell_nonlinearity"], ("loadcell_nonlinearity",)))
@pytest.mark.parametrize(
    "factors",
    [(0.02, 1.0, 1.0, 1.0), (1.0, 8.0, 0.01, 50.0), (18.75, 0.1, 1.9, 0.3)],
    ids=["0.16 N", "millivolts", "150 N and 0.3 mm"],
)
def test_a_larger_rig_gets_the_same_diagnosis(name: str, factors: tuple[float, float, float, float]) -> None:
    _agrees(name, factors)


def test_the_planted_effects_are_named() -> None:
    assert {name: _first(name)["named"] for name in QUICK} == {n: () if n == "none" else (n,) for n in QUICK}


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
