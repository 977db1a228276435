"""The runtime on an emulated Cortex-M0: the same integers, within its budget of time, code and memory."""

import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from softcal.core.export.c_text import network_header, unit_header
from softcal.core.export.cost import device_cost
from softcal.core.export.integer_network import IntegerMix
from softcal.core.export.loader import DeviceStream, open_sensor, run_self_test

INSTRUCTIONS_PER_TICK = 62.5
"""QEMU's microbit: SysTick at 16 MHz, one instruction per ns with `-icount shift=0`."""

SAMPLES = 250


@dataclass(frozen=True, eq=False)
class Run:
    """What the board printed."""

    estimates: np.ndarray
    numbers: dict[str, int]

    @property
    def instructions(self) -> float:
        return self.numbers["estimate_ticks"] * INSTRUCTIONS_PER_TICK


@pytest.fixture
def run_on_board(require: Callable[[object, str], None], examples: Path, tmp_path: Path) -> Callable[..., Run]:
    """`run_on_board(case, *options)`: build the example for a Cortex-M0 and run it in QEMU."""
    for tool, package in (("arm-none-eabi-gcc", "gcc-arm-none-eabi"), ("qemu-system-arm", "qemu-system-arm")):
        require(shutil.which(tool), f"{tool} is missing; apt-get install {package}")

    def run(case: Any, optimise: str = "-O2", define: str = "") -> Run:
        (tmp_path / "network.h").write_text(network_header(case.network_file))
        (tmp_path / "unit.h").write_text(unit_header(case.unit_file))
        codes = ",".join(map(str, case.codes[:SAMPLES]))
        (tmp_path / "codes.h").write_text(f"static const uint16_t codes[] = {{{codes}}};\n")
        image = tmp_path / "softsensor.elf"
        image.unlink(missing_ok=True)
        done = subprocess.run(
            ["make", "-s", f"HEADERS={tmp_path}", f"OUT={image}", f"OPTIMISE={optimise} {define}", "run"],
            cwd=examples / "cortex_m0", capture_output=True, text=True, timeout=120,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr
        lines = [line.split() for line in done.stdout.splitlines() if line]
        estimates = np.array([row[1:] for row in lines if row[0] == "e"], dtype=int)
        return Run(estimates, {row[0]: int(row[1]) for row in lines if row[0] != "e"})

    return run


def _reference(case: Any) -> np.ndarray:
    stream = DeviceStream(open_sensor(case.network_file.to_bytes(), case.unit_file.to_bytes()))
    rows = []
    for k, code in enumerate(case.codes[:SAMPLES]):
        stream.push(int(code), 1000 + 20 * k)
        rows.append(stream.read(1000 + 20 * k))
    return np.array(rows)


@pytest.mark.parametrize("optimise", ["-Os", "-O2", "-O3"])
def test_the_board_gives_the_integers_of_numpy_within_its_budget(
    run_on_board: Callable[..., Run], real_case: Any, optimise: str
) -> None:
    run = run_on_board(real_case, optimise)
    assert run.numbers["status"] == 0
    assert np.array_equal(run.estimates, _reference(real_case))
    assert run.instructions <= 85_000
    told = device_cost(real_case.network_file.network, real_case.unit_file.device_map)
    assert told.instructions == pytest.approx(run.instructions, rel=0.05)
    assert told.ram_bytes == run.numbers["ram_bytes"]
    assert run.numbers["ram_bytes"] <= 700
    assert run.numbers["stack_bytes"] <= 256


def test_a_map_with_a_mix_gives_the_integers_of_numpy_within_the_same_budget(
    run_on_board: Callable[..., Run], real_case: Any
) -> None:
    """The paper's network again, behind the largest mix there is room for."""
    unit, rng = real_case.unit_file, np.random.default_rng(3)
    weights = np.vstack([np.full(15, 17), rng.integers(-127, 128, (4, 15))])
    mix = IntegerMix(0, weights, np.array([2, 7, 7, 7, 7]), rng.integers(-300, 300, 5))
    device_map = replace(unit.device_map, mix=mix)
    tests = tuple(
        replace(t, expected=run_self_test(real_case.network_file.network, device_map, t)) for t in unit.self_tests
    )
    case = replace(real_case, unit_file=replace(unit, device_map=device_map, self_tests=tests))
    run = run_on_board(case, "-Os")
    assert run.numbers["status"] == 0
    assert np.array_equal(run.estimates, _reference(case))
    assert len(set(run.estimates[:, 0])) > 50
    told = device_cost(case.network_file.network, device_map)
    assert told.instructions == pytest.approx(run.instructions, rel=0.05)
    assert run.instructions <= 85_000
    assert run.numbers["stack_bytes"] <= 256


def test_the_portable_loop_gives_the_same_integers(run_on_board: Callable[..., Run], real_case: Any) -> None:
    run = run_on_board(real_case, "-O2", "-DSS_PORTABLE")
    assert np.array_equal(run.estimates, _reference(real_case))
    assert run.instructions <= 85_000


@pytest.mark.parametrize(("core", "most_bytes"), [("cortex-m0plus", 1536), ("cortex-m4", 1600)])
def test_code_and_tables_stay_small(
    require: Callable[[object, str], None], runtime: Path, tmp_path: Path, core: str, most_bytes: int
) -> None:
    require(shutil.which("arm-none-eabi-gcc"), "arm-none-eabi-gcc is missing; apt-get install gcc-arm-none-eabi")
    source, image = tmp_path / "size.c", tmp_path / "size.o"
    source.write_text("""
#include "softsensor.h"
ss_sensor sensor;
ss_status start(const void *n, uint32_t nb, const void *u, uint32_t ub) { return ss_open(&sensor, n, nb, u, ub, 0); }
ss_estimate tick(uint16_t code, uint32_t t) { ss_push(&sensor, code, t); return ss_read(&sensor, t); }
""")
    flags = ["-std=c99", f"-mcpu={core}", "-mthumb", "-Os", "-ffreestanding", "-Wall", "-Wextra", "-Wconversion"]
    subprocess.run(
        ["arm-none-eabi-gcc", *flags, "-Werror", f"-I{runtime}", "-c", str(source), "-o", str(image)], check=True
    )
    told = subprocess.run(["arm-none-eabi-size", str(image)], capture_output=True, text=True, check=True).stdout
    text, data, bss = (int(n) for n in re.findall(r"\d+", told.splitlines()[1])[:3])
    assert text + data <= most_bytes
    assert bss <= 700


def test_the_runtime_needs_nothing_from_libc(
    require: Callable[[object, str], None], runtime: Path, tmp_path: Path
) -> None:
    require(shutil.which("arm-none-eabi-gcc"), "arm-none-eabi-gcc is missing; apt-get install gcc-arm-none-eabi")
    source, image = tmp_path / "alone.c", tmp_path / "alone.o"
    source.write_text("""
#include "softsensor.h"
ss_sensor s; ss_adaptation a;
int all(const void *n, uint32_t nb, const void *const u[3], uint32_t ub) {
  int slot = ss_choose_slot(u, ub, n, 0);
  if (slot < 0 || ss_open(&s, n, nb, u[slot], ub, 0) != SS_OK) return -1;
  ss_adapt_start(&a, &s), ss_push(&s, 1, 2), ss_adapt(&a, &s, 1, 100);
  return ss_read(&s, 2).value + ss_slot_to_write(slot);
}
""")
    subprocess.run(
        ["arm-none-eabi-gcc", "-std=c99", "-mcpu=cortex-m0plus", "-mthumb", "-Os", "-ffreestanding", "-Wall",
         "-Wextra", "-Werror", f"-I{runtime}", "-c", str(source), "-o", str(image)], check=True,
    )  # fmt: skip
    symbols = subprocess.run(["arm-none-eabi-nm", "-u", str(image)], capture_output=True, text=True, check=True).stdout
    wanted = {line.split()[-1] for line in symbols.splitlines()}
    # Division and small switches are the compiler's own (libgcc); memcpy it may use for structures.
    assert {name for name in wanted if not name.startswith(("__aeabi_", "__gnu_"))} <= {"memcpy"}
