"""Slots and the trim on the device: an update cut off loses nothing, and known loads bring a drifted unit back."""

import ctypes
from dataclasses import replace
from itertools import permutations
from typing import Any

import numpy as np
import pytest

from softcal.core.export.blob import UnitFile
from softcal.core.export.loader import DeviceSensor
from tests.device_sensor import open_sensor
from tests.firmware.device_stream import DeviceStream, Shift, Trim, TrimResult, find_trim, joined

SLOT_BYTES = 256


def _aligned(data: bytes) -> Any:
    return (ctypes.c_uint32 * (-(-len(data) // 4))).from_buffer_copy(data.ljust(-(-len(data) // 4) * 4, b"\xff"))


class Device:
    """The runtime behind a few calls; keeps its files alive."""

    def __init__(self, bridge: ctypes.CDLL, network: bytes, unit: bytes) -> None:
        self.bridge, self.network, self.unit = bridge, _aligned(network), _aligned(unit)
        self.status = bridge.bridge_open(self.network, len(network), self.unit, len(unit), None)

    def read(self, now_ms: int) -> tuple[int, int, int, int]:
        out = (ctypes.c_int32 * 4)()
        self.bridge.bridge_read(now_ms, out)
        return tuple(out)


def _slot(file: UnitFile | None) -> Any:
    return _aligned((file.to_bytes() if file else b"").ljust(SLOT_BYTES, b"\xff"))


def _open_best(bridge: ctypes.CDLL, case: Any, slots: list[Any], serial: str | None = None) -> int:
    network = _aligned(case.network_file.to_bytes())
    key = serial.encode() if serial else None
    bridge.kept = network, slots  # the runtime reads them where they lie
    return bridge.bridge_open_best(*slots, SLOT_BYTES, network, len(case.network_file.to_bytes()), key)


def test_the_newest_good_update_wins_and_the_factory_waits(bridge: ctypes.CDLL, real_case: Any) -> None:
    factory, old, new = (replace(real_case.unit_file, revision=r) for r in (3, 4, 5))
    assert _open_best(bridge, real_case, [_slot(old), _slot(new), _slot(factory)]) == 1
    assert _open_best(bridge, real_case, [_slot(new), _slot(old), _slot(factory)]) == 0
    assert _open_best(bridge, real_case, [_slot(None), _slot(old), _slot(factory)]) == 1
    assert _open_best(bridge, real_case, [_slot(None), _slot(None), _slot(factory)]) == 2
    assert _open_best(bridge, real_case, [_slot(old), _slot(old), _slot(factory)]) == 0
    assert _open_best(bridge, real_case, [_slot(None)] * 3) == -1


def test_an_older_revision_of_its_own_is_refused_in_whatever_slot_it_lies(bridge: ctypes.CDLL, real_case: Any) -> None:
    revisions = (4, 5, 9)
    files = {revision: replace(real_case.unit_file, revision=revision) for revision in revisions}
    for order in permutations(revisions):
        assert _open_best(bridge, real_case, [_slot(files[one]) for one in order]) == order.index(9), order
    # Also where the newest one was the only one, and the older is written beside it.
    for in_use in range(3):
        slots = [_slot(files[4]) for _ in range(3)]
        slots[in_use] = _slot(files[5])
        assert _open_best(bridge, real_case, slots) == in_use


def test_a_slot_of_another_unit_or_network_is_no_choice(bridge: ctypes.CDLL, real_case: Any) -> None:
    foreign = _slot(replace(real_case.unit_file, network_id=b"another!", revision=8))
    slots = [foreign, _slot(None), _slot(real_case.unit_file)]
    assert _open_best(bridge, real_case, slots) == 2
    assert _open_best(bridge, real_case, slots, "S2") == 2
    assert _open_best(bridge, real_case, slots, "S3") == -1


def test_an_update_that_fails_its_self_test_is_passed_over_and_may_be_written_again(
    bridge: ctypes.CDLL, real_case: Any
) -> None:
    good = real_case.unit_file
    wrong = replace(good.self_tests[0], expected=good.self_tests[0].expected + 1)
    newer = replace(good, revision=7, self_tests=(wrong, *good.self_tests[1:]))
    for slots, expected in (
        ([newer, good, None], 1),
        ([good, newer, None], 0),
        ([newer, newer, good], 2),
        ([newer, newer, newer], -1),
    ):
        in_use = _open_best(bridge, real_case, [_slot(file) for file in slots])
        assert in_use == expected
        assert bridge.bridge_slot_to_write(in_use) != in_use


def test_an_update_cut_off_at_any_byte_leaves_the_old_calibration(bridge: ctypes.CDLL, real_case: Any) -> None:
    in_use, update = (replace(real_case.unit_file, revision=r) for r in (4, 5))
    file_bytes = update.to_bytes()
    for length in range(len(file_bytes)):
        torn = _aligned(file_bytes[:length].ljust(SLOT_BYTES, b"\xff"))
        assert _open_best(bridge, real_case, [_slot(in_use), torn, _slot(None)]) == 0
    assert _open_best(bridge, real_case, [_slot(in_use), _slot(update), _slot(None)]) == 1


def test_no_sensor_and_a_closed_one_give_nothing_anywhere(bridge: ctypes.CDLL, real_case: Any) -> None:
    network, unit = real_case.network_file.to_bytes(), real_case.unit_file.to_bytes()
    assert bridge.bridge_nothing(_aligned(network), len(network), _slot(real_case.unit_file), len(unit)) == 0


@pytest.mark.parametrize(("in_use", "target"), [(0, 1), (1, 0), (2, 0), (-1, 0)])
def test_an_update_never_writes_the_slot_in_use(bridge: ctypes.CDLL, in_use: int, target: int) -> None:
    assert bridge.bridge_slot_to_write(in_use) == target


def test_a_sensor_that_is_silent_is_stale_and_a_closed_one_gives_nothing(bridge: ctypes.CDLL, real_case: Any) -> None:
    device = Device(bridge, real_case.network_file.to_bytes(), real_case.unit_file.to_bytes())
    for k, code in enumerate(real_case.codes[:20]):
        bridge.bridge_push(int(code), 20 * k)
    assert device.read(20 * 19 + 30)[3] & 4 == 0
    assert device.read(20 * 19 + 31)[3] & 4 == 4
    closed = Device(bridge, real_case.network_file.to_bytes(), b"\0" * 136)
    assert closed.status == 2
    assert closed.read(400) == (0, 0, 0, 2)


def _rests(
    case: Any, share: float, gain: float, offset: float, rng: np.random.Generator, count: int = 40, noise: float = 3
) -> np.ndarray:
    """Codes of a unit that has drifted, at rest under a load that fills this share of its range."""
    unit = case.unit_file
    code = unit.code_min + share * (unit.code_max - unit.code_min)
    moved = unit.code_min + gain * (code - unit.code_min) + offset * (unit.code_max - unit.code_min)
    return np.clip(np.rint(moved + rng.normal(0, noise, count)), 0, 65_535).astype(np.int64)


def _load_of(case: Any, code: float) -> int:
    """The load under which the source rests where the unit, as it was calibrated, stands at a code."""
    levels, mapped = case.network_file.levels, case.unit_file.device_map.on_samples(np.array([round(code)]))
    loads = levels.first + levels.step * np.arange(len(levels.counts))
    return round(float(np.interp(mapped[0], levels.counts, loads)))


def _trimmed(
    device: Device, codes: tuple[np.ndarray, ...], loads: tuple[int, int], errors: tuple[int, int] = (0, 0)
) -> tuple[TrimResult, Trim]:
    device.bridge.bridge_trim_start()
    for load, samples in enumerate(codes):
        for code in samples:
            device.bridge.bridge_trim_sample(load, int(code))
    result = TrimResult(device.bridge.bridge_trim_finish(*loads, *errors))
    output = (ctypes.c_int32 * 6)()
    device.bridge.bridge_trim(output)
    gain, offset, *rest = output
    return result, Trim(Shift(gain, offset), (rest[0], rest[1]), (rest[2], rest[3]))


def test_a_trim_on_the_device_is_that_of_numpy_bit_for_bit(
    bridge: ctypes.CDLL, real_case: Any, rng: np.random.Generator
) -> None:
    network, unit = real_case.network_file.to_bytes(), real_case.unit_file.to_bytes()
    sensor = open_sensor(network, unit)
    results = set()
    for k in range(300):
        shares, drift = rng.uniform(-0.1, 1.1, 2), (rng.uniform(0.4, 2.0), rng.uniform(-0.4, 0.4))
        codes = tuple(_rests(real_case, share, *drift, rng, int(rng.integers(13, 60))) for share in shares)
        loads = tuple(int(n) for n in rng.integers(-200, 5000, 2))
        if k % 2:  # loads that are really on
            at_rest = np.array([np.full(15, _rests(real_case, share, 1, 0, rng)[0]) for share in shares])
            loads = tuple(sensor.estimate(at_rest).value.tolist())
        if k % 20 == 1:  # and nothing has moved
            codes = tuple(_rests(real_case, share, 1, 0, rng) for share in shares)
        if k % 10 == 9:
            loads = loads[:1] * 2
        errors = tuple(int(n) for n in rng.integers(0, 17_000 if k % 7 == 0 else 200, 2))
        device = Device(bridge, network, unit)
        on_device = _trimmed(device, codes, loads, errors)
        assert on_device == find_trim(sensor, codes, loads, errors)
        if on_device[0] is TrimResult.TRIMMED:
            _assert_reads_as_numpy(device, sensor, on_device[1], real_case.codes[:30])
        results.add(on_device[0])
    assert results == set(TrimResult)


def _assert_reads_as_numpy(device: Device, sensor: DeviceSensor, trim: Trim, codes: np.ndarray) -> None:
    stream = DeviceStream(sensor, trim)
    for k, code in enumerate(codes):
        device.bridge.bridge_push(int(code), 20_000 + 20 * k)
        stream.push(int(code), 20_000 + 20 * k)
        assert device.read(20_000 + 20 * k) == stream.read(20_000 + 20 * k)


def test_the_interval_of_a_trim_is_that_of_a_line_through_two_points(
    bridge: ctypes.CDLL, real_case: Any, rng: np.random.Generator
) -> None:
    """Against the covariance of a weighted least squares line, in floating point, out to the ends of 16 bits."""
    Device(bridge, real_case.network_file.to_bytes(), real_case.unit_file.to_bytes())
    for _ in range(400):
        loads, half_widths = rng.integers(-32_767, 32_768, 2), rng.integers(1, 65_536 if rng.random() < 0.3 else 500, 2)
        value = int(rng.integers(-32_767, 32_768))
        if loads[0] == loads[1]:
            continue
        trim = Trim(Shift(), (int(loads[0]), int(loads[1])), (int(half_widths[0]), int(half_widths[1])))
        bridge.bridge_set_trim((ctypes.c_int32 * 6)(0, 0, *trim.loads, *trim.half_widths))
        design = np.column_stack([np.ones(2), loads])
        covariance = np.linalg.inv(design.T @ (design / (half_widths[:, None].astype(float) ** 2)))
        line = np.array([1.0, value])
        exact = float(np.sqrt(line @ covariance @ line))
        on_device = bridge.bridge_trim_reach(value)
        assert on_device == trim.half_width_at(value)
        # Rounded up, never down: a count for each load and for the root, two beyond 15 bits.
        assert min(exact, 65_535) - 1e-6 * exact <= on_device <= min(exact + 6, 65_535)


def test_a_root_of_squares_is_exact_at_the_ends_of_its_range(bridge: ctypes.CDLL, rng: np.random.Generator) -> None:
    ends = [0, 1, 2, 180, 32_767, 32_768, 46_340, 46_341, 65_534, 65_535]
    pairs = [(a, b) for a in ends for b in ends] + rng.integers(0, 65_536, (2000, 2)).tolist()
    for a, b in pairs:
        on_device = bridge.bridge_hypot(a, b)
        assert on_device == joined(a, b)
        assert min(np.hypot(a, b), 65_535) - 1e-9 <= on_device <= min(np.hypot(a, b) + 4, 65_535)


def test_what_is_known_of_a_load_widens_the_interval_most_beyond_the_loads(
    bridge: ctypes.CDLL, real_case: Any, rng: np.random.Generator
) -> None:
    network, unit = real_case.network_file.to_bytes(), real_case.unit_file.to_bytes()
    codes = tuple(_rests(real_case, share, 1.0, 0.12, rng) for share in (0.1, 0.9))
    at_rest = tuple(_rests(real_case, share, 1.0, 0.0, rng) for share in (0.1, 0.9))
    loads = tuple(_load_of(real_case, np.median(c)) for c in at_rest)
    half_widths = []
    for error in (0, 50, 200):
        device = Device(bridge, network, unit)
        result, trim = _trimmed(device, codes, loads, (error, error))
        assert result is TrimResult.TRIMMED
        apart = loads[1] - loads[0]
        half_widths.append(
            [
                trim.half_width_at(loads[0]),
                trim.half_width_at(loads[1] + apart),
                trim.half_width_at(loads[1] + 3 * apart),
            ]
        )
    assert np.all(np.diff(half_widths, axis=0) > 0) and np.all(np.diff(half_widths, axis=1) > 0)


@pytest.mark.parametrize(("gain", "offset"), [(1.0, 0.12), (1.15, 0.0), (1.2, 0.1)])
def test_two_known_loads_bring_a_drifted_unit_back(
    bridge: ctypes.CDLL, real_case: Any, rng: np.random.Generator, gain: float, offset: float
) -> None:
    network, unit = real_case.network_file.to_bytes(), real_case.unit_file.to_bytes()
    sensor, device = open_sensor(network, unit), Device(bridge, network, unit)

    def settled(share: float, *drift: float) -> int:
        for k, code in enumerate(_rests(real_case, share, *drift, rng, 15, noise=0)):
            bridge.bridge_push(int(code), 10_000 + 20 * k)
        return device.read(10_300)[0]

    loads = tuple(_load_of(real_case, _rests(real_case, share, 1, 0, rng, noise=0)[0]) for share in (0.1, 0.9))
    drifted = tuple(_rests(real_case, share, gain, offset, rng) for share in (0.1, 0.9))
    before = [abs(settled(share, gain, offset) - settled(share, 1.0, 0.0)) for share in (0.1, 0.5, 0.9)]
    fresh = [settled(share, 1.0, 0.0) for share in (0.1, 0.5, 0.9)]
    result, _ = _trimmed(device, drifted, loads)
    assert result is TrimResult.TRIMMED
    assert device.read(10_300)[3] == 1  # the window fills anew
    after = [abs(settled(share, gain, offset) - was) for share, was in zip((0.1, 0.5, 0.9), fresh, strict=True)]
    assert max(after) < 0.25 * max(before)
    assert find_trim(sensor, drifted, loads, (0, 0))[0] is TrimResult.TRIMMED
