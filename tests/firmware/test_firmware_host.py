"""The runtime on this machine, under the sanitizers: NumPy's integers, and no number from a bad file."""

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from softcal.core.export.c_text import network_header, unit_header
from softcal.core.export.loader import CLAMPED, OUT_OF_RANGE, STUCK, WARM_UP, WRONG_RATE
from softcal.core.export.quantise import evaluate_float64
from tests.device_sensor import estimate_output, open_sensor
from tests.firmware.device_stream import DeviceStream

Build = Callable[..., Path]
CONFORMANCE = Path(__file__).parents[2] / "firmware" / "conformance"


@pytest.fixture(scope="module")
def program(build_checked: Build, examples: Path) -> Path:
    return build_checked(examples / "pc" / "softsensor_pc.c")


def _run(program: Path, network: Path, unit: Path, samples: list[tuple[int, int]], *serial: str) -> tuple[int, Any]:
    text = "".join(f"{t_ms} {code}\n" for t_ms, code in samples)
    command = [str(program), str(network), str(unit), *serial]
    process = subprocess.run(command, input=text, capture_output=True, text=True)
    assert "runtime error" not in process.stderr and "Sanitizer" not in process.stderr
    return process.returncode, np.array([line.split() for line in process.stdout.splitlines()], dtype=int)


def _reference(case: Any, samples: list[tuple[int, int]]) -> np.ndarray:
    stream = DeviceStream(open_sensor(case.network_file.to_bytes(), case.unit_file.to_bytes()))
    rows = []
    for t_ms, code in samples:
        stream.push(code, t_ms)
        rows.append(stream.read(t_ms))
    return np.array(rows)


def test_every_sample_of_a_real_recording_gives_the_integers_of_numpy(
    program: Path, real_case: Any, tmp_path: Path
) -> None:
    samples = [(1000 + 20 * k, int(code)) for k, code in enumerate(real_case.codes)]
    code, outputs = _run(program, *real_case.write(tmp_path), samples, "S2")
    assert code == 0
    assert np.array_equal(outputs, _reference(real_case, samples))
    # All at once gives the same as one by one.
    sensor = open_sensor(real_case.network_file.to_bytes(), real_case.unit_file.to_bytes())
    at_once = sensor.estimate(real_case.unit_file.scale.codes(real_case.recording.windows))
    assert np.array_equal(outputs[14:, 0], at_once.value)


def test_integers_are_within_3_mN_of_float64_on_the_real_recording(real_case: Any) -> None:
    sensor = open_sensor(real_case.network_file.to_bytes(), real_case.unit_file.to_bytes())
    windows = real_case.recording.windows
    estimate, *_ = estimate_output(sensor, windows)
    exact = evaluate_float64(real_case.network, real_case.unit_map.apply(windows))
    assert np.abs(estimate - exact).max() <= 0.003
    assert np.sqrt(np.mean((estimate - exact) ** 2)) <= 0.001


def test_gaps_noise_and_codes_out_of_range_are_flagged_alike(
    program: Path, real_case: Any, tmp_path: Path, rng: np.random.Generator
) -> None:
    t_ms = np.cumsum(rng.choice([0, 20, 20, 20, 30, 31, 2000], 3000)) + 2**32 - 20_000  # across the wrap of millis()
    codes = rng.integers(0, 65_536, 3000)
    codes[::3] = rng.choice(real_case.codes, 1000)
    samples = [(int(t) % 2**32, int(code)) for t, code in zip(t_ms, codes, strict=True)]
    code, outputs = _run(program, *real_case.write(tmp_path), samples)
    assert code == 0
    assert np.array_equal(outputs, _reference(real_case, samples))
    flags = set(outputs[:, 3].tolist())
    assert WARM_UP in flags
    assert all(any(flag & bit for flag in flags) for bit in (OUT_OF_RANGE, CLAMPED, WRONG_RATE))


@pytest.mark.parametrize(
    ("steps_ms", "is_flagged"),
    [((20,), False), ((19, 21), False), ((18,), False), ((22,), False), ((12, 28), False), ((0,), True), ((5,), True),
     ((10,), True), ((17,), True), ((24,), True), ((29,), True), ((2, 29, 29), True)],
)  # fmt: skip
def test_samples_at_another_rate_are_flagged(
    program: Path, real_case: Any, tmp_path: Path, steps_ms: tuple[int, ...], is_flagged: bool
) -> None:
    t_ms = 1000 + np.cumsum([steps_ms[k % len(steps_ms)] for k in range(100)])
    samples = [(int(t), int(code)) for t, code in zip(t_ms, real_case.codes, strict=False)]
    code, outputs = _run(program, *real_case.write(tmp_path), samples)
    assert code == 0
    assert np.array_equal(outputs, _reference(real_case, samples))
    assert set((outputs[14:, 3] & WRONG_RATE).tolist()) == ({WRONG_RATE} if is_flagged else {0})


def test_a_code_that_stays_for_a_minute_is_stuck_until_it_moves(program: Path, real_case: Any, tmp_path: Path) -> None:
    codes = [20_000] * 3010 + [20_064] + [20_000] * 20
    samples = [(1000 + 20 * k, code) for k, code in enumerate(codes)]
    code, outputs = _run(program, *real_case.write(tmp_path), samples)
    assert code == 0
    assert np.array_equal(outputs, _reference(real_case, samples))
    stuck = np.flatnonzero(outputs[:, 3] & STUCK)
    assert (stuck[0], stuck[-1]) == (3000, 3009)


def test_a_serial_is_a_c_string_of_which_no_more_is_read_than_there_is(
    build_checked: Build, real_case: Any, tmp_path: Path
) -> None:
    (tmp_path / "network.h").write_text(network_header(real_case.network_file))
    (tmp_path / "unit.h").write_text(unit_header(real_case.unit_file))
    (tmp_path / "main.c").write_text("""
#include <stdlib.h>
#include <string.h>
#include "network.h"
#include "unit.h"
#include "softsensor.h"
static ss_sensor s;
int main(int count, char **arguments) {
  size_t bytes = strlen(arguments[1]) + 1, is_bare = count > 2;
  char *serial = malloc(bytes); /* not one byte more: the sanitizer sees what is read beyond */
  if (!serial) return 99;
  memcpy(serial, arguments[1], bytes);
  if (is_bare) serial = memset(realloc(serial, 20), 'x', 20);
  int status = (int)ss_open(&s, SS_NETWORK, SS_NETWORK_BYTES, SS_UNIT, SS_UNIT_BYTES, serial);
  free(serial);
  return status;
}
""")
    program = str(build_checked(tmp_path / "main.c"))
    for serial, status in (("S2", 0), ("S", 8), ("S3", 8), ("S22", 8), ("", 8), ("S2 and more than twenty", 8)):
        assert subprocess.run([program, serial], capture_output=True).returncode == status
    assert subprocess.run([program, "S2", "bare"], capture_output=True).returncode == 8


@pytest.mark.parametrize("name", ["unit-curve", "unit-layer", "unit-curve-layer", "unit-mix", "unit-mix-alone"])
def test_every_form_of_map_gives_the_same_integers(
    program: Path, tmp_path: Path, rng: np.random.Generator, name: str
) -> None:
    network, unit = CONFORMANCE / "network.ssc", CONFORMANCE / f"{name}.ssc"
    stream = DeviceStream(open_sensor(network.read_bytes(), unit.read_bytes()))
    expected = []
    samples = [(20 * k, int(code)) for k, code in enumerate(rng.integers(0, 65_536, 500))]
    for t_ms, sample in samples:
        stream.push(sample, t_ms)
        expected.append(stream.read(t_ms))
    code, outputs = _run(program, network, unit, samples, "SYN-1")
    assert code == 0
    assert np.array_equal(outputs, np.array(expected))


def test_each_refusal_ends_with_its_own_status(program: Path, real_case: Any, tmp_path: Path) -> None:
    network, unit = real_case.write(tmp_path)
    damaged = tmp_path / "damaged.ssc"
    content = bytearray(unit.read_bytes())
    content[60] ^= 0xFF
    damaged.write_bytes(content)
    cut = tmp_path / "cut.ssc"
    cut.write_bytes(unit.read_bytes()[:-8])
    assert _run(program, network, network, [])[0] == 6
    assert _run(program, network, CONFORMANCE / "unit-curve.ssc", [])[0] == 7
    assert _run(program, network, unit, [], "S3")[0] == 8
    assert _run(program, network, damaged, [])[0] == 5
    assert _run(program, network, cut, [])[0] == 4
    assert _run(program, Path("/dev/null"), unit, [])[0] == 4


def test_a_network_wider_than_the_buffers_is_refused(
    build_checked: Build, examples: Path, real_case: Any, tmp_path: Path
) -> None:
    narrow = build_checked(examples / "pc" / "softsensor_pc.c", "-DSS_WIDTH=64")
    assert _run(narrow, *real_case.write(tmp_path), [])[0] == 9


@pytest.mark.long
def test_of_a_hundred_thousand_damaged_files_none_gives_a_number(
    build_checked: Build, real_case: Any, tmp_path: Path
) -> None:
    fuzz = build_checked(Path(__file__).parent / "fuzz.c")
    network, unit = real_case.write(tmp_path)
    rounds = [
        (network, unit, "3000", "300", "300"),
        (CONFORMANCE / "network.ssc", CONFORMANCE / "unit-curve.ssc", "60000", "20000", "10000"),
        (CONFORMANCE / "network.ssc", CONFORMANCE / "unit-curve-layer.ssc", "20000", "2000", "10000"),
        (CONFORMANCE / "network.ssc", CONFORMANCE / "unit-mix.ssc", "30000", "0", "20000"),
    ]
    attempts = 0
    for a, b, *counts in rounds:
        process = subprocess.run([str(fuzz), str(a), str(b), *counts, "7"], capture_output=True, text=True)
        assert process.returncode == 0, process.stderr + process.stdout
        counts_printed = process.stdout.split()
        assert counts_printed[2:4] == ["accepted", "0"]
        attempts += int(counts_printed[1])
    assert attempts >= 100_000


def test_exported_headers_compile_and_give_the_same_number(
    build_checked: Build, runtime: Path, real_case: Any, tmp_path: Path
) -> None:
    (tmp_path / "network.h").write_text(network_header(real_case.network_file))
    (tmp_path / "unit.h").write_text(unit_header(real_case.unit_file))
    codes = ", ".join(map(str, real_case.codes[100:115]))
    (tmp_path / "main.c").write_text(f"""
#include <stdio.h>
#include "network.h"
#include "unit.h"
#include "softsensor.h"
static ss_sensor sensor;
static const uint16_t codes[] = {{{codes}}};
int main(void) {{
  unsigned k;
  if (ss_open(&sensor, SS_NETWORK, SS_NETWORK_BYTES, SS_UNIT, SS_UNIT_BYTES, SS_UNIT_SERIAL) != SS_OK) return 1;
  for (k = 0; k < 15; k++) ss_push(&sensor, codes[k], 20 * k);
  printf("%d", ss_read(&sensor, 280).value);
  return ss_exponent(&sensor) == -3 ? 0 : 2;
}}
""")
    process = subprocess.run([str(build_checked(tmp_path / "main.c"))], capture_output=True, text=True)
    sensor = open_sensor(real_case.network_file.to_bytes(), real_case.unit_file.to_bytes())
    assert process.returncode == 0
    assert int(process.stdout) == sensor.estimate(real_case.codes[None, 100:115]).value[0]


ARDUINO_H = """
#include <stdint.h>
static const uint8_t A0 = 14;
static uint32_t now_ms, stall_at_ms, stall_ms;
static int newest;
struct SerialPort {
  void begin(long) {}
  void print(const char *) {}
  void print(int) {}
  void print(char) {}
  void println(int flags) { newest = flags; }
};
static SerialPort Serial;
inline int analogRead(uint8_t) { return 512 + (int)(now_ms / 20 % 3); }
inline void analogReadResolution(int) {}
inline uint32_t millis() {
  now_ms++;
  if (stall_at_ms && now_ms >= stall_at_ms) now_ms += stall_ms, stall_at_ms = 0;
  return now_ms;
}
"""


@pytest.fixture
def sketch(runtime: Path, examples: Path, real_case: Any, tmp_path: Path, require_program: Callable[..., str]) -> Path:
    """The Arduino example as a program: argument 1 a stall in ms, prints the flags of every estimate."""
    text = (examples / "arduino" / "softsensor_arduino" / "softsensor_arduino.ino").read_text()
    (tmp_path / "network-0123456789abcdef.h").write_text(network_header(real_case.network_file))
    (tmp_path / "unit-A1.h").write_text(unit_header(real_case.unit_file))
    (tmp_path / "Arduino.h").write_text(ARDUINO_H)
    (tmp_path / "main.cpp").write_text(
        f'#include <cstdio>\n#include <cstdlib>\n#include "Arduino.h"\n{text}\n'
        "int main(int, char **arguments) {\n  stall_ms = (uint32_t)atoi(arguments[1]), stall_at_ms = 1000;\n"
        "  for (setup(); now_ms < 4000;) {\n    newest = -1, loop();\n"
        '    if (newest >= 0) std::printf("%d\\n", newest);\n'
        "  }\n  return ss_read(&sensor, now_ms).flags & SS_NO_NUMBER;\n}\n"
    )
    program = tmp_path / "sketch"
    flags = ["-std=c++11", "-Wall", "-Wextra", "-Wconversion", "-Wpedantic", "-Werror", f"-I{tmp_path}", f"-I{runtime}"]
    subprocess.run([require_program("g++"), *flags, str(tmp_path / "main.cpp"), "-o", str(program)], check=True)
    return program


@pytest.mark.parametrize("stall_ms", [0, 3, 9, 12, 15, 19, 25, 40, 200, 1500])
def test_the_arduino_sketch_gives_no_wrong_window_after_a_stall(sketch: Path, stall_ms: int) -> None:
    process = subprocess.run([str(sketch), str(stall_ms)], capture_output=True, text=True)
    assert process.returncode == 0
    flags = [int(line) for line in process.stdout.split()]
    assert len(flags) > 90
    assert not any(flag & (WRONG_RATE | WARM_UP) for flag in flags)


@pytest.mark.parametrize("command", [("gcc", "-std=c99", "only.c"), ("g++", "-std=c++11", "only.cpp")])
def test_the_header_alone_gives_no_warning(
    runtime: Path, tmp_path: Path, command: tuple[str, ...], require_program: Callable[..., str]
) -> None:
    compiler, standard, name = command
    (tmp_path / name).write_text('#include "softsensor.h"\n')
    warnings = ["-Wall", "-Wextra", "-Wconversion", "-Wpedantic", "-Wshadow", "-Wcast-qual", "-Werror"]
    process = subprocess.run(
        [require_program(compiler), standard, *warnings, f"-I{runtime}", "-c", name, "-o", "only.o"],
        cwd=tmp_path, capture_output=True, text=True,
    )  # fmt: skip
    assert process.returncode == 0, process.stderr
