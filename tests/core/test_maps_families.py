"""Every map family against closed forms and independent solvers."""

from dataclasses import replace

import numpy as np
import ot
import pytest
from scipy.stats import wasserstein_distance

from softcal.core.errors import InputError, UnitRefused
from softcal.core.maps.affine_map import AffineMap
from softcal.core.maps.catalogue import FAMILIES, family, map_from_arrays
from softcal.core.maps.choose import dwell_distance
from softcal.core.maps.config import MapConfig
from softcal.core.maps.crossing import level_path, turning_points
from softcal.core.maps.curve import CurveMap, continued
from softcal.core.maps.ends import match_ends
from softcal.core.maps.interface import FitProblem, UnitMap, map_sha256
from softcal.core.maps.paired import paired_by_stage
from softcal.core.maps.plan import barycentric, solve_exact
from softcal.core.network.network import Network
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.windows import windows
from tests.presses import presses

GAIN, OFFSET = 1.3, 0.04
MAPS = MapConfig()


def source_output(force_N: np.ndarray) -> np.ndarray:
    return 0.5 + 0.1 * force_N + 0.02 * force_N**2


def target_output(force_N: np.ndarray) -> np.ndarray:
    return (source_output(force_N) - OFFSET) / GAIN


def recording(serial: str, output: np.ndarray, stage_mm: np.ndarray | None = None) -> OutputRecording:
    return OutputRecording(serial, np.arange(len(output)) / 50.0, output, 50.0, stage_mm=stage_mm)


def linear_network() -> Network:
    """f = mean of the taps, scaled: a network whose derivative is known."""
    weight = np.full((15, 1), 1 / 15)
    return Network((weight,), (np.zeros(1),), 0.6, 0.1, 1.0, 1.0)


def labelled(source: OutputRecording) -> LabelledRecording:
    """The source under the load that f reads from it: f fits its own source."""
    load = linear_network().evaluate(source.windows)
    return LabelledRecording(source, np.pad(load, (len(source) - len(load), 0), mode="edge"))


def problem(source_N: np.ndarray, target_N: np.ndarray, stage: bool = False) -> FitProblem:
    source = recording("S", source_output(source_N), source_N if stage else None)
    target = recording("T", target_output(target_N), target_N if stage else None)
    return FitProblem(labelled(source), linear_network(), target)


def relative_error(unit_map: UnitMap, load_N: np.ndarray) -> float:
    """Error of the mapped output under known loads, as a share of the output's range."""
    mapped = unit_map.apply(windows(target_output(load_N)))
    truth = windows(source_output(load_N))
    return float(np.sqrt(np.mean((mapped - truth) ** 2)) / np.ptp(truth))


SAME = problem(presses(1, 1500), presses(1, 1500), stage=True)


@pytest.mark.parametrize("name", [n for n in FAMILIES if n != "identity"])
def test_family_recovers_an_affine_unit_under_the_same_programme(name: str) -> None:
    assert relative_error(family(name).fit(SAME), presses(7, 600)) < 0.03


@pytest.mark.parametrize("name", list(FAMILIES))
def test_map_survives_its_arrays_and_keeps_its_hash(name: str) -> None:
    unit_map = family(name).fit(SAME)
    again = map_from_arrays(name, unit_map.arrays(), unit_map.settings())
    probe = windows(target_output(presses(3, 200)))
    assert np.array_equal(unit_map.apply(probe), again.apply(probe))
    assert map_sha256(unit_map) == map_sha256(again)


@pytest.mark.parametrize("name", list(FAMILIES))
def test_map_of_a_signal_equals_map_of_its_windows(name: str) -> None:
    unit_map, signal = family(name).fit(SAME), target_output(presses(4, 120))
    assert np.allclose(unit_map.apply_signal(signal), unit_map.apply(windows(signal)), atol=1e-12)


@pytest.mark.parametrize("name", [n for n in FAMILIES if n != "identity"])
def test_equal_recordings_give_the_identity(name: str) -> None:
    force_N = presses(5, 900)
    twin = recording("S", source_output(force_N), force_N)
    fitted = family(name).fit(FitProblem(labelled(twin), linear_network(), twin))
    mapped = fitted.apply(twin.windows)
    assert np.sqrt(np.mean((mapped - twin.windows) ** 2)) < 0.02 * np.ptp(twin.output)


def test_crossings_do_not_see_how_long_the_unit_rests() -> None:
    lazy = problem(presses(1, 6000), presses(2, 6000, dwell=80.0))
    load_N = presses(7, 600)
    by_crossings = relative_error(family("two_point").fit(lazy), load_N)
    assert by_crossings < 0.03
    assert by_crossings < relative_error(family("monotone").fit(lazy), load_N) / 3


def test_the_dwell_distance_shows_that_time_is_spent_differently() -> None:
    source, lazy = source_output(presses(1, 4000)), source_output(presses(2, 4000, dwell=80.0))
    resting, resting_long = np.mean(source < 0.52), np.mean(lazy < 0.52)
    assert resting_long / resting > 2 * (1 - resting_long) / (1 - resting)
    equal, apart = (dwell_distance(recording("S", source), windows(other), 20) for other in (source, lazy))
    assert equal == 0.0 and apart > 0.3


def test_turning_points_of_a_sampled_triangle_are_its_corners() -> None:
    corners = np.array([0.0, 2.0, 1.0, 3.0, 0.0])
    signal = np.concatenate([np.linspace(a, b, 21)[:-1] for a, b in zip(corners[:-1], corners[1:], strict=True)])
    signal = np.append(signal, corners[-1])
    assert np.allclose(signal[turning_points(signal, 0.5)], corners)
    assert np.allclose(signal[turning_points(signal, 1.5)], [0.0, 3.0, 0.0])


def test_path_quantiles_of_a_triangle_are_uniform() -> None:
    path = level_path(recording("T", np.abs((np.arange(400) % 100) - 50.0)), 1, MAPS.crossing)
    assert path is not None
    assert np.allclose(path.quantiles(np.array([0.25, 0.5, 0.75])), [12.5, 25.0, 37.5], atol=0.6)


def test_exact_plan_is_the_one_of_sorting_in_one_dimension(rng: np.random.Generator) -> None:
    a, b = rng.normal(size=40), rng.normal(size=40) + 1.0
    plan = solve_exact(np.abs(a[:, None] - b[None, :]))
    assert np.sum(plan * np.abs(a[:, None] - b[None, :])) == pytest.approx(wasserstein_distance(a, b))
    assert np.allclose(plan.sum(axis=0), 1 / 40) and np.allclose(plan.sum(axis=1), 1 / 40)


def test_exact_map_agrees_with_pot_on_the_windows_it_was_fitted_to(rng: np.random.Generator) -> None:
    fit = problem(presses(1, 300), presses(2, 300))
    source = fit.source.windows + 1e-6 * rng.normal(size=fit.source.windows.shape)
    theirs = ot.da.EMDTransport().fit(Xs=fit.target.windows, Xt=source).transform(fit.target.windows)
    ours = barycentric(solve_exact(ot.dist(fit.target.windows, source)), source)
    assert np.allclose(ours, theirs, atol=1e-4)


def test_exact_map_of_an_unseen_window_moves_with_its_neighbours() -> None:
    fitted = family("exact").fit(problem(presses(1, 900), presses(1, 900)))
    unseen_window = target_output(np.full(15, 1.234567))[None, :]
    assert fitted.apply(unseen_window)[0, -1] == pytest.approx(source_output(np.array([1.234567]))[0], abs=0.02)


def test_joint_transport_uses_labels_where_windows_alone_are_lost() -> None:
    mixed = problem(presses(1, 900), presses(2, 900, dwell=60.0))
    load_N = presses(7, 400)
    assert relative_error(family("joint").fit(mixed), load_N) < 1.2 * relative_error(family("exact").fit(mixed), load_N)


def test_curve_is_linear_beyond_its_knots() -> None:
    curve = CurveMap(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 3.0]), "monotone")
    assert np.allclose(curve(np.array([-1.0, 0.5, 1.5, 4.0])), [-1.0, 0.5, 2.0, 7.0])


def test_continued_curve_is_the_same_inside_and_bounded_beyond() -> None:
    curve = CurveMap(np.array([0.0, 1.0, 2.0, 2.1]), np.array([0.0, 1.0, 2.0, 4.0]), "monotone")
    longer = continued(curve, 4.0, MAPS.curve)
    inside = np.linspace(0.0, 2.1, 50)
    assert np.allclose(longer(inside), curve(inside))
    overall = 4.0 / 2.1
    for beyond in (-1.0, 3.1):
        slope = (longer(np.array([beyond + 0.1])) - longer(np.array([beyond]))) / 0.1
        assert 0.5 * overall <= slope[0] <= 2 * overall


def test_slope_beyond_a_glimpse_is_drawn_to_one() -> None:
    glimpse = CurveMap(np.array([0.0, 0.1]), np.array([0.0, 0.3]), "monotone")
    slope_of_wide_span, slope_of_narrow_span = (
        continued(glimpse, span, MAPS.curve)(np.array([1.1])) - 0.3 for span in (0.3, 30.0)
    )
    assert slope_of_wide_span[0] == pytest.approx(3.0)
    assert 1.0 < slope_of_narrow_span[0] < 2.0


def test_ends_match_a_short_recording_to_stretches_as_short() -> None:
    lot = problem(presses(1, 6000), presses(2, 250))
    match = match_ends(lot.source, lot.target, MAPS)
    assert match.gain == pytest.approx(GAIN, rel=0.25)
    longer = problem(presses(1, 1500), presses(2, 6000)).target
    assert match.gain_error > 3 * match_ends(lot.source, longer, MAPS).gain_error


@pytest.mark.parametrize("output_V", [0.5, 0.1])
@pytest.mark.parametrize("name", ["affine", "two_point", "monotone"])
def test_constant_output_is_refused(name: str, output_V: float) -> None:
    # Means of 0.1 differ by rounding, those of 0.5 do not.
    still = replace(SAME, target=recording("T", np.full(400, output_V)))
    with pytest.raises(UnitRefused):
        family(name).fit(still)


@pytest.mark.parametrize(("name", "code"), [("stage_matched", "no_position"), ("synchronous", "not_synchronous")])
def test_what_cannot_be_paired_is_refused(name: str, code: str) -> None:
    with pytest.raises(UnitRefused) as refused:
        family(name).fit(problem(presses(1, 1500), presses(2, 1500)))
    assert refused.value.reason.code == code


def test_stage_pairs_find_the_map_though_the_programme_is_another() -> None:
    other = problem(presses(1, 6000), 0.5 * presses(2, 3000), stage=True)
    assert relative_error(family("stage_matched").fit(other), 0.5 * presses(7, 600)) < 0.02


def test_a_few_windows_at_known_positions_are_enough() -> None:
    whole = problem(presses(1, 6000), presses(2, 6000), stage=True)
    rows = (np.arange(5)[:, None] * 1100 + 40 + np.arange(15)).ravel()
    target, stage_mm = whole.target, whole.target.stage_mm
    assert stage_mm is not None
    few = replace(target, t_s=target.t_s[rows], output=target.output[rows], stage_mm=stage_mm[rows])
    assert len(few.windows) == 5
    assert relative_error(family("stage_matched").fit(replace(whole, target=few)), presses(7, 600)) < 0.05


def test_positions_beyond_a_gap_do_not_mislead_the_pairs() -> None:
    load_N = presses(1, 6000)
    whole = problem(load_N, load_N, stage=True)
    rows = np.flatnonzero(np.arange(6000) % 200 < 20)
    target, stage_mm = whole.target, whole.target.stage_mm
    assert stage_mm is not None
    holed = replace(target, t_s=target.t_s[rows], output=target.output[rows], stage_mm=stage_mm[rows])
    source_rows, target_rows = paired_by_stage(whole.source.unlabelled, holed, MAPS)
    assert len(target_rows) == len(holed.windows)
    # Both ran one profile, so that every window has its like in the source.
    at_mm = load_N[whole.source.unlabelled.window_rows[source_rows]]
    assert np.allclose(at_mm, stage_mm[rows][holed.window_rows[target_rows]], atol=1e-9)


def test_unknown_family_lists_the_known_ones() -> None:
    with pytest.raises(InputError, match="identity, affine"):
        family("magic")


def test_affine_map_is_its_equation() -> None:
    assert AffineMap(2.0, 1.0).apply(np.array([[3.0]])) == 7.0
