"""The wheel holds every folder, and no module of app/ hides a library."""

import importlib.metadata
import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDERS = ("app", "core", "db", "station")


def _project() -> dict:
    return tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_every_folder_with_modules_is_packaged() -> None:
    on_disk = {
        "softcal." + ".".join(folder.relative_to(ROOT).parts)
        for top in FOLDERS
        for folder in [ROOT / top, *(ROOT / top).rglob("*")]
        if folder.is_dir() and any(folder.glob("*.py"))
    }
    assert on_disk - {"softcal.app.face"} | {"softcal"} == set(_project()["tool"]["setuptools"]["packages"])


def test_no_module_beside_the_page_script_has_the_name_of_a_library() -> None:
    # `streamlit run app/ui/main.py` puts app/ui/ first on sys.path.
    libraries = set(sys.stdlib_module_names) | set(importlib.metadata.packages_distributions()) - {"softcal"}
    modules = {path.stem for path in (ROOT / "app" / "ui").glob("*.py")} - {"__init__"}
    assert not modules & libraries


def test_every_dependency_is_locked_at_one_version_with_its_hashes() -> None:
    project = _project()["project"]
    everything = [project["dependencies"], *project["optional-dependencies"].values()]
    needed_to_run = [project["dependencies"], project["optional-dependencies"]["station"]]
    locked, demo = _locked("requirements.lock"), _locked("requirements-demo.lock")
    assert {_name(r) for group in everything for r in group} - {"softcal"} <= set(locked)
    assert {_name(r) for group in needed_to_run for r in group} <= set(demo)
    assert demo.items() <= locked.items()
    assert demo.items() <= _locked("requirements-image.lock").items() <= locked.items()


def _locked(name: str) -> dict[str, str]:
    """Versions by name; every entry must carry at least one hash, and none may bring CUDA."""
    versions = {}
    for entry in re.split(r"\n(?=[A-Za-z])", re.sub(r"^#.*\n", "", (ROOT / name).read_text(), flags=re.MULTILINE)):
        package, version = re.match(r"([\w.-]+)==(\S+)", entry.lstrip()).groups()  # type: ignore[union-attr]
        assert "--hash=sha256:" in entry, package
        assert not package.startswith(("nvidia", "cuda", "triton")), package
        versions[_name(package)] = version
    return versions


def _name(requirement: str) -> str:
    return (
        requirement.partition(";")[0]
        .replace("[", ">")
        .replace("=", ">")
        .split(">")[0]
        .strip()
        .lower()
        .replace("_", "-")
    )


def test_the_repository_names_no_path_of_a_machine() -> None:
    suspicious = [
        path.relative_to(ROOT)
        for path in _tracked()
        if path.suffix in {".py", ".md", ".toml", ".c", ".h", ".ino"} and path != Path(__file__)
        for word in ("/work/", "/root/", "/tmp/")
        if word in path.read_text(encoding="utf-8")
    ]
    assert not suspicious


def _tracked() -> list[Path]:
    skipped = {".venv", ".git", ".links", "build", "softcal-demo"}
    return [p for p in ROOT.rglob("*.*") if p.is_file() and not skipped & set(p.relative_to(ROOT).parts)]
