"""Four readers, one answer: C, NumPy, plain Python and C++ on the vectors that are shipped with docs/format.md."""

import importlib.util
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from softcal.core.export.blob import FileRefused
from tests.device_sensor import open_sensor
from tests.firmware.device_stream import DeviceStream

FIRMWARE = Path(__file__).parents[2] / "firmware"
VECTORS = FIRMWARE / "conformance"
NAMES = sorted(path.name.removeprefix("unit-").removesuffix(".ssc") for path in VECTORS.glob("unit-*.ssc"))
Reader = Callable[[Path, str], tuple[int, list[str]]]


def _program(*command: str) -> Reader:
    def read(unit: Path, text: str) -> tuple[int, list[str]]:
        arguments = [*command, str(VECTORS / "network.ssc"), str(unit), "SYN-1"]
        process = subprocess.run(arguments, input=text, capture_output=True, text=True)
        return process.returncode, process.stdout.splitlines()

    return read


def _numpy(unit: Path, text: str) -> tuple[int, list[str]]:
    try:
        stream = DeviceStream(open_sensor((VECTORS / "network.ssc").read_bytes(), unit.read_bytes(), "SYN-1"))
    except FileRefused as refusal:
        return int(refusal.cause), []
    lines = []
    for t_ms, code in (map(int, line.split()) for line in text.splitlines()):
        stream.push(code, t_ms)
        lines.append(" ".join(map(str, stream.read(t_ms))))
    return 0, lines


@pytest.fixture(scope="module")
def readers(
    build_checked: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory, require_program: Callable[..., str]
) -> dict[str, Reader]:
    compiler, program = require_program("g++"), tmp_path_factory.mktemp("cpp") / "reader"
    source = FIRMWARE / "examples" / "cpp" / "softsensor_reader.cpp"
    warnings = ["-Wall", "-Wextra", "-Wconversion", "-Wpedantic", "-Werror", "-fsanitize=address,undefined"]
    subprocess.run([compiler, "-std=c++17", "-O1", *warnings, str(source), "-o", str(program)], check=True)
    return {
        "C": _program(str(build_checked(FIRMWARE / "examples" / "pc" / "softsensor_pc.c"))),
        "C++": _program(str(program)),
        "Python": _program(sys.executable, str(FIRMWARE / "examples" / "micropython" / "softsensor_reader.py")),
        "NumPy": _numpy,
    }


@pytest.mark.parametrize("name", NAMES)
def test_every_reader_gives_the_expected_lines(readers: dict[str, Reader], name: str) -> None:
    text = (VECTORS / "stream.txt").read_text()
    expected = (VECTORS / f"expected-{name}.txt").read_text().splitlines()
    flags = {bit for line in expected for bit in (1, 4, 8, 16, 32, 64) if int(line.split()[3]) & bit}
    assert {1, 8, 32, 64} | ({16} if name == "curve" else set()) <= flags and len(
        {line.split()[0] for line in expected}
    ) > 20
    for language, read in readers.items():
        code, lines = read(VECTORS / f"unit-{name}.ssc", text)
        assert code == 0, language
        assert lines == expected, language


def test_every_reader_refuses_for_the_same_cause(readers: dict[str, Reader]) -> None:
    listed = [line.split() for line in (VECTORS / "refused.txt").read_text().splitlines()]
    assert {int(cause) for _, cause in listed} == set(range(2, 11))
    for name, cause in listed:
        for language, read in readers.items():
            assert read(VECTORS / name, "0 1\n") == (int(cause), []), (name, language)


def test_the_vectors_are_those_the_generator_writes(tmp_path: Path) -> None:
    spec = importlib.util.spec_from_file_location("generate", VECTORS / "generate.py")
    assert spec is not None and spec.loader is not None
    generate = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(generate)
    generate.write(tmp_path)
    files = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert files == {path.name: path.read_bytes() for path in VECTORS.iterdir() if path.suffix in (".ssc", ".txt")}


def test_the_python_reader_needs_nothing_that_micropython_lacks() -> None:
    """Its imports are among MicroPython's own modules, and it uses no annotation, dataclass, f-string or match."""
    import ast

    tree = ast.parse((FIRMWARE / "examples" / "micropython" / "softsensor_reader.py").read_text())
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    assert imported <= {"binascii", "hashlib", "struct", "sys"}
    newer = (ast.ImportFrom, ast.AnnAssign, ast.JoinedStr, ast.Match, ast.AsyncFunctionDef)
    assert not any(isinstance(node, newer) for node in ast.walk(tree))


def test_a_long_serial_is_shortened_alike() -> None:
    from softcal.core.export.blob import serial_field

    spec = importlib.util.spec_from_file_location(
        "reader", FIRMWARE / "examples" / "micropython" / "softsensor_reader.py"
    )
    assert spec is not None and spec.loader is not None
    reader = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(reader)
    rng = np.random.default_rng(1)
    for length in (1, 19, 20, 21, 64):
        serial = "".join(chr(65 + int(k)) for k in rng.integers(0, 26, length))
        assert reader.serial_field(serial) == serial_field(serial)
