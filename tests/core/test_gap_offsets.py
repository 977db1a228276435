"""What every rig has is no cause: a cell that was not tared, a unit that sits anew; and a tone is not nothing."""

import dataclasses

import numpy as np
import pytest
from scipy.signal import lfilter

from softcal.core import profiles
from softcal.core.gap.case import Case, Run
from softcal.core.gap.fault_location import strongest_tone
from softcal.core.gap.hypothesis import BASE as PARAMETERS
from softcal.core.gap.hypothesis import Hypothesis, to_fit
from softcal.core.gap.method import METHOD
from softcal.core.gap.model import Problem
from softcal.core.gap.twin import TWIN, diagnose
from softcal.core.recording import Array
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin, simulate

READOUT = ReadoutMetadata(vref_V=3.3, adc_bits=16, r_series_ohm=10.0, sample_rate_Hz=50.0)
BASE = BaseParameters(u0_mm=0.35, k1_N_mm=1.1, k3_N_mm3=0.1, kappa_per_N=0.06, sigma_force_N=0.015)
DEPTH_mm = 3.1
SIGMA = {"force_N": 0.015, "output_V": 0.001}
PEAK_N = 1.1 * 2.75 + 0.1 * 2.75**3


def _runs(
    seatings: tuple[float, ...] = (0.0, 0.0, 0.0),
    *effects: EffectSetting,
    seats_mm: tuple[float, ...] = (0.0, 0.0, 0.0),
) -> list[Run]:
    rng = np.random.default_rng(4)
    press_profiles = (
        profiles.ramps([DEPTH_mm] * 2, 0.6),
        profiles.ramps([DEPTH_mm] * 6, 4.0),
        profiles.steps_with_holds([1.2, 2.4, DEPTH_mm, 1.8], hold_s=4.0),
    )
    runs = []
    for seating, seat_mm, profile in zip(seatings, seats_mm, press_profiles, strict=True):
        t_s, stage_mm = profile.sample(50.0)
        unit = dataclasses.replace(BASE, r0_ohm=BASE.r0_ohm * (1.0 + seating), u0_mm=BASE.u0_mm + seat_mm)
        force_N, output_V = simulate(Twin(unit, effects, READOUT), t_s, stage_mm, rng, np.full(len(t_s), 22.0))
        runs.append(Run(profile.name, t_s, READOUT, stage_mm, force_N, output_V, profile=profile.name))
    return runs


def _case(runs: list[Run]) -> Case:
    return Case("G1", tuple(runs))


def _untared(tare_N: float, *effects: EffectSetting) -> Case:
    runs = _runs((0.0, 0.0, 0.0), *effects)
    return _case([dataclasses.replace(run, force_N=np.asarray(run.force_N) + tare_N) for run in runs])


def _prediction(problem: Problem, base: BaseParameters = BASE) -> Array:
    return problem.predict(Hypothesis(), np.array([to_fit(p, getattr(base, p.name)) for p in PARAMETERS]))


def _find_offsets(problem: Problem) -> Array:
    """(runs, 3) offsets of force, resistance and seat at the true parameters."""
    at = np.array([to_fit(p, getattr(BASE, p.name)) for p in PARAMETERS])
    return np.array(list(problem.offset_sizes(Hypothesis(), at).values()))


def test_every_offset_of_every_run_is_found() -> None:
    zeros_N, seatings, seats_mm = (0.05, -0.1, 0.02), (0.004, -0.006, 0.0), (0.02, 0.0, -0.01)
    runs = [
        dataclasses.replace(run, force_N=np.asarray(run.force_N) + zero)
        for run, zero in zip(_runs(seatings, seats_mm=seats_mm), zeros_N, strict=True)
    ]
    offsets = _find_offsets(Problem(TWIN, _case(runs), SIGMA))
    assert offsets[:, 0] == pytest.approx(zeros_N, abs=3e-3)
    assert offsets[:, 1] == pytest.approx(np.array(seatings), abs=1e-3)
    assert offsets[:, 2] == pytest.approx(np.array(seats_mm), abs=2e-3)


def test_the_directions_are_those_of_the_twin() -> None:
    """A twin with another resistance and surface, and one whose offsets are taken off, leave the same."""
    moved = _runs((0.0, 0.008, 0.0), seats_mm=(0.0, 0.015, 0.0))
    problem = Problem(TWIN, _case(moved), SIGMA)
    residual = (problem.measured - _prediction(problem)) / problem.noise
    shifted_base = dataclasses.replace(BASE, r0_ohm=BASE.r0_ohm * 1.008, u0_mm=BASE.u0_mm + 0.015)
    of_moved = np.concatenate([np.full(b.rows.stop - b.rows.start, b.run == 1) for b in problem.blocks])
    true_left = (problem.measured - _prediction(problem.bare, shifted_base)) / problem.noise
    assert np.std(residual[of_moved]) == pytest.approx(np.std(true_left[of_moved]), rel=0.03)


def test_an_offset_beyond_what_rigs_have_stays_a_gap() -> None:
    problem = Problem(TWIN, _untared(0.5), SIGMA)
    largest_N = max(np.ptp(problem.measured[b.rows]) for b in problem.blocks if b.channel == "force_N")
    assert _find_offsets(problem)[:, 0] == pytest.approx([METHOD.offset.tare * largest_N] * 3)


def test_what_all_runs_share_is_left_to_the_base() -> None:
    every = _find_offsets(Problem(TWIN, _case(_runs((0.01, 0.01, 0.01), seats_mm=(0.02, 0.02, 0.02))), SIGMA))
    assert np.abs(every[:, 1]).max() < 1e-3 < 0.01 < METHOD.offset.resistance and np.abs(every[:, 2]).max() < 2e-3


@pytest.mark.parametrize("share", [-0.02, 0.02])
def test_a_cell_that_was_not_tared_is_no_gap(share: float) -> None:
    assert diagnose(_untared(share * PEAK_N)).verdict == "no_gap"


def test_a_unit_that_sits_anew_in_every_run_is_no_gap() -> None:
    assert diagnose(_case(_runs((-0.01, 0.008, 0.0), seats_mm=(0.0, -0.03, 0.02)))).verdict == "no_gap"


def test_a_cause_on_an_untared_rig_is_named_alone() -> None:
    relaxes = EffectSetting("stress_relaxation", {"g": 0.1, "tau": 5.0}, ())
    diagnosis = diagnose(_untared(0.02 * PEAK_N, relaxes))
    assert diagnosis.best.hypothesis.ids == ("stress_relaxation",)


def _disturbed_runs(seed: int, *effects: EffectSetting) -> Case:
    """Runs with all that rigs have at once: tare, seat, warm room, fading noise, noise under load, an uneven clock."""
    rng = np.random.default_rng(seed)
    runs = _runs((0.004, -0.003, 0.001), *effects, seats_mm=(0.0, 0.015, -0.01))
    disturbed_runs = []
    for run in runs:
        n, load = len(run), np.clip(np.asarray(run.force_N) / PEAK_N, 0.0, 1.0)
        late_s = np.clip(run.t_s + rng.uniform(-0.0015, 0.0015, n), run.t_s[0], run.t_s[-1])
        output_V = np.interp(late_s, run.t_s, np.asarray(run.output_V))
        span_V = float(np.ptp(output_V))
        output_V = output_V + _fading(rng, n, 0.003 * span_V) + rng.normal(0.0, 0.0015, n) * load
        force_N = np.asarray(run.force_N) + 0.015 * PEAK_N + _fading(rng, n, 0.003 * PEAK_N)
        force_N = force_N + rng.normal(0.0, 0.02, n) * load
        warm_C = 22.0 + 3.0 * (1.0 - np.exp(-run.t_s / 10.0))
        disturbed_runs.append(dataclasses.replace(run, output_V=output_V, force_N=force_N, temperature_C=warm_C))
    return _case(disturbed_runs)


def _fading(rng: np.random.Generator, count: int, spread: float) -> Array:
    decay = np.exp(-0.02 / 0.5)
    return np.asarray(lfilter([1.0], [1.0, -decay], rng.normal(0.0, spread * np.sqrt(1.0 - decay**2), count)))


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_all_that_rigs_have_at_once_is_no_gap(seed: int) -> None:
    diagnosis = diagnose(_disturbed_runs(seed))
    assert diagnosis.verdict == "no_gap" and not [c.effect for c in diagnosis.causes if c.probability > 0.5]


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_a_cause_is_named_beside_all_that_rigs_have(seed: int) -> None:
    diagnosis = diagnose(_disturbed_runs(seed, EffectSetting("backlash", {"b": 0.12})))
    assert [c.effect for c in diagnosis.causes if c.probability > 0.5] == ["backlash"]
    assert diagnosis.verdict in ("explained", "ambiguous")
    assert diagnosis.causes[0].parameters["b"].value == pytest.approx(0.12, rel=0.05)


@pytest.mark.parametrize("channel", ["force_N", "output_V"])
def test_a_tone_is_not_taken_for_noise(channel: str) -> None:
    noise = SIGMA[channel]

    def with_tone(run: Run) -> Run:
        tone = 3 * noise * np.sin(2 * np.pi * 17.3 * run.t_s)
        return dataclasses.replace(run, **{channel: np.asarray(getattr(run, channel)) + tone})

    toned = [with_tone(run) for run in _runs()]
    tone_found = strongest_tone(TWIN.base_fit(_case(toned)))
    assert (
        tone_found is not None
        and tone_found.channel == channel
        and tone_found.frequency_Hz == pytest.approx(17.3, abs=0.1)
    )
    assert diagnose(_case(toned)).verdict != "no_gap"


def test_white_noise_has_no_tone() -> None:
    assert strongest_tone(TWIN.base_fit(_case(_runs()))) is None


def test_a_surface_that_lies_lower_leaves_no_corner_at_first_touch() -> None:
    quiet = dataclasses.replace(BASE, sigma_force_N=0.0, sigma_output_V=0.0)
    runs, seats_mm = [], (0.0, 0.04, -0.03)
    for seat_mm, resistance in zip(seats_mm, (0.0, 0.015, -0.01), strict=True):
        t_s, stage_mm = profiles.ramps([DEPTH_mm] * 3, 1.0).sample(50.0)
        unit = dataclasses.replace(quiet, r0_ohm=quiet.r0_ohm * (1.0 + resistance), u0_mm=quiet.u0_mm + seat_mm)
        force_N, output_V = simulate(Twin(unit, (), READOUT), t_s, stage_mm, np.random.default_rng(0))
        runs.append(Run("ramps", t_s, READOUT, stage_mm, force_N, output_V))
    problem = Problem(TWIN, _case(runs), SIGMA)
    error = problem.measured - _prediction(problem)
    largest_residual = {
        c: max(float(np.max(np.abs(error[b.rows]))) for b in problem.blocks if b.channel == c) for c in SIGMA
    }
    # A straight step along the slopes leaves k1·40 µm = 44 mN and 0.1 mV.
    assert largest_residual["force_N"] < 0.003
    assert largest_residual["output_V"] < READOUT.step_V + 5e-5
