"""Where the stage touches: found within some micrometres, whatever the stiffness, the noise and the delays."""

from dataclasses import replace

import numpy as np
import pytest
from common.rig_trial import ForceLaw, RigCase, open_rig

from softcal.core.errors import BadReply
from softcal.core.profiles import ramps
from softcal.core.twin.parameters import BaseParameters
from softcal.core.twin.simulate import Twin
from softcal.station.bench.bench import open_simulated_bench
from softcal.station.devices.config import UNKNOWN_S, FixtureConfig
from softcal.station.interfaces import Sample
from softcal.station.motion.contact import ContactSearch, fit_contact_onset
from softcal.station.tasks.acquisition import record
from tests.layers import layered

SEARCHING = "searching for contact"
FIRST_APPROACH = ramps([0.5], 4.0, rest_s=0.1)


@pytest.mark.parametrize("stiffness_N_mm", [0.4, 1.0, 5.0])
def test_the_bend_is_found_whatever_the_stiffness(rng, stiffness_N_mm):
    stage_mm = np.arange(0.0, 5.2 + 0.3 / stiffness_N_mm, 0.00625)  # 0.5 mm/s at 80 Hz
    force_N = stiffness_N_mm * np.maximum(0.0, stage_mm - 5.2) + rng.normal(0, 0.013, len(stage_mm))
    # Standard error of a line's foot: about 2 sigma / (k sqrt(n)); three of them.
    touching = np.sum(stage_mm > 5.2)
    assert fit_contact_onset(stage_mm, force_N + 0.7).at_mm == pytest.approx(
        5.2, abs=6 * 0.013 / stiffness_N_mm / np.sqrt(touching)
    )


@pytest.mark.parametrize("power", [1.0, 1.25, 1.4, 1.75])
def test_the_uncertainty_of_a_contact_is_the_spread_of_many(rng, power):
    errors_mm, uncertainties_mm = [], []
    for _ in range(60):
        stage_mm = np.arange(4.0 + rng.uniform(0, 0.006), 5.2 + (0.3 / 5.0) ** (1 / power), 0.006)
        fit_onset = fit_contact_onset(
            stage_mm, 5.0 * np.maximum(0.0, stage_mm - 5.2) ** power + rng.normal(0, 0.004, len(stage_mm))
        )
        errors_mm.append(fit_onset.at_mm - 5.2)
        uncertainties_mm.append(fit_onset.uncertainty_mm)
    spread_mm = np.sqrt(np.mean(np.square(errors_mm)))
    assert spread_mm == pytest.approx(np.median(uncertainties_mm), rel=0.3)  # 60 draws tell a spread within 9 %


@pytest.mark.parametrize("power", layered((1.0, 1.25, 1.4, 1.75, 2.0), (1.4,)))
def test_the_surface_is_found_within_ten_micrometres_for_any_power_law(power):
    for seed in (1, 2, 3):
        case = RigCase(law=ForceLaw(1.2, power), surface_mm=2.203, latency_s=0.0, stiffest_N_mm=60.0, seed=seed)
        with open_rig(replace(case, limit_N=12.0)) as (bench, _):
            recording = record(bench, "A1", ramps([0.3], 0.5, rest_s=0.1), with_reference=True)
        assert recording.contact_mm == pytest.approx(2.203, abs=0.010)


@pytest.mark.parametrize("power", layered((1.0, 1.4, 2.0), (1.4,)))
@pytest.mark.parametrize(("late_s", "declared_s"), [(0.1, UNKNOWN_S), (0.3, UNKNOWN_S), (0.1, 0.1)])
def test_a_late_cell_moves_no_contact_and_its_latency_is_found_after_a_second_touch_too(power, late_s, declared_s):
    law, searches = ForceLaw(1.2, power), []
    case = RigCase(law=law, surface_mm=2.203, cell_late_s=late_s, latency_s=declared_s, stiffest_N_mm=60.0)

    def follow(progress):
        if progress.phase == SEARCHING:
            searches.append(progress.stage_mm)

    with open_rig(replace(case, limit_N=12.0)) as (bench, _):
        recording = record(bench, "A1", ramps([1.5, 2.0], 5.0, rest_s=0.3), True, follow)
    is_touched_again = np.min(np.diff(searches)) < -0.05
    assert is_touched_again == (power > 1.0)
    assert recording.contact_mm == pytest.approx(2.203, abs=0.010)
    assert recording.alignment.force_behind_s == pytest.approx(late_s, abs=0.012)


def test_a_force_that_belongs_to_the_path_before_the_slow_press_hides_no_latency():
    surface_mm = 2.2 + 0.01 * float(np.random.default_rng(0).uniform())
    case = RigCase(law=ForceLaw(1.2, 1.0), surface_mm=surface_mm, cell_late_s=0.3, latency_s=UNKNOWN_S, seed=0)
    with open_rig(replace(case, stiffest_N_mm=60.0, limit_N=12.0)) as (bench, _):
        recording = record(bench, "A1", ramps([1.5, 2.0], 5.0, rest_s=0.3), with_reference=True)
    assert recording.contact_mm == pytest.approx(surface_mm, abs=0.010)


@pytest.mark.long
def test_units_of_other_stiffness_are_aligned_within_micrometres():
    errors_mm = []
    with open_simulated_bench(seed=4) as (bench, station):
        for k1_N_mm in (0.7, 1.0, 1.4, 1.0, 1.0, 0.7):
            unit = Twin(BaseParameters(k1_N_mm=k1_N_mm))
            station.mount(unit)
            found_mm = record(bench, "A1", FIRST_APPROACH, with_reference=True).contact_mm
            errors_mm.append(found_mm - station.rig.clearance_mm - unit.parameters.u0_mm)
    assert np.max(np.abs(errors_mm)) < 0.02
    assert np.std(errors_mm) < 0.008


def searching(late_s=0.0):
    """A search above the unit, cell and output at rest for 0.4 s."""
    cell, output = ([Sample(0.01 * k, None, (level,)) for k in range(40)] for level in (0.0, 1.0))
    return ContactSearch(FixtureConfig(), True, cell, output, late_s=late_s), cell, output


@pytest.mark.parametrize(("late_s", "waited_s", "dead_s"), [(0.0, (), 0.5), (0.25, (0.5, 0.6, 0.7), 0.76)])
def test_a_cell_that_shows_nothing_while_the_output_changes_is_dead_when_its_delay_is_over(late_s, waited_s, dead_s):
    search, _, output = searching(late_s)
    assert not search.is_over()
    for at_s in waited_s:
        output.append(Sample(at_s, None, (1.2,)))
        assert not search.is_over()
    output.append(Sample(dead_s, None, (1.2,)))
    with pytest.raises(BadReply) as dead:
        search.is_over()
    assert dead.value.reason.code == "rig.no_contact.cell"
    assert dead.value.reason.values["change"] == pytest.approx(0.2)


def test_an_output_far_ahead_of_a_measured_force_is_no_fault():
    search, cell, output = searching()
    cell.append(Sample(0.5, None, (0.1,)))
    output.append(Sample(0.5, None, (1.2,)))
    assert not search.is_over()
    cell.append(Sample(0.6, None, (0.31,)))
    assert search.is_over()
