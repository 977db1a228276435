"""Every file of a unit, every reader, the same windows: are the numbers the same?

    python benchmarks/export_agreement.py REGISTRY.db [--units N]

Exports units of a registry as `softcal export` does, in every format that gives numbers, and reads each file back by
its own way: C on the PC and on emulated boards, the C++ and the MicroPython reader, Intel HEX and JSON back into device
files for the NumPy reader, ONNX in onnxruntime. The windows are those of the unit's own recording. `softcal demo` makes
a registry; with `--hidden 32,16` its network fits an Uno, too. Needs the compilers and emulators of
benchmarks/export_device.py.
"""

import argparse
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import onnxruntime
from adapt_common import print_markdown
from export_device import BOARDS, UNO_FLASH, run_program

from softcal.app.export.calibrated_unit import CalibratedUnit, ExportOptions, UnitLoader
from softcal.app.export.formats import writer_of
from softcal.core.export.json_text import network_from_values, unit_from_values
from softcal.core.export.loader import DeviceSensor, open_sensor
from softcal.core.export.stream import DeviceStream
from softcal.core.recording import Array, Indices
from softcal.core.windows import TAPS, windows
from softcal.db.connection import open_registry

FIRMWARE = Path(__file__).parents[1] / "firmware"
FORMATS = ("blob", "c", "hex", "json", "onnx")
PERIOD_MS, START_MS = 20, 1000


def numpy_rows(network: bytes, unit: bytes, codes: Indices) -> Indices:
    """Return (n, 4) value, lower, upper and flags by the NumPy reader."""
    stream, rows = DeviceStream(open_sensor(network, unit)), []
    for k, code in enumerate(codes):
        stream.push(int(code), START_MS + PERIOD_MS * k)
        rows.append(stream.read(START_MS + PERIOD_MS * k))
    return np.array(rows)


def by_program(command: list[str], folder: Path, files: list[Path], codes: Indices) -> Indices:
    """The same by a program that reads codes from standard input."""
    text = "".join(f"{START_MS + PERIOD_MS * k} {code}\n" for k, code in enumerate(codes))
    command = [*command, *map(str, files)]
    done = subprocess.run(command, input=text, capture_output=True, text=True, check=True, cwd=folder)
    return np.array([line.split() for line in done.stdout.splitlines()], dtype=np.int64)


def programs(folder: Path) -> dict[str, list[str]]:
    """Build the readers of the examples."""
    examples, c, cpp = FIRMWARE / "examples", folder / "c", folder / "cpp"
    flags = ["-O2", f"-I{FIRMWARE / 'softsensor'}"]
    subprocess.run(["gcc", "-std=c99", *flags, examples / "pc" / "softsensor_pc.c", "-o", c], check=True)
    subprocess.run(["g++", "-std=c++17", *flags, examples / "cpp" / "softsensor_reader.cpp", "-o", cpp], check=True)
    python = [sys.executable, str(examples / "micropython" / "softsensor_reader.py")]
    return {"blob, C (gcc, PC)": [str(c)], "blob, C++ reader": [str(cpp)], "blob, MicroPython reader": python}


def hex_bytes(text: bytes) -> bytes:
    """The data of an Intel HEX file."""
    raw = [bytes.fromhex(line.removeprefix(":")) for line in text.decode().splitlines()]
    return b"".join(line[4:-1] for line in raw if line[3] == 0)


def header_bytes(text: bytes) -> bytes:
    """The table of an exported header."""
    words = re.findall(r"0x([0-9a-f]{8})u", text.decode())
    return b"".join(int(word, 16).to_bytes(4, "little") for word in words)


def pairs(files: dict[str, bytes]) -> Iterator[tuple[str, bytes, bytes]]:
    """Yield reader, network file and unit file as each text form gives them back."""
    network, unit = one(files, "network", "hex"), one(files, "unit", "hex")
    yield "hex, NumPy reader", hex_bytes(network), hex_bytes(unit)
    network, unit = one(files, "network", "json"), one(files, "unit", "json")
    file = unit_from_values(json.loads(unit)["device"])
    yield "JSON, NumPy reader", network_from_values(json.loads(network)).to_bytes(), file.to_bytes()
    network, unit = one(files, "network", "h"), one(files, "unit", "h")
    yield "C header, NumPy reader", header_bytes(network), header_bytes(unit)


def one(files: dict[str, bytes], start: str, ending: str) -> bytes:
    """The one file of a name and ending."""
    (found,) = (data for name, data in files.items() if name.startswith(f"{start}-") and name.endswith(f".{ending}"))
    return found


def readings(unit: CalibratedUnit, codes: Indices, folder: Path) -> Iterator[tuple[str, Indices | None]]:
    """Yield each reader with its (n, 4) rows; None where the network does not fit the board."""
    files = {name: data for form in FORMATS for name, data in writer_of(form)(unit).items()}
    for name, data in files.items():
        (folder / name).write_bytes(data)
    network = unit.shared.file.to_bytes()
    blobs = [folder / f"network-{unit.shared.file.id.hex()}.ssc", folder / f"unit-{unit.serial}.ssc"]
    yield "blob, NumPy reader", numpy_rows(blobs[0].read_bytes(), blobs[1].read_bytes(), codes)
    for name, command in programs(folder).items():
        yield name, by_program(command, folder, blobs, codes)
    for name, *both in pairs(files):
        yield name, numpy_rows(both[0], both[1], codes)
    for name, (board, _, _, options) in BOARDS.items():
        fits = board != "uno" or len(network) < UNO_FLASH / 2
        rows = run_program(unit.shared.file, unit.device_unit.file, codes, board, options[0])[1] if fits else None
        yield f"C header, {name}", rows


def rows(unit: CalibratedUnit, count: int) -> Iterator[list[object]]:
    """Yield a row per reader: samples, those equal to NumPy's in all four numbers, differences from f∘γ in float64."""
    sensor = DeviceSensor(unit.shared.file, unit.device_unit.file)
    codes = sensor.unit_file.scale.codes(unit.recording.output[:count])
    output = sensor.unit_file.scale.outputs(codes)
    seen = windows(output)
    exact = unit.network.evaluate(unit.calibration.unit_map.apply(seen))
    with tempfile.TemporaryDirectory() as folder:
        first = numpy_rows(unit.shared.file.to_bytes(), unit.device_unit.file.to_bytes(), codes)
        for name, found in readings(unit, codes, Path(folder)):
            if found is None:
                yield [unit.serial, name, "does not fit", "–", "–", "–"]
                continue
            same = int(np.sum(np.all(found == first, axis=1))) if found.shape == first.shape else 0
            estimate = np.asarray(sensor.count * found[TAPS - 1 :, 0], dtype=np.float64)
            yield [unit.serial, name, len(found), same, *differences(estimate, exact)]
        session = onnxruntime.InferenceSession(Path(folder) / f"unit-{unit.serial}.onnx")
    names = ["estimate", "lower", "upper", "flag"]
    estimate, lower, upper, flag = session.run(names, {"window": seen.astype(np.float32)})
    same_flag = int(np.sum(flag == (first[TAPS - 1 :, 3] & 24)))
    yield [unit.serial, "ONNX, onnxruntime", len(seen), f"flag {same_flag}", *differences(estimate, exact)]
    device = sensor.count * first[TAPS - 1 :, :3]
    apart = np.abs(np.stack([estimate, lower, upper], axis=1) - device).max(axis=0)
    yield [unit.serial, "ONNX against blob: estimate, lower, upper", len(seen), "–", "–", 1000 * float(apart.max())]


def differences(estimate: Array, exact: Array) -> list[object]:
    """Rms and largest difference, in thousandths of the reference unit."""
    apart = 1000 * np.abs(estimate - exact)
    return [float(np.sqrt(np.mean(apart**2))), float(apart.max())]


def table(path: Path, units: int, samples: int) -> Iterator[list[object]]:
    """Yield the rows of units of a registry."""
    with open_registry(f"sqlite:///{path.resolve()}") as registry:
        loader = UnitLoader(registry, ExportOptions(failed_too=True))
        known = [entry.serial for entry in registry.units() if entry.revision is not None]
        for serial in known[:units]:
            yield from rows(loader.load(serial), samples)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("registry", type=Path)
    parser.add_argument("--units", type=int, default=2)
    parser.add_argument("--samples", type=int, default=200)
    options = parser.parse_args()
    header = ["unit", "file and reader", "samples", "as NumPy", "from f∘γ: rms [mN]", "largest [mN]"]
    print_markdown(header, table(options.registry, options.units, options.samples))
