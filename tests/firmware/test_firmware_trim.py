"""A trim on the device is that of the PC: the same loads give the same gain, zero and interval, or the same refusal."""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import pytest

from softcal.core.errors import InputError
from softcal.core.export.blob import NetworkFile, UnitFile
from softcal.core.export.device import DeviceRecord, build_network_file, build_unit_file
from softcal.core.export.integer_network import DeviceMap, IntegerMix
from softcal.core.export.loader import OUT_OF_RANGE, run_self_test
from softcal.core.export.quantise import quantise_layer
from softcal.core.maps.affine_map import AffineMap
from softcal.core.maps.anchors import AnchoredMap
from softcal.core.maps.config import AnchorConfig
from softcal.core.maps.interface import Anchors, FitProblem
from softcal.core.network.config import NetworkConfig
from softcal.core.network.training import fit_network
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.adjustments import Trim as UnitTrim
from softcal.core.unit.method import LEVELS
from softcal.core.unit.trim import trim
from softcal.core.unit.uncertainty import NORMAL_90, Interval
from softcal.core.windows import TAPS
from tests.device_sensor import open_sensor
from tests.firmware.device_stream import Shift, Trim, TrimResult, find_trim

BAND_N, RANGE_N = 0.08, 3.0
LOAD_ERROR_N = 0.003 * RANGE_N
"""What `softcal trim` takes a load to be known to."""

GAIN, OFFSET_V = 1.12, 0.03


def source_V(load_N: Any) -> Any:
    return 0.5 + 0.1 * load_N + 0.02 * load_N**2


def unit_V(load_N: Any, gain: float = 1.0, zero_V: float = 0.0) -> Any:
    """The output of the unit, which drifts by a gain and a zero after its calibration."""
    return OFFSET_V + zero_V + GAIN * (0.5 + gain * (source_V(load_N) - 0.5))


def press_unit(serial: str, output_V: Callable[[Any], Any], seed: int) -> LabelledRecording:
    rng = np.random.default_rng(seed)
    peaks = np.concatenate([[RANGE_N], rng.uniform(0.5, RANGE_N, 39)])
    press = np.concatenate([np.linspace(0, 1, 40), np.ones(20), np.linspace(1, 0, 40), np.zeros(20)])
    load_N = np.concatenate([peak * press for peak in peaks])
    noise = rng.normal(0, 0.0005, len(load_N))
    return LabelledRecording(
        OutputRecording(serial, np.arange(len(load_N)) / 50.0, output_V(load_N) + noise, 50.0), load_N
    )


def interval() -> Interval:
    """The interval of estimates before the trim: the same for every load and direction."""
    table = {"low": 0.0, "high": RANGE_N, "half_width": np.full((3, LEVELS), BAND_N)}
    return Interval(**{**{f.name: None for f in fields(Interval)}, **table})  # type: ignore[arg-type]


def aligned(data: bytes) -> Any:
    return (ctypes.c_uint32 * (-(-len(data) // 4))).from_buffer_copy(data.ljust(-(-len(data) // 4) * 4, b"\xff"))


@dataclass(frozen=True, eq=False)
class Both:
    """One unit on the PC and on the device."""

    problem: FitProblem
    unit_map: AffineMap
    network_file: NetworkFile
    unit_file: UnitFile
    bridge: ctypes.CDLL

    @property
    def count_N(self) -> float:
        return float(10.0**self.network_file.network.output_exponent)

    def on_pc(self, output_V: list[float], load_N: list[float]) -> UnitTrim:
        return trim(self.problem, self.unit_map, interval(), Anchors(np.array(output_V), np.array(load_N)))

    def on_device(self, output_V: list[float], load_N: list[float], error_N: float = LOAD_ERROR_N) -> Any:
        """Trim the compiled C and NumPy, which do the same; return how it ended and the trim."""
        codes = [np.full(20, code) for code in self.unit_file.scale.codes(np.array(output_V))]
        loads = [round(load / self.count_N) for load in load_N]
        error = round(error_N / self.count_N)
        return trimmed(self.bridge, self.network_file, self.unit_file, codes, loads, error)

    def read(self, output_V: float) -> tuple[int, ...]:
        """Value, lower, upper and flags of the compiled C at rest."""
        code = int(self.unit_file.scale.codes(np.array([output_V]))[0])
        for k in range(15):
            self.bridge.bridge_push(code, 20_000 + 20 * k)
        out = (ctypes.c_int32 * 4)()
        self.bridge.bridge_read(20_280, out)
        return tuple(out)


def trimmed(
    bridge: ctypes.CDLL, network: NetworkFile, unit: UnitFile, codes: list[Any], loads: list[int], error: int
) -> tuple[TrimResult, Trim]:
    contents = network.to_bytes(), unit.to_bytes()
    files = [aligned(content) for content in contents]
    bridge.kept = files  # type: ignore[attr-defined]  # the runtime reads them where they lie
    assert bridge.bridge_open(files[0], len(contents[0]), files[1], len(contents[1]), None) == 0
    bridge.bridge_trim_start()
    for load, samples in enumerate(codes):
        for code in samples:
            bridge.bridge_trim_sample(load, int(code))
    result = TrimResult(bridge.bridge_trim_finish(*loads, error, error))
    output = (ctypes.c_int32 * 6)()
    bridge.bridge_trim(output)
    trim_result = Trim(Shift(output[0], output[1]), (output[2], output[3]), (output[4], output[5]))
    sensor = open_sensor(*contents)
    assert (result, trim_result) == find_trim(sensor, (codes[0], codes[1]), (loads[0], loads[1]), (error, error))
    return result, trim_result


@pytest.fixture(scope="module")
def both(bridge: ctypes.CDLL) -> Both:
    source, unit = press_unit("S0", source_V, 1), press_unit("U1", unit_V, 2).unlabelled
    network = fit_network(source, NetworkConfig(hidden=(16, 8), max_epochs=60)).network
    unit_map = AffineMap(1 / GAIN, -OFFSET_V / GAIN)
    network_file = build_network_file(network, source, AnchorConfig())
    exact = network.evaluate(unit_map.apply(unit.windows))
    record = DeviceRecord("U1", 1, "pass", 0, unit_map, unit, exact - BAND_N, exact + BAND_N, BAND_N)
    unit_file = build_unit_file(record, network, network_file).file
    return Both(FitProblem(source, network, unit), unit_map, network_file, unit_file, bridge)


@pytest.mark.parametrize("load_N", [(0.0, 2.5), (2.8, 0.4), (0.2, 1.5)])
@pytest.mark.parametrize("drift", [(1.15, 0.01), (0.8, -0.03), (1.0, 0.06), (1.3, 0.0)])
def test_the_same_loads_give_the_same_trim(both: Both, load_N: tuple[float, float], drift: tuple[float, float]) -> None:
    output_V = [float(unit_V(load, *drift)) for load in load_N]
    on_pc = both.on_pc(output_V, list(load_N))
    result, on_device = both.on_device(output_V, list(load_N))
    assert result is TrimResult.TRIMMED
    net, low = both.network_file.network, both.unit_file.pivot
    gain = on_device.shift.gain / 2**15
    offset_V = net.input_lsb * (on_device.shift.offset - gain * low) - gain * net.input_zero
    # A source count at each load is what the device resolves.
    apart = abs(source_V(load_N[0]) - source_V(load_N[1]))
    assert gain + 1 == pytest.approx(on_pc.gain, abs=4 * net.input_lsb / apart + 2**-15)
    assert offset_V == pytest.approx(on_pc.offset, abs=4 * net.input_lsb * (1 + 1 / apart))
    levels_N = RANGE_N * (np.arange(LEVELS) + 0.5) / LEVELS
    open_N = NORMAL_90 * np.sqrt(on_pc.variance(interval()))
    open_on_device_N = both.count_N * np.array(
        [on_device.half_width_at(round(level / both.count_N)) for level in levels_N]
    )
    # The band of a device file holds what its integers are off by.
    assert open_on_device_N == pytest.approx(open_N, rel=0.05, abs=6 * both.count_N)


SHAPES = np.random.default_rng(3).integers(-20, 21, (3, TAPS))
ON_WINDOWS = {
    "coarse mix": {"mix": IntegerMix(60, SHAPES, np.array([7, 7, 7]), np.array([192, -128, 64]))},
    "fine mix": {"mix": IntegerMix(62, 40 * SHAPES, np.full(3, 12), np.array([900, -500, 100]))},
    "layer": {"layer": quantise_layer(0.9 * np.eye(TAPS) + 0.005, np.full(TAPS, 300.0), np.ones(TAPS), np.ones(TAPS))},
}


@pytest.mark.parametrize("name", ON_WINDOWS)
def test_what_a_map_does_to_windows_is_seen_through(both: Both, name: str) -> None:
    """The trim acts in front of a mix or a layer: behind it the unit rests where the source does, as on the PC."""
    unit, network = both.unit_file, both.network_file.network
    device_map = DeviceMap(unit.device_map.curve, **ON_WINDOWS[name])
    tests = tuple(replace(one, expected=run_self_test(network, device_map, one)) for one in unit.self_tests)
    changed = replace(both, unit_file=replace(unit, device_map=device_map, self_tests=tests))
    load_N = [0.3, 2.5]
    output_V = [float(unit_V(load, 1.15, 0.02)) for load in load_N]
    result, _ = changed.on_device(output_V, load_N)
    assert result is TrimResult.TRIMMED
    on_pc = both.on_pc(output_V, load_N)
    for output, load in zip(output_V, load_N, strict=True):
        value, lower, upper, _ = changed.read(output)
        mapped = AnchoredMap(both.unit_map, on_pc.gain, on_pc.offset).apply(np.full((1, TAPS), output))
        # Shapes bend a window at rest a little; its mean is where the PC's stands.
        assert value * both.count_N == pytest.approx(both.problem.network.evaluate(mapped)[0], abs=0.05)
        assert lower * both.count_N <= load <= upper * both.count_N


REFUSED = {
    "alike": ([1.0, 1.0001], [0.0, 2.5], TrimResult.ALIKE),
    "loads too close": ([unit_V(1.0), unit_V(1.05)], [1.0, 1.05], TrimResult.ALIKE),
    "reads them already": ([unit_V(0.0), unit_V(2.5)], [0.0, 2.5], TrimResult.NEEDLESS),
    "another sensor": ([unit_V(0.0, 2.2), unit_V(1.0, 2.2)], [0.0, 1.0], TrimResult.TOO_FAR),
    "a weak one": ([unit_V(0.0, 0.5), unit_V(2.5, 0.5)], [0.0, 2.5], TrimResult.TOO_FAR),
    "exchanged": ([unit_V(2.5), unit_V(0.0)], [0.0, 2.5], TrimResult.TOO_FAR),
    "beyond the source": ([unit_V(0.0), unit_V(2.5)], [0.0, 3.5], TrimResult.OUT_OF_RANGE),
    "one load": ([unit_V(0.0), unit_V(2.5)], [1.0, 1.0], TrimResult.TOO_CLOSE),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_one_refuses_the_other_does(both: Both, name: str) -> None:
    output_V, load_N, why = REFUSED[name]
    with pytest.raises(InputError):
        both.on_pc([float(one) for one in output_V], load_N)
    assert both.on_device([float(one) for one in output_V], load_N) == (why, Trim())


def test_after_a_trim_a_sample_is_out_of_range_where_the_trim_has_put_it(both: Both) -> None:
    drift = 1.2, 0.05
    output_V = [float(unit_V(load, *drift)) for load in (0.0, 2.5)]
    assert both.on_device(output_V, [0.0, 2.5])[0] is TrimResult.TRIMMED
    assert not both.read(float(unit_V(2.9, *drift)))[3] & OUT_OF_RANGE
    assert both.read(float(unit_V(2.9, *drift)) + 0.1)[3] & OUT_OF_RANGE
    # Where the unit rested when it was calibrated it is now below its range.
    assert both.read(float(unit_V(0.0)) - 0.005)[3] & OUT_OF_RANGE
    # Beyond the knots the curve shows nothing, wherever the trim puts it.
    assert both.read(float(unit_V(0.0)) - 0.6)[3] & OUT_OF_RANGE


def test_codes_beyond_the_curve_make_no_trim(both: Both) -> None:
    first = float(both.unit_file.scale.outputs(both.unit_file.device_map.curve.codes[:1])[0])  # type: ignore[union-attr]
    assert both.on_device([first - 0.01, float(unit_V(2.5))], [0.0, 2.5])[0] is TrimResult.OUT_OF_RANGE


def test_intervals_after_a_trim_hold_the_truth_as_often_as_they_say(both: Both, rng: np.random.Generator) -> None:
    """Loads that are not what is stated: nine in ten estimates stay within their interval."""
    bands = tuple(replace(band, minus=1, plus=1) for band in both.unit_file.bands)
    narrow = replace(both, unit_file=replace(both.unit_file, bands=bands))
    drift, error_N, load_N, checked_N = (1.1, 0.03), 0.06, (0.5, 2.0), (0.2, 0.5, 1.2, 2.0, 2.7)
    output_V = [float(unit_V(load, *drift)) for load in load_N]
    covered, widths = [], []
    for _ in range(200):
        stated_N = [load + rng.normal(0, error_N) for load in load_N]
        assert narrow.on_device(output_V, stated_N, error_N)[0] is TrimResult.TRIMMED
        for load in checked_N:
            _, lower, upper, _ = narrow.read(float(unit_V(load, *drift)))
            covered.append(lower * narrow.count_N <= load <= upper * narrow.count_N)
            widths.append((upper - lower) / 2 * narrow.count_N)
    assert 0.85 < np.mean(covered) < 0.97
    # Not by being endless: at the loads about 1.645 times what the loads are known to.
    assert np.median(np.reshape(widths, (-1, 5))[:, 1]) < 1.3 * NORMAL_90 * error_N
