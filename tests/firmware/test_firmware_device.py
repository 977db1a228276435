"""The runtime on an emulated Cortex-M0: the same integers, within its budget of time, code and memory."""

import re
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from softcal.core.export.blob import LoadLevels, NetworkFile, UnitFile
from softcal.core.export.blob_reader import read_network, read_unit
from softcal.core.export.device import device_cost
from softcal.core.export.integer_network import IntegerMix
from softcal.core.export.loader import run_self_test
from tests.device_sensor import open_sensor
from tests.firmware.conftest import TOOLS, Run
from tests.firmware.device_stream import DeviceStream, Trim, TrimResult, find_trim

SAMPLES = 250
CONFORMANCE = Path(__file__).parents[2] / "firmware" / "conformance"


def _reference(network: NetworkFile, unit: UnitFile, codes: Any, trim: Trim = Trim()) -> np.ndarray:  # noqa: B008
    stream = DeviceStream(open_sensor(network.to_bytes(), unit.to_bytes()), trim)
    rows = []
    for k, code in enumerate(codes):
        stream.push(int(code), 1000 + 20 * k)
        rows.append(stream.read(1000 + 20 * k))
    return np.array(rows)


@pytest.mark.parametrize("options", ["-Os", "-O2", "-O3"])
def test_the_board_gives_the_integers_of_numpy_within_its_budget(
    run_on_board: Callable[..., Run], real_case: Any, options: str
) -> None:
    network, unit, codes = real_case.network_file, real_case.unit_file, real_case.codes[:SAMPLES]
    run = run_on_board(network, unit, codes, "m0", options)
    assert run.numbers["status"] == 0
    assert np.array_equal(run.estimates, _reference(network, unit, codes))
    assert run.instructions <= 85_000
    cost = device_cost(network.network, unit.device_map)
    assert cost.instructions == pytest.approx(run.instructions, rel=0.05)
    assert cost.ram_bytes == run.numbers["ram_bytes"]
    assert run.numbers["ram_bytes"] <= 700
    assert run.numbers["stack_bytes"] <= 256


def _with_mix(case: Any, rng: np.random.Generator) -> UnitFile:
    """A mix of five shapes before the paper's network."""
    weights = np.vstack([np.full(15, 17), rng.integers(-127, 128, (4, 15))])
    mix = IntegerMix(0, weights, np.array([2, 7, 7, 7, 7]), rng.integers(-20_000, 20_000, 5))
    device_map = replace(case.unit_file.device_map, mix=mix)
    tests = tuple(
        replace(t, expected=run_self_test(case.network_file.network, device_map, t)) for t in case.unit_file.self_tests
    )
    return replace(case.unit_file, device_map=device_map, self_tests=tests)


@pytest.mark.parametrize("board", ["m0", "m4", "rv32", "mega"])
def test_a_map_with_a_mix_gives_the_integers_of_numpy_on_every_core(
    run_on_board: Callable[..., Run], real_case: Any, rng: np.random.Generator, board: str
) -> None:
    network, unit, codes = real_case.network_file, _with_mix(real_case, rng), real_case.codes[100:160]
    run = run_on_board(network, unit, codes, board, "-Os")
    assert run.numbers["status"] == 0
    assert np.array_equal(run.estimates, _reference(network, unit, codes))
    assert len(set(run.estimates[:, 0])) > 20
    assert run.instructions <= {"m0": 85_000, "m4": 85_000, "rv32": 110_000, "mega": 1_300_000}[board]
    assert run.numbers["stack_bytes"] <= 256
    if board == "m0":
        cost = device_cost(network.network, unit.device_map)
        assert cost.instructions == pytest.approx(run.instructions, rel=0.05)


@pytest.mark.parametrize("name", ["unit-curve", "unit-layer", "unit-curve-layer"])
@pytest.mark.parametrize("board", ["uno", "rv32"])
def test_every_form_of_map_gives_the_same_integers_with_16_bit_ints(
    run_on_board: Callable[..., Run], rng: np.random.Generator, name: str, board: str
) -> None:
    network = read_network((CONFORMANCE / "network.ssc").read_bytes())
    unit = read_unit((CONFORMANCE / f"{name}.ssc").read_bytes())
    codes = rng.integers(0, 65_536, 80)
    run = run_on_board(network, unit, codes, board, "-Os")
    assert run.numbers["status"] == 0
    assert np.array_equal(run.estimates, _reference(network, unit, codes))
    if board == "uno":  # files lie in flash, so RAM does not grow with them
        assert run.numbers["ram_bytes"] + run.numbers["stack_bytes"] <= 512
        assert run.instructions <= 80_000


@pytest.mark.parametrize("name", ["unit-mix", "unit-mix-alone"])
@pytest.mark.parametrize("board", ["m0", "m4", "rv32", "uno", "mega"])
def test_a_mix_alone_gives_the_integers_of_numpy_on_every_core(
    run_on_board: Callable[..., Run], rng: np.random.Generator, name: str, board: str
) -> None:
    """The files that a second reader is proved with: weights of 16 bits, sums close to the end of 32."""
    network = read_network((CONFORMANCE / "network.ssc").read_bytes())
    unit = read_unit((CONFORMANCE / f"{name}.ssc").read_bytes())
    assert unit.device_map.mix is not None
    codes = np.concatenate([rng.integers(0, 65_536, 60), np.repeat([0, 65_535], 20)])
    run = run_on_board(network, unit, codes, board, "-Os")
    assert run.numbers["status"] == 0
    assert np.array_equal(run.estimates, _reference(network, unit, codes))
    assert len(set(run.estimates[:, 0])) > 20
    assert run.numbers["stack_bytes"] <= 256


@pytest.mark.parametrize("board", sorted(TOOLS))
def test_two_known_loads_trim_a_unit_on_the_board_as_in_numpy(run_on_board: Callable[..., Run], board: str) -> None:
    network = read_network((CONFORMANCE / "network.ssc").read_bytes())
    unit = read_unit((CONFORMANCE / "unit-curve.ssc").read_bytes())
    unit = replace(unit, bands=tuple(replace(band, minus=9, plus=9) for band in unit.bands))
    sensor = open_sensor(network.to_bytes(), unit.to_bytes())
    span = unit.code_max - unit.code_min
    ends = [unit.code_min + span // 5, unit.code_min + 4 * span // 5]
    by_load = sorted((int(sensor.estimate(np.full((1, 15), code)).value[0]), code) for code in ends)
    loads, rest = [load for load, _ in by_load], [code for _, code in by_load]
    # The source as the unit was: its levels run in a line through these two.
    step, counts = (loads[1] - loads[0]) // 16, unit.device_map.on_samples(np.array(rest))
    levels = np.rint(counts[0] + (counts[1] - counts[0]) * np.arange(-4, 21) / 16).astype(int)
    network = replace(network, levels=LoadLevels(loads[0] - 4 * step, step, tuple(levels.tolist())))
    unit = replace(unit, network_id=network.id)
    sensor = open_sensor(network.to_bytes(), unit.to_bytes())
    drifted = [code + span // 4 for code in rest]
    codes = np.linspace(unit.code_min, unit.code_max, 60).astype(int)
    defines = f"-Os -DTRIM={loads[0]},{loads[1]} -DTRIM_CODES={drifted[0]},{drifted[1]} -DTRIM_ERRORS=0,9"
    run = run_on_board(network, unit, codes, board, defines)
    at_rest = np.full(20, drifted[0]), np.full(20, drifted[1])
    result, trim = find_trim(sensor, at_rest, (loads[0], loads[1]), (0, 9))
    assert (run.numbers["trim"], result) == (0, TrimResult.TRIMMED)
    assert (run.numbers["trim_gain"], run.numbers["trim_offset"]) == (trim.shift.gain, trim.shift.offset) != (0, 0)
    assert (run.numbers["trim_reach_0"], run.numbers["trim_reach_1"]) == trim.half_widths
    assert np.array_equal(run.estimates, _reference(network, unit, codes, trim))


def test_the_portable_loop_gives_the_same_integers(run_on_board: Callable[..., Run], real_case: Any) -> None:
    network, unit, codes = real_case.network_file, real_case.unit_file, real_case.codes[:SAMPLES]
    run = run_on_board(network, unit, codes, "m0", "-O2 -DSS_PORTABLE")
    assert np.array_equal(run.estimates, _reference(network, unit, codes))
    assert run.instructions <= 85_000


@pytest.mark.parametrize(("core", "max_bytes"), [("cortex-m0plus", 1920), ("cortex-m4", 1920)])
def test_code_and_tables_stay_small(
    require_program: Callable[..., str], runtime: Path, tmp_path: Path, core: str, max_bytes: int
) -> None:
    require_program("arm-none-eabi-gcc")
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
    sizes = subprocess.run(["arm-none-eabi-size", str(image)], capture_output=True, text=True, check=True).stdout
    text, data, bss = (int(n) for n in re.findall(r"\d+", sizes.splitlines()[1])[:3])
    assert text + data <= max_bytes
    assert bss <= 700


def test_the_runtime_needs_nothing_from_libc(
    require_program: Callable[..., str], runtime: Path, tmp_path: Path
) -> None:
    require_program("arm-none-eabi-gcc")
    source, image = tmp_path / "alone.c", tmp_path / "alone.o"
    source.write_text("""
#include "softsensor.h"
ss_sensor s;
int all(const void *n, uint32_t nb, const void *const u[3], uint32_t ub) {
  int slot = ss_open_best(&s, u, ub, n, nb, 0);
  if (slot < 0 || ss_open(&s, n, nb, u[slot], ub, 0) != SS_OK) return -1;
  ss_push(&s, 1, 2);
  return ss_read(&s, 2).value + ss_slot_to_write(slot);
}
""")
    subprocess.run(
        ["arm-none-eabi-gcc", "-std=c99", "-mcpu=cortex-m0plus", "-mthumb", "-Os", "-ffreestanding", "-Wall",
         "-Wextra", "-Werror", f"-I{runtime}", "-c", str(source), "-o", str(image)], check=True,
    )  # fmt: skip
    symbols = subprocess.run(["arm-none-eabi-nm", "-u", str(image)], capture_output=True, text=True, check=True).stdout
    undefined_symbols = {line.split()[-1] for line in symbols.splitlines()}
    # Division and small switches are the compiler's own (libgcc); memcpy it may use for structures.
    assert {name for name in undefined_symbols if not name.startswith(("__aeabi_", "__gnu_"))} <= {"memcpy"}
