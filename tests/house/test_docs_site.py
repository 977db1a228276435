"""`make docs`: the site builds without a warning, and its reference holds every public name."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

import softcal

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2]


def test_the_site_builds_without_a_warning_and_shows_the_reference(tmp_path: Path, require) -> None:  # type: ignore[no-untyped-def]
    require(importlib.util.find_spec("mkdocstrings"), "no mkdocs (pip install 'softcal[docs]')")
    links = tmp_path / "links" / "softcal"
    links.mkdir(parents=True)
    for folder in ("app", "core", "db", "station"):
        (links / folder).symlink_to(ROOT / folder)
    settings = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").replace("build/source", str(links.parent))
    (tmp_path / "mkdocs.yml").write_text(settings.replace("docs_dir: docs", f"docs_dir: {ROOT / 'docs'}"))
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    process = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
    assert "WARNING -" not in process.stderr
    reference = (tmp_path / "site" / "api" / "index.html").read_text(encoding="utf-8")
    for name in set(softcal.__all__) - {"__version__"}:
        assert re.search(rf'id="softcal\.[\w.]*\.{name}"', reference), name
