"""The choice among families: by evidence of the outputs alone, explained, and better with a few known loads."""

import gc
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.stats import rankdata

from softcal.core.errors import UnitRefused
from softcal.core.maps.anchors import AnchoredMap
from softcal.core.maps.catalogue import map_from_arrays
from softcal.core.maps.choose import choose_map
from softcal.core.maps.config import MapConfig
from softcal.core.maps.dwell import paced_time
from softcal.core.maps.interface import Anchors, FitProblem
from softcal.core.maps.monotone import fit_averaged, fit_monotone, weigh_line
from softcal.core.maps.synchrony import find_synchrony
from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.network.training import TrainedNetwork, fit_network
from softcal.core.recording import LabelledRecording, OutputRecording
from tests.presses import presses

GAIN, OFFSET = 1.3, 0.04
NOISE_V = 0.0005


def recording(
    serial: str, force_N: np.ndarray, gain: float = 1.0, offset: float = 0.0, seed: int = 0, stage: bool = False
):  # type: ignore[no-untyped-def]
    noise = np.random.default_rng(seed).normal(0, NOISE_V, len(force_N))
    output = (0.5 + 0.1 * force_N + 0.02 * force_N**2 - offset) / gain + noise
    return OutputRecording(
        serial, np.arange(len(output)) / 50.0, output, 50.0, stage_mm=force_N.copy() if stage else None
    )


@pytest.fixture(scope="module")
def source() -> LabelledRecording:
    force_N = presses(1, 3000)
    return LabelledRecording(recording("S", force_N, stage=True), force_N)


@pytest.fixture(scope="module")
def trained(source: LabelledRecording) -> TrainedNetwork:
    return fit_network(source, NetworkConfig(hidden=(32, 16), max_epochs=25))


def unit(source: LabelledRecording, trained: TrainedNetwork, force_N: np.ndarray, **settings) -> FitProblem:  # type: ignore[no-untyped-def]
    settings = {"gain": GAIN, "offset": OFFSET, "seed": 9} | settings
    return FitProblem(source, trained.network, recording("T", force_N, **settings))


@pytest.fixture(scope="module")
def make(source, trained):
    """`make(force_N, **settings)`: the problem of a unit under these loads."""
    return lambda force_N, **settings: unit(source, trained, force_N, **settings)


def after(problem: FitProblem, chosen, seed: int = 33) -> tuple[float, float]:  # type: ignore[no-untyped-def]
    load_N = presses(seed, 800)
    test = LabelledRecording(recording("T", load_N, GAIN, OFFSET, 5), load_N)
    mapped = problem.network.evaluate(chosen.unit_map.apply(test.windows))
    raw = problem.network.evaluate(test.windows)
    return rmse(mapped, test.window_reference), rmse(raw, test.window_reference)


def test_one_load_at_once_is_found_and_paired(make, source, trained):
    problem = make(source.reference)
    chosen = choose_map(problem)
    mapped, raw = after(problem, chosen)
    assert chosen.family == "synchronous"
    assert mapped < 1.5 * trained.validation_rmse < raw / 3


def test_late_clock_is_found_and_undone(make, source):
    late = make(np.concatenate([np.zeros(12), source.reference[:-12]])).target
    assert find_synchrony(source.unlabelled, late, MapConfig()).lag_s == pytest.approx(0.24, abs=0.011)


def test_opening_that_both_recordings_share_is_paired_and_the_rest_is_not(make, source, trained):
    parts_at = 1500
    other_presses = presses(50, 1500)
    problem = make(np.concatenate([source.reference[:parts_at], other_presses]))
    chosen = choose_map(problem)
    mapped, raw = after(problem, chosen)
    assert chosen.family == "synchronous"
    assert 20.0 < float(chosen.evidence["shared_until_s"]) < parts_at / 50.0
    assert mapped < 1.5 * trained.validation_rmse < raw / 3


def test_a_long_opening_does_not_make_the_whole_one_load(make, source):
    parts_at = 2400
    rest = 0.5 * source.reference[parts_at:3000] + 0.5 * presses(50, 3000 - parts_at)
    load_N = np.concatenate([source.reference[:parts_at], rest])
    ranks = (rankdata(load) for load in (load_N, source.reference[:3000]))
    assert np.corrcoef(*ranks)[0, 1] > 0.95
    synchrony = find_synchrony(source.unlabelled, make(load_N).target, MapConfig())
    assert synchrony.is_synchronous and synchrony.until_s < parts_at / 50.0


def test_units_that_were_compared_leave_little_in_memory(source):
    def compare(seeds):
        for seed in seeds:
            find_synchrony(
                source.unlabelled, recording("T", presses(seed, 900 + seed), GAIN, OFFSET, seed), MapConfig()
            )
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    before = compare(range(12))
    each = (compare(range(12, 24)) - before) / 12
    tracemalloc.stop()
    assert each < 5_000


def test_one_slow_rise_alike_is_no_opening():
    rise = np.linspace(0.0, 3.0, 1500)
    source = LabelledRecording(
        recording("S", np.concatenate([rise, presses(3, 1500)])),
        np.concatenate([rise, presses(3, 1500)]),
    )
    target = recording("T", np.concatenate([rise, presses(4, 1500)]), GAIN, OFFSET, 9)
    assert not find_synchrony(source.unlabelled, target, MapConfig()).is_synchronous


def test_stage_position_pairs_another_programme(make):
    problem = make(0.6 * presses(8, 2000), stage=True)
    chosen = choose_map(problem)
    assert chosen.family == "stage_matched"
    assert after(problem, chosen)[0] < 0.5 * after(problem, choose_map(make(0.6 * presses(8, 2000))))[0]


def test_other_dwell_is_seen_and_believed_in_part(make):
    problem = make(presses(4, 5000, dwell=80.0))
    chosen = choose_map(problem)
    mapped, raw = after(problem, chosen)
    assert chosen.family == "averaged"
    quantiles_alone = after(problem, choose_map(replace(problem, config=MapConfig("monotone"))))[0]
    assert mapped < 0.6 * quantiles_alone and mapped < raw / 2
    assert float(chosen.evidence["dwell_distance"]) > 0.2


@pytest.mark.parametrize("dwell", [0.0, 15.0])
def test_a_bent_unit_is_read_better_by_the_mean_than_by_rest_and_peak(source, trained, dwell):
    def bent(load_N: np.ndarray, seed: int) -> OutputRecording:
        level = load_N / 3.0
        output_V = 0.5 + 0.4 * level * (1.6 - 0.6 * level)
        noise_V = np.random.default_rng(seed).normal(0, NOISE_V, len(load_N))
        return OutputRecording("T", np.arange(len(load_N)) / 50.0, output_V + noise_V, 50.0)

    problem = FitProblem(source, trained.network, bent(presses(4, 5000, dwell), 9))
    test = LabelledRecording(bent(presses(33, 800), 5), presses(33, 800))

    def error(family: str) -> float:
        chosen = choose_map(replace(problem, config=MapConfig(family)))
        return rmse(problem.network.evaluate(chosen.unit_map.apply(test.windows)), test.window_reference)

    assert error("averaged") < 0.8 * error("two_point")


@pytest.mark.parametrize(("gain_error", "share"), [(0.0, 0.5), (0.5, 0.0)])
def test_a_line_counts_by_how_well_its_gain_is_known(make, gain_error, share):
    problem = make(presses(4, 5000, dwell=80.0))
    knots = fit_monotone(problem).knots
    problem.__dict__["ends"] = match = replace(problem.ends, gain_error=1e9)
    curves = fit_averaged(problem).values
    problem.__dict__["ends"] = match = replace(match, gain_error=gain_error)
    line = match.offset + match.gain * knots
    assert fit_averaged(problem).values == pytest.approx((1 - share) * curves + share * line)


def slow_rise_and_fall(wait: int) -> np.ndarray:
    """A load that rises and falls once, and waits at a third of its range on the way up."""
    return np.concatenate(
        [np.linspace(0, 1, 700), np.full(wait, 1.0), np.linspace(1, 3, 1400), np.linspace(3, 0, 2100)]
    )


@pytest.mark.parametrize(("gain", "curvature"), [(1.3, 0.02), (1.0, 0.005)])
def test_where_a_programme_waits_is_not_taken_for_a_curvature(trained, gain, curvature):
    load_N = slow_rise_and_fall(0)
    source = LabelledRecording(recording("S", load_N), load_N)
    maps = {}
    for wait in (0, 2100):
        load_N = slow_rise_and_fall(wait)
        output_V = (0.5 + 0.1 * load_N + curvature * load_N**2) / gain
        target = OutputRecording("T", np.arange(len(load_N)) / 50.0, output_V, 50.0)
        problem = FitProblem(source, trained.network, target)
        shown = slow_rise_and_fall(0)
        shown_V = (0.5 + 0.1 * shown + curvature * shown**2) / gain
        maps[wait] = [fit(problem)(shown_V) for fit in (fit_monotone, fit_averaged)]
    (all_time, averaged), (all_time_waited, averaged_waited) = maps[0], maps[2100]
    # A third of the mean goes by all time, and half of it by the line.
    assert rmse(averaged_waited, averaged) < 0.35 * rmse(all_time_waited, all_time)


def test_time_beyond_the_usual_pace_of_a_passage_counts_as_none():
    weights, plain = (paced_time(recording("T", slow_rise_and_fall(wait)), MapConfig()) for wait in (2100, 0))
    assert weights.sum() == pytest.approx(plain.sum(), rel=0.02)
    assert weights[900:2600].mean() < 0.2 and weights[-2100:].mean() > 0.8


def test_a_unit_that_is_bent_keeps_its_paces():
    load_N = slow_rise_and_fall(0)
    output_V = 0.5 + 0.1 * load_N**2
    weights = paced_time(OutputRecording("T", np.arange(len(load_N)) / 50.0, output_V, 50.0), MapConfig())
    shares = [weights[(output_V >= low) & (output_V < low + 0.1)].sum() for low in (0.7, 0.9, 1.1, 1.2)]
    assert shares == sorted(shares, reverse=True) and shares[0] > 1.3 * shares[-1]


@pytest.mark.parametrize("rho", [0.0, 0.5])
def test_the_shares_of_line_and_curve_leave_the_least_error(rho):
    for line, curve in ((0.04, 0.04), (0.05, 0.04), (0.07, 0.04), (0.1, 0.04), (0.03, 0.09)):
        shares = np.linspace(0.0, 1.0, 1001)
        variance = (shares * line) ** 2 + ((1 - shares) * curve) ** 2 + 2 * rho * shares * (1 - shares) * line * curve
        share, error = weigh_line(line, curve, rho)
        assert share == pytest.approx(shares[np.argmin(variance)], abs=1e-3)
        assert error == pytest.approx(np.sqrt(variance.min()), rel=1e-3)


def test_unit_like_the_source_is_left_alone(make):
    problem = make(presses(4, 3000), gain=1.0, offset=0.0)
    assert choose_map(problem).family == "identity"


def test_a_gain_that_is_known_no_better_than_a_map_errs_shows_no_likeness(make):
    problem = make(presses(4, 3000), gain=1.0, offset=0.0)
    problem.__dict__["ends"] = replace(problem.ends, gain=1.1, gain_error=0.055)
    assert choose_map(problem).family == "averaged"


def test_noise_instead_of_presses_is_refused(make):
    hiss = np.random.default_rng(2).uniform(0, 3, 2000)
    with pytest.raises(UnitRefused):
        choose_map(make(hiss))


def test_far_quicker_swings_make_the_choice_abstain(make):
    shaken = 1.5 + 1.5 * np.sin(np.arange(2000) * 2 * np.pi / 8)
    chosen = choose_map(make(shaken))
    assert chosen.family == "two_point" and "abstain" in str(chosen.evidence["decision"])


@pytest.mark.parametrize("share", [0.25, 0.1, 0.05])
def test_short_recording_never_makes_the_unit_much_worse_than_it_was(make, share):
    whole = make(presses(4, 3000))
    part = replace(whole, target=whole.target.part(0, round(share * 3000)))
    mapped, raw = after(part, choose_map(part))
    assert mapped < 1.2 * raw


def test_scattered_windows_of_the_same_programme_are_enough(make, source):
    whole = make(source.reference)
    starts = 15 * np.sort(np.random.default_rng(0).choice(200, 20, replace=False))
    rows = (starts[:, None] + np.arange(15)).ravel()
    target = replace(whole.target, t_s=whole.target.t_s[rows], output=whole.target.output[rows])
    chosen = choose_map(replace(whole, target=target))
    mapped, raw = after(whole, chosen)
    assert chosen.family == "synchronous" and mapped < 0.2 * raw


def test_still_unit_is_refused(make):
    problem = make(np.zeros(600))
    still = replace(problem, target=replace(problem.target, output=np.full(600, 0.5)))
    with pytest.raises(UnitRefused):
        choose_map(still)


def test_equal_input_gives_equal_maps_and_later_labels_change_nothing(make):
    problem = make(presses(4, 2000))
    first, again = choose_map(problem).unit_map.arrays(), choose_map(problem).unit_map.arrays()
    assert all(np.array_equal(first[name], again[name]) for name in first)


def test_configured_family_is_obeyed(make):
    chosen = choose_map(replace(make(presses(4, 2000)), config=MapConfig("monotone")))
    assert chosen.family == "monotone" and "as configured" in str(chosen.evidence["decision"])


def test_more_anchors_never_hurt_much_and_three_repair_half_a_range(make):
    problem = make(0.5 * presses(8, 2500))
    errors = []
    for loads in ([], [0.0], [0.0, 2.5], [0.0, 1.25, 2.5]):
        output = (0.5 + 0.1 * np.array(loads) + 0.02 * np.array(loads) ** 2 - OFFSET) / GAIN
        anchors = Anchors(output, np.array(loads)) if loads else None
        errors.append(after(problem, choose_map(replace(problem, anchors=anchors)))[0])
    assert errors[3] < 0.4 * errors[0]
    assert errors[2] < 0.5 * errors[0]
    assert errors[1] < 1.1 * errors[0]


def test_what_f_itself_misreads_is_not_taken_out_of_the_map(make, source, trained):
    """f reads everything 0.3 N too high; the unit is the source itself. There is nothing to correct."""
    wrong = replace(trained.network, reference_mean=trained.network.reference_mean + 0.3)
    problem = replace(make(presses(4, 3000), gain=1.0, offset=0.0), network=wrong)
    loads = np.array([0.1, 2.5])
    chosen = choose_map(replace(problem, anchors=Anchors(0.5 + 0.1 * loads + 0.02 * loads**2, loads)))
    assert float(chosen.evidence["anchor_gain"]) == pytest.approx(1.0, abs=0.02)
    assert float(chosen.evidence["anchor_offset"]) == pytest.approx(0.0, abs=0.01)


def test_known_loads_do_not_harm_a_unit_that_is_paired_well(make, source):
    problem = make(source.reference)
    loads = np.array([0.0, 2.5])
    anchors = Anchors((0.5 + 0.1 * loads + 0.02 * loads**2 - OFFSET) / GAIN, loads)
    without, with_loads = (after(problem, choose_map(replace(problem, anchors=a)))[0] for a in (None, anchors))
    assert with_loads < 1.02 * without


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_known_loads_show_a_paired_unit_that_was_pressed_with_another_load(make, source, factor):
    problem = make(factor * source.reference)
    loads = np.array([0.0, 2.5])
    anchors = Anchors((0.5 + 0.1 * loads + 0.02 * loads**2 - OFFSET) / GAIN, loads)
    without, with_loads = (choose_map(replace(problem, anchors=a)) for a in (None, anchors))
    assert with_loads.family == without.family == "synchronous"
    assert after(problem, with_loads)[0] < 0.3 * after(problem, without)[0]


@pytest.mark.parametrize(
    ("family", "load_factor", "within_N"),
    [
        ("identity", 0.925, 0.06),
        ("two_point", 0.85, 0.06),
        ("monotone", 0.85, 0.06),
        ("averaged", 0.85, 0.06),
        # Shapes fitted to noise leave windows at rest not flat, and this network reads one sample of them.
        ("synchronous", 0.7, 0.13),
        ("stage_matched", 0.7, 0.13),
    ],
)
def test_a_known_load_is_read_to_within_its_uncertainty(linear_network, family, load_factor, within_N):
    """The source is noisy by 0.1 N a sample. A press passes a load in three, so what it puts out is known to 0.06 N."""
    noise_V = np.random.default_rng(3).normal(0.0, 0.01, (2, 6000))
    load_N = presses(1, 6000)
    unit_load_N = load_N if family == "synchronous" else presses(8, 6000)
    t_s = np.arange(6000) / 50.0
    source_V, unit_V = 0.5 + 0.1 * load_N + noise_V[0], 0.5 + 0.1 * load_factor * unit_load_N + noise_V[1]
    source = LabelledRecording(OutputRecording("S", t_s, source_V, 50.0, stage_mm=load_N), load_N)
    target = OutputRecording("T", t_s, unit_V, 50.0, stage_mm=unit_load_N)
    # The others take its softer presses for the source's; its output stands as low where none is taken for another.
    anchor_V = np.array([0.5 + 0.1 * 2.5 * (load_factor if family == "identity" else 1.0)])
    problem = FitProblem(source, linear_network, target, config=MapConfig(family))
    anchored = replace(problem, anchors=Anchors(anchor_V, np.array([2.5])))
    before, after = (
        float(linear_network.evaluate(choose_map(one).unit_map.apply(np.full((1, 15), anchor_V)))[0]) - 2.5
        for one in (problem, anchored)
    )
    assert abs(before) > 2.5 * within_N
    assert abs(after) < within_N


@pytest.mark.parametrize("family", ["identity", "affine", "two_point", "monotone", "averaged", "exact"])
@pytest.mark.parametrize("moved_V", [-0.15, 0.15])
def test_a_load_at_zero_moves_the_level_alone(linear_network, press, family, moved_V):
    """The rest of the unit has moved by half the range since its recording: no gain follows from that."""
    source, unit = press(1, seconds=40.0), press(2, gain=1.1, seconds=30.0)
    problem = FitProblem(source, linear_network, unit.unlabelled, config=MapConfig(family))
    given = replace(problem, anchors=Anchors(np.array([0.5 + moved_V]), np.array([0.0])))
    moved = replace(unit.unlabelled, output=unit.unlabelled.output + moved_V).windows
    fits = [choose_map(one) for one in (problem, given)]
    before, after = (rmse(linear_network.evaluate(one.unit_map.apply(moved)), unit.window_reference) for one in fits)
    assert float(fits[1].evidence["anchor_gain"]) == pytest.approx(1.0, abs=0.01)
    assert after < 0.7 * before


@pytest.mark.parametrize("load_N", [0.0, 1.0, 2.5])
@pytest.mark.parametrize("level", [1.0, 3.0])
def test_one_known_load_harms_no_unit_beyond_its_own_uncertainty(linear_network, press, load_N, level):
    """Units that differ as far as a map may be off, and three times as far at rest; uncertainties at k = 2."""
    rng, source, loads = np.random.default_rng(0), press(1), press(2).reference
    before, after = [], []
    for _ in range(40):
        gain, rest_V = float(np.exp(0.3 * rng.normal())), 0.5 + 0.03 * level * rng.normal()
        unit = LabelledRecording(
            OutputRecording("T", np.arange(len(loads)) / 50.0, rest_V + 0.1 * gain * loads, 50.0), loads
        )
        anchors = Anchors(np.array([rest_V + 0.1 * gain * load_N]), np.array([load_N]))
        chosen = choose_map(FitProblem(source, linear_network, unit.unlabelled, anchors, MapConfig("identity")))
        raw, mapped = (
            rmse(linear_network.evaluate(windows), unit.window_reference)
            for windows in (unit.windows, chosen.unit_map.apply(unit.windows))
        )
        by_gain = float(chosen.evidence["gain_error"]) * np.sqrt(np.mean(loads**2))
        assert mapped < raw + 2.0 * np.hypot(by_gain, float(chosen.evidence["rest_error"]) / 0.1)
        before.append(raw)
        after.append(mapped)
    assert np.sqrt(np.mean(np.square(after))) < 0.85 * np.sqrt(np.mean(np.square(before)))


def test_two_loads_say_how_well_they_fix_gain_and_zero(make):
    """The gain that two loads give is off by no more than three of the standard uncertainties said with it."""
    rng, misses = np.random.default_rng(7), []
    problem = make(presses(4, 3000))
    loads = np.array([0.0, 2.5])
    for _ in range(20):
        stated_N = loads + rng.normal(0, 0.01, 2)
        anchors = Anchors((0.5 + 0.1 * loads + 0.02 * loads**2 - OFFSET) / GAIN, stated_N)
        chosen = choose_map(replace(problem, anchors=anchors, config=MapConfig("two_point")))
        gain = float(chosen.evidence["anchor_gain"]) * float(chosen.unit_map.arrays()["gain"])
        misses.append((gain / GAIN - 1) / float(chosen.evidence["gain_error"]))
    assert 0.05 < np.sqrt(np.mean(np.square(misses))) < 3.0


def test_measured_sensors_are_read_no_worse_with_two_known_loads(measured_data: Path) -> None:
    """Its network is flat at rest: no gain or offset of any size makes it read the zero."""

    def sensor(name: str) -> LabelledRecording:
        table = pd.read_csv(measured_data / "egain_pair" / f"{name}.csv")
        t_s, output_V = np.arange(len(table)) / 50.0, table["output_V"].to_numpy()
        return LabelledRecording(OutputRecording(name, t_s, output_V, 50.0), table["force_N"].to_numpy())

    source, target = sensor("S1").part(0, 800), sensor("S2")
    network = fit_network(source, NetworkConfig(hidden=(32, 16), max_epochs=25)).network
    problem = FitProblem(source, network, target.part(0, 800).unlabelled)
    at = [int(np.argmin(np.abs(target.reference[:800] - load_N))) for load_N in (0.0, 3.0)]
    anchors = Anchors(target.unlabelled.output[at], target.reference[at])
    test = target.part(800, 1200)
    without, with_loads = (
        rmse(
            network.evaluate(choose_map(replace(problem, anchors=a)).unit_map.apply(test.windows)),
            test.window_reference,
        )
        for a in (None, anchors)
    )
    assert with_loads < 1.02 * without


def test_anchored_map_survives_its_arrays(make):
    problem = make(presses(4, 2000))
    chosen = choose_map(replace(problem, anchors=Anchors(np.array([0.4]), np.array([0.1]))))
    again = map_from_arrays(chosen.family, chosen.unit_map.arrays(), chosen.unit_map.settings())
    assert isinstance(chosen.unit_map, AnchoredMap)
    assert np.array_equal(chosen.unit_map.apply(problem.target.windows), again.apply(problem.target.windows))


def test_measured_taxels_under_one_pressure_are_found_synchronous_and_other_days_are_not(measured_data: Path) -> None:
    day, other = (
        pd.read_parquet(measured_data / "insole_lot" / f"{name}.parquet") for name in ("calibration", "validation_1")
    )

    def taxel(frame: pd.DataFrame, name: str) -> OutputRecording:
        return OutputRecording(name, frame["t_s"].to_numpy(), frame[name].to_numpy(np.float64), 48.9)

    source = taxel(day, "taxel_001")
    for name in ("taxel_030", "taxel_060"):
        assert find_synchrony(source, taxel(day, name), MapConfig()).is_synchronous
        assert not find_synchrony(source, taxel(other, name), MapConfig()).is_synchronous


def bent(serial: str, force_N: np.ndarray, curvature: float, gain: float = 1.0, offset: float = 0.0) -> OutputRecording:
    """A sensor whose output rises by 0.1 V/N and bends by so many V/N^2."""
    noise = np.random.default_rng(len(serial)).normal(0, NOISE_V, len(force_N))
    output = (0.5 + 0.1 * force_N + curvature * force_N**2 - offset) / gain + noise
    return OutputRecording(serial, np.arange(len(output)) / 50.0, output, 50.0)


@pytest.mark.parametrize(("curvature", "family"), [(0.002, "two_point"), (0.06, "averaged")])
def test_two_known_loads_leave_a_linear_source_its_affine_map(curvature: float, family: str) -> None:
    load_N, unit_load_N = presses(1, 3000), presses(7, 3000, dwell=60.0)
    source = LabelledRecording(bent("S", load_N, curvature), load_N)
    network = fit_network(source, NetworkConfig(hidden=(32, 16), max_epochs=25)).network
    problem = FitProblem(source, network, bent("T", unit_load_N, curvature, GAIN, OFFSET))
    at_N = np.array([0.0, 2.7])
    anchors = Anchors((0.5 + 0.1 * at_N + curvature * at_N**2 - OFFSET) / GAIN, at_N)
    assert choose_map(problem).family == "averaged"
    assert choose_map(replace(problem, anchors=anchors)).family == family
    one = Anchors(anchors.output[:1], anchors.reference[:1])
    assert choose_map(replace(problem, anchors=one)).family == "averaged"
