"""Units that were pressed by one load at once are mapped by it; whoever was not, or not alike, keeps its own map."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from softcal.core.maps import common_load
from softcal.core.maps.catalogue import map_from_arrays
from softcal.core.maps.choose import choose_map
from softcal.core.maps.common_load import LoadGroup, weigh_lines
from softcal.core.maps.config import MapConfig, SharedLoadConfig
from softcal.core.maps.interface import FitProblem, map_sha256
from softcal.core.maps.shared_load import LotFit, fit_lot
from softcal.core.maps.source_bias import compare_sources
from softcal.core.metrics import rms, rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.network.training import fit_network
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.lot_fit import LotMap
from tests.presses import dwelling_presses

RATE_HZ, NOISE_V = 50.0, 0.0005
UNITS = 6


def unit(serial: str, force_N: np.ndarray, seed: int, start_s: float = 0.0) -> LabelledRecording:
    """A unit of a gain, a rest and a bend of its own."""
    unit_rng = np.random.default_rng([seed, 7])
    gain, rest, curvature = unit_rng.uniform(0.8, 1.2), unit_rng.uniform(0.4, 0.6), unit_rng.uniform(-0.015, 0.02)
    noise = np.random.default_rng([seed, len(force_N)]).normal(0, NOISE_V, len(force_N))
    output = rest + gain * (0.1 * force_N + curvature * force_N**2) + noise
    t_s = start_s + np.arange(len(output)) / RATE_HZ
    return LabelledRecording(OutputRecording(serial, t_s, output, RATE_HZ), force_N)


@pytest.fixture(scope="module")
def source() -> LabelledRecording:
    return unit("S0", dwelling_presses(1, 4000, dwell=2.0), 0)


@pytest.fixture(scope="module")
def network(source: LabelledRecording) -> Network:
    return fit_network(source, NetworkConfig(hidden=(24, 12), max_epochs=40)).network


def lot(spread: float = 0.0, units: int = UNITS, programme: int = 9) -> list[LabelledRecording]:
    """Units pressed together under a programme that the source did not have: held much longer."""
    return [unit(f"U{k}", dwelling_presses(programme, 3000, 60.0, spread, k), k) for k in range(1, units + 1)]


def outputs(units: list[LabelledRecording]) -> list[OutputRecording]:
    return [one.unlabelled for one in units]


def errors(fit: LotFit, network: Network, alone: bool) -> np.ndarray:
    """Error of each map on a recording that no fit has seen."""
    errors_found = []
    for serial, one in fit.units.items():
        test = unit(serial, dwelling_presses(33, 2000, dwell=5.0), int(serial[1:]))
        unit_map = one.alone.unit_map if alone else one.unit_map
        errors_found.append(rmse(network.evaluate(unit_map.apply(test.windows)), test.window_reference))
    return np.array(errors_found)


@pytest.fixture(scope="module")
def fit(source, network) -> LotFit:
    return fit_lot(source, network, outputs(lot()))


def test_a_load_that_all_share_is_known_better_than_by_any_of_them(fit, network):
    assert fit.members == tuple(f"U{k}" for k in range(1, UNITS + 1)) and not fit.outliers and not fit.refused
    alone, together = errors(fit, network, True), errors(fit, network, False)
    assert np.median(together) < 0.9 * np.median(alone) and together.max() < 0.8 * alone.max()


def test_its_uncertainties_are_those_of_its_estimates(fit, network):
    (group,) = fit.groups
    load_N = dwelling_presses(9, 3000, 60.0)[14:]
    common = rmse(group.load, load_N)
    # What all misread alike is no part of it: the true error is no smaller than this by much, and not far beyond.
    assert 0.3 * common < group.common_rmse < 3 * common
    # Of one unit the line may differ from the others' by more than its own map: of all together it does not.
    parts = np.array([(one.unit_rmse, one.moved_rmse) for one in fit.units.values()])
    assert parts.min() > 0 and rms(parts[:, 0]) < rms(parts[:, 1])
    assert all(0 < one.weight < 1 for one in fit.units.values())
    assert sum(one.weight for one in fit.units.values()) == pytest.approx(1.0)


def test_the_order_of_the_units_changes_nothing(source, network, fit):
    backwards = fit_lot(source, network, outputs(lot())[::-1])
    test = unit("U2", dwelling_presses(33, 2000, dwell=5.0), 2)
    one, other = (network.evaluate(f.units["U2"].unit_map.apply(test.windows)) for f in (fit, backwards))
    assert rmse(one, other) < 0.02 * np.ptp(test.reference)


def test_a_map_is_rebuilt_from_what_is_stored(fit):
    unit_map = fit.units["U1"].unit_map
    again = map_from_arrays(unit_map.family, unit_map.arrays(), unit_map.settings())
    assert map_sha256(again) == map_sha256(unit_map)


def test_who_was_pressed_otherwise_keeps_its_own_map_and_is_named(source, network):
    units = lot()
    foreign = unit("U5", dwelling_presses(77, 3000, 60.0), 5)
    still = replace(units[5].unlabelled, output=np.full(3000, 0.5))
    fit = fit_lot(source, network, [*outputs(units[:4]), foreign.unlabelled, still])
    assert fit.members == ("U1", "U2", "U3", "U4")
    assert fit.outliers["U5"].code == "lot_fit.alone" and list(fit.refused) == ["U6"]
    own_map = choose_map(FitProblem(source, network, foreign.unlabelled)).unit_map
    assert map_sha256(fit.units["U5"].unit_map) == map_sha256(own_map)


def test_a_unit_that_no_map_brings_to_the_others_stands_alone(source, network):
    units = lot()
    # A press that slips now and then on one unit: as synchronous as the rest, and not under their load.
    slipping = dwelling_presses(9, 3000, 60.0)
    slipping[900:1100] *= 0.7
    fit = fit_lot(source, network, [*outputs(units[:5]), unit("U6", slipping, 6).unlabelled])
    assert fit.members == tuple(f"U{k}" for k in range(1, 6))
    assert fit.outliers["U6"].code == "lot_fit.outlier"


def test_a_unit_that_swings_like_noise_under_the_common_load_stands_alone(source, network):
    units = outputs(lot())
    jitter = 0.05 * np.resize(np.repeat([1.0, -1.0], 5), 3000) * (dwelling_presses(9, 3000, 60.0) > 0.5)
    noisy = replace(units[5], output=units[5].output + jitter)
    fit = fit_lot(source, network, [*units[:5], noisy])
    assert fit.members == tuple(f"U{k}" for k in range(1, 6))
    assert fit.outliers["U6"].code == "lot_fit.noisy"


@pytest.mark.parametrize(("spread", "programme"), [(0.05, 900), (0.06, 9), (0.12, 9)])
def test_a_press_that_differs_from_unit_to_unit_is_no_shared_load(source, network, spread, programme):
    fit = fit_lot(source, network, outputs(lot(spread, programme=programme)))
    assert not fit.members and {why.code for why in fit.outliers.values()} == {"lot_fit.spread"}
    for one in fit.units.values():
        assert 0.2 * spread < one.press_spread < 1.2 * spread
        assert map_sha256(one.unit_map) == map_sha256(one.alone.unit_map)


def test_clocks_that_differ_and_gaps_are_no_obstacle(source, network, fit):
    units = outputs(lot())
    late = replace(units[1], t_s=units[1].t_s + 0.3)
    rows = np.r_[0:1000, 1100:3000]
    gapped = replace(units[2], t_s=units[2].t_s[rows], output=units[2].output[rows])
    moved = fit_lot(source, network, [units[0], late, gapped, *units[3:]])
    assert moved.members == fit.members
    assert np.median(errors(moved, network, False)) < 1.15 * np.median(errors(fit, network, False))


def test_who_was_pressed_with_the_source_keeps_its_pairs(source, network):
    units = [unit(f"U{k}", dwelling_presses(1, 4000, dwell=2.0), k) for k in range(1, 4)]
    fit = fit_lot(source, network, outputs(units))
    assert {why.code for why in fit.outliers.values()} == {"lot_fit.known"} and not fit.groups


def test_two_units_say_nothing_of_each_other(source, network):
    fit = fit_lot(source, network, outputs(lot(units=2)))
    assert not fit.members and set(fit.outliers) == {"U1", "U2"}


def test_the_cost_is_linear_in_the_units(source, network, monkeypatch):
    calls = []
    find_synchrony = common_load.find_synchrony
    monkeypatch.setattr(common_load, "find_synchrony", lambda *args: calls.append(1) or find_synchrony(*args))
    counts = []
    for count in (10, 20, 30):
        calls.clear()
        fit_lot(
            source, network, [unit(f"U{k}", dwelling_presses(100 + k, 800, 20.0), k).unlabelled for k in range(count)]
        )
        counts.append(len(calls))
    steps = [b - a for a, b in pairwise(counts)]
    assert steps[0] == steps[1]


def read_by_sources(fit: LotFit) -> dict[str, tuple[LoadGroup, ...]]:
    """Common loads by three sources; the load cell of the last reads low, and so does its network."""
    groups = {"S0": fit.groups}
    for serial, factor in (("S1", 1.0), ("S2", 0.75)):
        force_N = dwelling_presses(40 + int(serial[1:]), 4000, dwell=2.0)
        source_recording = replace(unit(serial, force_N, 50 + int(serial[1:])), reference=factor * force_N)
        own_network = fit_network(source_recording, NetworkConfig(hidden=(24, 12), max_epochs=40)).network
        groups[serial] = fit_lot(source_recording, own_network, outputs(lot()), paired=()).groups
    return groups


def test_a_source_whose_network_reads_the_lot_low_is_named_with_what_its_units_err_by(fit):
    biases = compare_sources(read_by_sources(fit), SharedLoadConfig())
    assert {serial for serial, one in biases.items() if one.is_bad} == {"S2"}
    load_N = dwelling_presses(9, 3000, 60.0)
    one = biases["S2"]
    assert one.bias == pytest.approx(np.mean(0.75 * load_N) - np.mean(load_N), abs=2.5 * one.uncertainty)
    assert one.others == 2 and one.common_rmse > 0.5 * rmse(0.75 * load_N, load_N)
    reason = one.to_reason("S2", "N")
    assert (
        reason.code == "lot_fit.source.low"
        and "(sources: 2)" in str(reason)
        and biases["S0"].to_reason("S0", "N") is None
    )
    group = LotMap.from_group(fit.units["U1"], fit.groups[0], ["a"], 1, one).part
    assert group.common_rmse == max(one.common_rmse, fit.groups[0].common_rmse)


def test_of_two_sources_nobody_can_say_which_errs(fit):
    (group,) = fit.groups
    biases = compare_sources({"S0": fit.groups, "S1": fit.groups}, SharedLoadConfig())
    assert {one.bias for one in biases.values()} == {0.0} and not any(one.is_bad for one in biases.values())
    biases = compare_sources({"S0": fit.groups, "S1": (replace(group, load=0.5 * group.load),)}, SharedLoadConfig())
    assert not any(one.is_bad for one in biases.values())
    assert {one.to_reason(s, "N").code for s, one in biases.items()} == {"lot_fit.source.two"}
    assert compare_sources({"S0": fit.groups}, SharedLoadConfig()) == {}


def test_units_that_another_network_reads_show_the_load_and_get_no_map(source, network, fit):
    part = fit_lot(source, network, outputs(lot()), paired=["U2"])
    assert list(part.units) == ["U2"] and part.groups[0].members == fit.groups[0].members
    assert map_sha256(part.units["U2"].unit_map) == map_sha256(fit.units["U2"].unit_map)


def line_share(
    spread: float = 0.07, curvature: float = 0.02, apart: float = 0.08, gain: float = 0.02, units: int = 20
) -> float:
    share, error = weigh_lines(spread**2, curvature, apart**2, gain, units, MapConfig())
    assert 0.0 <= share <= 1.0 and error > 0.0
    return share


def test_lines_through_peaks_that_are_hardly_known_take_little_part_in_the_common_load():
    shares = [line_share(gain=gain) for gain in (0.0, 0.03, 0.06, 0.2)]
    assert shares == sorted(shares, reverse=True) and shares[0] > 0.5 and shares[-1] < 0.1


@pytest.mark.parametrize("gain", [0.03, 0.06, 0.12])
def test_lines_and_curves_of_a_lot_are_weighed_so_that_what_errs_apart_errs_least(gain):
    """Drawn lots of units that hardly differ: their lines err by the gain alone, their curves by the dwell."""
    dwell, rng = SharedLoadConfig().dwell, np.random.default_rng(4)
    lines, curves = gain * rng.standard_normal(40_000), dwell * rng.standard_normal(40_000)
    apart = float(np.mean((lines - curves) ** 2))
    share, error = weigh_lines(1e-9, 0.0, apart, gain, 20, MapConfig())
    rms_by_weight = [np.sqrt(np.mean((s * lines + (1 - s) * curves) ** 2)) for s in np.linspace(0.0, 1.0, 101)]
    assert share == pytest.approx(np.argmin(rms_by_weight) / 100, abs=0.03)
    assert np.hypot(error, share * gain) == pytest.approx(min(rms_by_weight), rel=0.03)


def test_a_source_that_is_bent_beyond_its_units_takes_weight_from_the_lines():
    shares = [line_share(curvature=curvature) for curvature in (0.0, 0.05, 0.1, 0.2, 0.4)]
    assert shares == sorted(shares, reverse=True) and shares[0] > 0.5 > 2 * shares[3]
    # Units that hardly differ from each other are bent as their source, however much that is.
    assert line_share(spread=0.005, curvature=0.1) > 0.9


def test_a_dwell_gives_the_lines_weight_and_bends_that_differ_take_it():
    shares = [line_share(apart=apart) for apart in (0.0, 0.05, 0.1, 0.2)]
    assert shares == sorted(shares) and shares[-1] > 0.8
    shares = [line_share(spread=spread) for spread in (0.01, 0.03, 0.1, 0.2)]
    assert shares == sorted(shares, reverse=True)
    assert line_share(units=3) < line_share(units=40)


def test_what_all_units_miss_together_is_uncertainty_of_the_common_load(fit):
    (group,) = fit.groups
    gains = {float(one.alone.evidence["gain_error"]) for one in fit.units.values()}
    assert group.gain_rmse > 0.2 * min(gains) * np.ptp(group.load)
    assert group.common_rmse == pytest.approx(float(np.hypot(group.gain_rmse, group.shape_rmse)))
