"""Where a gap lies, from maps and residuals alone: departures written here by hand, not from the catalogue."""

import numpy as np
import pytest

from softcal.core import profiles
from softcal.core.gap.case import Case, Run
from softcal.core.gap.fault_location import likely_stages
from softcal.core.gap.twin import TWIN
from softcal.core.twin.parameters import ReadoutMetadata

READOUT = ReadoutMetadata(vref_V=3.3, adc_bits=14, r_series_ohm=10.0, sample_rate_Hz=50.0)


def recorded(pad=None, force=None, channel=None, output=None, instant=None, cell=None):
    """Runs of a rig in the equations of the base model, with one step of the chain replaced."""
    rng, runs = np.random.default_rng(7), []
    same = lambda t_s, value: value  # noqa: E731
    press_profiles = (
        profiles.ramps([3.0] * 3, 0.5),
        profiles.ramps([3.0] * 12, 4.0),
        profiles.random_presses(rng, 30.0, 3.0),
    )
    for k, profile in enumerate(press_profiles):
        t_s, stage_mm = profile.sample(50.0)
        depth_mm = np.maximum(0.0, (pad or same)(t_s, stage_mm) - 0.3)
        force_N = (force or same)(t_s, depth_mm + 0.1 * depth_mm**3)
        resistance = 4.0 / (1 - 0.07 * (channel or same)(t_s, force_N))
        clean_V = (output or same)(t_s, 3.3 * resistance / (resistance + 10.0))
        read_V = np.interp((instant or same)(t_s, t_s), t_s, clean_V) + rng.normal(0, 1e-3, len(t_s))
        read_N = (cell or same)(t_s, force_N) + rng.normal(0, 0.015, len(t_s))
        codes_V = np.round(read_V / READOUT.step_V) * READOUT.step_V
        runs.append(Run(f"run {k}", t_s, READOUT, stage_mm, read_N, codes_V, profile=profile.name))
    return Case("P1", tuple(runs))


RNG = np.random.default_rng(3)
DEPARTURES = {
    "a slip of the carriage": ("motion", {"pad": lambda t_s, u_mm: u_mm - 0.08 * (t_s > 0.45 * t_s[-1])}),
    "an error of the screw's pitch": (
        "motion",
        {"pad": lambda t_s, u_mm: u_mm + 0.02 * np.sin(2 * np.pi * u_mm / 0.6)},
    ),
    "a pad that weakens with time": ("mechanics", {"force": lambda t_s, f_N: f_N * (1 - 0.002 * t_s)}),
    "a channel that loses sensitivity": ("transduction", {"channel": lambda t_s, f_N: f_N * (1 - 0.002 * t_s)}),
    "a wavy converter": ("electronics", {"output": lambda t_s, v_V: v_V + 0.006 * np.sin(2 * np.pi * v_V / 0.06)}),
    "spikes": ("electronics", {"output": lambda t_s, v_V: v_V + 0.08 * (RNG.random(len(t_s)) < 0.01)}),
    "instants that jitter": ("acquisition", {"instant": lambda t_s, at_s: at_s + RNG.normal(0, 0.008, len(t_s))}),
    "a cell that reads the cable": ("load_cell", {"cell": lambda t_s, f_N: f_N + 0.1 * np.sqrt(np.maximum(f_N, 0.0))}),
}


@pytest.mark.parametrize("name", DEPARTURES)
def test_the_stage_is_named_without_any_effect(name):
    stage, change = DEPARTURES[name]
    case = recorded(**change)
    assert likely_stages(TWIN.base_fit(case), TWIN.maps(case))[0] == stage


def test_no_stage_is_named_where_there_is_no_gap():
    case = recorded()
    assert likely_stages(TWIN.base_fit(case), TWIN.maps(case)) == ()
