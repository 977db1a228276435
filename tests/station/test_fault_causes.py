"""A fault is called by its cause: a stage that lost steps or says nothing new, an output that changed by itself."""

import pytest
from common.fault_trial import without_cell

from softcal.core.errors import DeviceError
from softcal.core.messages.reason import Reason
from softcal.core.profiles import moves
from softcal.core.twin.parameters import BaseParameters
from softcal.core.twin.simulate import EffectSetting, Twin
from softcal.station.bench.bench import open_simulated_bench
from softcal.station.simulated.far_end import FarEnd
from softcal.station.tasks.acquisition import record
from softcal.station.tasks.self_test import self_test
from tests.layers import layered

PROFILE = moves("three", [0.0, 3.0, 0.0, 2.5, 0.0, 3.0, 0.0], [2.0] * 7, [0.5, 0.5, 0.6, 0.5, 0.6, 0.5, 1.0])
RELAXING = Twin(BaseParameters(), (EffectSetting("stress_relaxation", {"g": 0.2, "tau": 1.0}),))


def press_with_fault(fault, after_s, unit=None, stage_kind="grbl", profile=PROFILE):
    """Press with a fault so many seconds into the profile; return the recording, or the reason why there is none."""
    pending = [True]
    with open_simulated_bench(unit, seed=3, stage_kind=stage_kind) as (bench, station):

        def on_progress(progress):
            if progress.phase == "pressing" and pending:
                pending.clear()
                station.world.at(station.world.now_s() + after_s, lambda: fault(station))

        try:
            recording = record(bench, "A1", profile, True, on_progress)
        except DeviceError as error:
            return error.reason.values.get("why", error.reason)
        finally:
            station.world.sleep_s(1.0)
            assert not station.axis.is_moving
    return recording


def reasons_of(result):
    """A change of the output is a remark, or why there is no recording."""
    return result if isinstance(result, Reason) else result.remarks[0]


def changing_gain(share):
    return lambda station: setattr(station.rig, "output_fault", lambda now_s, output_V: share * output_V)


def drifting(rate_V_s):
    def begin(station):
        since_s = station.world.now_s()
        station.rig.output_fault = lambda now_s, output_V: output_V + rate_V_s * (now_s - since_s)

    return begin


@pytest.mark.parametrize("share", layered((0.9, 0.95, 1.1), (0.9, 1.1)))
@pytest.mark.parametrize("unit", [None, RELAXING])
def test_an_output_that_changes_at_equal_force_is_reported_with_how_much(share, unit):
    sentences = reasons_of(press_with_fault(changing_gain(share), 4.5, unit))
    assert sentences.code == ("rig.output_fell" if share < 1.0 else "rig.output_rose")
    assert sentences.values["percent"] == pytest.approx(100 * abs(1 - share), rel=0.3)


@pytest.mark.parametrize("rate_V_s", [0.02, -0.02])
def test_an_output_that_drifts_at_equal_force_is_reported_with_how_fast(rate_V_s):
    sentences = reasons_of(press_with_fault(drifting(rate_V_s), 0.0))
    assert sentences.code == "rig.output_drift" and sentences.values["rate"] == pytest.approx(rate_V_s, rel=0.2)


@pytest.mark.parametrize("unit", [None, RELAXING])
def test_nothing_is_reported_of_an_output_that_follows_the_force(unit):
    assert press_with_fault(lambda station: None, 0.0, unit).remarks == ()


@pytest.mark.parametrize("stage_kind", ["grbl", "zaber", "esm"])
def test_a_position_report_that_stands_still_is_the_stages_fault(stage_kind):
    def freeze(station):
        station.far_end(FarEnd, "stage").frozen_mm = station.axis.position_mm

    why = press_with_fault(freeze, 1.2, stage_kind=stage_kind)
    assert why.code == "rig.still" and why.values["seconds"] < 1.0


@pytest.mark.parametrize("lost_mm", layered((0.1, 0.15, 0.2, 0.5), (0.15, 0.2)))
@pytest.mark.parametrize("unit", [None, RELAXING])
def test_steps_that_are_lost_between_two_presses_are_called_so(lost_mm, unit):
    why = press_with_fault(lambda station: station.rig.lose_steps(lost_mm), 3.9, unit)
    assert why.code == "rig.slipped" and why.values["lost_mm"] == pytest.approx(lost_mm, abs=0.04)


@pytest.mark.parametrize("gain", [0.8, 1.25])
def test_a_cell_whose_gain_changes_is_no_stage_that_slipped(gain):
    def change(station):
        station.rig.force_fault = lambda now_s, force_N: gain * force_N

    assert press_with_fault(change, 3.9).code in ("rig.odd_force", "rig.gain")


@pytest.mark.parametrize("has_cell", [True, False])
def test_who_presses_without_a_load_cell_is_told_what_nobody_sees(has_cell):
    with open_simulated_bench(seed=3) as (full, _):
        findings = self_test(full if has_cell else without_cell(full))
    assert any(finding.what.code == "check.unseen" for finding in findings) != has_cell
