"""Maps fitted to pairs: what they take from a window, what they follow, and what they are measured by."""

import numpy as np
import pytest

from softcal.core.maps.catalogue import family
from softcal.core.maps.interface import FitProblem
from softcal.core.maps.paired import DynamicMap
from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.network.training import fit_network
from softcal.core.recording import LabelledRecording, OutputRecording

NOISE_V = 0.05


def recording(output: np.ndarray, seed: int, noise_V: float = NOISE_V) -> OutputRecording:
    noisy = output + np.random.default_rng(seed).normal(0, noise_V, len(output))
    return OutputRecording(f"U{seed}", np.arange(len(output)) / 50.0, noisy, 50.0)


def newest_sample(gain: float = 1.0) -> Network:
    """f = gain x newest sample: it cannot average, the map has to."""
    weight = np.zeros((15, 1))
    weight[-1] = gain
    return Network((weight,), (np.zeros(1),), 0.0, 1.0, 0.0, 1.0)


def synchronous(source: OutputRecording, load_N: np.ndarray, network: Network, target: OutputRecording):  # type: ignore[no-untyped-def]
    return family("synchronous").fit(FitProblem(LabelledRecording(source, load_N), network, target))


def slow_load(count: int = 6000) -> np.ndarray:
    return 1.5 - 1.5 * np.cos(np.linspace(0, 2 * np.pi, count))


def quick_load(count: int = 6000) -> np.ndarray:
    return 1.5 - 1.5 * np.cos(np.linspace(0, 2 * np.pi * count / 30, count))


def fitted_to_half(load_N: np.ndarray):  # type: ignore[no-untyped-def]
    """Return the map of a unit of half the gain, and its error on a recording it has not seen."""
    fitted = synchronous(recording(load_N, 1), load_N, newest_sample(), recording(load_N / 2, 2))
    unseen = recording(load_N / 2, 3)
    return fitted, rmse(newest_sample().evaluate(fitted.apply(unseen.windows)), load_N[unseen.window_rows])


def test_level_of_a_window_is_all_that_a_slow_load_leaves_to_read() -> None:
    fitted, error = fitted_to_half(slow_load())
    assert isinstance(fitted, DynamicMap) and fitted.mix.shape == (1, 1)
    # One sample has the unit's noise times its gain of 2; the mean of fifteen has a quarter of that.
    assert error < 0.6 * 2 * NOISE_V


def test_more_than_the_level_is_kept_where_the_load_is_quick() -> None:
    fitted, error = fitted_to_half(quick_load())
    assert not isinstance(fitted, DynamicMap) or len(fitted.mix) >= 5
    assert error < 1.1 * 2 * NOISE_V


def test_curve_follows_every_bend_of_the_source() -> None:
    load_N = slow_load()
    winding = recording(load_N + 0.07 * np.sin(4 * np.pi * load_N), 1, 0.01)
    network = fit_network(LabelledRecording(winding, load_N), NetworkConfig(hidden=(32, 16), max_epochs=60)).network
    fitted = synchronous(winding, load_N, network, recording(load_N / 2, 2, 0.01))
    assert rmse(network.evaluate(fitted.apply_signal(load_N / 2)), load_N[14:]) < 0.014


def test_what_f_misreads_on_the_source_is_not_handed_on_whole() -> None:
    load_N = slow_load()
    network = newest_sample(gain=1.1)
    source = recording(load_N, 1, 0.0)
    fitted = synchronous(source, load_N, network, recording(load_N / 2, 2, 0.0))
    handed_on = rmse(network.evaluate(fitted.apply_signal(load_N / 2)), load_N[14:])
    source_rmse = rmse(network.evaluate(source.windows), load_N[14:])
    assert handed_on == pytest.approx(source_rmse / 2, rel=0.2)
