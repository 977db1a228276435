"""The wheel holds every folder, and no module of app/ hides a library."""

import importlib.metadata
import re
import runpy
import sys
import tomllib
from pathlib import Path

import pytest
import setuptools
from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).parents[2]
FOLDERS = ("app", "core", "db", "station")


def _project() -> dict:
    return tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_every_folder_with_modules_is_packaged(monkeypatch: pytest.MonkeyPatch) -> None:
    setup_arguments: dict = {}
    monkeypatch.setattr(setuptools, "setup", lambda **given: setup_arguments.update(given))
    monkeypatch.chdir(ROOT)
    runpy.run_path("setup.py")
    on_disk = {
        "softcal." + ".".join(folder.relative_to(ROOT).parts)
        for top in FOLDERS
        for folder in [ROOT / top, *(ROOT / top).rglob("*")]
        if folder.is_dir() and any(folder.glob("*.py"))
    }
    assert on_disk - {"softcal.app.public"} | {"softcal"} == set(setup_arguments["packages"])


def test_no_module_beside_the_page_script_has_the_name_of_a_library() -> None:
    # `streamlit run app/ui/main.py` puts app/ui/ first on sys.path.
    libraries = set(sys.stdlib_module_names) | set(importlib.metadata.packages_distributions()) - {"softcal"}
    modules = {path.stem for path in (ROOT / "app" / "ui").glob("*.py")} - {"__init__"}
    assert not modules & libraries


def test_every_dependency_is_locked_with_its_hashes() -> None:
    project = _project()["project"]
    locked = {package["name"]: package for package in tomllib.loads((ROOT / "uv.lock").read_text())["package"]}
    requirements = [project["dependencies"], *project["optional-dependencies"].values()]
    assert {_name(requirement) for group in requirements for requirement in group} <= locked.keys()
    bare = [name for name, package in locked.items() if not _files(package) and name != "softcal"]
    assert bare == []
    assert [name for name in locked if name.startswith(("nvidia", "cuda", "triton"))] == []


def _files(package: dict) -> list[dict]:
    return [
        file for file in [*package.get("wheels", []), package.get("sdist", {})] if "sha256:" in file.get("hash", "")
    ]


def _name(requirement: str) -> str:
    return Requirement(requirement).name.lower().replace("_", "-")


def test_the_repository_names_no_path_of_a_machine() -> None:
    suspicious = [
        path.relative_to(ROOT)
        for path in _tracked()
        if path.suffix in {".py", ".md", ".toml", ".c", ".h", ".ino"} and path != Path(__file__)
        if re.search(r"/(work|root|tmp)/", path.read_text(encoding="utf-8"))
    ]
    assert not suspicious


def _tracked() -> list[Path]:
    skipped = {".venv", ".git", "build", "softcal-demo"}
    return [p for p in ROOT.rglob("*.*") if p.is_file() and not skipped & set(p.relative_to(ROOT).parts)]


def test_the_version_has_one_owner_and_stands_on_top_of_the_changelog() -> None:
    version = _project()["project"]["version"]
    changelog = re.findall(r"^## (\d\S*)", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    assert changelog == sorted(changelog, key=Version, reverse=True) and changelog[0] == Version(version).base_version
    assert re.findall(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text("utf-8"), re.MULTILINE) == [version]
    locked = tomllib.loads((ROOT / "uv.lock").read_text("utf-8"))["package"]
    assert [package["version"] for package in locked if package["name"] == "softcal"] == [version]
    compose = (ROOT / "deploy/compose.yaml").read_text("utf-8")
    assert set(re.findall(r"image: softcal:(\S+)", compose)) == {version}
    assert importlib.metadata.version("softcal") == version, "run `make .venv/.installed`"
