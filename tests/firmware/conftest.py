"""Real networks and units as device files, and the compilers that build the runtime."""

import ctypes
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from softcal.core.export.blob import NetworkFile, UnitFile
from softcal.core.export.c_text import network_header, unit_header
from softcal.core.export.compile_map import InputScale
from softcal.core.export.device import DeviceOptions, DeviceRecord, build_network_file, build_unit_file
from softcal.core.maps.affine_map import AffineMap, fit_affine
from softcal.core.maps.config import AnchorConfig
from softcal.core.maps.interface import FitProblem
from softcal.core.network.network import Network
from softcal.core.recording import LabelledRecording, OutputRecording

ROOT = Path(__file__).parents[2]
RUNTIME = ROOT / "firmware" / "softsensor"
WARNINGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")


TOOLS = {
    "m0": ("arm-none-eabi-gcc", "qemu-system-arm"),
    "m4": ("arm-none-eabi-gcc", "qemu-system-arm"),
    "rv32": ("riscv64-unknown-elf-gcc", "qemu-system-riscv32"),
    "uno": ("avr-gcc", "simavr"),
    "mega": ("avr-gcc", "simavr"),
}


@dataclass(frozen=True, eq=False)
class DeviceCase:
    """A network and a unit as files, the float model they stand for, and the unit's recording."""

    network: Network
    unit_map: AffineMap
    network_file: NetworkFile
    unit_file: UnitFile
    recording: OutputRecording

    @property
    def codes(self) -> np.ndarray:
        return self.unit_file.scale.codes(self.recording.output)

    def write(self, folder: Path) -> tuple[Path, Path]:
        network, unit = folder / "network.ssc", folder / "unit.ssc"
        network.write_bytes(self.network_file.to_bytes())
        unit.write_bytes(self.unit_file.to_bytes())
        return network, unit


@pytest.fixture(scope="session")
def real_case(measured_data: Path) -> DeviceCase:
    """The paper's network on its own first sensor, and the second one mapped to it; 10-bit codes as recorded."""
    from softcal.core.network.config import NetworkConfig
    from softcal.core.network.training import fit_network

    source, target = (_recording(measured_data / "egain_pair" / f"{name}.csv", name) for name in ("S1", "S2"))
    network = fit_network(source, NetworkConfig(max_epochs=60)).network
    unit_map = fit_affine(FitProblem(source, network, target.unlabelled))
    network_file = build_network_file(network, source, AnchorConfig())
    estimate = network.evaluate(unit_map.apply(target.windows))
    record = DeviceRecord("S2", 1, "pass", 0, unit_map, target.unlabelled, estimate - 0.4, estimate + 0.5, 0.3)
    options = DeviceOptions(InputScale.from_converter(10, 5.0))
    unit_file = build_unit_file(record, network, network_file, options).file
    return DeviceCase(network, unit_map, network_file, unit_file, target.unlabelled)


def _recording(path: Path, serial: str) -> LabelledRecording:
    table = pd.read_csv(path)
    t_s = np.arange(len(table)) / 50.0
    return LabelledRecording(
        OutputRecording(serial, t_s, table["output_V"].to_numpy(), 50.0), table["force_N"].to_numpy()
    )


@pytest.fixture(scope="session")
def runtime() -> Path:
    """The folder of softsensor.h."""
    return RUNTIME


@pytest.fixture(scope="session")
def examples() -> Path:
    """The folder of the example programs."""
    return ROOT / "firmware" / "examples"


@pytest.fixture(scope="session")
def build(tmp_path_factory: pytest.TempPathFactory, require_program: Callable[..., str]) -> Callable[..., Path]:
    """`build(source, *options)`: compile one C file for this machine with warnings as errors; returns the program."""

    def compile_for_host(source: Path, *options: str) -> Path:
        require_program("gcc")
        program = tmp_path_factory.mktemp("host") / source.stem
        command = ["gcc", *WARNINGS, *options, f"-I{RUNTIME}", str(source), "-o", str(program)]
        process = subprocess.run(command, capture_output=True, text=True)
        assert process.returncode == 0, process.stderr
        return program

    return compile_for_host


@pytest.fixture(scope="session")
def build_checked(build: Callable[..., Path]) -> Callable[..., Path]:
    """`build` with address and undefined-behaviour sanitizers that stop at the first finding."""
    return lambda source, *options: build(source, "-O1", "-g", *SANITIZERS, *options)


@pytest.fixture(scope="session")
def bridge(build: Callable[..., Path]) -> ctypes.CDLL:
    """The runtime with its trim as a library that Python calls; undefined behaviour stops it."""
    trap = ("-fsanitize=undefined", "-fsanitize-undefined-trap-on-error")
    return ctypes.CDLL(str(build(Path(__file__).parent / "bridge.c", "-O2", "-shared", "-fPIC", *trap)))


@dataclass(frozen=True, eq=False)
class Run:
    """What the board printed; `instructions` are cycles on an AVR."""

    estimates: np.ndarray
    numbers: dict[str, int]

    @property
    def instructions(self) -> float:
        return self.numbers["estimate_ticks"] * self.numbers["per_1000_ticks"] / 1000


@pytest.fixture
def run_on_board(require_program: Callable[..., str], examples: Path, tmp_path: Path) -> Callable[..., Run]:
    """`run_on_board(network, unit, codes)`: build the example for a board (default: Cortex-M0) and run it emulated."""

    def run(network: NetworkFile, unit: UnitFile, codes: Any, board: str = "m0", options: str = "-O2") -> Run:
        require_program(*TOOLS[board])
        (tmp_path / "network.h").write_text(network_header(network))
        (tmp_path / "unit.h").write_text(unit_header(unit))
        listed = ",".join(map(str, codes))
        (tmp_path / "codes.h").write_text(f"static const uint16_t SS_TABLE codes[] = {{{listed}}};\n")
        image = tmp_path / "softsensor.elf"
        image.unlink(missing_ok=True)
        process = subprocess.run(
            ["make", "-s", f"BOARD={board}", f"HEADERS={tmp_path}", f"OUT={image}", f"OPTIMISE={options}", "run"],
            cwd=examples / "emulated", capture_output=True, text=True, timeout=300,
        )  # fmt: skip
        assert process.returncode == 0, process.stdout + process.stderr
        lines = [line.split() for line in process.stdout.splitlines() if line]
        estimates = np.array([row[1:] for row in lines if row[0] == "e"], dtype=int)
        numbers = {row[0]: int(row[1]) for row in lines if len(row) == 2 and row[0] != "e"}
        return Run(estimates, numbers)

    return run
