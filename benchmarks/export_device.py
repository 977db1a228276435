"""What a unit costs on an end device: bytes, memory, instructions of a Cortex-M0 in QEMU, and error of the integers.

    python benchmarks/export_device.py [--quick] [--write docs/export_device.md]

Trains the paper's network and smaller ones on the paper's own first sensor (egain_pair), maps the second one to it and
runs its recording through the firmware. Needs gcc-arm-none-eabi and qemu-system-arm.
"""

import argparse
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from map_methods import egain

from softcal.core.export.c_text import network_header, unit_header
from softcal.core.export.compile_map import InputScale
from softcal.core.export.device import DeviceOptions, DeviceUnit, UnitFacts, build_network_file, build_unit_file
from softcal.core.export.loader import DeviceStream, open_sensor
from softcal.core.maps.choose import choose_map
from softcal.core.maps.interface import FitProblem
from softcal.core.network.config import NetworkConfig
from softcal.core.network.training import fit_network

ROOT = Path(__file__).parents[1]
HIDDEN = ((120, 70, 35), (48, 24), (32, 16), (16, 8))
INSTRUCTIONS_PER_TICK = 62.5
CLOCK_MHz = 48.0
CYCLES_PER_INSTRUCTION = 1.36
"""Of a Cortex-M0+ with one flash wait state on a loop of this kind, from a cycle model; a board may differ by 10 %."""

SAMPLES = 200


@dataclass(frozen=True)
class Board:
    """What one run in QEMU gave."""

    instructions: float
    open_instructions: float
    ram_bytes: int
    stack_bytes: int
    is_identical: bool


def run_on_board(network_file, unit: DeviceUnit, codes: np.ndarray, optimise: str) -> Board:  # type: ignore[no-untyped-def]
    """Build the example firmware and run it."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "network.h").write_text(network_header(network_file))
        (Path(folder) / "unit.h").write_text(unit_header(unit.file))
        (Path(folder) / "codes.h").write_text(f"static const uint16_t codes[] = {{{','.join(map(str, codes))}}};\n")
        command = ["make", "-s", f"HEADERS={folder}", f"OUT={folder}/f.elf", f"OPTIMISE={optimise}", "run"]
        where = ROOT / "firmware" / "examples" / "cortex_m0"
        text = subprocess.run(command, cwd=where, capture_output=True, text=True, check=True).stdout
    lines = [line.split() for line in text.splitlines()]
    told = {row[0]: int(row[1]) for row in lines if row[0] != "e"}
    found = np.array([row[1:] for row in lines if row[0] == "e"], dtype=int)
    return Board(
        told["estimate_ticks"] * INSTRUCTIONS_PER_TICK,
        told["open_ticks"] * INSTRUCTIONS_PER_TICK,
        told["ram_bytes"],
        told["stack_bytes"],
        bool(np.array_equal(found, reference(network_file, unit, codes))),
    )


def reference(network_file, unit: DeviceUnit, codes: np.ndarray) -> np.ndarray:  # type: ignore[no-untyped-def]
    """The same samples through the NumPy reference."""
    stream = DeviceStream(open_sensor(network_file.to_bytes(), unit.file.to_bytes()))
    rows = []
    for k, code in enumerate(codes):
        stream.push(int(code), 1000 + 20 * k)
        rows.append(stream.read(1000 + 20 * k))
    return np.array(rows)


def rows(quick: bool) -> list[list[str]]:
    """One row per network and optimisation."""
    source, target = egain("S1"), egain("S2")
    table = []
    for hidden in HIDDEN[:: 3 if quick else 1]:
        network = fit_network(source, NetworkConfig(hidden=hidden, max_epochs=20 if quick else 200)).network
        chosen = choose_map(FitProblem(source, network, target.unlabelled)).unit_map
        estimate = network.evaluate(chosen.apply(target.windows))
        network_file = build_network_file(network, source)
        facts = UnitFacts("S2", 1, "pass", 0, chosen, target.unlabelled, estimate - 0.4, estimate + 0.4, None)
        unit = build_unit_file(facts, network, network_file, DeviceOptions(InputScale.of_converter(10, 5.0)))
        codes = unit.file.scale.codes(target.unlabelled.output)[:SAMPLES]
        for optimise in ("-Os", "-O2", "-O3")[: 1 if quick else 3]:
            board = run_on_board(network_file, unit, codes, optimise)
            ms = board.instructions * CYCLES_PER_INSTRUCTION / CLOCK_MHz / 1000
            table.append([
                "-".join(map(str, network.sizes)), optimise, f"{len(network_file.to_bytes())}",
                f"{len(unit.file.to_bytes())}", f"{board.instructions:.0f}", f"{ms:.2f}", f"{1000 / ms:.0f}",
                f"{ms * 5:.1f}", f"{board.open_instructions:.0f}", f"{board.ram_bytes} + {board.stack_bytes}",
                f"{1000 * unit.max_error:.2f}", f"{1000 * unit.rms_error:.2f}", "yes" if board.is_identical else "NO",
            ])  # fmt: skip
    return table


HEADER = (
    "network", "gcc", "network file, B", "unit file, B", "instructions per estimate", "about ms at 48 MHz", "about Hz",
    "CPU at 50 Hz, %", "instructions to open", "RAM + stack, B", "error max, mN", "error rms, mN", "bits as NumPy",
)  # fmt: skip


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--write", type=Path)
    options = parser.parse_args()
    lines = ["| " + " | ".join(HEADER) + " |", "|" + "---|" * len(HEADER)]
    lines += ["| " + " | ".join(row) + " |" for row in rows(options.quick)]
    text = "\n".join(lines) + "\n"
    print(text)
    if options.write:
        options.write.write_text(text)


if __name__ == "__main__":
    main()
