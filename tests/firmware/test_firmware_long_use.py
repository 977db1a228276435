"""Slots and on-device adaptation: an update cut off loses nothing, and what the device changes stays within bounds."""

import ctypes
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from softcal.core.export.blob import UnitFile
from softcal.core.export.loader import open_sensor
from softcal.core.export.stream import Shift, TrimResult, find_trim

WATCHING, ADAPTED, AT_BOUND, NOT_ADAPTABLE = range(4)
SLOT_BYTES = 256


@pytest.fixture(scope="module")
def bridge(build: Callable[..., Path]) -> ctypes.CDLL:
    trap = ("-fsanitize=undefined", "-fsanitize-undefined-trap-on-error")
    return ctypes.CDLL(str(build(Path(__file__).parent / "bridge.c", "-O2", "-shared", "-fPIC", *trap)))


def _aligned(data: bytes) -> Any:
    return (ctypes.c_uint32 * (-(-len(data) // 4))).from_buffer_copy(data.ljust(-(-len(data) // 4) * 4, b"\xff"))


class Device:
    """The runtime behind a few calls; keeps its files alive."""

    def __init__(self, bridge: ctypes.CDLL, network: bytes, unit: bytes) -> None:
        self.bridge, self.network, self.unit = bridge, _aligned(network), _aligned(unit)
        self.status = bridge.bridge_open(self.network, len(network), self.unit, len(unit), None)

    def push(self, codes: np.ndarray, period: int) -> list[int]:
        results = []
        for k, code in enumerate(codes):
            self.bridge.bridge_push(int(code), 20 * k)
            results.append(self.bridge.bridge_adapt(int(code), period))
        return results

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
    old, new, factory = (replace(real_case.unit_file, revision=r) for r in (4, 5, 9))
    assert _open_best(bridge, real_case, [_slot(old), _slot(new), _slot(factory)]) == 1
    assert _open_best(bridge, real_case, [_slot(new), _slot(old), _slot(factory)]) == 0
    assert _open_best(bridge, real_case, [_slot(None), _slot(old), _slot(factory)]) == 1
    assert _open_best(bridge, real_case, [_slot(None), _slot(None), _slot(factory)]) == 2
    assert _open_best(bridge, real_case, [_slot(old), _slot(old), _slot(factory)]) == 0
    assert _open_best(bridge, real_case, [_slot(None)] * 3) == -1


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
    written = update.to_bytes()
    for length in range(len(written)):
        torn = _aligned(written[:length].ljust(SLOT_BYTES, b"\xff"))
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
    device.push(real_case.codes[:20], 10**6)
    assert device.read(20 * 19 + 30)[3] & 4 == 0
    assert device.read(20 * 19 + 31)[3] & 4 == 4
    closed = Device(bridge, real_case.network_file.to_bytes(), b"\0" * 136)
    assert closed.status == 2
    assert closed.read(400) == (0, 0, 0, 2)


def _drifted(case: Any, gain: float, offset_share: float) -> np.ndarray:
    """The unit's recording, looped, with its mapped samples moved by a gain about rest and a share of their span."""
    codes = np.tile(case.codes, 20).astype(float)
    rest, top = np.quantile(codes, [1 / 32, 31 / 32])
    moved = rest + gain * (codes - rest) + offset_share * (top - rest)
    return np.clip(np.rint(moved), 0, 65_535).astype(int)


def _error_mN(device: Device, case: Any, codes: np.ndarray) -> float:
    truth = case.network.evaluate(case.unit_map.apply(case.recording.windows)) * 1000
    found = []
    for k, code in enumerate(codes):
        device.bridge.bridge_push(int(code), 20 * k)
        found.append(device.read(20 * k)[0])
    return float(np.sqrt(np.mean((np.array(found[14:]) - truth) ** 2)))


@pytest.mark.parametrize(("gain", "offset_share"), [(1.0, 0.15), (1.0, -0.15), (1.08, 0.0), (0.95, 0.1)])
def test_drift_within_the_bounds_is_followed(
    bridge: ctypes.CDLL, real_case: Any, gain: float, offset_share: float
) -> None:
    codes = _drifted(real_case, gain, offset_share)
    plain = Device(bridge, real_case.network_file.to_bytes(), real_case.unit_file.to_bytes())
    before = _error_mN(plain, real_case, codes[: len(real_case.codes)])
    device = Device(bridge, real_case.network_file.to_bytes(), real_case.unit_file.to_bytes())
    results = device.push(codes, 3 * len(real_case.codes))
    assert results[-1] in (WATCHING, ADAPTED) and ADAPTED in results
    assert _error_mN(device, real_case, codes[: len(real_case.codes)]) < 0.4 * before


def test_without_drift_adapting_changes_next_to_nothing(bridge: ctypes.CDLL, real_case: Any) -> None:
    device = Device(bridge, real_case.network_file.to_bytes(), real_case.unit_file.to_bytes())
    device.push(_drifted(real_case, 1.0, 0.0), 3 * len(real_case.codes))
    span = real_case.unit_file.adapt.high - real_case.unit_file.adapt.low
    assert abs(bridge.bridge_offset()) < 0.02 * span
    assert abs(bridge.bridge_gain()) < 0.03 * 2**15


def test_drift_beyond_the_bounds_is_held_there_and_told(bridge: ctypes.CDLL, real_case: Any) -> None:
    device = Device(bridge, real_case.network_file.to_bytes(), real_case.unit_file.to_bytes())
    results = device.push(_drifted(real_case, 1.0, 0.6), 3 * len(real_case.codes))
    assert AT_BOUND in results
    assert abs(bridge.bridge_offset()) <= real_case.unit_file.adapt.offset
    assert abs(bridge.bridge_gain()) <= real_case.unit_file.adapt.gain


def test_an_output_that_stands_still_moves_nothing(bridge: ctypes.CDLL, real_case: Any) -> None:
    device = Device(bridge, real_case.network_file.to_bytes(), real_case.unit_file.to_bytes())
    results = device.push(np.full(200_000, real_case.codes[0]), 50_000)
    assert results[-1] == AT_BOUND
    assert abs(bridge.bridge_offset()) <= real_case.unit_file.adapt.offset


def test_a_file_that_allows_no_change_is_never_adapted(bridge: ctypes.CDLL, real_case: Any) -> None:
    fixed = replace(real_case.unit_file, adapt=replace(real_case.unit_file.adapt, gain=0, offset=0))
    device = Device(bridge, real_case.network_file.to_bytes(), fixed.to_bytes())
    assert set(device.push(_drifted(real_case, 1.0, 0.2)[:5000], 1000)) == {NOT_ADAPTABLE}
    assert (bridge.bridge_gain(), bridge.bridge_offset()) == (0, 0)


def _rests(
    case: Any, share: float, gain: float, offset: float, rng: np.random.Generator, count: int = 40, noise: float = 3
) -> np.ndarray:
    """Codes of a unit that has drifted, at rest under a load that fills this share of its range."""
    unit = case.unit_file
    code = unit.code_min + share * (unit.code_max - unit.code_min)
    moved = unit.code_min + gain * (code - unit.code_min) + offset * (unit.code_max - unit.code_min)
    return np.clip(np.rint(moved + rng.normal(0, noise, count)), 0, 65_535).astype(np.int64)


def _trimmed(device: Device, codes: tuple[np.ndarray, ...], loads: tuple[int, int]) -> tuple[TrimResult, Shift]:
    device.bridge.bridge_trim_start()
    for load, samples in enumerate(codes):
        for code in samples:
            device.bridge.bridge_trim_sample(load, int(code))
    result = TrimResult(device.bridge.bridge_trim_finish(*loads))
    return result, Shift(device.bridge.bridge_trim_gain(), device.bridge.bridge_trim_offset())


def test_a_trim_on_the_device_is_that_of_numpy_bit_for_bit(
    bridge: ctypes.CDLL, real_case: Any, rng: np.random.Generator
) -> None:
    network, unit = real_case.network_file.to_bytes(), real_case.unit_file.to_bytes()
    sensor = open_sensor(network, unit)
    seen = set()
    for k in range(300):
        shares, drift = rng.uniform(-0.1, 1.1, 2), (rng.uniform(0.4, 2.0), rng.uniform(-0.4, 0.4))
        codes = tuple(_rests(real_case, share, *drift, rng, int(rng.integers(13, 60))) for share in shares)
        loads = tuple(int(n) for n in rng.integers(-200, 5000, 2))
        if k % 2:  # loads that are really on
            at_rest = np.array([np.full(15, _rests(real_case, share, 1, 0, rng)[0]) for share in shares])
            loads = tuple(sensor.estimate(at_rest).value.tolist())
        found = _trimmed(Device(bridge, network, unit), codes, loads)
        assert found == find_trim(sensor, codes, loads)
        seen.add(found[0])
    assert seen == set(TrimResult)


@pytest.mark.parametrize(("gain", "offset"), [(1.0, 0.12), (1.15, 0.0), (0.85, 0.1), (1.2, -0.1)])
def test_two_known_loads_bring_a_drifted_unit_back(
    bridge: ctypes.CDLL, real_case: Any, rng: np.random.Generator, gain: float, offset: float
) -> None:
    network, unit = real_case.network_file.to_bytes(), real_case.unit_file.to_bytes()
    sensor, device = open_sensor(network, unit), Device(bridge, network, unit)

    def settled(share: float, *drift: float) -> int:
        for k, code in enumerate(_rests(real_case, share, *drift, rng, 15, noise=0)):
            bridge.bridge_push(int(code), 10_000 + 20 * k)
        return device.read(10_300)[0]

    loads = tuple(settled(share, 1.0, 0.0) for share in (0.1, 0.9))
    drifted = tuple(_rests(real_case, share, gain, offset, rng) for share in (0.1, 0.9))
    before = [abs(settled(share, gain, offset) - settled(share, 1.0, 0.0)) for share in (0.1, 0.5, 0.9)]
    fresh = [settled(share, 1.0, 0.0) for share in (0.1, 0.5, 0.9)]
    result, _ = _trimmed(device, drifted, loads)
    assert result is TrimResult.TRIMMED
    assert device.read(10_300)[3] == 1  # the window fills anew
    after = [abs(settled(share, gain, offset) - was) for share, was in zip((0.1, 0.5, 0.9), fresh, strict=True)]
    assert max(after) < 0.25 * max(before)
    assert find_trim(sensor, drifted, loads)[0] is TrimResult.TRIMMED


def test_following_goes_on_from_the_trim(bridge: ctypes.CDLL, real_case: Any, rng: np.random.Generator) -> None:
    """After a trim the unit is where its calibration was: the use that followed finds nothing left to follow."""
    network, unit = real_case.network_file.to_bytes(), real_case.unit_file.to_bytes()
    device = Device(bridge, network, unit)
    codes = _drifted(real_case, 1.0, 0.15)
    span = real_case.unit_file.adapt.high - real_case.unit_file.adapt.low
    rest, top = (float(q) for q in np.quantile(real_case.codes, [1 / 32, 31 / 32]))
    loads = []
    for code in (rest, top):
        for k in range(15):
            bridge.bridge_push(int(code), 10_000 + 20 * k)
        loads.append(device.read(10_300)[0])
    moved = tuple(np.full(20, round(code + 0.15 * (top - rest))) for code in (rest, top))
    assert _trimmed(device, moved, (loads[0], loads[1]))[0] is TrimResult.TRIMMED
    device.push(codes, 3 * len(real_case.codes))
    assert abs(bridge.bridge_offset()) < 0.05 * span
