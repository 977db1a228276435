"""Two implementations of one page: the generator of sealed cases and the twin agree on every catalogue effect."""

from dataclasses import replace

import numpy as np
import pytest

from softcal.core.challenge.cases import EQUATIONS
from softcal.core.challenge.explained_fraction import PARAMETERS, UNFITTED
from softcal.core.challenge.protocols import one_rich_run
from softcal.core.challenge.rig import Cause, Rack, Rig, record
from softcal.core.twin.catalogue import EFFECTS
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin, simulate

BASE = {"u0_mm": 0.32, "k1_N_mm": 1.1, "k3_N_mm3": 0.14, "r0_ohm": 4.2, "kappa_per_N": 0.055}
READOUT = {"vref_V": 3.3, "r_series_ohm": 9.0, "adc_bits": 24, "sample_rate_Hz": 50.0}
RIG = Rig(noise_V=0.0, noise_N=0.0, **BASE, **READOUT)
_RICH_RUN = one_rich_run(np.random.default_rng(4), 2.6)
PATH = replace(_RICH_RUN, corner_s=np.round(_RICH_RUN.corner_s * 50.0) / 50.0)
"""Corners on sampling instants: between them the twin, which sees samples only, and the fine grid go the same way."""
VALUES: dict[str, tuple[float, ...]] = {
    "backlash": (0.06,),
    "contact_shift": (0.08, 12.0),
    "frame_compliance": (0.02,),
    "misaligned_contact": (0.2,),
    "stress_relaxation": (0.1, 4.0),
    "mechanical_hysteresis": (0.06, 0.3),
    "mullins_softening": (0.1, 2.0),
    "channel_creep": (0.1, 4.0),
    "channel_hysteresis": (0.06, 1.0),
    "channel_collapse": (0.03, 3.0),
    "thermal_drift": (1e-3,),
    "ageing_drift": (6e-3, 10.0),
    "readout_lag": (0.1,),
    "wiring_resistance": (0.6,),
    "reference_drift": (3e-4,),
    "adc_saturation": (1.15,),
    "loadcell_saturation": (14.0,),
    "loadcell_nonlinearity": (0.05, 10.0),
    "loadcell_creep": (0.03, 10.0),
    "loadcell_drift": (2e-3,),
    "clock_offset": (0.05,),
    "clock_skew": (-1e-3,),
}
DISCRETISATION = 0.01
"""Largest difference as a share of the effect: the twin steps by samples, the generator by tenths of them."""


def temperature(t_s: np.ndarray) -> np.ndarray:
    return 22.0 + 0.2 * t_s


def generated(*causes: Cause) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    columns = record(RIG, Rack(causes, EQUATIONS), PATH, temperature, np.random.default_rng(0)).columns
    return columns["t_s"], columns["stage_mm"], columns["force_N"], columns["output_V"]


def twinned(t_s: np.ndarray, stage_mm: np.ndarray, *settings: EffectSetting) -> tuple[np.ndarray, np.ndarray]:
    return simulate(
        Twin(BaseParameters(**BASE), settings, ReadoutMetadata(**READOUT)), t_s, stage_mm, None, temperature(t_s)
    )


def test_base_models_agree_to_the_last_digit() -> None:
    t_s, stage_mm, force_N, output_V = generated()
    twin_N, twin_V = twinned(t_s, stage_mm)
    np.testing.assert_allclose(twin_N, force_N, atol=1e-9)
    np.testing.assert_allclose(twin_V, output_V, atol=2e-7)


@pytest.mark.parametrize("effect", PARAMETERS)
def test_effect_agrees_within_the_discretisation(effect: str) -> None:
    names = PARAMETERS[effect]
    ours = {name: value for (_, name), value in zip(names, VALUES[effect], strict=True)}
    theirs = {name: value for (name, _), value in zip(names, VALUES[effect], strict=True)}
    t_s, stage_mm, force_N, output_V = generated(Cause(effect, "catalogue", {**UNFITTED.get(effect, {}), **ours}))
    twin_N, twin_V = twinned(t_s, stage_mm, EffectSetting(effect, theirs))
    _, _, base_N, base_V = generated()
    size_N, size_V = np.std(force_N - base_N), np.std(output_V - base_V)
    assert np.std(twin_N - force_N) <= DISCRETISATION * size_N + 1e-9
    assert np.std(twin_V - output_V) <= DISCRETISATION * size_V + 2e-7
    assert max(size_N, size_V) > 1e-5


def test_no_effect_of_the_catalogue_is_left_out() -> None:
    per_run = {"intermittent_contact", "dropped_samples", "mains_hum"}
    assert set(PARAMETERS) | per_run == set(EFFECTS)
