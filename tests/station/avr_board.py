"""A sketch of the project, compiled for an ATmega328P with Debian's Arduino core, run in simavr on a pty."""

import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.system_packages import ARDUINO

FIRMWARE = Path(__file__).parents[2] / "firmware"
CORE = Path("/usr/share/arduino/hardware/arduino/avr")
SIMAVR = Path("/usr/include/simavr/sim_avr.h")
SOURCES = """wiring.c wiring_analog.c wiring_digital.c hooks.c main.cpp HardwareSerial.cpp HardwareSerial0.cpp
Print.cpp new.cpp abi.cpp""".split()
TARGET = ["-mmcu=atmega328p", "-std=gnu++11", "-DF_CPU=16000000L", "-DARDUINO=10819"]
BOARD = ["-DARDUINO_AVR_UNO", "-DARDUINO_ARCH_AVR"]
SIZE = ["-Os", "-ffunction-sections", "-fdata-sections", "-Wl,--gc-sections"]
MISSING = f"no simulated Arduino; apt-get install {ARDUINO}"


def can_run() -> bool:
    """Whether compiler, core and simulator are there."""
    return bool(shutil.which("avr-gcc")) and CORE.is_dir() and SIMAVR.exists()


@contextmanager
def running_board(folder: Path, sketch: str, define: str, *arguments: str) -> Iterator[str]:
    """Give the pty of a board that runs a sketch; the arguments are those of `simavr_host.c`."""
    host, program = _compile_host(folder), _compile_sketch(folder, FIRMWARE / sketch, define)
    board = subprocess.Popen([str(host), str(program), *arguments], stdout=subprocess.PIPE, text=True)
    assert board.stdout is not None
    yield next(line for line in board.stdout if line.startswith("/dev/")).strip()
    board.terminate()
    board.wait()
    board.stdout.close()


def _compile_sketch(folder: Path, sketch: Path, define: str) -> Path:
    include = [f"-I{CORE / 'cores' / 'arduino'}", f"-I{CORE / 'variants' / 'standard'}"]
    flags = [*TARGET, *BOARD, *SIZE, *include]
    source, built, program = (folder / f"sketch.{ending}" for ending in ("cpp", "o", "elf"))
    source.write_text("#include <Arduino.h>\n" + sketch.read_text())
    warnings = ["-Wall", "-Wextra", "-Werror", "-Wno-unused-parameter"]
    _run(["avr-gcc", *flags, *warnings, f"-D{define}", "-c", str(source), "-o", str(built)])
    core = [str(CORE / "cores" / "arduino" / name) for name in SOURCES]
    _run(["avr-gcc", *flags, "-w", "-fpermissive", *core, str(built), "-o", str(program)])
    return program


def _compile_host(folder: Path) -> Path:
    source = Path(__file__).with_name("simavr_host.c")
    _run(["gcc", "-O2", str(source), "-o", str(folder / "host"), "-lsimavr", "-lelf"])
    return folder / "host"


def _run(command: list[str]) -> None:
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr[-2000:]
