"""The example map family and exporter, installed as a package: conforming, used, exported; broken ones are one line."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from softcal.app.cli.main import main
from softcal.core.errors import InputError
from softcal.core.maps.affine import Affine
from softcal.core.maps.affine_map import AffineMap
from softcal.core.maps.catalogue import OWN_FAMILIES
from softcal.core.maps.conformance import example_problem, faults
from softcal.core.maps.plugins import with_plugins

EXAMPLE = Path(__file__).parents[2] / "examples" / "softcal-example-map"


@pytest.fixture(scope="module")
def installed(install_example: Callable[[Path], Path]) -> Path:
    """Folder into which pip has installed the example."""
    return install_example(EXAMPLE)


def _python(site: Path, code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(site)}
    return subprocess.run([sys.executable, "-c", code, *arguments], env=environment, capture_output=True, text=True)


SOFTCAL = "import sys; from softcal.app.cli.main import main; sys.exit(main(sys.argv[1:]))"


def test_the_example_family_conforms_and_fits_a_unit(installed: Path) -> None:
    code = """
import json, softcal
from softcal.core.maps.catalogue import FAMILIES
from softcal.core.maps.conformance import example_problem, faults
problem = example_problem()
fitted = FAMILIES["moments"].fit(problem)
print(json.dumps([list(FAMILIES)[-1], faults(FAMILIES["moments"]), fitted.gain, fitted.offset]))
"""
    done = _python(installed, code)
    name, wrong, gain, offset = json.loads(done.stdout)
    assert (name, wrong) == ("moments", [])
    assert gain == pytest.approx(1.3) and offset == pytest.approx(0.04)


@pytest.mark.long
def test_python_uses_the_family_by_name(installed: Path, press_unit, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
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


def test_the_example_format_is_written_and_listed(
    installed: Path, lot_folder: Path, registry_url: str, tmp_path: Path
) -> None:
    main(["batch", str(lot_folder), "--registry", registry_url, "--hidden", "16,8"])
    out = tmp_path / "files"
    arguments = ["export", "--serial", "A1", "--format", "ini", "--out", str(out), "--registry", registry_url]
    done = _python(installed, SOFTCAL, *arguments)
    assert done.returncode == 0, done.stderr
    assert (out / "unit-A1.ini").read_bytes().startswith(b"[unit]\r\nserial = A1\r\n")
    assert "unit-A1.ini" in (out / "manifest.json").read_text()
    assert _python(installed, SOFTCAL, "export", "--check", "--out", str(out)).returncode == 0


def test_without_the_package_its_format_is_unknown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["export", "--serial", "A1", "--format", "ini", "--out", str(tmp_path)])
    assert "invalid choice: 'ini'" in capsys.readouterr().err


def test_a_plug_in_format_gives_nothing_of_a_unit_that_is_not_released(monkeypatch: pytest.MonkeyPatch) -> None:
    from softcal.app.export import formats
    from softcal.core.errors import UnitRefused

    class Held:
        serial = "A1"

        def check_usable(self) -> None:
            raise UnitRefused("unit A1 has the verdict fail")

    asked = []
    point = EntryPoint("ini", "tests:write", "softcal.exporters")
    with pytest.raises(UnitRefused):
        formats._plugin_files(point, asked.append, Held())  # type: ignore[arg-type]
    assert not asked


@pytest.mark.parametrize(
    "files", [{"../unit-A1.ini": b""}, {"unit-B2.ini": b""}, {"unit-A1.ini": "text"}, None, {"-A1": b""}]
)
def test_files_of_a_plug_in_stay_in_the_folder_and_name_their_unit(files: object) -> None:
    from softcal.app.export import formats

    class Released:
        serial = "A1"

        def check_usable(self) -> None:
            return None

    point = EntryPoint("ini", "tests:write", "softcal.exporters")
    with pytest.raises(InputError, match="exporter plug-in 'ini'.*names with the serial A1"):
        formats._plugin_files(point, lambda unit: files, Released())  # type: ignore[arg-type]


@pytest.mark.parametrize("name", [name for name in OWN_FAMILIES if name != "identity"])
def test_softcals_own_families_conform(name: str) -> None:
    problem = example_problem()
    if name == "phase":
        pytest.skip("pairs at equal stage positions, which the example has not")
    assert problem.target.stage_mm is None
    assert faults(OWN_FAMILIES[name]) == []


@dataclass(frozen=True)
class Careless(Affine):
    """A family with one fault at a time."""

    name: str = "careless"
    fault: str = ""

    def fit(self, problem):  # type: ignore[no-untyped-def]
        fitted = super().fit(problem)
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
    ("fault", "words"),
    [
        ("changes", "changes the recording"),
        ("random", "two fits"),
        ("name", "says family 'other'"),
        ("forgets", "gives another map"),
        ("shape", "same shape"),
        ("nan", "not finite"),
        ("neighbours", "windows beside it"),
        ("worse", "without it"),
        ("settings", "no JSON values"),
    ],
)
def test_the_conformance_kit_finds_a_fault(fault: str, words: str) -> None:
    assert any(words in line for line in faults(Careless(fault=fault)))
    assert faults(replace(Careless(), fault="")) == []


MINE = Careless(name="mine")
TAKEN = Careless(name="affine")
BROKEN = object()


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (f"{__name__}:TAKEN", "the name 'affine' is taken"),
        (f"{__name__}:BROKEN", "is object; a MapFamily"),
        ("no_such_module:X", "cannot be loaded"),
    ],
)
def test_a_broken_plug_in_is_one_line(value: str, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, __name__, sys.modules.get(__name__) or _this_module())
    with pytest.raises(InputError, match=words):
        with_plugins(OWN_FAMILIES, [EntryPoint("x", value, "softcal.maps")])


def _this_module() -> object:
    from types import SimpleNamespace

    return SimpleNamespace(TAKEN=TAKEN, BROKEN=BROKEN, MINE=MINE)


def test_plug_ins_stand_last(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, __name__, sys.modules.get(__name__) or _this_module())
    every = with_plugins(OWN_FAMILIES, [EntryPoint("mine", f"{__name__}:MINE", "softcal.maps")])
    assert list(every) == [*OWN_FAMILIES, "mine"]
