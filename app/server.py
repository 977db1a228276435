"""The process behind `softcal ui`: reads the pages' modules, so that no page waits, then hands over to Streamlit."""

import gc
import importlib
import json
import shutil
import sys
import tempfile
from pathlib import Path

from softcal.app.pages import PAGES

MAIN = Path(__file__).with_name("main.py")
DRAWN_WITH = (
    "pandas",
    "pyarrow.pandas_compat",
    "plotly.graph_objs.bar",
    "plotly.graph_objs.layout",
    "plotly.graph_objs.scatter",
    "streamlit.elements.plotly_chart",
    "streamlit.material_icon_names",
    "streamlit.web.bootstrap",
    "streamlit.web.server.starlette.starlette_server",
    "softcal.core.maps.catalogue",
    "softcal.db.connection",
)


SERVER_IS_AT_ROOT = """<script>
if (%s.includes(location.pathname)) window.__streamlit = {BACKEND_BASE_URL: location.origin + "/"}
</script>
"""


def main(flags: list[str]) -> None:
    """Serve with Streamlit's own flags; returns when the server ends."""
    with tempfile.TemporaryDirectory(prefix="softcal-pages-") as folder:
        _serve(flags, Path(folder))


def _serve(flags: list[str], folder: Path) -> None:
    for name in (*DRAWN_WITH, *(f"softcal.app.app_pages.{page.name}" for page in PAGES)):
        importlib.import_module(name)
    from streamlit import file_util
    from streamlit.web import cli

    shell = _shell(Path(file_util.get_static_dir()), folder)
    file_util.get_static_dir = lambda: str(shell)
    # Streamlit collects garbage after every run of a page: without this it looks through all modules each time, 0.13 s.
    gc.collect()
    gc.freeze()
    sys.argv = ["streamlit", "run", str(MAIN), *flags]
    cli.main()


def _shell(static: Path, folder: Path) -> Path:
    """Return a folder with Streamlit's browser part whose page knows where its server is.

    Without being told, the browser of a page with a path of its own first asks for a server below that path, is
    refused, and waits 0.1 s before it asks at the root. An address that is none of ours is left to Streamlit: it may be
    below a proxy's path.
    """
    page = (static / "index.html").read_text(encoding="utf-8")
    told = SERVER_IS_AT_ROOT % json.dumps([f"/{entry.name}" for entry in PAGES])
    (folder / "index.html").write_text(page.replace("<script", f"{told}<script", 1), encoding="utf-8")
    for entry in static.iterdir():
        if entry.name != "index.html":
            _link(entry, folder / entry.name)
    return folder


def _link(entry: Path, place: Path) -> None:
    try:
        place.symlink_to(entry, target_is_directory=entry.is_dir())
    except OSError:  # Windows lets only some people make links.
        (shutil.copytree if entry.is_dir() else shutil.copy)(entry, place)


if __name__ == "__main__":
    main(sys.argv[1:])
