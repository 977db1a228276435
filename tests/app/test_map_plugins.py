"""The example map family and exporter, installed as a package: conforming, used, exported; broken ones are one line."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from softcal.app.cli.main import main
from softcal.app.export import formats
from softcal.core.errors import InputError, UnitRefused
from softcal.core.maps.affine_map import AffineMap, fit_affine
from softcal.core.maps.catalogue import BUILTIN_FAMILIES, PLUGINS
from softcal.core.maps.conformance import example_problem, faults
from tests.layers import layered

EXAMPLE = Path(__file__).parents[2] / "examples" / "softcal-example-map"


@pytest.fixture(scope="module")
def installed(install_example: Callable[[Path], Path]) -> Path:
    """Folder into which pip has installed the example."""
    return install_example(EXAMPLE)


def _python(site: Path, code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(site)}
    return subprocess.run([sys.executable, "-c", code, *arguments], env=environment, capture_output=True, text=True)


POINT = EntryPoint("ini", "tests:write", "softcal.exporters")
SOFTCAL = "import sys; from softcal.app.cli.main import main; sys.exit(main(sys.argv[1:]))"


def test_the_example_family_conforms_and_fits_a_unit(installed):
    code = """
import json, softcal
from softcal.core.maps.catalogue import FAMILIES
from softcal.core.maps.conformance import example_problem, faults
problem = example_problem()
fitted = FAMILIES["moments"].fit(problem)
print(json.dumps([list(FAMILIES)[-1], faults(FAMILIES["moments"]), fitted.gain, fitted.offset]))
"""
    process = _python(installed, code)
    name, wrong, gain, offset = json.loads(process.stdout)
    assert (name, wrong) == ("moments", [])
    assert gain == pytest.approx(1.3) and offset == pytest.approx(0.04)


@pytest.mark.long
def test_python_uses_the_family_by_name(installed, press_unit, tmp_path):
    for k in (0, 1):
        press_unit(1500, 1 + 0.2 * k, 0.5, 1).to_csv(tmp_path / f"S{k}.csv", index=False)
    code = """
import sys, softcal
columns = {"reference": "reference", "time_s": "t_s"}
source, target = (softcal.Recording.read(f"{sys.argv[1]}/S{k}.csv", **columns) for k in (0, 1))
unit = softcal.fit_map(softcal.fit_network(source, hidden=(8,)), target, family="moments")
print(unit.family, unit.map.gain)
"""
    family, gain = _python(installed, code, str(tmp_path)).stdout.split()
    assert family == "moments" and float(gain) == pytest.approx(1 / 1.2, rel=0.02)


def test_the_example_format_is_written_and_listed(installed, lot_folder, registry_url, tmp_path):
    main(["batch", str(lot_folder), "--registry", registry_url, "--hidden", "16,8"])
    out = tmp_path / "files"
    arguments = ["export", "--serial", "A1", "--format", "ini", "--out", str(out), "--registry", registry_url]
    process = _python(installed, SOFTCAL, *arguments)
    assert process.returncode == 0, process.stderr
    assert (out / "unit-A1.ini").read_bytes().startswith(b"[unit]\r\nserial = A1\r\n")
    assert "unit-A1.ini" in (out / "manifest.json").read_text()
    assert _python(installed, SOFTCAL, "export", "--check", "--out", str(out)).returncode == 0


def test_without_the_package_its_format_is_unknown(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["export", "--serial", "A1", "--format", "ini", "--out", str(tmp_path)])
    assert "'ini'" in capsys.readouterr().err


class Unit:
    """A unit as a plug-in's exporter gets it."""

    serial = "A1"

    def __init__(self, is_released: bool) -> None:
        self.is_released = is_released

    def check_usable(self) -> None:
        if not self.is_released:
            raise UnitRefused("unit A1 has the verdict fail")


def test_a_plug_in_format_gives_nothing_of_a_unit_that_is_not_released():
    calls: list[object] = []
    with pytest.raises(UnitRefused):
        formats._plugin_files(POINT, calls.append, Unit(False))  # type: ignore[arg-type]
    assert not calls


@pytest.mark.parametrize(
    "files", [{"../unit-A1.ini": b""}, {"unit-B2.ini": b""}, {"unit-A1.ini": "text"}, None, {"-A1": b""}]
)
def test_files_of_a_plug_in_stay_in_the_folder_and_name_their_unit(files):
    with pytest.raises(InputError, match="'ini'.*A1"):
        formats._plugin_files(POINT, lambda unit: files, Unit(True))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "name", layered(sorted(BUILTIN_FAMILIES.keys() - {"identity", "stage_matched"}), ("affine", "monotone"))
)
def test_softcals_own_families_conform(name):
    # The example has no stage positions, at which "stage_matched" pairs.
    assert example_problem().target.stage_mm is None
    assert faults(BUILTIN_FAMILIES[name]) == []


@dataclass(frozen=True)
class Careless:
    """A family with one fault at a time."""

    name: str = "careless"
    fault: str = ""

    def fit(self, problem):  # type: ignore[no-untyped-def]
        fitted = fit_affine(problem)
        if self.fault == "changes":
            problem.target.output[0] += 1.0
        gain = fitted.gain * (np.random.default_rng().uniform(0.9, 1.1) if self.fault == "random" else 1.0)
        return _Map(gain, fitted.offset, "other" if self.fault == "name" else self.name, self.fault)

    def from_arrays(self, arrays, settings):  # type: ignore[no-untyped-def]
        gain = 1.0 if self.fault == "forgets" else float(arrays["gain"])
        return _Map(gain, float(arrays["offset"]), self.name, self.fault)


@dataclass(frozen=True)
class _Map(AffineMap):
    fault: str = ""

    def apply(self, windows):  # type: ignore[no-untyped-def]
        mapped = super().apply(windows)
        if self.fault == "shape":
            return mapped[:, 1:]
        if self.fault == "nan":
            mapped[0, 0] = np.nan
        if self.fault == "neighbours":
            mapped = np.maximum.accumulate(mapped)
        return mapped + 1.0 if self.fault == "worse" else mapped

    def settings(self):  # type: ignore[no-untyped-def]
        return {"x": np.zeros(1)} if self.fault == "settings" else {}


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("changes", "recording"),
        ("random", "two fits"),
        ("name", "'other'"),
        ("forgets", "another map"),
        ("shape", "shape"),
        ("nan", "finite"),
        ("neighbours", "beside"),
        ("worse", "without"),
        ("settings", "JSON"),
    ],
)
def test_the_conformance_kit_finds_a_fault(fault, message):
    assert any(message in line for line in faults(Careless(fault=fault))) and faults(Careless()) == []


@pytest.fixture
def package(monkeypatch: pytest.MonkeyPatch) -> None:
    """A package of somebody else with a good family, one whose name is taken, and something that is none."""
    families = SimpleNamespace(MINE=Careless(name="mine"), TAKEN=Careless(name="affine"), BROKEN=object())
    monkeypatch.setitem(sys.modules, "somebody", families)


@pytest.mark.parametrize(
    ("value", "message"),
    [("somebody:TAKEN", "'affine'"), ("somebody:BROKEN", "object"), ("no_such_module:X", "no_such")],
)
def test_a_broken_plug_in_is_one_line(package, value, message):
    with pytest.raises(InputError, match=f"^.*{message}.*$"):
        PLUGINS.merge_plugins(BUILTIN_FAMILIES, [EntryPoint("x", value, "softcal.maps")])


def test_plug_ins_stand_last(package):
    every = PLUGINS.merge_plugins(BUILTIN_FAMILIES, [EntryPoint("mine", "somebody:MINE", "softcal.maps")])
    assert list(every) == [*BUILTIN_FAMILIES, "mine"]
