"""Networks and maps in integers: close to float64, and never past 32 bits, whatever comes in."""

import numpy as np
import pytest

from softcal.core.errors import UnitRefused
from softcal.core.export.integer_network import (
    ACTIVATION_MAX,
    IntegerLayer,
    IntegerNetwork,
    PiecewiseMap,
)
from softcal.core.export.quantise import evaluate_float64, quantise_layer, quantise_network
from softcal.core.network.network import Network
from softcal.core.windows import TAPS, windows

SIZES = (TAPS, 120, 70, 35, 1)


@pytest.fixture
def network(rng: np.random.Generator) -> Network:
    """The paper's sizes with He weights: as large inside as a trained one."""
    shapes = list(zip(SIZES[:-1], SIZES[1:], strict=True))
    weights = tuple(rng.normal(0, np.sqrt(2 / a), (a, b)) for a, b in shapes)
    biases = tuple(rng.normal(0, 0.1, b) for _, b in shapes)
    return Network(weights, biases, 0.6, 0.1, 1.0, 0.7)


@pytest.fixture
def source_windows(rng: np.random.Generator) -> np.ndarray:
    return windows(0.6 + 0.15 * np.sin(np.cumsum(rng.uniform(0, 0.3, 1500))) + rng.normal(0, 0.002, 1500))


def _counts(net: IntegerNetwork, x: np.ndarray) -> np.ndarray:
    return np.rint((x - net.input_zero) / net.input_lsb).astype(np.int64)


def test_integers_stay_within_a_thousandth_of_the_span(network: Network, source_windows: np.ndarray) -> None:
    net = quantise_network(network, source_windows)
    exact = evaluate_float64(network, source_windows)
    integer_estimate = net.evaluate(_counts(net, source_windows)) * 10.0**net.output_exponent
    assert np.sqrt(np.mean((integer_estimate - exact) ** 2)) < 1e-3 * np.ptp(exact)


def test_the_float64_yardstick_agrees_with_the_network(network: Network, source_windows: np.ndarray) -> None:
    exact = evaluate_float64(network, source_windows)
    assert np.allclose(exact, network.evaluate(source_windows), atol=1e-5 * np.ptp(exact))


def test_no_input_at_all_leaves_32_bits(network: Network, source_windows: np.ndarray, rng: np.random.Generator) -> None:
    # Python's own integers, and for every row the very inputs that reach furthest.
    for layer in quantise_network(network, source_windows).layers:
        for row in rng.choice(layer.shape[0], size=min(20, layer.shape[0]), replace=False):
            weights = [int(w) for w in layer.weights[row]]
            for sign in (1, -1):
                total = int(layer.bias[row])
                for weight in weights:
                    total += weight * (ACTIVATION_MAX if sign * weight > 0 else -ACTIVATION_MAX)
                    assert abs(total) < 2**31
                product = (total >> int(layer.shift1[row])) * int(layer.multiplier[row])
                assert abs(product + 2 ** (int(layer.shift2[row]) - 1)) < 2**31


def test_a_layer_that_could_overflow_is_refused() -> None:
    full = np.full((1, 70), 32_767, dtype=np.int64)
    one = np.ones(1, dtype=np.int64)
    with pytest.raises(ValueError, match="75157"):
        IntegerLayer(full, 0 * one, 8192 * one, 15 * one, one)


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_rows_of_any_size_keep_fourteen_bits(rng: np.random.Generator, scale: float) -> None:
    weights, inputs = scale * rng.normal(size=(8, 40)), rng.integers(-32_767, 32_768, (500, 40))
    exact = inputs @ weights.T
    layer = quantise_layer(weights, np.zeros(8), np.ones(40), np.abs(exact).max(axis=0) / 30_000)
    integer_estimate = layer.apply(inputs, is_rectified=False) * np.abs(exact).max(axis=0) / 30_000
    assert np.abs(integer_estimate - exact).max() < 3e-4 * np.abs(exact).max()


def test_rows_without_any_weight_give_their_bias() -> None:
    layer = quantise_layer(np.zeros((2, 15)), np.array([0.0, 0.5]), np.ones(15), np.full(2, 1e-4))
    assert layer.apply(np.full((1, 15), 32_767), is_rectified=False).tolist() == [[0, 5000]]


def test_a_network_that_says_nothing_is_refused(network: Network, source_windows: np.ndarray) -> None:
    mute = Network(tuple(0 * w for w in network.weights), tuple(0 * b for b in network.biases), 0.6, 0.1, 0.0, 1.0)
    with pytest.raises(UnitRefused):
        quantise_network(mute, source_windows)


def test_a_piecewise_map_agrees_with_linear_interpolation(rng: np.random.Generator) -> None:
    for direction in (1, -1):
        codes = np.sort(rng.choice(65_536, 32, replace=False))
        values = direction * np.sort(rng.integers(-32_767, 32_768, 32))
        every = np.arange(65_536)
        integer_estimate = PiecewiseMap(codes, values).apply(every)
        assert np.abs(integer_estimate - np.interp(every, codes, values)).max() <= 0.5


@pytest.mark.parametrize(
    ("codes", "values"),
    [([5], [1]), ([5, 5], [1, 2]), ([0, 70_000], [1, 2]), ([0, 1, 2], [0, 5, 3]), ([0, 1], [0, 40_000])],
)
def test_knots_that_are_no_monotone_map_are_refused(codes: list[int], values: list[int]) -> None:
    with pytest.raises(ValueError):
        PiecewiseMap(np.array(codes), np.array(values))
