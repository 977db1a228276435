"""The binary files `network-<id>.ssc` and `unit-<serial>.ssc`, format 1.0: values ⇄ bytes. No file I/O here.

The layout, byte by byte, and what a reader has to check are written down in docs/format.md.
"""

import hashlib
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from softcal.core.errors import InputError
from softcal.core.export.compile_map import InputScale
from softcal.core.export.integer_network import (
    ACTIVATION_MAX,
    CODE_MAX,
    MAX_KNOTS,
    AffineMap,
    DeviceMap,
    IntegerLayer,
    IntegerNetwork,
    PiecewiseMap,
)
from softcal.core.windows import TAPS

MAGIC = 0x4643_5353
"""The bytes S S C F."""

MAJOR, MINOR = 1, 0
WEIGHTS_INT16 = 1
SERIAL_BYTES = 20
HEADER = struct.Struct("<IBBBBI8sII20s")
NETWORK_FIXED = struct.Struct("<BBBb8HHHIff8s8s32s")
UNIT_FIXED = struct.Struct("<BBBBHHhhffhhHH")
BAND, SELF_TEST, KNOT, ROW = struct.Struct("<hHH"), struct.Struct("<Hhh"), struct.Struct("<Hh"), struct.Struct("<iHBB")
CONDITIONAL, FAILED = 1, 2
MAX_LAYERS, MAX_WIDTH, MAX_BANDS, MAX_SELF_TESTS = 7, 1024, 4, 4


class Kind(IntEnum):
    """What a file holds."""

    NETWORK = 1
    UNIT = 2


class Cause(IntEnum):
    """Why a file is refused; the same numbers as `ss_status` in softsensor.h."""

    ALIGNMENT = 1
    MAGIC = 2
    VERSION = 3
    LENGTH = 4
    CRC = 5
    KIND = 6
    NETWORK = 7
    SERIAL = 8
    LAYOUT = 9
    SELF_TEST = 10


class FileRefused(InputError):
    """A calibration file that must not give a number.

    Args:
        cause: which check failed.
    """

    def __init__(self, cause: Cause, text: str) -> None:
        super().__init__(text)
        self.cause = cause


@dataclass(frozen=True)
class SelfTest:
    """A window of codes start, start + step, ... (TAPS of them) and the estimate it must give, before the clamp."""

    start: int
    step: int
    expected: int


@dataclass(frozen=True)
class Band:
    """Up to estimate `level`, the 90 % interval reaches `minus` below and `plus` above the estimate, in counts."""

    level: int
    minus: int
    plus: int


@dataclass(frozen=True)
class AdaptLimits:
    """What the device itself may change in γ during use: two anchor levels in source counts and two bounds.

    Args:
        low, high: levels that the running low and high quantile of mapped samples had at calibration.
        gain: largest change of gain, in 2^-15.
        offset: largest change of offset, in source counts.
    """

    low: int
    high: int
    gain: int
    offset: int


@dataclass(frozen=True, eq=False)
class NetworkFile:
    """The shared network as a device holds it; once per lot.

    Args:
        network: f in integers.
        network_sha256: the registry's id of f (hex).
        source_serial: the unit f was trained on.
        period_us: time between two samples of a window in µs.
        output_unit, reference_unit: physical units, at most 8 bytes each.
    """

    network: IntegerNetwork
    network_sha256: str
    source_serial: str
    period_us: int
    output_unit: str
    reference_unit: str

    @property
    def gap_ms(self) -> int:
        """Longest time between two samples of one window: 1.5 periods, rounded up to the next ms."""
        return -(-3 * self.period_us // 2000)

    @property
    def id(self) -> bytes:
        """First 8 bytes of the SHA-256 of the body: what ties unit files to this file."""
        return hashlib.sha256(_network_body(self)).digest()[:8]

    def to_bytes(self) -> bytes:
        """Return the file."""
        return _sealed(Kind.NETWORK, 0, self.id, 0, 0, self.source_serial, _network_body(self))


@dataclass(frozen=True, eq=False)
class UnitFile:
    """The calibration of one unit as a device holds it.

    Args:
        serial: the unit's serial.
        network_id: 8 bytes, `NetworkFile.id`.
        revision: of the calibration in the registry; the newest valid one wins on the device.
        time_s: when it was calibrated, Unix time in s; 0 where unknown.
        flags: CONDITIONAL, FAILED or 0.
        device_map: γ in integers.
        scale: what a code means in the sensor's output unit; the device does not need it.
        code_min, code_max: codes the unit was seen with; outside, the estimate is flagged.
        out_min, out_max: the estimate is clamped to these, in counts.
        bands: 1 ... 4, by rising level.
        self_tests: 1 ... 4.
        adapt: what the device may change.
    """

    serial: str
    network_id: bytes
    revision: int
    time_s: int
    flags: int
    device_map: DeviceMap
    scale: InputScale
    code_min: int
    code_max: int
    out_min: int
    out_max: int
    bands: tuple[Band, ...]
    self_tests: tuple[SelfTest, ...]
    adapt: AdaptLimits

    def to_bytes(self) -> bytes:
        """Return the file: at most 256 bytes for a per-sample map."""
        body = _unit_body(self)
        return _sealed(Kind.UNIT, self.flags, self.network_id, self.revision, self.time_s, self.serial, body)


def serial_field(serial: str) -> bytes:
    """Return the 20-byte serial of a file.

    A serial over 20 characters becomes its first 11, a tilde and 8 hex digits of its SHA-256; no serial holds a tilde.
    """
    raw = serial.encode("ascii")
    if len(raw) > SERIAL_BYTES:
        raw = raw[:11] + b"~" + hashlib.sha256(raw).hexdigest()[:8].encode()
    return raw.ljust(SERIAL_BYTES, b"\0")


def _sealed(kind: Kind, flags: int, network_id: bytes, revision: int, time_s: int, serial: str, body: bytes) -> bytes:
    length = HEADER.size + len(body) + 4
    header = HEADER.pack(MAGIC, kind, MAJOR, MINOR, flags, length, network_id, revision, time_s, serial_field(serial))
    return header + body + struct.pack("<I", zlib.crc32(header + body))


def _network_body(file: NetworkFile) -> bytes:
    net, sizes = file.network, file.network.sizes
    fixed = NETWORK_FIXED.pack(
        len(net.layers), WEIGHTS_INT16, TAPS, net.output_exponent, *sizes, *[0] * (8 - len(sizes)), file.gap_ms, 0,
        file.period_us, net.input_zero, net.input_lsb,
        _unit_text(file.output_unit), _unit_text(file.reference_unit), bytes.fromhex(file.network_sha256),
    )  # fmt: skip
    return fixed + b"".join(_layer_bytes(layer) for layer in net.layers)


def _unit_text(unit: str) -> bytes:
    raw = unit.encode()
    if len(raw) > 8:
        raise InputError(f"unit {unit!r} needs {len(raw)} bytes, a calibration file has 8; use a shorter name")
    return raw


def _layer_bytes(layer: IntegerLayer) -> bytes:
    """Row records, then weights in blocks of four rows, column by column; rows padded with zeros to a multiple of 4."""
    rows, columns = layer.shape
    records = b"".join(
        ROW.pack(*map(int, row)) for row in zip(layer.bias, layer.multiplier, layer.shift1, layer.shift2, strict=True)
    )
    missing = -rows % 4
    padded = np.vstack([layer.weights, np.zeros((missing, columns), dtype=np.int64)])
    interleaved = padded.reshape(-1, 4, columns).transpose(0, 2, 1)
    return records + ROW.pack(0, 0, 0, 1) * missing + interleaved.astype("<i2").tobytes()


def _unit_body(file: UnitFile) -> bytes:
    form, adapt = file.device_map, file.adapt
    knots = len(form.codes) if isinstance(form, PiecewiseMap) else 0
    fixed = UNIT_FIXED.pack(
        1 if knots else 2, knots, len(file.bands), len(file.self_tests), file.code_min, file.code_max, file.out_min,
        file.out_max, file.scale.zero, file.scale.lsb, adapt.low, adapt.high, adapt.gain, adapt.offset,
    )  # fmt: skip
    tables = b"".join(BAND.pack(b.level, b.minus, b.plus) for b in file.bands)
    tables += b"".join(SELF_TEST.pack(t.start, t.step, t.expected) for t in file.self_tests)
    tables += b"\0" * (-len(tables) % 4)
    if isinstance(form, PiecewiseMap):
        return (
            fixed + tables + b"".join(KNOT.pack(int(c), int(v)) for c, v in zip(form.codes, form.values, strict=True))
        )
    return fixed + tables + _layer_bytes(form.layer)


@dataclass(frozen=True)
class _Opened:
    """A file whose header and CRC are good."""

    flags: int
    minor: int
    network_id: bytes
    revision: int
    time_s: int
    serial: str
    body: bytes


def _open(data: bytes, kind: Kind) -> _Opened:
    name = f"{kind.name.lower()} file"
    if len(data) < HEADER.size + 4:
        raise FileRefused(Cause.LENGTH, f"{name} of {len(data)} bytes is shorter than its header; copy it again")
    magic, found, major, minor, flags, length, network_id, revision, time_s, serial = HEADER.unpack_from(data)
    if magic != MAGIC:
        raise FileRefused(Cause.MAGIC, f"this is no calibration file: it starts with 0x{magic:08x}")
    if major != MAJOR:
        raise FileRefused(Cause.VERSION, f"{name} has format {major}.{minor}, this version of softcal reads {MAJOR}.x")
    if length != len(data) or length % 4:
        raise FileRefused(Cause.LENGTH, f"{name} says {length} bytes and has {len(data)}; copy it again")
    if zlib.crc32(data[:-4]) != struct.unpack_from("<I", data, length - 4)[0]:
        raise FileRefused(Cause.CRC, f"{name} is damaged: its CRC-32 does not match; copy or export it again")
    if found != kind:
        raise FileRefused(Cause.KIND, f"a {name} was expected, this one is of kind {found}")
    return _Opened(flags, minor, network_id, revision, time_s, _text(serial), data[HEADER.size : -4])


def _text(field: bytes) -> str:
    return field.rstrip(b"\0").decode("utf-8", errors="replace")


def _layout(name: str, problem: object) -> FileRefused:
    return FileRefused(Cause.LAYOUT, f"{name} file contradicts itself: {problem}; export it again")


def read_network(data: bytes) -> NetworkFile:
    """Read a network file and check everything in it, the overflow proof included.

    Raises:
        FileRefused: the first check that fails.
    """
    opened = _open(data, Kind.NETWORK)
    try:
        file, end = _parse_network(opened)
    except (ValueError, struct.error, IndexError) as error:
        raise _layout("network", error) from error
    _check_end("network", opened, end)
    if hashlib.sha256(opened.body).digest()[:8] != opened.network_id:
        raise FileRefused(Cause.NETWORK, "network file: its id is not the hash of its body; export it again")
    return file


def _parse_network(opened: _Opened) -> tuple[NetworkFile, int]:
    count, weight_type, taps, exponent, *rest = NETWORK_FIXED.unpack_from(opened.body)
    sizes, (_, _, period_us, zero, lsb, output_unit, reference_unit, sha256) = rest[:8], rest[8:]
    if weight_type != WEIGHTS_INT16 or taps != TAPS or not 1 <= count <= MAX_LAYERS or period_us == 0:
        raise ValueError(f"weight type {weight_type}, {taps} taps, {count} layers, period {period_us} µs")
    if max(sizes) > MAX_WIDTH or min(sizes[: count + 1]) < 1 or not (np.isfinite(zero) and lsb > 0):
        raise ValueError(f"sizes {sizes}, input scale {zero}, {lsb}")
    layers, at = [], NETWORK_FIXED.size
    for columns, rows in zip(sizes[:count], sizes[1 : count + 1], strict=True):
        layer, at = _parse_layer(opened.body, at, rows, columns)
        layers.append(layer)
    network = IntegerNetwork(tuple(layers), zero, lsb, exponent)
    units = _text(output_unit), _text(reference_unit)
    return NetworkFile(network, sha256.hex(), opened.serial, period_us, *units), at


def _parse_layer(body: bytes, at: int, rows: int, columns: int) -> tuple[IntegerLayer, int]:
    padded = rows + -rows % 4
    records = [ROW.unpack_from(body, at + i * ROW.size) for i in range(padded)][:rows]
    start = at + padded * ROW.size
    end = start + padded * columns * 2
    if end > len(body):
        raise ValueError(f"a layer of {rows} × {columns} ends after the file")
    blocks = np.frombuffer(body[start:end], dtype="<i2").reshape(-1, columns, 4)
    weights = blocks.transpose(0, 2, 1).reshape(padded, columns)[:rows].astype(np.int64)
    bias, multiplier, shift1, shift2 = np.array(records, dtype=np.int64).T
    return IntegerLayer(weights, bias, multiplier, shift1, shift2), end


def read_unit(data: bytes) -> UnitFile:
    """Read a unit file and check everything that needs no network.

    Raises:
        FileRefused: the first check that fails.
    """
    opened = _open(data, Kind.UNIT)
    try:
        file, end = _parse_unit(opened)
    except (ValueError, struct.error, IndexError) as error:
        raise _layout("unit", error) from error
    _check_end("unit", opened, end)
    return file


def _parse_unit(opened: _Opened) -> tuple[UnitFile, int]:
    body = opened.body
    form, knots, bands, tests, code_min, code_max, out_min, out_max, *rest = UNIT_FIXED.unpack_from(body)
    zero, lsb, low, high, gain, offset = rest
    if form not in (1, 2) or not 1 <= bands <= MAX_BANDS or not 1 <= tests <= MAX_SELF_TESTS:
        raise ValueError(f"form {form}, {bands} bands, {tests} self-tests")
    if code_min >= code_max or out_min >= out_max:
        raise ValueError(f"codes {code_min} ... {code_max}, estimates {out_min} ... {out_max}")
    at = UNIT_FIXED.size
    band_rows = tuple(Band(*BAND.unpack_from(body, at + i * BAND.size)) for i in range(bands))
    at += bands * BAND.size
    test_rows = tuple(SelfTest(*SELF_TEST.unpack_from(body, at + i * SELF_TEST.size)) for i in range(tests))
    at += tests * SELF_TEST.size
    at += -at % 4
    device_map: DeviceMap
    if form == 1:
        pairs = np.array([KNOT.unpack_from(body, at + i * KNOT.size) for i in range(knots)], dtype=np.int64)
        device_map, at = PiecewiseMap(*pairs.reshape(-1, 2).T), at + knots * KNOT.size
    else:
        layer, at = _parse_layer(body, at, TAPS, TAPS)
        device_map = AffineMap(layer)
    _check_tables(band_rows, test_rows)
    return UnitFile(
        opened.serial, opened.network_id, opened.revision, opened.time_s, opened.flags, device_map,
        InputScale(zero, lsb), code_min, code_max, out_min, out_max, band_rows, test_rows,
        AdaptLimits(low, high, gain, offset),
    ), at  # fmt: skip


def _check_tables(bands: Sequence[Band], tests: Sequence[SelfTest]) -> None:
    levels = [band.level for band in bands]
    if levels != sorted(levels):
        raise ValueError(f"band levels {levels} do not rise")
    for test in tests:
        if not 0 <= test.start + (TAPS - 1) * test.step <= CODE_MAX or abs(test.expected) > ACTIVATION_MAX:
            raise ValueError(f"self-test {test} leaves the range of codes")


def _check_end(name: str, opened: _Opened, end: int) -> None:
    """A later minor version may append; this one ends where it says."""
    if len(opened.body) < end or (opened.minor == MINOR and len(opened.body) != end):
        raise _layout(name, f"its contents end at byte {end} of a body of {len(opened.body)}")


MAX_UNIT_BYTES = (
    HEADER.size
    + UNIT_FIXED.size
    + MAX_BANDS * BAND.size
    + MAX_SELF_TESTS * SELF_TEST.size
    + 4
    + (MAX_KNOTS * KNOT.size)
)
"""256: one flash row of the SAMD21."""
