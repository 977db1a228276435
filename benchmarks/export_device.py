"""What a unit costs on end devices: bytes, memory, instructions (QEMU) or cycles (simavr), and error of the integers.

    python benchmarks/export_device.py [--quick]

Trains the paper's network and smaller ones on the paper's own first sensor (egain_pair), maps the second one to it and
runs its recording through the firmware on a Cortex-M0, a Cortex-M4, an RV32, an Uno and a Mega. Needs
gcc-arm-none-eabi, qemu-system-arm, gcc-riscv64-unknown-elf, qemu-system-misc, gcc-avr, avr-libc and simavr.
"""

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from common.command import parser_of
from common.map_methods import egain
from common.tables import print_table

from softcal.core.export.c_text import network_header, unit_header
from softcal.core.export.compile_map import InputScale
from softcal.core.export.device import DeviceOptions, DeviceRecord, DeviceUnit, build_network_file, build_unit_file
from softcal.core.maps.choose import choose_map
from softcal.core.maps.config import AnchorConfig
from softcal.core.maps.interface import FitProblem
from softcal.core.network.config import NetworkConfig
from softcal.core.network.training import fit_network
from tests.device_sensor import open_sensor

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from tests.firmware.device_stream import DeviceStream  # noqa: E402

HIDDEN = ((120, 70, 35), (48, 24), (32, 16), (16, 8))
CYCLES_PER_INSTRUCTION = 1.36
"""Of a Cortex-M0+ with one flash wait state on a loop of this kind, from a cycle model; a board may differ by 10 %."""

BOARDS = {
    "Cortex-M0": ("m0", 48.0, CYCLES_PER_INSTRUCTION, ("-Os", "-O2", "-O3")),
    "Cortex-M4": ("m4", 64.0, None, ("-O2",)),
    "RV32IMC": ("rv32", 160.0, None, ("-O2",)),
    "Uno": ("uno", 16.0, 1.0, ("-Os",)),
    "Mega": ("mega", 16.0, 1.0, ("-Os",)),
}
"""Name in the Makefile, clock in MHz, cycles per count (None: not modelled), optimisations."""

UNO_FLASH = 32_256
SAMPLES = 60


@dataclass(frozen=True)
class Board:
    """What one emulated run gave; counts are instructions, on an AVR cycles."""

    count: float
    open_count: float
    ram_bytes: int
    stack_bytes: int
    is_identical: bool


def run_on_board(  # type: ignore[no-untyped-def]
    network_file, unit: DeviceUnit, codes: np.ndarray, board: str, optimise: str
) -> Board:
    """Build the example firmware, run it, and hold it against the NumPy reference."""
    counters, estimates = run_program(network_file, unit.file, codes, board, optimise)
    per_tick = counters["per_1000_ticks"] / 1000
    return Board(
        counters["estimate_ticks"] * per_tick,
        counters["open_ticks"] * per_tick,
        counters["ram_bytes"],
        counters["stack_bytes"],
        bool(np.array_equal(estimates, reference(network_file, unit, codes))),
    )


def run_program(  # type: ignore[no-untyped-def]
    network_file, unit_file, codes: np.ndarray, board: str, optimise: str
) -> tuple[dict[str, int], np.ndarray]:
    """Return what the example firmware tells of itself, and (n, 4) value, lower, upper and flags of its samples."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "network.h").write_text(network_header(network_file))
        (Path(folder) / "unit.h").write_text(unit_header(unit_file))
        listed = ",".join(map(str, codes))
        (Path(folder) / "codes.h").write_text(f"static const uint16_t SS_TABLE codes[] = {{{listed}}};\n")
        settings = [f"BOARD={board}", f"HEADERS={folder}", f"OUT={folder}/f.elf", f"OPTIMISE={optimise}"]
        where = ROOT / "firmware" / "examples" / "emulated"
        command = ["make", "-s", *settings, "run"]
        text = subprocess.run(command, cwd=where, capture_output=True, text=True, check=True).stdout
    lines = [line.split() for line in text.splitlines() if line]
    counters = {row[0]: int(row[1]) for row in lines if len(row) == 2 and row[0] != "e"}
    estimates = np.array([row[1:] for row in lines if row[0] == "e"], dtype=int)
    return counters, estimates


def reference(network_file, unit: DeviceUnit, codes: np.ndarray) -> np.ndarray:  # type: ignore[no-untyped-def]
    """The same samples through the NumPy reference."""
    stream = DeviceStream(open_sensor(network_file.to_bytes(), unit.file.to_bytes()))
    rows = []
    for k, code in enumerate(codes):
        stream.push(int(code), 1000 + 20 * k)
        rows.append(stream.read(1000 + 20 * k))
    return np.array(rows)


def rows(quick: bool) -> Iterator[tuple[str, ...]]:
    """One row per network and optimisation."""
    source, target = egain("S1"), egain("S2")
    for hidden in HIDDEN[:: 3 if quick else 1]:
        network = fit_network(source, NetworkConfig(hidden=hidden, max_epochs=20 if quick else 200)).network
        chosen = choose_map(FitProblem(source, network, target.unlabelled)).unit_map
        estimate = network.evaluate(chosen.apply(target.windows))
        network_file = build_network_file(network, source, AnchorConfig())
        record = DeviceRecord("S2", 1, "pass", 0, chosen, target.unlabelled, estimate - 0.4, estimate + 0.4, None)
        unit = build_unit_file(record, network, network_file, DeviceOptions(InputScale.from_converter(10, 5.0)))
        codes = unit.file.scale.codes(target.unlabelled.output)[:SAMPLES]
        for name, (board, clock_MHz, cycles, options) in BOARDS.items():
            if board == "uno" and len(network_file.to_bytes()) > UNO_FLASH / 2:
                continue
            for optimise in options[: 1 if quick else None]:
                run = run_on_board(network_file, unit, codes, board, optimise)
                ms = None if cycles is None else run.count * cycles / clock_MHz / 1000
                time = ("–", "–") if ms is None else (f"{ms:.2f} at {clock_MHz:.0f}", f"{1000 / ms:.0f}")
                yield (
                    "-".join(map(str, network.sizes)), f"{name} {optimise}", f"{len(network_file.to_bytes())}",
                    f"{len(unit.file.to_bytes())}", f"{run.count:.0f}", *time, f"{run.open_count:.0f}",
                    f"{run.ram_bytes} + {run.stack_bytes}", f"{1000 * unit.max_error:.2f}",
                    f"{1000 * unit.rms_error:.2f}", "yes" if run.is_identical else "NO",
                )  # fmt: skip


HEADER = (
    "network | core, gcc | network file, B | unit file, B | instructions (AVR: cycles) per estimate | ms at MHz | "
    "at most, Hz | to open | RAM + stack, B | error max, mN | error rms, mN | bits as NumPy"
)


def main() -> None:
    """Print the table."""
    print_table(HEADER, rows(parser_of(__doc__, "two networks, short training").parse_args().quick))


if __name__ == "__main__":
    main()
