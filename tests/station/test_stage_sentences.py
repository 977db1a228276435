"""Whatever breaks, and whenever: what is said of the stage afterwards is so, by the rig itself."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from common.fault_trial import is_report_true
from common.proof_trial import draw_good_rig, open_good_rig
from common.rig_trial import ForceLaw, RigCase, open_rig

from softcal.core.errors import DeviceError
from softcal.core.profiles import ramps
from softcal.station.tasks.acquisition import record
from softcal.station.testing.faults import FAULTS

OTHERS = tuple(f.inject for f in FAULTS if (f.stage_kind, f.force_kind, f.has_cell) == ("grbl", "hx711", True))
LIES = (
    lambda station: station.rig.cut_motor(),
    lambda station: station.rig.lose_steps(1.0),
    lambda station: station.rig.lose_steps(-2.0),
)
SEARCHING = "searching for contact"
PROFILE = ramps([2.5, 2.5], 4.0, rest_s=0.5)


class Breaks:
    """Breaks a station at drawn moments, and presses Ctrl-C at the last of them."""

    def __init__(self, station, injections, moments_s, is_stopped):
        self._station, self._is_stopped, self._end_s = station, is_stopped, max(moments_s)
        for inject, at_s in zip(injections, moments_s, strict=False):
            station.world.at(at_s, lambda inject=inject: inject(station))

    def on_wait(self):
        if self._is_stopped and self._station.world.now_s() > self._end_s:
            self._is_stopped = False
            raise KeyboardInterrupt


def stage_sentence_after(seed):
    """Break a drawn rig in a drawn way; return what is said of its stage ("" for a run that went through)."""
    rng = np.random.default_rng([seed, 340])
    rig = replace(draw_good_rig(seed), profile=PROFILE)
    with open_good_rig(rig) as (bench, station):
        lies = [LIES[int(rng.integers(len(LIES)))]] * bool(rng.random() < 0.6)
        injections = [*lies, *[OTHERS[int(rng.integers(len(OTHERS)))]] * bool(rng.random() < 0.5)]
        moments_s = np.sort(rng.uniform(2.0, 45.0, len(injections) + 1))
        breaks = Breaks(station, injections, moments_s, is_stopped=bool(rng.random() < 0.5))
        zeros_N = []

        def on_progress(progress):
            if progress.phase == SEARCHING:
                zeros_N.append(progress.force_N)

        try:
            record(bench, "S1", rig.profile, True, on_progress, on_wait=breaks.on_wait)
        except DeviceError as error:
            assert is_report_true(error, bench, station, zeros_N[0] if zeros_N else 0.0), f"{seed}: {error}"
            return code_of(error)
    return ""


def code_of(error):
    lift_state = error.reason.values["state"]
    return lift_state.values.get("state", lift_state).code


@pytest.mark.parametrize("seed", [*range(5), 1132])  # 1132: a touch before the stage had said where it is
def test_what_is_reported_of_the_stage_after_drawn_faults_is_so(seed):
    stage_sentence_after(seed)


@pytest.mark.long
def test_what_is_reported_of_the_stage_after_a_hundred_drawn_faults_is_so():
    sentence_counts = Counter(stage_sentence_after(seed) for seed in range(100, 200))
    assert {"left.lifted", "left.told", "left.stays"} <= set(sentence_counts)


QUICK = RigCase(latency_s=0.0, stiffest_N_mm=100.0, law=ForceLaw(1.0, 1.0))


def stopped_by_hand_at(depth_mm, breaks=lambda station: None, case=QUICK):
    """Break a rig at a depth, press Ctrl-C 0.1 s later; return what is said, and how deep the stage truly stands."""
    with open_rig(case) as (bench, station):
        broken_s = []

        def on_wait():
            is_deep = bench.stage.position_mm > case.surface_mm + depth_mm
            if not broken_s and is_deep:
                broken_s.append(station.world.now_s())
                breaks(station)
            if broken_s and station.world.now_s() > broken_s[0] + 0.1:
                raise KeyboardInterrupt

        with pytest.raises(DeviceError) as caught:
            record(bench, "S1", PROFILE, True, on_wait=on_wait)
        assert is_report_true(caught.value, bench, station), str(caught.value)
        return caught.value, station.rig.carriage_mm - case.surface_mm


def test_a_stage_whose_motor_lost_its_supply_is_not_called_lifted():
    error, stopped_mm = stopped_by_hand_at(1.5, lambda station: station.rig.cut_motor())
    lift_state = error.reason.values["state"]
    assert stopped_mm > 1.4 and code_of(error) == "left.stays"
    assert lift_state.values["force_N"] == pytest.approx(stopped_mm, abs=0.1)  # 1 N/mm
    assert lift_state.values["at_mm"] == pytest.approx(
        QUICK.approach_mm, abs=0.05
    )  # where its controller believes it to be


def test_a_stage_whose_force_has_fallen_to_rest_is_called_lifted():
    error, stopped_mm = stopped_by_hand_at(1.5)
    assert stopped_mm < 0.0 and code_of(error) == "left.lifted"


def test_without_a_force_to_confirm_it_a_lift_is_reported_and_not_confirmed():
    error, _ = stopped_by_hand_at(1.5, lambda station: station.force_wire.unplug())
    assert code_of(error) == "left.told"


def dies(station):
    station.rig.force_fault = lambda now_s, force_N: 0.0


@pytest.mark.parametrize("lies", LIES)
def test_a_cell_that_died_confirms_no_lift_of_a_stage_that_still_stands_on_the_unit(lies):
    def breaks(station):
        lies(station)
        dies(station)

    error, stopped_mm = stopped_by_hand_at(1.5, breaks)
    assert code_of(error) == ("left.told" if stopped_mm > 0.0 else "left.lifted")


def test_a_stage_that_touches_nothing_is_called_lifted_where_cell_and_sensor_are_at_rest():
    error, stopped_mm = stopped_by_hand_at(-0.3)
    assert stopped_mm < 0.0 and code_of(error) == "left.lifted"
    error, _ = stopped_by_hand_at(-0.3, lambda station: station.readout_wire.unplug())
    assert code_of(error) == "left.told"


def test_a_late_cell_confirms_a_lift_only_once_it_tells_of_now():
    late = replace(QUICK, cell_late_s=0.3, latency_s=0.3)
    error, stopped_mm = stopped_by_hand_at(1.5, lambda station: station.rig.cut_motor(), late)
    assert stopped_mm > 1.4 and code_of(error) == "left.stays"
    error, stopped_mm = stopped_by_hand_at(1.5, case=late)
    assert stopped_mm < 0.0 and code_of(error) == "left.lifted"
