"""Write the conformance vectors: files of a synthetic unit, a stream of samples, and what a reader must answer.

    python firmware/conformance/generate.py [folder]

The files come from softcal's exporter; the expected numbers from firmware/examples/micropython, a reader that was
written from docs/format.md and shares no code with it.
"""

import importlib.util
import struct
import sys
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from softcal.core.export.blob import NetworkFile, UnitFile
from softcal.core.export.compile_map import InputScale
from softcal.core.export.device import DeviceOptions, DeviceRecord, build_network_file, build_unit_file
from softcal.core.export.integer_network import DeviceMap, IntegerMix
from softcal.core.export.loader import run_self_test
from softcal.core.export.quantise import quantise_layer
from softcal.core.maps.affine_map import AffineMap
from softcal.core.maps.config import AnchorConfig
from softcal.core.network.network import Network
from softcal.core.recording import LabelledRecording, OutputRecording

HERE = Path(__file__).parent
READER = HERE.parent / "examples" / "micropython" / "softsensor_reader.py"
RATE_Hz = 2.0
PERIOD_MS = 500
SEED = 21


def synthetic_files() -> tuple[NetworkFile, dict[str, UnitFile]]:
    """One network and one unit with every form of map."""
    rng = np.random.default_rng(SEED)
    t_s = np.arange(600) / RATE_Hz
    output = 0.6 + 0.2 * np.sin(0.3 * t_s) + 0.05 * np.sin(1.1 * t_s)
    sizes = (15, 8, 4, 1)
    weights = tuple(rng.normal(0, np.sqrt(2 / a), (a, b)) for a, b in zip(sizes[:-1], sizes[1:], strict=True))
    network = Network(weights, tuple(rng.normal(0, 0.1, b) for b in sizes[1:]), 0.6, 0.1, 1.0, 0.7)
    recording = OutputRecording("SYN-1", t_s, output, RATE_Hz)
    source = LabelledRecording(OutputRecording("SYN-0", t_s, output, RATE_Hz), np.abs(np.sin(t_s)))
    network_file = build_network_file(network, source, AnchorConfig())
    unit_map = AffineMap(0.9, 0.05)
    exact = network.evaluate(unit_map.apply(recording.windows))
    facts = DeviceRecord("SYN-1", 7, "pass", 1_700_000_000, unit_map, recording, exact - 0.2, exact + 0.3, 0.5)
    curve = build_unit_file(facts, network, network_file, DeviceOptions(InputScale.from_converter(12, 1.2))).file
    return network_file, {name: _with_map(curve, network_file, m) for name, m in _maps(curve, rng).items()}


def _maps(curve: UnitFile, rng: np.random.Generator) -> dict[str, DeviceMap]:
    knots = curve.device_map.curve
    weights, bias = rng.integers(-4000, 4001, (5, 15)), rng.integers(-60_000, 60_000, 5)
    mix = IntegerMix(30, weights, np.full(5, 11), bias)
    matrix = 0.8 * np.eye(15) + 0.02 * rng.normal(size=(15, 15))
    layer = quantise_layer(matrix, rng.normal(0, 500, 15), np.ones(15), np.ones(15))
    return {
        "curve": DeviceMap(knots),
        "mix": DeviceMap(knots, mix=mix),
        "mix-alone": DeviceMap(None, mix=mix),
        "layer": DeviceMap(None, layer),
        "curve-layer": DeviceMap(knots, layer),
    }


def _with_map(unit: UnitFile, network: NetworkFile, device_map: DeviceMap) -> UnitFile:
    tests = tuple(replace(t, expected=run_self_test(network.network, device_map, t)) for t in unit.self_tests)
    margin = (unit.out_max - unit.out_min) // 5  # narrow enough for some estimates to be clamped
    low, high = unit.out_min + margin, unit.out_max - margin
    return replace(unit, device_map=device_map, self_tests=tests, out_min=low, out_max=high)


def stream(unit: UnitFile) -> list[tuple[int, int]]:
    """Samples (time in ms, code): across the wrap of the clock, with gaps, other rates, far codes and a stuck code."""
    rng = np.random.default_rng(SEED)
    steps = [PERIOD_MS] * 60 + [751] + [750] * 20 + [PERIOD_MS] * 15 + [249] * 20 + [PERIOD_MS] * 40
    steps += [100] * 20 + [2000] + [PERIOD_MS] * 180
    t_ms = (2**32 - 25_000 + np.cumsum(steps)) % 2**32
    span = unit.code_max - unit.code_min
    walk = (
        unit.code_min + span * (0.5 + 0.45 * np.sin(np.arange(len(steps)) / 7)) + rng.normal(0, 0.01 * span, len(steps))
    )
    walk[70:75] = [0, 65_535, unit.code_min - 1, unit.code_max + 1, 32_768]
    walk[-150:-20] = walk[-150]
    return [(int(t), int(code)) for t, code in zip(t_ms, np.clip(np.rint(walk), 0, 65_535), strict=True)]


def refusals(network: bytes, unit: bytes) -> dict[str, tuple[int, bytes]]:
    """Damaged and forged unit files, with the cause each must be refused for."""

    def changed(at: int, value: bytes, is_sealed: bool = True) -> bytes:
        data = bytearray(unit)
        data[at : at + len(value)] = value
        return sealed(bytes(data)) if is_sealed else bytes(data)

    tests_at = 72 + 6 * unit[50]
    expected = struct.unpack_from("<h", unit, tests_at + 4)[0]
    longer = bytearray(unit[:-4] + bytes(8))
    longer[8:12] = struct.pack("<I", len(longer))
    return {
        "magic": (2, changed(0, b"X")),
        "version": (3, changed(5, b"\2")),
        "length": (4, unit[:-4]),
        "crc": (5, changed(60, b"\xff", is_sealed=False)),
        "kind": (6, network),
        "network": (7, changed(12, b"\xff\xff")),
        "serial": (8, changed(28, b"SYN-2")),
        "form": (9, changed(48, b"\6")),
        "too-long": (9, sealed(bytes(longer))),
        "self-test": (10, changed(tests_at + 4, struct.pack("<h", expected + 1))),
    }


def sealed(data: bytes) -> bytes:
    """Return the file with a right CRC."""
    return data[:-4] + struct.pack("<I", zlib.crc32(data[:-4]))


def reader():  # type: ignore[no-untyped-def]
    """Load the reader in plain Python."""
    spec = importlib.util.spec_from_file_location("softsensor_reader", READER)
    assert spec is not None and spec.loader is not None  # noqa: S101
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def write(folder: Path) -> None:
    """Write every vector into a folder."""
    network, units = synthetic_files()
    samples = stream(units["curve"])
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "network.ssc").write_bytes(network.to_bytes())
    (folder / "stream.txt").write_text("".join(f"{t_ms} {code}\n" for t_ms, code in samples))
    independent = reader()
    for name, unit in units.items():
        (folder / f"unit-{name}.ssc").write_bytes(unit.to_bytes())
        sensor = independent.Sensor(network.to_bytes(), unit.to_bytes(), "SYN-1")
        lines = []
        for t_ms, code in samples:
            sensor.push(code, t_ms)
            lines.append(" ".join(map(str, sensor.read(t_ms))) + "\n")
        (folder / f"expected-{name}.txt").write_text("".join(lines))
    causes = []
    for name, (cause, data) in refusals(network.to_bytes(), units["curve"].to_bytes()).items():
        (folder / f"refused-{name}.ssc").write_bytes(data)
        causes.append(f"refused-{name}.ssc {cause}\n")
    (folder / "refused.txt").write_text("".join(causes))


if __name__ == "__main__":
    write(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE)
