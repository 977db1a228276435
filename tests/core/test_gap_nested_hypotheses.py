"""A larger hypothesis ends no worse than the smaller one it holds; what looks alike is parted by the proposed run."""

from dataclasses import replace

import numpy as np
import pytest

from softcal.core import profiles
from softcal.core.gap.case import Case, Run
from softcal.core.gap.fit import fit
from softcal.core.gap.search import fit_jointly, screen
from softcal.core.gap.twin import TWIN, diagnose
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin, simulate

READOUT = ReadoutMetadata(vref_V=5.0, adc_bits=10, r_series_ohm=10.0, sample_rate_Hz=50.0)
BASE = BaseParameters(u0_mm=0.35, k1_N_mm=0.9, k3_N_mm3=0.05, r0_ohm=0.05, kappa_per_N=0.31, sigma_force_N=0.015)
LEAD_RESISTANCE = EffectSetting("wiring_resistance", {"Rw": 1.2})


def _table(seed: int, *effects: EffectSetting) -> Case:
    """Return one table of force and output: a flat output to half the force, then a steep rise."""
    rng = np.random.default_rng(seed)
    t_s, stage_mm = profiles.ramps([1.2, 2.4, 3.1, 1.8, 3.0], 1.0).sample(50.0)
    force_N, output_V = simulate(Twin(BASE, effects, READOUT), t_s, stage_mm, rng)
    return Case("S", (Run("S", t_s, READOUT, None, force_N, output_V),))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_no_effect_ends_worse_than_the_twin_without_it(seed: int) -> None:
    case = _table(seed, LEAD_RESISTANCE)
    base = TWIN.base_fit(case)
    candidates = screen(base, TWIN.probes(base, TWIN.visible(case)))
    assert candidates[0].gain > 1000.0
    for candidate in candidates:
        assert fit_jointly(base, candidate).chi2 <= 1.001 * base.chi2, candidate.effect.id


def test_a_start_that_leads_nowhere_is_tried_more_gently() -> None:
    case = _table(1, LEAD_RESISTANCE)
    base = TWIN.base_fit(case)
    candidate = next(
        one for one in screen(base, TWIN.probes(base, TWIN.visible(case))) if one.effect.id == "wiring_resistance"
    )
    # Four hundred times too large a promise, as a bent surface makes it.
    far = replace(candidate, values=(400.0 * candidate.values[0],), shift=400.0 * candidate.shift)
    misled_fit = fit(base.problem, base.hypothesis.adding(candidate.effect), far.start(base))
    joined_fit = fit_jointly(base, far)
    assert joined_fit.chi2 < min(misled_fit.chi2, 0.5 * base.chi2)


def test_what_looks_alike_is_parted_by_a_run_though_something_is_left_besides() -> None:
    collapsing = EffectSetting("channel_collapse", {"beta": 0.08, "Fc": 1.2})
    base = replace(BASE, r0_ohm=1.2, kappa_per_N=0.1)
    t_s, stage_mm = profiles.ramps([1.2, 2.4, 3.1, 1.8, 3.0], 1.0).sample(50.0)
    force_N, output_V = simulate(Twin(base, (collapsing,), READOUT), t_s, stage_mm, np.random.default_rng(4))
    # No effect of the catalogue has an output that swings with its own level.
    output_V = output_V + 0.04 * np.sin(25.0 * output_V)
    diagnosis = diagnose(Case("S", (Run("S", t_s, READOUT, None, force_N, output_V),)))
    assert diagnosis.verdict == "unknown"
    assert ["channel_collapse", "wiring_resistance"] in [sorted(pair) for pair in diagnosis.ambiguous_with]
    assert diagnosis.next_experiment.separation_sigma > 10.0
    assert "channel_collapse" in str(diagnosis.next_experiment.why)
