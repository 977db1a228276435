"""Bytes of a file back into values; every check of a reader, as docs/format.md orders them."""

import struct
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from softcal.core.export import blob
from softcal.core.export.blob import FileRefused, Kind, LoadLevels, NetworkFile, RefusalCause, SelfTest, UnitFile
from softcal.core.export.compile_map import InputScale
from softcal.core.export.integer_network import (
    ACTIVATION_MAX,
    CODE_MAX,
    DeviceMap,
    IntegerLayer,
    IntegerMix,
    IntegerNetwork,
    PiecewiseMap,
)
from softcal.core.windows import TAPS


@dataclass(frozen=True)
class _CheckedFile:
    """A file whose header and CRC are good."""

    flags: int
    minor: int
    network_id: bytes
    revision: int
    time_s: int
    serial: str
    body: bytes


def _open(data: bytes, kind: Kind) -> _CheckedFile:
    name = f"{kind.name.lower()} file"
    if len(data) < blob.HEADER.size + 4:
        raise FileRefused(RefusalCause.LENGTH, f"{name} of {len(data)} bytes is shorter than its header; copy it again")
    magic, kind_number, major, minor, flags, length, network_id, revision, time_s, serial = blob.HEADER.unpack_from(
        data
    )
    if magic != blob.MAGIC:
        raise FileRefused(RefusalCause.MAGIC, f"this is no calibration file: it starts with 0x{magic:08x}")
    if major != blob.MAJOR:
        raise FileRefused(
            RefusalCause.VERSION, f"{name} has format {major}.{minor}, this version of softcal reads {blob.MAJOR}.x"
        )
    if length != len(data) or length % 4:
        raise FileRefused(RefusalCause.LENGTH, f"{name} says {length} bytes and has {len(data)}; copy it again")
    if zlib.crc32(data[:-4]) != struct.unpack_from("<I", data, length - 4)[0]:
        raise FileRefused(RefusalCause.CRC, f"{name} is damaged: its CRC-32 does not match; copy or export it again")
    if kind_number != kind:
        raise FileRefused(RefusalCause.KIND, f"a {name} was expected, this one is of kind {kind_number}")
    return _CheckedFile(
        flags, minor, network_id, revision, time_s, blob.decode_serial(serial), data[blob.HEADER.size : -4]
    )


def _text(field: bytes) -> str:
    return field.rstrip(b"\0").decode("utf-8", errors="replace")


def _layout(name: str, problem: object) -> FileRefused:
    return FileRefused(RefusalCause.LAYOUT, f"{name} file contradicts itself: {problem}; export it again")


def read_network(data: bytes) -> NetworkFile:
    """Read a network file and check all of its content, including the overflow proof.

    Raises:
        FileRefused: the first check that fails.
    """
    checked = _open(data, Kind.NETWORK)
    try:
        count, weight_type, taps, exponent, *rest = blob.NETWORK_FIXED.unpack_from(checked.body)
        sizes, (_, _, period_us, zero, lsb, output_unit, reference_unit, sha256) = rest[:8], rest[8:]
        if weight_type != blob.WEIGHTS_INT16 or taps != TAPS or not 1 <= count <= blob.MAX_LAYERS or period_us == 0:
            raise ValueError(f"weight type {weight_type}, {taps} taps, {count} layers, period {period_us} µs")
        if max(sizes) > blob.MAX_WIDTH or min(sizes[: count + 1]) < 1 or not (np.isfinite(zero) and lsb > 0):
            raise ValueError(f"sizes {sizes}, input scale {zero}, {lsb}")
        layers, at = [], blob.NETWORK_FIXED.size
        for columns, rows in zip(sizes[:count], sizes[1 : count + 1], strict=True):
            layer, at = _parse_layer(checked.body, at, rows, columns)
            layers.append(layer)
        network = IntegerNetwork(tuple(layers), zero, lsb, exponent)
        first, step, *counts, _ = blob.LEVELS.unpack_from(checked.body, at)
        levels, at = LoadLevels(first, step, tuple(counts)), at + blob.LEVELS.size
        if not step:
            raise ValueError("levels of the source have no distance")
        units = _text(output_unit), _text(reference_unit)
        file = NetworkFile(network, sha256.hex(), checked.serial, period_us, *units, levels)
    except (ValueError, struct.error, IndexError) as error:
        raise _layout("network", error) from error
    _check_end("network", checked, at)
    if file.id != checked.network_id:
        raise FileRefused(RefusalCause.NETWORK, "network file: its id is not the hash of its body; export it again")
    return file


def _rows(row: struct.Struct, body: bytes, at: int, count: int) -> tuple[list[tuple[Any, ...]], int]:
    """Return rows of one layout from a place on, and the place behind them."""
    return [row.unpack_from(body, at + k * row.size) for k in range(count)], at + count * row.size


def _parse_layer(body: bytes, at: int, rows: int, columns: int) -> tuple[IntegerLayer, int]:
    padded = rows + -rows % 4
    records, start = _rows(blob.ROW, body, at, padded)
    end = start + padded * columns * 2
    if end > len(body):
        raise ValueError(f"a layer of {rows} × {columns} ends after the file")
    blocks = np.frombuffer(body[start:end], dtype="<i2").reshape(-1, columns, 4)
    weights = blocks.transpose(0, 2, 1).reshape(padded, columns)[:rows].astype(np.int64)
    bias, multiplier, shift1, shift2 = np.array(records[:rows], dtype=np.int64).T
    return IntegerLayer(weights, bias, multiplier, shift1, shift2), end


def read_unit(data: bytes) -> UnitFile:
    """Read a unit file, checked without its network (`FileRefused`: the first check that fails)."""
    checked = _open(data, Kind.UNIT)
    try:
        body = checked.body
        form, knots, bands, tests, code_min, code_max, out_min, out_max, *rest = blob.UNIT_FIXED.unpack_from(body)
        zero, lsb, pivot, _ = rest
        if form not in blob.FORMS or (knots > 0) != bool(form & blob.HAS_CURVE):
            raise ValueError(f"form {form} with {knots} knots")
        if not 1 <= bands <= blob.MAX_BANDS or not 1 <= tests <= blob.MAX_SELF_TESTS:
            raise ValueError(f"{bands} bands, {tests} self-tests")
        if code_min >= code_max or out_min >= out_max:
            raise ValueError(f"codes {code_min} ... {code_max}, estimates {out_min} ... {out_max}")
        band_rows, at = _rows(blob.BAND, body, blob.UNIT_FIXED.size, bands)
        test_rows, at = _rows(blob.SELF_TEST, body, at, tests)
        file_bands = tuple(blob.Band(*row) for row in band_rows)
        file_tests = tuple(SelfTest(*row) for row in test_rows)
        at += -at % 4
        curve, layer, mix = None, None, None
        if form & blob.HAS_CURVE:
            points, at = _rows(blob.KNOT, body, at, knots)
            curve = PiecewiseMap(*np.array(points, dtype=np.int64).reshape(-1, 2).T)
        if form & blob.HAS_LAYER:
            layer, at = _parse_layer(body, at, TAPS, TAPS)
        if form & blob.HAS_MIX:
            mix, at = _parse_mix(body, at)
        device_map = DeviceMap(curve, layer, mix)
        levels = [band.level for band in file_bands]
        if levels != sorted(levels):
            raise ValueError(f"band levels {levels} do not rise")
        for test in file_tests:
            if not 0 <= test.start + (TAPS - 1) * test.step <= CODE_MAX or abs(test.expected) > ACTIVATION_MAX:
                raise ValueError(f"self-test {test} leaves the range of codes")
        file = UnitFile(
            checked.serial, checked.network_id, checked.revision, checked.time_s, checked.flags, device_map,
            InputScale(zero, lsb), code_min, code_max, out_min, out_max, file_bands, file_tests, pivot,
        )  # fmt: skip
    except (ValueError, struct.error, IndexError) as error:
        raise _layout("unit", error) from error
    _check_end("unit", checked, at)
    return file


def _parse_mix(body: bytes, at: int) -> tuple[IntegerMix, int]:
    keep, count, _ = blob.MIX_FIXED.unpack_from(body, at)
    rows, end = _rows(blob.MIX_ROW, body, at + blob.MIX_FIXED.size, count)
    table = np.array(rows, dtype=np.int64).reshape(-1, TAPS + 2)
    return IntegerMix(keep, table[:, 1 : TAPS + 1], table[:, TAPS + 1], table[:, 0]), end


def _check_end(name: str, checked: _CheckedFile, end: int) -> None:
    """Check the end of the body: a later minor version may append, earlier versions end at their last field."""
    if len(checked.body) < end or (checked.minor <= blob.MINOR and len(checked.body) != end):
        raise _layout(name, f"its contents end at byte {end} of a body of {len(checked.body)}")
