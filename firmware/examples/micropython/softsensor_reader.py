# ruff: noqa: B905, UP032 - MicroPython's zip has no `strict`, small builds have no f-strings
"""A reader of softcal's calibration files in plain Python, for MicroPython and CPython alike.

Written from docs/format.md alone. On a board:

    import softsensor_reader
    sensor = softsensor_reader.Sensor(open("network.ssc", "rb").read(), open("unit.ssc", "rb").read(), "A1")
    sensor.push(adc.read_u16(), time.ticks_ms())
    value, lower, upper, flags = sensor.read(time.ticks_ms())

On a PC: `python softsensor_reader.py network.ssc unit.ssc [serial] < codes.txt`, a line `time_ms code` per sample; a
line `value lower upper flags` comes out for each. A refused file ends with its cause as exit code.
"""

import binascii
import hashlib
import struct
import sys

TAPS = 15
ALIGNMENT, MAGIC, VERSION, LENGTH, CRC, KIND, NETWORK, SERIAL, LAYOUT, SELF_TEST = range(1, 11)
WARM_UP, CLOSED, STALE, OUT_OF_RANGE, CLAMPED, WRONG_RATE, STUCK = 1, 2, 4, 8, 16, 32, 64
LATEST_MINOR = 0
STUCK_MS = 60000


class Refused(Exception):
    """A file that must not give a number; `cause` as in docs/format.md."""

    def __init__(self, cause, text):
        super().__init__(text)
        self.cause = cause


def clip(x):
    return max(-32767, min(32767, x))


def need(holds, cause, text):
    if not holds:
        raise Refused(cause, text)


class File:
    """A file whose header and CRC are good; `take` reads its body field by field."""

    def __init__(self, data, kind):
        need(len(data) >= 52, LENGTH, "shorter than its header")
        fields = struct.unpack_from("<IBBBBI8sII20s", data, 0)
        magic, found, major, self.minor, self.flags, length, self.network_id, self.revision, self.time_s, name = fields
        need(magic == 0x46435353, MAGIC, "no calibration file")
        need(major == 1, VERSION, "another major version")
        need(length == len(data) and length % 4 == 0, LENGTH, "cut off")
        crc = struct.unpack_from("<I", data, length - 4)[0]
        need(binascii.crc32(data[:-4]) & 0xFFFFFFFF == crc, CRC, "damaged")
        need(found == kind, KIND, "network and unit file mixed up")
        self.serial = name
        self.data, self.at, self.end = data, 48, length - 4

    def take(self, layout):
        size = struct.calcsize("<" + layout)
        need(self.at + size <= self.end, LAYOUT, "ends in the middle")
        fields = struct.unpack_from("<" + layout, self.data, self.at)
        self.at += size
        return fields

    def skip_to_four(self):
        self.at += -self.at % 4

    def finish(self):
        need(self.at <= self.end, LAYOUT, "ends in the middle")
        need(self.at == self.end or self.minor > LATEST_MINOR, LAYOUT, "longer than its contents")


class Layer:
    def __init__(self, file, rows, columns):
        padded = rows + -rows % 4
        self.rows = [file.take("iHBB") for _ in range(padded)][:rows]
        weights = [[] for _ in range(padded)]
        for block in range(0, padded, 4):
            for _ in range(columns):
                for row, weight in enumerate(file.take("4h")):
                    weights[block + row].append(weight)
        self.weights = weights[:rows]
        for (bias, multiplier, shift1, shift2), row in zip(self.rows, self.weights):
            bound = sum(abs(w) for w in row) * 32767 + abs(bias)
            fits = bound < 2**31 and ((bound >> shift1) + 1) * multiplier + (1 << max(shift2 - 1, 0)) < 2**31
            need(fits and shift1 <= 31 and 1 <= shift2 <= 31 and 8192 <= multiplier <= 16383, LAYOUT, "could overflow")

    def apply(self, window, is_rectified):
        out = []
        for (bias, multiplier, shift1, shift2), row in zip(self.rows, self.weights):
            total = bias + sum(w * x for w, x in zip(row, window))
            if is_rectified and total < 0:
                total = 0
            out.append(clip(((total >> shift1) * multiplier + (1 << (shift2 - 1))) >> shift2))
        return out


class Mix:
    def __init__(self, file):
        self.keep, count, _ = file.take("BBH")
        need(1 <= count <= 6, LAYOUT, "shapes of a mix")
        self.shapes = []
        for _ in range(count):
            fields = file.take("i15hH")
            self.shapes.append((fields[1:16], fields[16], fields[0]))
        need(all(shift <= 31 for _, shift, _ in self.shapes), LAYOUT, "shift of a mix")

    def apply(self, window):
        steps = [(sum(w * x for w, x in zip(row, window)) >> shift) + bias for row, shift, bias in self.shapes]
        out = []
        for tap, x in enumerate(window):
            total = before = 0
            for step in reversed(steps):
                total, before = step + ((tap - 7) * total >> 2) - before, total
            out.append(clip((total + self.keep * x + 32) >> 6))
        return out


class Sensor:
    """One unit with its network, opened and proved by its self-tests; then one sample at a time."""

    def __init__(self, network, unit, serial=None):
        net, own = File(network, 1), File(unit, 2)
        need(net.network_id == own.network_id, NETWORK, "calibrated with another network")
        name = serial_field(serial) if serial is not None else own.serial
        need(name == own.serial, SERIAL, "the file of another unit")
        self._read_network(net)
        self._read_unit(own)
        self.trim = (0, 0)
        for start, step, expected in self.tests:
            ring = [self.on_sample(start + step * k) for k in range(TAPS)]
            need(self.raw(ring) == expected, SELF_TEST, "a self-test gives another number")
        self.times, self.last_ms, self.moved_ms, self.last_code, self.is_stuck = [], 0, 0, 0, False
        self.ring, self.codes = [], []

    def _read_network(self, file):
        count, weights, taps, self.exponent = file.take("BBBb")
        sizes = file.take("8H")
        self.gap_ms, _, self.period_us = file.take("HHI")
        file.take("ff8s8s32s")
        need(1 <= count <= 7 and weights == 1 and taps == TAPS, LAYOUT, "layers")
        need(sizes[0] == TAPS and sizes[count] == 1 and self.period_us > 0, LAYOUT, "sizes")
        need(all(1 <= size <= 1024 for size in sizes[: count + 1]), LAYOUT, "sizes")
        self.layers = [Layer(file, sizes[k + 1], sizes[k]) for k in range(count)]
        file.take("hH25hH")
        file.finish()

    def _read_unit(self, file):
        form, knots, bands, tests, self.code_min, self.code_max, self.out_min, self.out_max = file.take("BBBBHHhh")
        _, _, self.pivot, _ = file.take("ffhH")
        need(form in (1, 2, 3, 4, 5) and (2 <= knots <= 32 if form & 1 else knots == 0), LAYOUT, "form")
        need(1 <= bands <= 4 and 1 <= tests <= 4, LAYOUT, "bands or self-tests")
        need(self.code_min < self.code_max and self.out_min < self.out_max, LAYOUT, "ranges")
        self.bands = [file.take("hHH") for _ in range(bands)]
        self.tests = [file.take("Hhh") for _ in range(tests)]
        file.skip_to_four()
        self.knots = [file.take("Hh") for _ in range(knots)]
        self.layer = Layer(file, TAPS, TAPS) if form & 2 else None
        self.mix = Mix(file) if form & 4 else None
        file.finish()

    def on_sample(self, code):
        if not self.knots:
            return max(code - 32768, -32767)
        if code <= self.knots[0][0]:
            return self.knots[0][1]
        for (x0, y0), (x1, y1) in zip(self.knots, self.knots[1:]):
            if code < x1:
                step = (abs(y1 - y0) * (code - x0) + (x1 - x0) // 2) // (x1 - x0)
                return y0 + step if y1 >= y0 else y0 - step
        return self.knots[-1][1]

    def raw(self, ring):
        """The estimate of a window in counts, before the clamp."""
        values = ring
        if self.layer:
            values = self.layer.apply(values, False)
        if self.mix:
            values = self.mix.apply(values)
        for k, layer in enumerate(self.layers):
            values = layer.apply(values, k < len(self.layers) - 1)
        return values[0]

    def push(self, code, t_ms):
        """Take one 16-bit code; a step over 1.5 periods empties the window."""
        if (t_ms - self.last_ms) % 2**32 > self.gap_ms:
            self.ring, self.codes, self.times = [], [], []
        if not self.ring or code != self.last_code:
            self.is_stuck, self.moved_ms = False, t_ms
        elif (t_ms - self.moved_ms) % 2**32 >= STUCK_MS:
            self.is_stuck = True
        gain, offset = self.trim
        y = self.on_sample(code)
        self.ring = (self.ring + [clip(y + offset + ((gain * (y - self.pivot)) >> 15))])[-TAPS:]
        self.codes = (self.codes + [code])[-TAPS:]
        self.times = (self.times + [t_ms])[-TAPS:]
        self.last_ms, self.last_code = t_ms, code

    def read(self, now_ms):
        """Value, lower, upper in counts, and flags; all values 0 where there is no number yet."""
        if len(self.ring) < TAPS:
            return 0, 0, 0, WARM_UP
        raw = self.raw(self.ring)
        value = max(self.out_min, min(self.out_max, raw))
        reaches = [band for band in self.bands if band[0] >= value]
        _, minus, plus = reaches[0] if reaches else self.bands[-1]
        flags = CLAMPED if value != raw else 0
        flags |= STALE if (now_ms - self.last_ms) % 2**32 > self.gap_ms else 0
        flags |= OUT_OF_RANGE if min(self.codes) < self.code_min or max(self.codes) > self.code_max else 0
        flags |= WRONG_RATE if not self._keeps_rate() else 0
        flags |= STUCK if self.is_stuck else 0
        return value, max(value - minus, -32767), min(value + plus, 32767), flags

    def _keeps_rate(self):
        steps = [(b - a) % 2**32 for a, b in zip(self.times, self.times[1:])]
        p = self.period_us
        if min(steps) < (p - 1) // 2000:
            return False
        return sum(steps) + 1 >= 63 * p // 5000 and sum(steps) <= 77 * p // 5000 + 1


def serial_field(serial):
    """A serial as a file has it: 20 bytes, longer ones shortened and ended by a hash."""
    raw = serial.encode()
    if len(raw) > 20:
        digest = binascii.hexlify(hashlib.sha256(raw).digest())
        raw = raw[:11] + b"~" + digest[:8]
    return raw + bytes(20 - len(raw))


def main(arguments):
    with open(arguments[0], "rb") as network, open(arguments[1], "rb") as unit:
        try:
            sensor = Sensor(network.read(), unit.read(), *arguments[2:3])
        except Refused as refusal:
            sys.stderr.write("refused: {} (cause {})\n".format(refusal, refusal.cause))
            return refusal.cause
    for line in sys.stdin:
        t_ms, code = line.split()
        sensor.push(int(code), int(t_ms))
        print(*sensor.read(int(t_ms)))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
