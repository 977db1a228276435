"""Episodes, lines, levels and mistakes of recordings: against exhaustive search, closed forms and hand-made faults."""

from dataclasses import replace
from itertools import combinations, product

import numpy as np
import pytest

from softcal.core.gap import mistakes as looks
from softcal.core.gap.case import Case, Run
from softcal.core.gap.episodes import (
    lag_path,
    relocate_episodes,
    step_path,
    with_intervals,
    with_level,
    with_line,
    with_losses,
)
from softcal.core.gap.fit import fit
from softcal.core.gap.hypothesis import BASE, Hypothesis, to_fit
from softcal.core.gap.method import METHOD
from softcal.core.gap.mistakes import UNITS, UNITS_OF_RUN, nearest, outlier_run, suspect_units
from softcal.core.gap.model import Problem
from softcal.core.gap.twin import TWIN
from softcal.core.twin.catalogue import EFFECTS
from softcal.core.twin.effects import SearchTarget
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata

READOUT = ReadoutMetadata(vref_V=3.3, adc_bits=20, r_series_ohm=10.0, sample_rate_Hz=50.0)
PAD = BaseParameters(u0_mm=0.35, k1_N_mm=1.1, k3_N_mm3=0.1, r0_ohm=4.0, kappa_per_N=0.06)
SIGMA = {"force_N": 0.01, "output_V": 0.001}
AT = np.array([to_fit(p, getattr(PAD, p.name)) for p in BASE])
CONFIG = METHOD.mistake


def find_suspects(case):
    return suspect_units(case, CONFIG)


def volt(resistance):
    return 3.3 * resistance / (resistance + 10.0)


def resistance_of(force_N):
    return 4.0 / (1.0 - 0.06 * force_N)


def swing(t_s, speed=1.0):
    return 1.6 * (1.0 - np.cos(2 * np.pi * speed * t_s / 3.1)) * (0.7 + 0.3 * np.sin(t_s / 3.0))


def elastic(stage_mm, pad=PAD):
    depth = np.maximum(0.0, stage_mm - pad.u0_mm)
    return pad.k1_N_mm * depth + pad.k3_N_mm3 * depth**3


def run_of(number=1, count=600, pad=PAD, output=None, added_ohm=0.0, readout=READOUT, **change):
    rng = np.random.default_rng(number)
    t_s = np.arange(count) * 0.02
    stage_mm = swing(t_s, 1.0 + 0.3 * number)
    force_N = elastic(stage_mm, pad)
    clean_V = volt(pad.r0_ohm / (1 - pad.kappa_per_N * force_N) + added_ohm)
    clean_V = clean_V if output is None else output(t_s, clean_V)
    columns = {"stage_mm": stage_mm, "force_N": force_N + rng.normal(0, 0.01, count),
               "output_V": clean_V + rng.normal(0, 0.001, count)}  # fmt: skip
    return Run(str(number), t_s, readout, **(columns | change))


def base_of(*runs):
    return fit(Problem(TWIN, Case("E", runs), SIGMA).bare, Hypothesis(), AT, steps=0)


# The cheapest path, by trying all.


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("advance", [0, 2])
def test_a_path_of_losses_is_the_cheapest_of_all(seed, advance):
    rng = np.random.default_rng(seed)
    n, longest, penalty = 34, 4, 3.0
    signal = np.cumsum(rng.normal(size=n + advance + longest + 5))
    true = np.zeros(n, dtype=int) + (1 if advance else 0)
    true[6:] += 2
    measured = signal[np.minimum(np.arange(n) + true, n + advance - 1)] + rng.normal(0, 0.3, n)
    predicted, noise = signal[: n + advance], np.full(n, 0.3)

    def cost(shifts, losses):
        at = np.arange(n) + shifts
        z = np.where(at < n + advance, (measured - predicted[np.minimum(at, n + advance - 1)]) / noise, 1.0)
        return np.sum(np.minimum(z**2, 25.0)) + penalty * losses

    judged = METHOD.episode.min_following
    best = (np.inf, None)
    for start in range(advance + 1):
        best = min(best, (cost(np.full(n, start), 0), (start,)), key=lambda b: b[0])
        for end in range(start + 1, longest + 1):
            for k in range(1, n):
                if k < n + advance - end - judged:
                    shifts = np.where(np.arange(n) < k, start, end)
                    best = min(best, (cost(shifts, 1), tuple(shifts)), key=lambda b: b[0])
        for middle, end in combinations(range(start + 1, longest + 1), 2):
            for j, k in combinations(range(1, n), 2):
                if j < n + advance - middle - judged and k < n + advance - end - judged:
                    shifts = np.select([np.arange(n) < j, np.arange(n) < k], [start, middle], end)
                    best = min(best, (cost(shifts, 2), tuple(shifts)), key=lambda b: b[0])
    path = lag_path(measured, predicted, noise, advance, longest, penalty, METHOD.episode.min_following)
    assert np.all(np.diff(path) >= 0)
    assert cost(path.astype(int), np.count_nonzero(np.diff(path))) == pytest.approx(best[0])


@pytest.mark.parametrize("seed", range(5))
def test_a_path_of_contacts_is_the_cheapest_of_all(seed):
    rng = np.random.default_rng(seed)
    n, size, penalty = 11, 1.0, 2.5
    sigma = rng.uniform(0.2, 0.6, n)
    error = np.where((np.arange(n) >= 3) & (np.arange(n) < 7), size, 0.0) * (seed % 2) + rng.normal(0, sigma)
    error[0] += 40.0 * (seed == 3)

    def cost(path):
        path = np.array(path)
        z = np.where(path, (error - size) / sigma, error / sigma)
        changes = np.count_nonzero(np.diff(path)) + path[0]
        return np.sum(np.minimum(z**2, 100.0)) + penalty * changes

    best = min(product((0, 1), repeat=n), key=cost)
    np.testing.assert_array_equal(step_path(error, sigma, size, penalty), np.array(best, dtype=bool))


# Placed in the recordings of a pad.


def lose_samples(at, count):
    def output(t_s, clean_V):
        longer = np.append(t_s, t_s[-1] + 0.02 * np.arange(1, 30))
        more_V = volt(resistance_of(elastic(swing(longer, 1.3))))
        return more_V[np.arange(len(t_s)) + count * (np.arange(len(t_s)) >= at)]

    return output


def test_losses_are_placed_where_they_are():
    base = base_of(run_of(1, output=lose_samples(250, 7)), run_of(2))
    refitted = with_losses(base, EFFECTS["dropped_samples"])
    first, second = (refitted.hypothesis.episodes_of(k)["dropped_samples"] for k in (0, 1))
    assert len(second) == 0 and len(first) == 1
    assert first[0] == pytest.approx((250 * 0.02, 7), abs=0.05)
    assert refitted.chi2 < 1.2 * refitted.problem.count < base.chi2
    assert refitted.hypothesis.episode_count == 1
    assert refitted.penalty - base.penalty == pytest.approx(
        (1 + METHOD.evidence.episode_cost) * np.log(refitted.problem.count) - 2 * np.log(METHOD.evidence.prior_odds)
    )
    again = relocate_episodes(refitted)
    assert again.bic <= refitted.bic
    whole = base_of(run_of(1), run_of(2))
    assert with_losses(whole, EFFECTS["dropped_samples"]) is None


def test_a_second_loss_of_causes_costs_less_than_the_first():
    from softcal.core.gap.fit import penalty

    base = base_of(run_of(1, output=lose_samples(250, 7)), run_of(2))
    refitted = with_losses(base, EFFECTS["dropped_samples"])
    twice = replace(refitted.hypothesis, episodes=({"dropped_samples": np.array([[5.0, 4.0], [6.0, 3.0]])}, {}))
    more = replace(refitted, hypothesis=twice)
    each = METHOD.evidence.episode_cost * np.log(refitted.problem.count)
    assert more.penalty - refitted.penalty == pytest.approx(each)
    further = METHOD.evidence.further_episode_cost * np.log(refitted.problem.count)
    assert penalty(more) - penalty(refitted) == pytest.approx(further)


@pytest.mark.parametrize("ohm", [0.8, -0.5, 0.035])
def test_bad_contacts_are_placed_where_they_are(ohm):
    t_s = np.arange(600) * 0.02
    bad = ((t_s >= 3.0) & (t_s < 3.4)) | ((t_s >= 9.0) & (t_s < 9.2))
    base = base_of(run_of(1, added_ohm=ohm * bad), run_of(2))
    refitted = with_intervals(base, EFFECTS["intermittent_contact"])
    first, second = (refitted.hypothesis.episodes_of(k)["intermittent_contact"] for k in (0, 1))
    np.testing.assert_allclose(first, [[3.0, 3.4], [9.0, 9.2]], atol=0.021)
    assert len(second) == 0
    assert refitted.effect_values[0][0] == pytest.approx(ohm, rel=0.06)
    smooth = base_of(run_of(1, added_ohm=0.3 * np.sin(t_s)), run_of(2))
    assert with_intervals(smooth, EFFECTS["intermittent_contact"]) is None
    whole = base_of(run_of(1), run_of(2))
    assert with_intervals(whole, EFFECTS["intermittent_contact"]) is None


def test_a_contact_that_stays_bad_ends_with_the_run():
    t_s = np.arange(600) * 0.02
    base = base_of(run_of(1, added_ohm=0.8 * (t_s >= 11.0)), run_of(2))
    refitted = with_intervals(base, EFFECTS["intermittent_contact"])
    ((start, stop),) = refitted.hypothesis.episodes_of(0)["intermittent_contact"]
    assert start == pytest.approx(11.0, abs=0.021) and stop == pytest.approx(600 * 0.02)


@pytest.mark.parametrize(("rate_Hz", "alias_Hz"), [(83.0, 33.0), (83.0, 23.0)])
def test_a_line_is_found_at_the_alias_of_the_mains(rate_Hz, alias_Hz):
    readout = replace(READOUT, sample_rate_Hz=rate_Hz)
    runs, phases = [], (0.4, -1.2)
    for number, phase in enumerate(phases, start=1):
        run = run_of(number, readout=readout)
        t_s = np.arange(600) / rate_Hz
        force = elastic(swing(t_s, 1.0))
        hum = 0.004 * np.sin(2 * np.pi * (alias_Hz + 0.1) * t_s + phase)
        noise = run.output_V - volt(resistance_of(elastic(run.stage_mm)))
        runs.append(
            replace(
                run, t_s=t_s, stage_mm=swing(t_s, 1.0), force_N=force, output_V=volt(resistance_of(force)) + hum + noise
            )
        )
    base = base_of(*runs)
    refitted = with_line(base, EFFECTS["mains_hum"])
    amplitude, frequency_Hz, *phi = refitted.effect_values[0]
    assert amplitude == pytest.approx(0.004, rel=0.05)
    assert frequency_Hz == pytest.approx(alias_Hz + 0.1, abs=0.01)
    np.testing.assert_allclose(np.cos(np.array(phi) - phases), 1.0, atol=0.01)
    assert refitted.chi2 < 1.2 * refitted.problem.count
    quiet = base_of(*(run_of(k, readout=readout) for k in (1, 2)))
    assert with_line(quiet, EFFECTS["mains_hum"]) is None


def test_no_line_shows_where_mains_stand_still():
    base = base_of(run_of(1, readout=replace(READOUT, sample_rate_Hz=100.0)))
    # 50 Hz lies at half of 100 Hz; 60 Hz at 40 Hz.
    assert with_line(base, EFFECTS["mains_hum"]) is None
    still = base_of(run_of(1, readout=replace(READOUT, sample_rate_Hz=10.0)))
    assert with_line(still, EFFECTS["mains_hum"]) is None


@pytest.mark.parametrize(("side", "level_V"), [(SearchTarget.CEILING, 1.1), (SearchTarget.FLOOR, 1.0)])
def test_a_level_is_found_where_the_output_is_clipped(side, level_V):
    clip = np.minimum if side == SearchTarget.CEILING else np.maximum
    effect = next(
        e for e in (EFFECTS["adc_saturation"], *EFFECTS["adc_saturation"].sides) if e.signs.search_target == side
    )
    base = base_of(*(run_of(k, output=lambda t_s, v: clip(v, level_V)) for k in (1, 2)))
    refitted = with_level(base, effect)
    assert refitted.effect_values[0][0] == pytest.approx(level_V, abs=2e-3)
    np.testing.assert_allclose(refitted.coordinates[:5], AT, atol=0.02)
    assert refitted.chi2 < 1.2 * refitted.problem.count
    whole = base_of(run_of(1), run_of(2))
    assert with_level(whole, effect) is None


# Mistakes that columns show.


def sound(count=4):
    return [run_of(k + 1, 500 + 40 * k) for k in range(count)]


def found_in(runs, **more):
    return [(m.what, m.channel, m.runs) for m in TWIN.mistakes(Case("M", tuple(runs), **more))]


def changed(at, **columns):
    runs = sound()
    for k in at:
        runs[k] = replace(runs[k], **{name: change(runs[k]) for name, change in columns.items()})
    return runs


EVERY = range(4)


def test_sound_recordings_have_no_mistake():
    assert found_in(sound()) == []
    assert find_suspects(Case("M", tuple(sound()))) == ()


@pytest.mark.parametrize(
    ("at", "change", "expected", "factor"),
    [
        (EVERY, {"t_s": lambda r: r.t_s * 1e3}, ("unit_factor", "time", ()), 1e-3),
        ((1,), {"t_s": lambda r: r.t_s / 60}, ("unit_factor", "time", (2,)), 60.0),
        ((2,), {"t_s": lambda r: r.t_s * 1.3}, ("rate", "time", (3,)), 1 / 1.3),
        (EVERY, {"output_V": lambda r: r.output_V * 1e3}, ("unit_factor", "output", ()), 1e-3),
        (
            EVERY,
            {"output_V": lambda r: np.round(r.output_V / r.readout.step_V)},
            ("unit_factor", "output", ()),
            READOUT.step_V,
        ),
        (EVERY, {"output_V": lambda r: -r.output_V}, ("sign", "output", ()), -1.0),
        (EVERY, {"force_N": lambda r: -r.force_N}, ("sign", "force", ()), -1.0),
        (EVERY, {"stage_mm": lambda r: -r.stage_mm}, ("sign", "stage", ()), -1.0),
        ((0,), {"force_N": lambda r: -r.force_N}, ("sign", "force", (1,)), -1.0),
        (EVERY, {"output_V": lambda r: 3.3 - r.output_V}, ("swapped_divider", "output", ()), None),
        ((3,), {"force_N": lambda r: r.force_N / 9.80665}, ("unit_factor", "force", (4,)), 9.80665),
        ((3,), {"force_N": lambda r: r.force_N * 3.0}, ("gain", "force", (4,)), 1 / 3.0),
        ((1,), {"stage_mm": lambda r: r.stage_mm / 25.4}, ("unit_factor", "stage", (2,)), 25.4),
    ],
)
def test_a_mistake_is_named_with_its_repair(at, change, expected, factor):
    (one,) = TWIN.mistakes(Case("M", tuple(changed(at, **change))))
    assert (one.what, one.channel, one.runs) == expected
    if factor is None:
        assert one.factor is None
    else:
        assert one.factor == pytest.approx(factor, rel=0.04)


def test_single_samples_far_off_are_counted():
    def stray(name, size):
        return lambda r: getattr(r, name) + size * (np.isin(np.arange(len(r)), (100, 200, 333)))

    (one,) = TWIN.mistakes(Case("M", tuple(changed((1,), force_N=stray("force_N", 900.0)))))
    assert (one.what, one.channel, one.runs) == ("out_of_range", "force", (2,))
    assert one.evidence.values["count"] == 3 and one.evidence.values["worst"] > 899.0
    low, high = np.quantile(changed((1,), force_N=stray("force_N", 900.0))[1].force_N, (0.01, 0.99))
    assert (one.evidence.values["low"], one.evidence.values["high"]) == pytest.approx((low, high))
    far_off = CONFIG.far * (high - low)
    for size, is_found in ((high + 1.02 * far_off + 1.0, True), (0.7 * far_off, False)):
        assert bool(found_in(changed((1,), force_N=stray("force_N", size)))) is is_found
    (one,) = TWIN.mistakes(Case("M", tuple(changed((1,), output_V=stray("output_V", 9.0)))))
    assert (one.what, one.channel, one.evidence.values["count"]) == ("out_of_range", "output", 3)
    assert one.evidence.values["worst"] > 9.0
    below = lambda r: np.where(np.arange(len(r)) == 100, -0.1, r.output_V)  # noqa: E731
    assert found_in(changed((1,), output_V=below)) == [("out_of_range", "output", (2,))]


def coarse(runs):
    readout = replace(READOUT, adc_bits=10)
    return [replace(r, readout=readout, output_V=np.round(r.output_V / readout.step_V) * readout.step_V) for r in runs]


@pytest.mark.parametrize("other", ["force_N", "stage_mm"])
def test_a_column_on_the_steps_of_the_adc_is_the_output(other):
    runs = [replace(r, **{other: r.output_V, "output_V": getattr(r, other) / 3.0}) for r in coarse(sound())]
    pair = "stage+output" if other == "stage_mm" else "force+output"
    assert found_in(runs) == [("swapped_columns", pair, ())]
    assert found_in(coarse(sound())) == []


def test_a_smooth_column_is_the_commanded_one():
    rng, runs = np.random.default_rng(1), []
    for k in range(3):
        t_s = np.arange(500) * 0.02
        stage_mm = np.interp(t_s % (3.0 + k), [0.0, 1.5, 3.0], [0.0, 3.0, 0.0])
        force_N = elastic(stage_mm) + rng.normal(0, 0.02, 500)
        runs.append(Run(str(k + 1), t_s, READOUT, stage_mm, force_N, volt(resistance_of(elastic(stage_mm)))))
    runs = coarse(runs)
    assert found_in(runs) == []
    swapped = [replace(r, stage_mm=r.force_N, force_N=r.stage_mm) for r in runs]
    assert found_in(swapped) == [("swapped_columns", "stage+force", ())]


def test_a_column_of_another_run_is_reported():
    runs = [run_of(k + 1, 600) for k in range(3)]
    exchanged = [runs[0], replace(runs[1], output_V=runs[2].output_V), replace(runs[2], output_V=runs[1].output_V)]
    assert found_in(exchanged) == [("swapped_runs", "output", (2, 3))]
    assert found_in(runs) == []


def test_two_channels_tell_an_exchange_too():
    runs = [replace(run_of(k + 1, 600), stage_mm=None) for k in range(3)]
    exchanged = [replace(runs[0], output_V=runs[2].output_V), runs[1], replace(runs[2], output_V=runs[0].output_V)]
    assert found_in(exchanged) == [("swapped_runs", "output", (1, 3))]
    # Runs of unlike length hold no column of one another.
    longer = [runs[0], runs[1], replace(run_of(3, 640), stage_mm=None)]
    assert found_in(longer) == []


def test_two_runs_do_not_tell_which_is_wrong():
    runs = sound(2)
    assert found_in([runs[0], replace(runs[1], force_N=3.0 * runs[1].force_N)]) == []


@pytest.mark.parametrize("factor", [1.6, 1 / 1.6])
def test_a_small_factor_is_an_effect(factor):
    assert found_in(changed((1,), force_N=lambda r: r.force_N * factor)) == []
    beyond = factor ** (np.log(CONFIG.apart * 1.25) / np.log(1.6))
    assert found_in(changed((1,), force_N=lambda r: r.force_N * beyond))[0][0] == "gain"


def test_an_unusual_pad_is_asked_about():
    (one,) = find_suspects(Case("M", tuple(replace(r, force_N=r.force_N * 1e3) for r in sound())))
    assert (one.what, one.channel, one.factor) == ("unit_factor", "force", 1e-3)
    (one,) = find_suspects(Case("M", tuple(replace(r, stage_mm=r.stage_mm * 1e3) for r in sound())))
    assert (one.channel, one.factor) == ("stage", 1e-3)
    assert (
        find_suspects(Case("M", tuple(replace(r, force_N=r.force_N * 1e3) for r in sound()), stiffness_N_mm=(1.0, 2.0)))
        == ()
    )
    assert find_suspects(Case("M", tuple(replace(r, force_N=r.force_N * 4.0) for r in sound()))) == ()


def test_units_are_those_of_the_world():
    assert UNITS["stage"] == {"inch": 25.4, "cm": 10.0, "m": 1e3, "um": 1e-3}
    assert UNITS["force"]["kgf"] == 9.80665 and UNITS["force"]["gf"] == pytest.approx(9.80665e-3)
    of_run = UNITS_OF_RUN["stage"]
    assert of_run["degree as rad"] == pytest.approx(np.deg2rad(1.0)) and of_run["rad as degree"] == pytest.approx(
        np.rad2deg(1.0)
    )
    assert of_run["2.54 mm"] == 2.54
    assert UNITS_OF_RUN["force"]["lbf"] == pytest.approx(0.45359237 * 9.80665, rel=1e-5)
    assert (UNITS_OF_RUN["force"]["kN"], UNITS_OF_RUN["output"]["mV"], UNITS["force"]["mN"]) == (1e3, 1e-3, 1e-3)
    assert looks.TIME_UNITS == {"ms": 1e-3, "us": 1e-6, "min": 60.0}


# One run that stands apart.


def fit_with_outlier(**change):
    runs = [run_of(k + 1, 500) for k in range(4)]
    runs[2] = replace(runs[2], **{name: f(runs[2]) for name, f in change.items()})
    return fit(Problem(TWIN, Case("O", tuple(runs)), SIGMA), Hypothesis(), AT)


@pytest.mark.parametrize(
    ("change", "what", "channel", "factor"),
    [
        ({"force_N": lambda r: 1.3 * r.force_N}, "gain", "force", 1 / 1.3),
        ({"force_N": lambda r: r.force_N + 0.8}, "zero", "force", 0.8),
        ({"output_V": lambda r: 0.9 * r.output_V}, "gain", "output", 1 / 0.9),
        ({"output_V": lambda r: r.output_V - 0.05}, "zero", "output", -0.05),
        ({"stage_mm": lambda r: r.stage_mm + 0.4}, "zero", "stage", 0.4),
    ],
)
def test_one_run_with_a_gain_or_a_zero_of_its_own_is_a_mistake(change, what, channel, factor):
    mistake = outlier_run(fit_with_outlier(**change))
    assert (mistake.what, mistake.channel, mistake.runs) == (what, channel, (3,))
    assert mistake.factor == pytest.approx(factor, rel=0.05)
    assert mistake.evidence.values["share"] == pytest.approx(1.0, abs=0.05)


def test_a_run_of_another_unit_is_reported():
    other = replace(PAD, k1_N_mm=1.6, k3_N_mm3=0.16, r0_ohm=4.6, kappa_per_N=0.05)
    other_run = run_of(3, 500, pad=other)
    mistake = outlier_run(fit_with_outlier(force_N=lambda r: other_run.force_N, output_V=lambda r: other_run.output_V))
    assert (mistake.what, mistake.runs) == ("other_unit", (3,))
    values = mistake.evidence.values
    assert values["stiffness"] == pytest.approx(0.5, abs=0.1)
    assert values["resistance"] == pytest.approx(0.15, abs=0.03)


def test_without_a_run_that_stands_apart_there_is_no_mistake():
    runs = [run_of(k + 1, 500) for k in range(4)]
    clean = fit(Problem(TWIN, Case("O", tuple(runs)), SIGMA), Hypothesis(), AT)
    assert outlier_run(clean) is None and nearest(clean, METHOD.outlier.min_predicted_share) == []
    two = fit(
        Problem(TWIN, Case("O", (runs[0], replace(runs[1], force_N=1.3 * runs[1].force_N))), SIGMA), Hypothesis(), AT
    )
    assert outlier_run(two) is None
    # The same in all runs belongs to the base or to a cause.
    creep = fit(
        Problem(TWIN, Case("O", tuple(replace(r, force_N=r.force_N * (1 + 0.02 * r.t_s)) for r in runs)), SIGMA),
        Hypothesis(),
        AT,
    )
    assert outlier_run(creep) is None
