"""Device files: round trips, every check of a loader, and every form of map."""

import json
import locale
import struct
import subprocess
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softcal.core.errors import UnitRefused
from softcal.core.export.blob import MINOR, FileRefused, NetworkFile, RefusalCause, UnitFile, serial_field
from softcal.core.export.blob_reader import read_network, read_unit
from softcal.core.export.c_text import intel_hex
from softcal.core.export.compile_map import Curve, InputScale, MapForm
from softcal.core.export.device import DeviceOptions, DeviceRecord, build_network_file, build_unit_file
from softcal.core.export.integer_network import DeviceMap, IntegerMix, PiecewiseMap
from softcal.core.export.json_text import (
    json_text,
    network_from_values,
    network_values,
    unit_from_values,
    unit_values,
)
from softcal.core.export.loader import run_self_test
from softcal.core.export.quantise import quantise_map
from softcal.core.export.shape_mix import Mix
from softcal.core.maps.affine_map import AffineMap
from softcal.core.maps.config import AnchorConfig
from softcal.core.network.network import Network
from softcal.core.recording import LabelledRecording
from tests.device_sensor import estimate_output, open_sensor

Press = Callable[..., LabelledRecording]
CONFORMANCE = Path(__file__).parents[2] / "firmware" / "conformance"


@pytest.fixture
def network_file(linear_network: Network, press: Press) -> NetworkFile:
    return build_network_file(linear_network, press(1, serial="S0"), AnchorConfig())


@pytest.fixture
def unit_file(linear_network: Network, press: Press, network_file: NetworkFile) -> UnitFile:
    recording = press(2, gain=1.1).unlabelled
    unit_map = AffineMap(1 / 1.1, 0.0)
    estimate = linear_network.evaluate(unit_map.apply(recording.windows))
    record = DeviceRecord("A1", 3, "pass", 1_700_000_000, unit_map, recording, estimate - 0.1, estimate + 0.2, 0.05)
    return build_unit_file(record, linear_network, network_file, DeviceOptions()).file


def _resealed(data: bytes) -> bytes:
    return data[:-4] + struct.pack("<I", zlib.crc32(data[:-4]))


def test_bytes_make_the_same_file_and_the_file_the_same_bytes(network_file: NetworkFile, unit_file: UnitFile) -> None:
    assert read_network(network_file.to_bytes()).to_bytes() == network_file.to_bytes()
    assert read_unit(unit_file.to_bytes()).to_bytes() == unit_file.to_bytes()
    assert read_unit(unit_file.to_bytes()).scale == unit_file.scale


def test_the_largest_curve_fills_one_flash_row(unit_file: UnitFile) -> None:
    knots = PiecewiseMap(np.arange(32) * 2000, np.arange(32) * 1000)
    full = replace(unit_file, device_map=DeviceMap(knots), bands=unit_file.bands[:1] * 4)
    assert 248 < len(full.to_bytes()) <= 256


def test_json_and_back_gives_the_same_bytes_under_a_decimal_comma(
    network_file: NetworkFile, unit_file: UnitFile, linear_network: Network
) -> None:
    before = locale.setlocale(locale.LC_NUMERIC)
    commas = [name for name in ("de_DE.UTF-8", "fr_FR.UTF-8") if _has_locale(name)]
    locale.setlocale(locale.LC_NUMERIC, commas[0] if commas else before)
    try:
        unit = unit_from_values(json.loads(json_text(unit_values(unit_file))))
        network = network_from_values(json.loads(json_text(network_values(network_file))))
    finally:
        locale.setlocale(locale.LC_NUMERIC, before)
    assert unit.to_bytes() == unit_file.to_bytes()
    assert network.to_bytes() == network_file.to_bytes()


def _has_locale(name: str) -> bool:
    before = locale.setlocale(locale.LC_NUMERIC)
    try:
        locale.setlocale(locale.LC_NUMERIC, name)
    except locale.Error:
        return False
    locale.setlocale(locale.LC_NUMERIC, before)
    return True


def test_every_flipped_bit_and_every_cut_is_refused(network_file: NetworkFile, unit_file: UnitFile) -> None:
    unit, network = unit_file.to_bytes(), network_file.to_bytes()
    damaged = [(read_unit, _flipped(unit, bit)) for bit in range(8 * len(unit))]
    damaged += [(read_unit, unit[:length]) for length in range(len(unit))]
    damaged += [(read_network, _flipped(network, 8 * byte + byte % 8)) for byte in range(len(network))]
    for read, data in damaged:
        with pytest.raises(FileRefused):
            read(data)


def test_a_forged_file_is_refused_or_read_never_a_crash(
    network_file: NetworkFile, unit_file: UnitFile, rng: np.random.Generator
) -> None:
    others = [(CONFORMANCE / name).read_bytes() for name in ("unit-curve-layer.ssc", "unit-mix.ssc")]
    files = [(read_unit, data) for data in (unit_file.to_bytes(), *others)]
    files.append((read_network, network_file.to_bytes()))
    causes = set()
    for read, good in files:
        for _ in range(1500):
            data = np.frombuffer(good, np.uint8)[: rng.integers(40, len(good) + 1)].copy()
            data[rng.integers(0, len(data), 4)] = rng.integers(0, 256, 4)
            sealed = bytearray(data[: len(data) // 4 * 4].tobytes())
            sealed[:12] = good[:8] + struct.pack("<I", len(sealed))
            try:
                read(_resealed(bytes(sealed)))
            except FileRefused as refusal:
                causes.add(refusal.cause)
    assert RefusalCause.LAYOUT in causes


def _flipped(data: bytes, bit: int) -> bytes:
    changed = bytearray(data)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


@pytest.mark.parametrize(
    ("at", "value", "cause"),
    [
        (0, 0x58, RefusalCause.MAGIC),
        (5, 2, RefusalCause.VERSION),
        (8, 0, RefusalCause.LENGTH),
        (4, 1, RefusalCause.KIND),
        (48, 9, RefusalCause.LAYOUT),
        (50, 0, RefusalCause.LAYOUT),
        (51, 7, RefusalCause.LAYOUT),
    ],
)
def test_each_wrong_field_has_its_own_cause(unit_file: UnitFile, at: int, value: int, cause: RefusalCause) -> None:
    data = bytearray(unit_file.to_bytes())
    data[at] = value
    with pytest.raises(FileRefused) as refusal:
        read_unit(_resealed(bytes(data)))
    assert refusal.value.cause is cause


def test_a_network_whose_row_could_overflow_is_refused_though_its_crc_is_right(network_file: NetworkFile) -> None:
    data = bytearray(network_file.to_bytes())
    data[132:136] = struct.pack("<i", 2**31 - 1)  # the bias of the first row
    with pytest.raises(FileRefused) as refusal:
        read_network(_resealed(bytes(data)))
    assert refusal.value.cause is RefusalCause.LAYOUT


def test_a_network_changed_behind_its_id_is_refused(network_file: NetworkFile) -> None:
    data = bytearray(network_file.to_bytes())
    data[84] ^= 1  # a letter of the output unit
    with pytest.raises(FileRefused) as refusal:
        read_network(_resealed(bytes(data)))
    assert refusal.value.cause is RefusalCause.NETWORK


def test_a_later_minor_version_may_append_what_this_one_skips(unit_file: UnitFile) -> None:
    data = bytearray(unit_file.to_bytes()[:-4] + b"more" + b"crc!")
    data[6] = MINOR + 1
    data[8:12] = struct.pack("<I", len(data))
    later = read_unit(_resealed(bytes(data)))
    assert later.to_bytes() == unit_file.to_bytes()


def test_a_foreign_network_serial_or_self_test_gives_no_sensor(network_file: NetworkFile, unit_file: UnitFile) -> None:
    network, unit = network_file.to_bytes(), unit_file.to_bytes()
    wrong_test = replace(unit_file.self_tests[0], expected=unit_file.self_tests[0].expected + 1)
    cases = {
        RefusalCause.NETWORK: (replace(unit_file, network_id=b"12345678").to_bytes(), "A1"),
        RefusalCause.SERIAL: (unit, "A2"),
        RefusalCause.SELF_TEST: (replace(unit_file, self_tests=(wrong_test,)).to_bytes(), "A1"),
    }
    assert open_sensor(network, unit, "A1").unit_file.serial == "A1"
    for cause, (data, serial) in cases.items():
        with pytest.raises(FileRefused) as refusal:
            open_sensor(network, data, serial)
        assert refusal.value.cause is cause


def test_long_serials_stay_apart_in_twenty_bytes() -> None:
    long = [f"LOT-2026-11-LINE-4-UNIT-{k}" for k in range(50)]
    assert len({serial_field(serial) for serial in long}) == 50
    assert serial_field("A1") == b"A1" + bytes(18)
    assert all(len(serial_field(serial)) == 20 and b"~" in serial_field(serial) for serial in long)


def test_estimates_read_back_are_close_to_the_float_ones(
    linear_network: Network, press: Press, network_file: NetworkFile, unit_file: UnitFile
) -> None:
    labelled = press(5, gain=1.1)
    sensor = open_sensor(network_file.to_bytes(), unit_file.to_bytes())
    estimate, lower, upper, flags = estimate_output(sensor, labelled.windows)
    exact = linear_network.evaluate(labelled.windows / 1.1)
    inside = flags == 0
    assert inside.mean() > 0.9
    assert np.abs(estimate - exact)[inside].max() < 0.004
    assert np.all(lower <= estimate) and np.all(estimate <= upper)
    assert np.allclose((upper - estimate)[inside], 0.2, atol=0.005)


def _mix(rng: np.random.Generator, shapes: int) -> Mix:
    """A mix near the identity, of a unit with 0.01 V more at every tap."""
    weights = rng.integers(-127, 128, (shapes, 15))
    return Mix(64, weights, np.full(shapes, 7), np.r_[0.01, np.zeros(shapes - 1)])


@pytest.mark.parametrize("shapes", [1, 5, 6])
def test_a_file_with_a_mix_beside_the_largest_curve_fits_into_two_flash_rows(
    network_file: NetworkFile,
    unit_file: UnitFile,
    linear_network: Network,
    press: Press,
    rng: np.random.Generator,
    shapes: int,
) -> None:
    outputs = np.linspace(0.3, 1.2, 32)
    form = MapForm(Curve(outputs, 0.5 + 0.4 * np.tanh(outputs - 0.5)), _mix(rng, shapes))
    device_map = quantise_map(form, unit_file.scale, network_file.network)
    tests = tuple(replace(t, expected=run_self_test(network_file.network, device_map, t)) for t in unit_file.self_tests)
    bands = (*[replace(unit_file.bands[0], level=k) for k in range(3)], unit_file.bands[-1])
    file = replace(unit_file, device_map=device_map, self_tests=tests, bands=bands)
    assert len(file.to_bytes()) <= 512
    assert file.to_bytes()[5:7] == b"\1\0"
    sensor = open_sensor(network_file.to_bytes(), file.to_bytes())
    unit_windows = press(2, gain=1.1).windows
    estimate, *_ = estimate_output(sensor, unit_windows)
    exact = np.clip(linear_network.evaluate(form.apply(unit_windows)), file.out_min / 1000, file.out_max / 1000)
    assert np.abs(estimate - exact).max() < 0.01
    assert unit_from_values(json.loads(json_text(unit_values(file)))).to_bytes() == file.to_bytes()


def test_a_mix_that_could_overflow_or_leaves_its_fields_is_no_mix(rng: np.random.Generator) -> None:
    weights = rng.integers(-127, 128, (2, 15))
    fine = IntegerMix(64, weights, np.array([6, 6]), np.array([0, 0]))
    assert fine.apply(np.zeros((3, 15), dtype=np.int64)).tolist() == [[0] * 15] * 3
    for broken in (
        {"keep": 256},
        {"weights": weights * 300},
        {"weights": weights[:1]},
        {"shift": np.array([6, 32])},
        {"bias": np.array([0, 2**30])},
        {"weights": np.full((6, 15), 127), "shift": np.zeros(6, dtype=np.int64), "bias": np.zeros(6, dtype=np.int64)},
    ):
        with pytest.raises(ValueError):
            replace(fine, **broken)


def test_no_window_at_all_takes_a_mix_out_of_32_bits(rng: np.random.Generator) -> None:
    # Python's own integers against NumPy's 64 bits, on the windows that reach furthest.
    mix = IntegerMix(255, rng.integers(-127, 128, (5, 15)), np.full(5, 4), rng.integers(-2_000_000, 2_000_000, 5))
    for row in mix.weights:
        window = [32_767 if w > 0 else -32_767 for w in row]
        steps = [
            (sum(int(w) * x for w, x in zip(mix.weights[k], window, strict=True)) >> int(mix.shift[k]))
            + int(mix.bias[k])
            for k in range(5)
        ]
        overflows = []
        for tap in range(-7, 8):
            total = before = 0
            for step in reversed(steps):
                assert abs(tap * total) < 2**31
                total, before = step + (tap * total >> 2) - before, total
            assert abs(total + 255 * window[tap + 7] + 32) < 2**31
            overflows.append(max(-32_767, min(32_767, (total + 255 * window[tap + 7] + 32) >> 6)))
        assert mix.apply(np.array([window])).tolist() == [overflows]


def test_a_network_too_large_for_the_format_is_refused(press: Press) -> None:
    wide = Network((np.ones((15, 1100)), np.ones((1100, 1))), (np.zeros(1100), np.zeros(1)), 0.5, 0.1, 0.0, 1.0)
    with pytest.raises(UnitRefused, match="15-1100-1"):
        build_network_file(wide, press(1), AnchorConfig())


def test_knots_that_fall_on_one_code_are_merged(network_file: NetworkFile) -> None:
    curve = Curve(np.array([0.1, 0.5, 0.5000001, 0.9]), np.array([0.1, 0.5, 0.5, 0.9]))
    device_map = quantise_map(MapForm(curve), InputScale(0.0, 1e-4), network_file.network)
    assert device_map.curve is not None and len(device_map.curve.codes) == 3


@pytest.mark.parametrize("address", [0, 0x1FFF0, 0x3FF00, 0xFFFF_0000])
def test_intel_hex_decodes_to_the_bytes_at_their_address(unit_file: UnitFile, address: int) -> None:
    memory, upper = {}, 0
    for line in intel_hex(unit_file.to_bytes(), address).splitlines():
        raw = bytes.fromhex(line.removeprefix(":"))
        assert sum(raw) % 256 == 0
        count, at, kind, data = raw[0], int.from_bytes(raw[1:3], "big"), raw[3], raw[4:-1]
        assert count == len(data)
        if kind == 4:
            upper = int.from_bytes(data, "big") << 16
        memory |= {upper + at + k: byte for k, byte in enumerate(data) if kind == 0}
    assert bytes(memory[k] for k in sorted(memory)) == unit_file.to_bytes()
    assert min(memory) == address


def test_a_foreign_tool_reads_the_hex_back(
    unit_file: UnitFile, tmp_path: Path, require_program: Callable[..., str]
) -> None:
    require_program("objcopy")
    source, target = tmp_path / "unit.hex", tmp_path / "unit.bin"
    source.write_text(intel_hex(unit_file.to_bytes(), 0x3FF00))
    subprocess.run(["objcopy", "-I", "ihex", "-O", "binary", str(source), str(target)], check=True)
    assert target.read_bytes() == unit_file.to_bytes()
    listed = subprocess.run(["objdump", "-h", str(source)], capture_output=True, text=True, check=True).stdout
    assert "0003ff00" in listed
