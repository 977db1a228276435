"""Slots and on-device adaptation: an update cut off loses nothing, and what the device changes stays within bounds."""

import ctypes
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from softcal.core.export.blob import UnitFile, serial_field

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


def _choose(bridge: ctypes.CDLL, case: Any, slots: list[Any], serial: str | None = None) -> int:
    network = _aligned(case.network_file.to_bytes())
    key = serial_field(serial) if serial else None
    return bridge.bridge_choose(*slots, SLOT_BYTES, network, key)


def test_the_newest_good_update_wins_and_the_factory_waits(bridge: ctypes.CDLL, real_case: Any) -> None:
    old, new, factory = (replace(real_case.unit_file, revision=r) for r in (4, 5, 9))
    assert _choose(bridge, real_case, [_slot(old), _slot(new), _slot(factory)]) == 1
    assert _choose(bridge, real_case, [_slot(new), _slot(old), _slot(factory)]) == 0
    assert _choose(bridge, real_case, [_slot(None), _slot(old), _slot(factory)]) == 1
    assert _choose(bridge, real_case, [_slot(None), _slot(None), _slot(factory)]) == 2
    assert _choose(bridge, real_case, [_slot(None)] * 3) == -1


def test_a_slot_of_another_unit_or_network_is_no_choice(bridge: ctypes.CDLL, real_case: Any) -> None:
    foreign = _slot(replace(real_case.unit_file, network_id=b"another!", revision=8))
    slots = [foreign, _slot(None), _slot(real_case.unit_file)]
    assert _choose(bridge, real_case, slots) == 2
    assert _choose(bridge, real_case, slots, "S2") == 2
    assert _choose(bridge, real_case, slots, "S3") == -1


def test_an_update_cut_off_at_any_byte_leaves_the_old_calibration(bridge: ctypes.CDLL, real_case: Any) -> None:
    in_use, update = (replace(real_case.unit_file, revision=r) for r in (4, 5))
    written = update.to_bytes()
    for length in range(len(written)):
        torn = _aligned(written[:length].ljust(SLOT_BYTES, b"\xff"))
        assert _choose(bridge, real_case, [_slot(in_use), torn, _slot(None)]) == 0
    assert _choose(bridge, real_case, [_slot(in_use), _slot(update), _slot(None)]) == 1


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
