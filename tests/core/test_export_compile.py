"""Maps of every kind as small device forms: exact where they can be, refused where the estimate would suffer."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from softcal.core.errors import UnitRefused
from softcal.core.export.compile_map import (
    InputScale,
    compile_map,
    curve_forms,
    fine_forms,
    matrix_forms,
    mix_forms,
)
from softcal.core.maps.catalogue import FAMILIES
from softcal.core.maps.interface import FitProblem
from softcal.core.network.network import Network
from softcal.core.recording import Array, LabelledRecording
from softcal.core.windows import TAPS, windows

Press = Callable[..., LabelledRecording]
LIMIT_N = 0.01


@dataclass(frozen=True)
class _Map:
    """A map given by its function on windows."""

    on_windows: Callable[[Array], Array]
    family: str = "test"

    def apply(self, windows: Array) -> Array:
        return self.on_windows(windows)

    def apply_signal(self, signal: Array) -> Array:
        return self.on_windows(windows(signal))

    def arrays(self) -> dict[str, np.ndarray]:
        return {}

    def settings(self) -> dict[str, object]:
        return {}


def test_an_affine_map_needs_two_knots(linear_network: Network, press: Press) -> None:
    unit = press(2).unlabelled
    compiled = compile_map(_Map(lambda x: 0.1 + 0.8 * x), linear_network, unit, LIMIT_N)
    assert compiled.form.linear is None and compiled.form.curve is not None
    assert len(compiled.form.curve.outputs) == 2
    assert compiled.max_deviation < 1e-6


def test_a_bent_map_fits_into_32_knots(linear_network: Network, press: Press) -> None:
    unit = press(2).unlabelled
    compiled = compile_map(_Map(lambda x: 0.6 + 0.2 * np.tanh(6 * (x - 0.6))), linear_network, unit, LIMIT_N)
    assert compiled.form.linear is None and compiled.form.curve is not None
    assert len(compiled.form.curve.outputs) <= 32
    assert compiled.rms_deviation < 0.002


def test_the_stated_deviation_is_what_the_estimate_changes(linear_network: Network, press: Press) -> None:
    unit, bent = press(2).unlabelled, _Map(lambda x: 0.6 + 0.2 * np.tanh(30 * (x - 0.6)))
    compiled = compile_map(bent, linear_network, unit, 0.05)
    exact = linear_network.evaluate(bent.apply(unit.windows))
    change = linear_network.evaluate(compiled.form.apply(unit.windows)) - exact
    assert compiled.max_deviation == pytest.approx(np.abs(change).max())
    assert compiled.rms_deviation == pytest.approx(np.sqrt(np.mean(change**2)))


def test_a_falling_map_stays_falling(linear_network: Network, press: Press) -> None:
    compiled = compile_map(_Map(lambda x: 1.2 - x), linear_network, press(2).unlabelled, LIMIT_N)
    assert compiled.form.curve is not None
    assert np.all(np.diff(compiled.form.curve.values) < 0)


def test_a_map_over_the_window_becomes_the_matrix_it_is_where_there_is_room(
    linear_network: Network, press: Press, rng: np.random.Generator
) -> None:
    matrix = 0.9 * np.eye(TAPS) + 0.15 * np.eye(TAPS, k=-1) + 0.1 * rng.normal(size=(TAPS, TAPS)) / TAPS
    windowed = _Map(lambda x: 0.02 + x @ matrix.T)
    compiled = compile_map(windowed, linear_network, press(2).unlabelled, 0.001, fine_forms)
    assert compiled.form.curve is None and compiled.form.linear is not None
    assert np.allclose(compiled.form.linear.matrix, matrix, atol=1e-3)


def _lag(samples: int) -> Array:
    """Half of every sample comes `samples` late; the oldest ones stay as they are."""
    lag = 0.5 * np.eye(TAPS) + 0.5 * np.eye(TAPS, k=-samples)
    lag[:samples] = np.eye(TAPS)[:samples]
    return lag


def _smoothing() -> Array:
    """A least-squares parabola through every window."""
    basis = np.vander(np.linspace(-1, 1, TAPS), 3)
    return np.asarray(basis @ np.linalg.pinv(basis))


MATRICES = {
    "lag": _lag(6),
    "short FIR": 0.7 * np.eye(TAPS) + 0.2 * np.eye(TAPS, k=-1) + 0.1 * np.eye(TAPS, k=-2),
    "smoothing": _smoothing(),
    "rank two": np.eye(TAPS) + 0.02 * np.outer(np.linspace(0, 1, TAPS) ** 2, np.linspace(1, -1, TAPS)),
    "creep": np.eye(TAPS) - 0.15 * np.linspace(1, 0, TAPS)[:, None] * np.linspace(-1, 1, TAPS)[None, :] / 4,
}


@pytest.mark.parametrize("name", sorted(MATRICES))
def test_a_bend_and_a_linear_part_take_a_curve_and_a_mix(name: str, linear_network: Network, press: Press) -> None:
    unit, matrix = press(2).unlabelled, MATRICES[name]
    both = _Map(lambda x: (0.6 + 0.2 * np.tanh(6 * (x - 0.6))) @ matrix.T)
    compiled = compile_map(both, linear_network, unit, LIMIT_N)
    assert compiled.rms_deviation < 0.5 * LIMIT_N
    assert compiled.form.curve is not None and (compiled.form.linear is not None or name in ("creep", "rank two"))


def test_a_map_that_has_no_small_form_is_refused_with_its_deviation(linear_network: Network, press: Press) -> None:
    rough = _Map(lambda x: 0.5 + 0.3 * np.round(np.sin(40 * x.mean(axis=1, keepdims=True))) * np.ones(TAPS))
    with pytest.raises(UnitRefused, match=r"test .*U1 .* N .*0\.01"):
        compile_map(rough, linear_network, press(2).unlabelled, LIMIT_N)


@pytest.mark.parametrize("name", sorted(FAMILIES))
def test_every_family_has_a_device_form_or_a_refusal(name: str, linear_network: Network, press: Press) -> None:
    source, target = press(1, serial="S0"), press(2, gain=1.1, offset_V=0.02).unlabelled
    try:
        unit_map = FAMILIES[name].fit(FitProblem(source, linear_network, target))
    except UnitRefused:
        return  # the family needs more than this recording holds
    try:
        compiled = compile_map(unit_map, linear_network, target, 0.05)
    except UnitRefused:
        return
    exact = linear_network.evaluate(unit_map.apply(target.windows))
    change = linear_network.evaluate(compiled.form.apply(target.windows)) - exact
    assert np.sqrt(np.mean(change**2)) <= 0.05


def test_a_converter_gives_back_its_own_codes() -> None:
    scale = InputScale.from_converter(10, 5.0)
    adc = np.arange(1024)
    assert np.array_equal(scale.codes(adc * 5 / 1023), adc * 64)


def test_the_default_scale_covers_source_and_unit(linear_network: Network) -> None:
    scale = InputScale.cover_range(linear_network, np.array([0.2, 3.1]))
    assert (scale.zero, scale.outputs(np.array([65_535]))[0]) == (0.0, pytest.approx(5.0))
    signed = InputScale.cover_range(linear_network, np.array([-0.2, 0.4]))
    assert signed.zero == -2.0


def test_more_bytes_hold_a_bend_and_a_linear_part_more_nearly(linear_network: Network, press: Press) -> None:
    """The whole matrix is exact for any linear part, a mix for one of few smooth shapes; a curve is for none."""
    unit, matrix = press(2).unlabelled, _smoothing()
    both = _Map(lambda x: (0.6 + 0.2 * np.tanh(6 * (x - 0.6))) @ matrix.T)
    curve, mix, whole = (
        compile_map(both, linear_network, unit, 10 * LIMIT_N, forms, 0.0)
        for forms in (curve_forms, mix_forms, matrix_forms)
    )
    assert mix.max_deviation < 0.5 * curve.max_deviation
    assert whole.max_deviation < 0.5 * curve.max_deviation
