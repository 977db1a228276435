"""Does following do harm on the device? The streams of long_use.py through `ss_adapt` of softsensor.h.

    python benchmarks/adapt_device.py [--streams FIRST LAST] [--seed SEED] [--gain SHARE] [--offset SHARE]

Errors with `ss_adapt` over those without it, both by the device's integers. `told` counts streams in which the device
said SS_AT_BOUND at least once. --offset and --gain are what `softcal export --adapt-offset --adapt-gain` allows.
"""

import argparse
import ctypes
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from common.simulated_streams import KINDS, Stream, draw
from common.tables import print_table
from long_use import HARM

from softcal.core.errors import UnitRefused
from softcal.core.export.device import DeviceOptions, UnitFacts, build_network_file, build_unit_file
from softcal.core.maps.affine_map import AffineMap
from softcal.core.recording import Array, Indices
from softcal.core.windows import TAPS

ROOT = Path(__file__).parents[1]
PERIOD_CYCLES = 20
"""Cycles after which the device moves its offset; as the averaging length of the PC."""

AT_BOUND = 2
NO_NUMBER = 3
"""Flags of an estimate that is none: SS_WARM_UP and SS_CLOSED."""


def library(folder: str) -> ctypes.CDLL:
    """Build the runtime as a shared library."""
    built = Path(folder) / "bridge.so"
    source = ROOT / "tests" / "firmware" / "bridge.c"
    flags = ["-O2", "-shared", "-fPIC", "-std=c99", f"-I{ROOT / 'firmware' / 'softsensor'}"]
    subprocess.run(["gcc", *flags, str(source), "-o", str(built)], check=True)
    return ctypes.CDLL(str(built))


def files(stream: Stream, options: DeviceOptions) -> tuple[bytes, bytes, Indices, float]:
    """Return network and unit file, the codes of the stream, and the reference units of a count."""
    bench, network = stream.bench, stream.bench.network
    network_file = build_network_file(network, bench.source)
    unit_map = AffineMap(1.0, 0.0, "identity")
    exact = network.evaluate(unit_map.apply(stream.calibrated.windows))
    facts = UnitFacts("unit", 1, "pass", 0, unit_map, stream.calibrated, exact - 0.1, exact + 0.1, None)
    unit = build_unit_file(facts, network, network_file, options).file
    codes = unit.scale.codes(stream.used.output)
    return network_file.to_bytes(), unit.to_bytes(), codes, 10.0**network_file.network.output_exponent


def aligned(data: bytes) -> ctypes.Array[ctypes.c_uint32]:
    words = -(-len(data) // 4)
    return (ctypes.c_uint32 * words).from_buffer_copy(data.ljust(4 * words, b"\xff"))


def run(
    device: ctypes.CDLL, network: bytes, unit: bytes, codes: Indices, period_ms: int, period: int
) -> tuple[Array, bool]:
    """Return (n,) estimates in counts, NaN where there is none, and whether the device said that it is at a bound."""
    kept = aligned(network), aligned(unit)
    if status := device.bridge_open(kept[0], len(network), kept[1], len(unit), None):
        raise ValueError(f"the device refused its files: {status}")
    found, out, is_told = np.full(len(codes), np.nan), (ctypes.c_int32 * 4)(), False
    for k, code in enumerate(codes.tolist()):
        t_ms = 1000 + period_ms * k
        device.bridge_push(code, t_ms)
        if period:
            is_told |= device.bridge_adapt(code, period) == AT_BOUND
        device.bridge_read(t_ms, out)
        if not out[3] & NO_NUMBER:
            found[k] = out[0]
    return found, is_told


def outcomes(numbers: range, seed: int, options: DeviceOptions) -> Iterator[tuple[str, float, bool]]:
    """Yield kind, error with over error without following, and whether the device said something.

    A unit that no device file holds well enough is left out, as an export leaves it out.
    """
    with tempfile.TemporaryDirectory() as folder:
        device = library(folder)
        for number in numbers:
            stream = draw(number, seed)
            try:
                network, unit, codes, count = files(stream, options)
            except UnitRefused:
                continue
            period_ms = round(1000 / stream.used.sample_rate_Hz)
            errors, told = [], False
            for period in (0, min(65_535, PERIOD_CYCLES * stream.cycle)):
                found, said = run(device, network, unit, codes, period_ms, period)
                wrong = (count * found - stream.load)[TAPS:]
                errors.append(float(np.sqrt(np.nanmean(wrong**2))))
                told |= said
            yield stream.kind, errors[1] / errors[0], told


def table(found: list[tuple[str, float, bool]]) -> Iterator[list[object]]:
    """Yield a row per kind, and one of all."""
    for kind in [*KINDS, "all"]:
        some = [(ratio, told) for name, ratio, told in found if kind in (name, "all")]
        if some:
            ratios = np.array([ratio for ratio, _ in some])
            harmed = [told for ratio, told in some if ratio > HARM]
            silent = len(harmed) - sum(harmed)
            yield [kind, len(some), float(np.median(ratios)), float(ratios.max()), len(harmed), silent]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--streams", type=int, nargs=2, default=(0, 180), metavar=("FIRST", "LAST"))
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--offset", type=float, default=0.1)
    parser.add_argument("--gain", type=float, default=0.0)
    options = parser.parse_args()
    allowed = DeviceOptions(adapt_offset=options.offset, adapt_gain=options.gain)
    header = ["kind", "streams", "median ratio", "worst", f"above {HARM:g}", "of these not told"]
    print_table(header, table(list(outcomes(range(*options.streams), options.seed, allowed))))
