"""Device files: round trips, every check of a loader, and old versions that stay readable."""

import json
import locale
import struct
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softcal.core.errors import UnitRefused
from softcal.core.export.blob import Cause, FileRefused, NetworkFile, UnitFile, serial_field
from softcal.core.export.blob_reader import read_network, read_unit
from softcal.core.export.compile_map import Curve, InputScale, Linear, MapForm
from softcal.core.export.device import DeviceOptions, UnitFacts, build_network_file, build_unit_file
from softcal.core.export.integer_network import DeviceMap, PiecewiseMap
from softcal.core.export.intel_hex import intel_hex
from softcal.core.export.json_text import (
    json_text,
    network_from_values,
    network_values,
    unit_from_values,
    unit_values,
)
from softcal.core.export.loader import open_sensor, run_self_test
from softcal.core.export.quantise import quantise_map
from softcal.core.maps.affine import AffineMap
from softcal.core.network import Network
from softcal.core.recording import LabelledRecording

Press = Callable[..., LabelledRecording]
RELEASED = Path(__file__).parents[1] / "firmware" / "released"


@pytest.fixture
def network_file(linear_network: Network, press: Press) -> NetworkFile:
    return build_network_file(linear_network, press(1, serial="S0"))


@pytest.fixture
def unit_file(linear_network: Network, press: Press, network_file: NetworkFile) -> UnitFile:
    recording = press(2, gain=1.1).unlabelled
    unit_map = AffineMap(1 / 1.1, 0.0)
    estimate = linear_network.evaluate(unit_map.apply(recording.windows))
    facts = UnitFacts("A1", 3, "pass", 1_700_000_000, unit_map, recording, estimate - 0.1, estimate + 0.2, 0.05)
    return build_unit_file(facts, linear_network, network_file, DeviceOptions(adapt_gain=0.05)).file


def _resealed(data: bytes) -> bytes:
    return data[:-4] + struct.pack("<I", zlib.crc32(data[:-4]))


def test_bytes_make_the_same_file_and_the_file_the_same_bytes(network_file: NetworkFile, unit_file: UnitFile) -> None:
    assert read_network(network_file.to_bytes()).to_bytes() == network_file.to_bytes()
    assert read_unit(unit_file.to_bytes()).to_bytes() == unit_file.to_bytes()
    assert read_unit(unit_file.to_bytes()).scale == unit_file.scale


def test_the_largest_curve_fills_one_flash_row(unit_file: UnitFile) -> None:
    knots = PiecewiseMap(np.arange(32) * 2000, np.arange(32) * 1000)
    full = replace(unit_file, device_map=DeviceMap(knots))
    assert len(full.to_bytes()) == 256


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


def _flipped(data: bytes, bit: int) -> bytes:
    changed = bytearray(data)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


@pytest.mark.parametrize(
    ("at", "value", "cause"),
    [(0, 0x58, Cause.MAGIC), (5, 2, Cause.VERSION), (8, 0, Cause.LENGTH), (4, 1, Cause.KIND), (48, 9, Cause.LAYOUT),
     (50, 0, Cause.LAYOUT), (51, 7, Cause.LAYOUT)],
)  # fmt: skip
def test_each_wrong_field_has_its_own_cause(unit_file: UnitFile, at: int, value: int, cause: Cause) -> None:
    data = bytearray(unit_file.to_bytes())
    data[at] = value
    with pytest.raises(FileRefused) as refusal:
        read_unit(_resealed(bytes(data)))
    assert refusal.value.cause is cause


def test_a_network_whose_row_could_overflow_is_refused_though_its_crc_is_right(network_file: NetworkFile) -> None:
    data = bytearray(network_file.to_bytes())
    data[132:136] = struct.pack("<i", 2**31 - 1)  # the bias of the first row
    with pytest.raises(FileRefused, match="accumulator") as refusal:
        read_network(_resealed(bytes(data)))
    assert refusal.value.cause is Cause.LAYOUT


def test_a_network_changed_behind_its_id_is_refused(network_file: NetworkFile) -> None:
    data = bytearray(network_file.to_bytes())
    data[84] ^= 1  # a letter of the output unit
    with pytest.raises(FileRefused) as refusal:
        read_network(_resealed(bytes(data)))
    assert refusal.value.cause is Cause.NETWORK


def test_a_later_minor_version_may_append_what_this_one_skips(unit_file: UnitFile) -> None:
    data = bytearray(unit_file.to_bytes()[:-4] + b"more" + b"crc!")
    data[6] = 1
    data[8:12] = struct.pack("<I", len(data))
    later = read_unit(_resealed(bytes(data)))
    assert later.to_bytes() == unit_file.to_bytes()


def test_a_foreign_network_serial_or_self_test_gives_no_sensor(network_file: NetworkFile, unit_file: UnitFile) -> None:
    network, unit = network_file.to_bytes(), unit_file.to_bytes()
    wrong_test = replace(unit_file.self_tests[0], expected=unit_file.self_tests[0].expected + 1)
    cases = {
        Cause.NETWORK: (replace(unit_file, network_id=b"12345678").to_bytes(), "A1"),
        Cause.SERIAL: (unit, "A2"),
        Cause.SELF_TEST: (replace(unit_file, self_tests=(wrong_test,)).to_bytes(), "A1"),
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
    estimate, lower, upper, flags = sensor.estimate_output(labelled.windows)
    exact = linear_network.evaluate(labelled.windows / 1.1)
    inside = flags == 0
    assert inside.mean() > 0.9
    assert np.abs(estimate - exact)[inside].max() < 0.004
    assert np.all(lower <= estimate) and np.all(estimate <= upper)
    assert np.allclose((upper - estimate)[inside], 0.2, atol=0.005)


@pytest.mark.parametrize("has_curve", [False, True])
def test_a_linear_part_on_windows_carries_its_matrix(
    network_file: NetworkFile,
    unit_file: UnitFile,
    linear_network: Network,
    press: Press,
    rng: np.random.Generator,
    has_curve: bool,
) -> None:
    linear = Linear(np.eye(15) + 0.02 * rng.normal(size=(15, 15)), np.full(15, 0.01))
    curve = Curve(np.array([0.2, 0.6, 1.2]), np.array([0.3, 0.6, 1.0])) if has_curve else None
    form = MapForm(curve, linear)
    device_map = quantise_map(form, unit_file.scale, network_file.network)
    tests = tuple(replace(t, expected=run_self_test(network_file.network, device_map, t)) for t in unit_file.self_tests)
    file = replace(unit_file, device_map=device_map, self_tests=tests)
    sensor = open_sensor(network_file.to_bytes(), file.to_bytes())
    unit_windows = press(2, gain=1.1).windows
    estimate, *_ = sensor.estimate_output(unit_windows)
    exact = np.clip(linear_network.evaluate(form.apply(unit_windows)), file.out_min / 1000, file.out_max / 1000)
    assert np.abs(estimate - exact).max() < 0.02
    assert len(file.to_bytes()) <= 864
    assert unit_from_values(json.loads(json_text(unit_values(file)))).to_bytes() == file.to_bytes()


def test_a_network_too_large_for_the_format_is_refused(press: Press) -> None:
    wide = Network((np.ones((15, 1100)), np.ones((1100, 1))), (np.zeros(1100), np.zeros(1)), 0.5, 0.1, 0.0, 1.0)
    with pytest.raises(UnitRefused, match="15-1100-1 is too large"):
        build_network_file(wide, press(1))


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


def test_files_of_format_1_0_open_for_ever() -> None:
    expected = json.loads((RELEASED / "expected-1.0.json").read_text())
    network = (RELEASED / "network-1.0.ssc").read_bytes()
    for name in ("unit-1.0", "linear-1.0", "both-1.0"):
        sensor = open_sensor(network, (RELEASED / f"{name}.ssc").read_bytes(), "A1")
        codes = np.array(expected["codes"], dtype=np.int64)
        assert sensor.estimate(codes).value.tolist() == expected[name]
