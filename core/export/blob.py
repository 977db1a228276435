"""The binary files `network-<id>.ssc` and `unit-<serial>.ssc`, format 1.0: values ⇄ bytes.

docs/format.md specifies the layout, byte by byte, and the checks of a reader.
"""

import hashlib
import struct
import zlib
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np

from softcal.core.errors import InputError
from softcal.core.export.compile_map import InputScale
from softcal.core.export.integer_network import DeviceMap, IntegerLayer, IntegerNetwork
from softcal.core.lot import escape_serial, unescape_serial
from softcal.core.windows import TAPS

MAGIC = 0x4643_5353
"""The bytes S S C F."""

MAJOR, MINOR = 1, 0
WEIGHTS_INT16 = 1
SERIAL_BYTES = 20
HEADER = struct.Struct("<IBBBBI8sII20s")
NETWORK_FIXED = struct.Struct("<BBBb8HHHIff8s8s32s")
UNIT_FIXED = struct.Struct("<BBBBHHhhffhH")
BAND, SELF_TEST, KNOT, ROW = struct.Struct("<hHH"), struct.Struct("<Hhh"), struct.Struct("<Hh"), struct.Struct("<iHBB")
MIX_FIXED, MIX_ROW = struct.Struct("<BBH"), struct.Struct("<i15hH")
CONDITIONAL, FAILED = 1, 2
HAS_CURVE, HAS_LAYER, HAS_MIX = 1, 2, 4
LEVELS = struct.Struct("<hH25hH")
FORMS = (1, 2, 3, 4, 5)
MAX_LAYERS, MAX_WIDTH, MAX_BANDS, MAX_SELF_TESTS = 7, 1024, 4, 4


class Kind(IntEnum):
    """Kind of a file: network or unit."""

    NETWORK = 1
    UNIT = 2


class RefusalCause(IntEnum):
    """Why a file is refused; the same numbers as `ss_status` in softsensor.h."""

    ALIGNMENT = 1  # noqa: V107
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
    """A calibration file that must not give a number (`cause`: which check failed)."""

    def __init__(self, cause: RefusalCause, text: str) -> None:
        super().__init__(text)
        self.cause = cause


@dataclass(frozen=True)
class SelfTest:
    """A window of TAPS codes start, start + step, ... and the expected estimate before clamping."""

    start: int
    step: int
    expected: int


@dataclass(frozen=True)
class Band:
    """Up to estimate `level` the 90 % interval reaches from -`minus` to +`plus`, in counts."""

    level: int
    minus: int
    plus: int


@dataclass(frozen=True)
class LoadLevels:
    """Output of the source at rest by load, interpolated linearly.

    Args:
        first, step: the least load, and the distance between two, in counts as estimates are.
        counts: the 25 levels, in source counts.
    """

    first: int
    step: int
    counts: tuple[int, ...]

    def at(self, load: int) -> int | None:
        """Return the level under a load, rounded to the nearest count; None beyond the table."""
        k, rest = divmod(load - self.first, self.step)
        if k < 0 or (k, rest) > (len(self.counts) - 1, 0):
            return None
        if rest == 0:
            return self.counts[k]
        rise = self.counts[k + 1] - self.counts[k]
        moved = (abs(rise) * rest + self.step // 2) // self.step
        return self.counts[k] + (moved if rise > 0 else -moved)


@dataclass(frozen=True, eq=False)
class NetworkFile:
    """Shared network in the form of a device; one per lot.

    Args:
        network_sha256: the registry's id of f (hex).
        source_serial: the unit f was trained on.
        period_us: time between two samples of a window in µs.
        output_unit, reference_unit: physical units, at most 8 bytes each.
        levels: of the source, for comparison with known loads.
    """

    network: IntegerNetwork
    network_sha256: str
    source_serial: str
    period_us: int
    output_unit: str
    reference_unit: str
    levels: LoadLevels

    @property
    def gap_ms(self) -> int:
        return longest_step_ms(self.period_us)

    @cached_property
    def _body(self) -> bytes:
        net, sizes = self.network, self.network.sizes
        fixed = NETWORK_FIXED.pack(
            len(net.layers), WEIGHTS_INT16, TAPS, net.output_exponent, *sizes, *[0] * (8 - len(sizes)), self.gap_ms, 0,
            self.period_us, net.input_zero, net.input_lsb,
            _unit_text(self.output_unit), _unit_text(self.reference_unit), bytes.fromhex(self.network_sha256),
        )  # fmt: skip
        levels = LEVELS.pack(self.levels.first, self.levels.step, *self.levels.counts, 0)
        return fixed + b"".join(_layer_bytes(layer) for layer in net.layers) + levels

    @cached_property
    def id(self) -> bytes:
        """First 8 bytes of the SHA-256 of the body, which unit files refer to."""
        return hashlib.sha256(self._body).digest()[:8]

    def to_bytes(self) -> bytes:
        return _pack_file(Kind.NETWORK, 0, self.id, 0, 0, self.source_serial, self._body)


@dataclass(frozen=True, eq=False)
class UnitFile:
    """Calibration of one unit in the form of a device.

    Args:
        network_id: 8 bytes, `NetworkFile.id`.
        revision: of the calibration in the registry; the newest valid one wins on the device.
        time_s: when it was calibrated, Unix time in s; 0 where unknown.
        flags: CONDITIONAL, FAILED or 0.
        scale: output of a code in the sensor's output unit; the device does not need it.
        code_min, code_max: range of codes of the calibration; outside, the estimate is flagged.
        out_min, out_max: the estimate is clamped to these, in counts.
        bands: 1 ... 4, by rising level.
        pivot: mapped sample, in source counts, that the gain of a trim turns about.
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
    pivot: int

    def to_bytes(self) -> bytes:
        """Return the file: at most 256, 512 or 1024 bytes, as the export was asked."""
        form = self.device_map
        knots = 0 if form.curve is None else len(form.curve.codes)
        parts = (HAS_CURVE, form.curve), (HAS_LAYER, form.layer), (HAS_MIX, form.mix)
        fixed = UNIT_FIXED.pack(
            sum(bit for bit, part in parts if part is not None), knots, len(self.bands), len(self.self_tests),
            self.code_min, self.code_max, self.out_min, self.out_max,
            self.scale.zero, self.scale.lsb, self.pivot, 0,
        )  # fmt: skip
        tables = b"".join(BAND.pack(b.level, b.minus, b.plus) for b in self.bands)
        tables += b"".join(SELF_TEST.pack(t.start, t.step, t.expected) for t in self.self_tests)
        body = fixed + tables + b"\0" * (-len(tables) % 4)
        if form.curve is not None:
            body += b"".join(
                KNOT.pack(*map(int, point)) for point in zip(form.curve.codes, form.curve.values, strict=True)
            )
        if form.layer is not None:
            body += _layer_bytes(form.layer)
        if (mix := form.mix) is not None:
            rows = zip(mix.weights.tolist(), mix.shift.tolist(), mix.bias.tolist(), strict=True)
            body += MIX_FIXED.pack(mix.keep, len(mix.bias), 0)
            body += b"".join(MIX_ROW.pack(bias, *weights, shift) for weights, shift, bias in rows)
        return _pack_file(Kind.UNIT, self.flags, self.network_id, self.revision, self.time_s, self.serial, body)


def longest_step_ms(period_us: int) -> int:
    """Return the longest time between two samples of a window: 1.5 periods, rounded up to ms."""
    return -(-3 * period_us // 2000)


def serial_field(serial: str) -> bytes:
    """Return the 20-byte serial of a file.

    Escaped to ASCII; over 20 characters it becomes the first 11, a tilde and 8 hex digits of the SHA-256.
    """
    raw = escape_serial(serial).encode("ascii")
    if len(raw) > SERIAL_BYTES:
        raw = raw[:11] + b"~" + hashlib.sha256(raw).hexdigest()[:8].encode()
    return raw.ljust(SERIAL_BYTES, b"\0")


def decode_serial(field: bytes) -> str:
    """Return the serial of a file's 20 bytes; of a shortened serial its stored part."""
    text = field.rstrip(b"\0").decode("utf-8", errors="replace")
    try:
        return text if text[11:12] == "~" else unescape_serial(text)
    except ValueError:
        return text


def _pack_file(
    kind: Kind, flags: int, network_id: bytes, revision: int, time_s: int, serial: str, body: bytes
) -> bytes:
    length = HEADER.size + len(body) + 4
    header = HEADER.pack(MAGIC, kind, MAJOR, MINOR, flags, length, network_id, revision, time_s, serial_field(serial))
    return header + body + struct.pack("<I", zlib.crc32(header + body))


def _unit_text(unit: str) -> bytes:
    raw = unit.encode()
    if len(raw) > 8:
        raise InputError(f"unit {unit!r} needs {len(raw)} bytes, a calibration file has 8; use a shorter name")
    return raw


def _layer_bytes(layer: IntegerLayer) -> bytes:
    """Row records, then weights in blocks of four rows, column by column; rows padded to 4."""
    rows, columns = layer.shape
    records = b"".join(
        ROW.pack(*map(int, row)) for row in zip(layer.bias, layer.multiplier, layer.shift1, layer.shift2, strict=True)
    )
    missing = -rows % 4
    padded = np.vstack([layer.weights, np.zeros((missing, columns), dtype=np.int64)])
    interleaved = padded.reshape(-1, 4, columns).transpose(0, 2, 1)
    return records + ROW.pack(0, 0, 0, 1) * missing + interleaved.astype("<i2").tobytes()


UNIT_BYTES = (256, 512, 1024)
"""What a unit file may take: one flash row of a SAMD21, two, or four."""
