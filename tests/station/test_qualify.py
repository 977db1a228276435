"""A qualification measures the whole chain on one unit: each figure against what the simulated rig has."""

from dataclasses import replace

import numpy as np
import pytest

from softcal.core.errors import CommandRefused, SafetyStop
from softcal.core.twin.parameters import BaseParameters
from softcal.core.twin.simulate import EffectSetting, Twin
from softcal.station.bench.bench import open_simulated_bench
from softcal.station.devices.config import UNKNOWN_S
from softcal.station.tasks.qualify import Figure, _Presses, qualify
from softcal.station.testing.faults import filter_cell
from tests.layers import layered

SPRING_N_MM, CELL_NOISE_N = 3.0, 0.012
SPRING = BaseParameters(k1_N_mm=SPRING_N_MM, k3_N_mm3=0.0, kappa_per_N=0.03, sigma_force_N=CELL_NOISE_N)


def qualified(effects=(), fault=lambda station: None, stiffness_N_mm=SPRING_N_MM, base=SPRING, latency_s=0.0):
    with open_simulated_bench(Twin(base, effects), seed=3) as (bench, station):
        fault(station)
        force = replace(bench.config.force, latency_s=latency_s)
        bench = replace(bench, config=replace(bench.config, force=force))
        qualification = qualify(bench, 2.0, stiffness_N_mm)
        assert not station.axis.is_moving
    assert qualification.seconds < 180.0
    return qualification, {figure.name.partition(" ")[0]: figure for figure in reversed(qualification.figures)}


def not_good(qualification):
    return {figure.name.partition(" ")[0] for figure in qualification.figures if not figure.is_good}


def test_a_good_rig_passes_on_a_stiff_spring_with_its_own_noise():
    qualification, figures = qualified()
    assert qualification.is_passed
    assert figures["noise"].value == pytest.approx(CELL_NOISE_N, rel=0.3)
    assert figures["time"].value == 0.0 and figures["pure"].value < 0.01
    assert figures["compliance"].value < 0.005 and figures["backlash"].value < 0.01


@pytest.mark.parametrize("backlash_mm", layered((0.08, 0.15), (0.08,)))
def test_backlash_is_measured_and_does_not_pass(backlash_mm):
    qualification, figures = qualified((EffectSetting("backlash", {"b": backlash_mm}),))
    assert not_good(qualification) == {"backlash"}
    assert figures["backlash"].value == pytest.approx(backlash_mm, abs=0.02)


@pytest.mark.parametrize("compliance_mm_N", layered((0.02, 0.08), (0.08,)))
def test_the_frame_gives_way_by_what_the_spring_does_not(compliance_mm_N):
    qualification, figures = qualified((EffectSetting("frame_compliance", {"c_f": compliance_mm_N}),))
    assert qualification.is_passed == (compliance_mm_N < 0.05)
    assert figures["compliance"].value == pytest.approx(compliance_mm_N, rel=0.1)


@pytest.mark.parametrize("share", layered((0.8, 1.3), (1.3,)))
def test_wrong_steps_per_mm_do_not_pass_on_a_spring_of_known_stiffness(share):
    qualification, figures = qualified(fault=lambda station: setattr(station.rig, "steps_share", share))
    assert not_good(qualification) == {"compliance"}
    assert figures["compliance"].value == pytest.approx((1.0 / share - 1.0) / SPRING_N_MM, abs=0.005)


def test_what_a_run_does_not_tell_is_no_figure_without_fault():
    t_s = np.arange(0.0, 40.0, 2.0)
    stage_mm = 1.0 - np.abs((t_s / 4.0) % 2.0 - 1.0)
    presses = _Presses(t_s, stage_mm, 5.0 * (stage_mm > 0.9))
    assert np.isnan(presses.backlash_mm) and not Figure("backlash", presses.backlash_mm, "mm", 0.05).is_good


def test_without_a_known_stiffness_frame_and_unit_stand_together_and_have_no_limit():
    qualification, figures = qualified(stiffness_N_mm=None)
    assert qualification.is_passed
    assert figures["compliance"].value == pytest.approx(1.0 / SPRING_N_MM, rel=0.05)


@pytest.mark.parametrize("constant_s", layered((0.06, 0.1, 0.2), (0.1,)))
def test_delay_and_bandwidth_of_the_cell_are_two_figures(constant_s):
    def slow_down(station):
        filter_cell(station, constant_s)
        station.force_wire.delay_s += 0.05

    qualification, figures = qualified(fault=slow_down, latency_s=UNKNOWN_S)
    assert not qualification.is_passed and figures["error"].value > figures["error"].limit
    assert figures["time"].value == pytest.approx(constant_s, rel=0.25)
    assert figures["pure"].value == pytest.approx(0.05, abs=0.025)


def test_a_cell_that_is_later_than_stated_does_not_pass():
    qualification, figures = qualified(fault=lambda station: setattr(station.force_wire, "delay_s", 0.1))
    assert not_good(qualification) == {"lag"}
    assert figures["lag"].value == pytest.approx(0.1, abs=0.015)


@pytest.mark.long
def test_a_slip_in_between_is_why_it_does_not_pass():
    def slip(station):
        station.world.at(45.0, lambda: station.rig.lose_steps(0.3))

    qualification, _ = qualified(fault=slip)
    assert not qualification.is_passed and qualification.refusal.code == "rig.slipped"


def test_a_unit_that_is_too_stiff_stops_the_stage_as_in_any_run():
    with open_simulated_bench(Twin(BaseParameters(k1_N_mm=20.0)), seed=3) as (bench, station):
        with pytest.raises((SafetyStop, CommandRefused)):
            qualify(bench, 2.0)
        assert not station.axis.is_moving
        assert station.rig.largest_force_N < 14.0
