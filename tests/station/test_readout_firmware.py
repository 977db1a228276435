"""The project's own readout sketch, compiled for an ATmega328P, run in simavr, read by our driver."""

import shutil
import subprocess
import time
from pathlib import Path

import pytest

from softcal.station.clock import HostClock
from softcal.station.drivers.arduino import ArduinoReadout
from softcal.station.tasks.identify import identify
from softcal.station.wire.link import Link
from tests.system_packages import ARDUINO

SKETCH = Path(__file__).parents[2] / "firmware" / "readout" / "readout.ino"
CORE = Path("/usr/share/arduino/hardware/arduino/avr")
SIMAVR = Path("/usr/include/simavr/sim_avr.h")
SOURCES = """wiring.c wiring_analog.c wiring_digital.c hooks.c main.cpp HardwareSerial.cpp HardwareSerial0.cpp
Print.cpp new.cpp abi.cpp""".split()
TARGET = ["-mmcu=atmega328p", "-std=gnu++11", "-DF_CPU=16000000L", "-DARDUINO=10819"]
BOARD = ["-DARDUINO_AVR_UNO", "-DARDUINO_ARCH_AVR"]
SIZE = ["-Os", "-ffunction-sections", "-fdata-sections", "-Wl,--gc-sections"]
CHANNELS = 2
LONGEST_S = 120.0


def compile_sketch(folder: Path) -> Path:
    include = [f"-I{CORE / 'cores' / 'arduino'}", f"-I{CORE / 'variants' / 'standard'}"]
    flags = [*TARGET, *BOARD, *SIZE, *include]
    sketch, built, program = folder / "readout.cpp", folder / "readout.o", folder / "readout.elf"
    sketch.write_text("#include <Arduino.h>\n" + SKETCH.read_text())
    warnings = ["-Wall", "-Wextra", "-Werror", "-Wno-unused-parameter"]
    _run(["avr-gcc", *flags, *warnings, f"-DCHANNELS={CHANNELS}", "-c", str(sketch), "-o", str(built)])
    core = [str(CORE / "cores" / "arduino" / name) for name in SOURCES]
    _run(["avr-gcc", *flags, "-w", "-fpermissive", *core, str(built), "-o", str(program)])
    return program


def compile_host(folder: Path) -> Path:
    source = Path(__file__).with_name("simavr_host.c")
    _run(["gcc", "-O2", str(source), "-o", str(folder / "host"), "-lsimavr", "-lelf"])
    return folder / "host"


def _run(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.fixture(scope="module")
def port(tmp_path_factory, require, require_program):
    """The pty of a running board with 1000 mV at A0 and 2500 mV at A1."""
    require_program("gcc")
    is_there = shutil.which("avr-gcc") and CORE.is_dir() and SIMAVR.exists()
    require(is_there, f"no simulated Arduino; apt-get install {ARDUINO}")
    folder = tmp_path_factory.mktemp("avr")
    board = subprocess.Popen(
        [str(compile_host(folder)), str(compile_sketch(folder)), "1000", "2500"], stdout=subprocess.PIPE, text=True
    )
    yield next(line for line in board.stdout if line.startswith("/dev/")).strip()
    board.terminate()
    board.wait()
    board.stdout.close()


def read(port, count):
    """Read so many samples: simavr may run slower than real time on a busy machine."""
    reader = ArduinoReadout(Link(port, HostClock()), channels=CHANNELS)
    reader.start()
    samples, end_s = [], time.monotonic() + LONGEST_S
    while len(samples) < count:
        assert time.monotonic() < end_s, f"{len(samples)} of {count} samples came within {LONGEST_S} s"
        time.sleep(0.01)
        samples += reader.poll()
    unreadable = reader.unreadable
    reader.close()
    return samples, unreadable


def test_the_sketch_is_read_by_the_driver(port):
    samples, unreadable = read(port, 50)
    assert unreadable == 0
    steps_ms = {round(1000 * (b.device_s - a.device_s)) for a, b in zip(samples, samples[1:], strict=False)}
    assert steps_ms == {20}
    # 10 bits at 5 V: 1000 mV reads 204, 2500 mV reads 511.
    assert samples[-1].values == pytest.approx((204 * 5 / 1023, 511 * 5 / 1023))


def test_the_sketch_is_identified(port):
    device = identify(port, HostClock())
    assert (device.role, device.kind, device.channels) == ("readout", "arduino", CHANNELS)
    assert device.rate_Hz == pytest.approx(50.0)
