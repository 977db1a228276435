"""The core alone maps and estimates with a trained network; the sdist is whole; a missing extra is one line."""

import importlib.metadata
import os
import shutil
import subprocess
import sys
import tarfile
import tomllib
import venv
import zipfile
from fnmatch import fnmatch
from pathlib import Path

import numpy as np
import pytest
from packaging.requirements import Requirement

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2]
LEFT_OUT = (
    ".git",
    ".venv",
    "build",
    "dist",
    "*.egg-info",
    "__pycache__",
    ".*_cache",
    "softcal-demo",
    "site",
    ".hypothesis",
)


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sdist, built from a copy of the tree so that nothing is written into it."""
    tree = tmp_path_factory.mktemp("tree") / "softcal"
    shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(*LEFT_OUT))
    return _built("sdist", tree)


@pytest.fixture(scope="module")
def wheel(sdist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from the sdist, as an index user gets it."""
    folder = tmp_path_factory.mktemp("unpacked")
    with tarfile.open(sdist) as archive:
        archive.extractall(folder, filter="data")
    return _built("wheel", next(folder.iterdir()))


def _built(kind: str, tree: Path) -> Path:
    """Build with the setuptools that is installed: no isolation, so no index is asked."""
    out = tree.parent / f"{kind}-out"
    out.mkdir()
    code = f"from setuptools import build_meta; print(build_meta.build_{kind}({str(out)!r}))"
    process = subprocess.run([sys.executable, "-c", code], cwd=tree, capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
    return out / process.stdout.split()[-1]


@pytest.fixture(scope="module")
def bare(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bin folder of an environment that holds the wheel, what its core needs, and nothing else."""
    folder = tmp_path_factory.mktemp("bare")
    venv.create(folder, symlinks=True)
    packages = next(folder.glob("lib/python*/site-packages"))
    for name in _core_distributions(wheel):
        _link(importlib.metadata.distribution(name), packages)
    pip = [sys.executable, "-m", "pip", "--python", str(folder / "bin" / "python")]
    process = subprocess.run(
        [*pip, "install", "--quiet", "--no-index", "--no-deps", str(wheel)], capture_output=True, text=True
    )
    assert process.returncode == 0, process.stderr
    return folder / "bin"


def _core_distributions(wheel: Path) -> set[str]:
    """Names of all distributions that the wheel's own requirements, without an extra, bring in."""
    with zipfile.ZipFile(wheel) as archive:
        name = next(n for n in archive.namelist() if n.endswith(".dist-info/METADATA"))
        lines = archive.read(name).decode().splitlines()
    waiting = [(line.removeprefix("Requires-Dist: "), "") for line in lines if line.startswith("Requires-Dist: ")]
    distributions: set[str] = set()
    while waiting:
        text, extra = waiting.pop()
        requirement = Requirement(text)
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": extra}):
            continue
        requirements = importlib.metadata.requires(requirement.name) or []
        if (name := _plain(text)) not in distributions:
            distributions.add(name)
            waiting += [(inner, "") for inner in requirements]
        waiting += [
            (inner, e)
            for e in requirement.extras
            for inner in requirements
            if f"extra == '{e}'" in inner.replace('"', "'")
        ]
    return distributions


def _link(distribution: importlib.metadata.Distribution, packages: Path) -> None:
    base = Path(str(distribution.locate_file("")))
    for top in {file.parts[0] for file in distribution.files or []} - {"..", "__pycache__"}:
        if (base / top).exists() and not (packages / top).exists():
            (packages / top).symlink_to(base / top)


def _run(bare: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL"))}
    environment |= {"SOFTCAL_REGISTRY": f"sqlite:///{folder / 'registry.db'}", "SOFTCAL_LOGS": str(folder / "logs")}
    return subprocess.run(
        [bare / "softcal", *arguments], cwd=folder, capture_output=True, text=True, env=environment, timeout=300
    )


@pytest.fixture(scope="module")
def calibrated(bare: Path, tmp_path_factory: pytest.TempPathFactory, press_unit) -> Path:  # type: ignore[no-untyped-def]
    """A folder in which core alone imported tables and, once a network was trained elsewhere, calibrated a lot."""
    folder = tmp_path_factory.mktemp("calibrated")
    for k in range(3):
        press_unit(1500, 1 + 0.15 * k, 0.5 + 0.04 * k, k + 1).to_csv(folder / f"S{k}.csv", index=False)
    columns = ("--reference-column", "reference", "--sample-rate", "50")
    process = _run(bare, folder, "import", *_TABLES, "--source", "S0", *columns, "--audit", "--out", "lot")
    assert process.returncode == 0, process.stderr
    untrained = _run(bare, folder, "batch", "lot", "--hidden", "16,8")
    assert untrained.returncode == 2, untrained.stderr
    assert "pip install 'softcal[train]'" in untrained.stderr.strip().splitlines()[-1]
    trained = _run(Path(sys.executable).parent, folder, "train", "lot", "--hidden", "16,8")
    assert trained.returncode == 0, trained.stderr
    batch = _run(bare, folder, "batch", "lot", "--hidden", "16,8", "--json", "report.json")
    assert batch.returncode in (0, 1), batch.stderr
    return folder


_TABLES = ("S0.csv", "S1.csv", "S2.csv")


def test_core_takes_no_more_than_900_megabytes(bare: Path, wheel: Path) -> None:
    sizes_MB = {name: _size_MB(importlib.metadata.distribution(name)) for name in _core_distributions(wheel)}
    listed = ", ".join(f"{name} {size:.0f}" for name, size in sorted(sizes_MB.items(), key=lambda item: -item[1]))
    print(f"{sum(sizes_MB.values()):.0f} MB in {len(sizes_MB)} packages: {listed}")
    assert sum(sizes_MB.values()) < 900, listed


def _size_MB(distribution: importlib.metadata.Distribution) -> float:
    files = [Path(str(distribution.locate_file(file))) for file in distribution.files or []]
    return sum(file.stat().st_size for file in files if file.is_file()) / 1e6


def test_core_alone_estimates(bare: Path, calibrated: Path) -> None:
    process = _run(bare, calibrated, "estimate", "--serial", "S1", "lot/units/S1.csv", "--out", "estimate.csv")
    assert process.returncode == 0, process.stderr
    rows = np.genfromtxt(calibrated / "estimate.csv", delimiter=",", names=True, usecols=(0, 1, 2, 3))
    reference = np.genfromtxt(calibrated / "S1.csv", delimiter=",", names=True)["reference"]
    error = (rows["estimate"] - reference)[15:]
    assert np.sqrt(np.nanmean(error**2)) < 0.3 * reference.std()


def test_core_alone_exports_what_the_estimate_used(bare: Path, calibrated: Path) -> None:
    process = _run(bare, calibrated, "export", "--serial", "S1", "--format", "json", "--out", "out", "--failed-too")
    assert process.returncode == 0, process.stderr
    assert list((calibrated / "out").rglob("unit-S1*.json"))


@pytest.mark.parametrize(
    ("arguments", "extra"),
    [
        (("gap", "effects"), "twin"),
        (("ui", "--no-browser"), "ui"),
        (("api", "openapi", "--out", "o.json"), "connect"),
        (("station", "check"), "station"),
        (("export", "--serial", "S1", "--format", "onnx", "--out", "o", "--failed-too"), "documents"),
        (("batch", "lot", "--registry", "postgresql://softcal@127.0.0.1/none"), "postgresql"),
    ],
)
def test_a_missing_extra_is_one_line_that_says_what_to_install(
    bare: Path, calibrated: Path, arguments: tuple[str, ...], extra: str
) -> None:
    process = _run(bare, calibrated, *arguments)
    assert process.returncode in (2, 4), process.stderr
    assert len(process.stderr.strip().splitlines()) == 1, process.stderr
    assert f"pip install 'softcal[{extra}]'" in process.stderr


def _files_of(root: Path) -> list[str]:
    files = (path.relative_to(root) for path in root.rglob("*") if path.is_file())
    return [p.as_posix() for p in files if not any(fnmatch(part, module) for part in p.parts for module in LEFT_OUT)]


def test_the_sdist_holds_what_a_packager_needs(sdist: Path) -> None:
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert not _tracked() - {".gitignore"} - names


def _tracked() -> set[str]:
    """What git knows; without git, as in an unpacked archive, every file but those that are made here."""
    git = ["git", "-c", f"safe.directory={ROOT}", "ls-files"]
    listed = subprocess.run(git, cwd=ROOT, capture_output=True, text=True)
    files = listed.stdout.splitlines() if listed.returncode == 0 else _files_of(ROOT)
    return {name for name in files if (ROOT / name).is_file()}


def test_the_wheel_holds_every_file_of_the_packages_fonts_and_licences_too(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    files = {name for name in _tracked() if name.startswith(("app/", "core/", "db/", "station/"))}
    assert not {f"softcal/{name.replace('app/public/', '')}" for name in files} - names


def test_the_wheel_says_its_licence_and_the_pythons_it_runs_on(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        name = next(n for n in archive.namelist() if n.endswith(".dist-info/METADATA"))
        text = archive.read(name).decode()
        assert any(n.endswith("licenses/LICENSE") for n in archive.namelist())
    assert "License-Expression: Apache-2.0" in text
    for minor in (11, 12, 13, 14):
        assert f"Python :: 3.{minor}\n" in text


def test_every_optional_library_is_named_with_its_extra() -> None:
    from softcal.app.extras import EXTRA_OF

    groups = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    of_tasks = {name: group for name, group in groups.items() if name not in ("all", "docs", "dev")}
    documented = {name: {_plain(r) for r in group} - {"softcal"} for name, group in of_tasks.items()}
    installed = importlib.metadata.packages_distributions()
    provided = {module: {_plain(d) for d in installed.get(module, [])} for module in EXTRA_OF}
    for module, extra in EXTRA_OF.items():
        assert provided[module] & documented[extra], f"{module}: {provided[module]} is not in extra {extra}"
    all_provided = set().union(*provided.values())
    assert {name for group in documented.values() for name in group} <= all_provided


def _plain(requirement: str) -> str:
    return Requirement(requirement).name.lower().replace("_", "-")
