"""The process behind `softcal ui`: reads the pages' modules, so that no page waits, then hands over to Streamlit."""

import gc
import importlib
import sys
from pathlib import Path

from softcal.app.ui.pages import PAGES

WEB_APP = Path(__file__).with_name("web_app.py")
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


def main(flags: list[str]) -> None:
    """Serve with Streamlit's own flags; returns when the server ends."""
    for name in (*DRAWN_WITH, *(f"softcal.app.ui.app_pages.{page.name}" for page in PAGES)):
        importlib.import_module(name)
    from streamlit.web import cli

    # Streamlit collects garbage after every run of a page: without this it looks through all modules each time, 0.13 s.
    gc.collect()
    gc.freeze()
    sys.argv = ["streamlit", "run", str(WEB_APP), *flags]
    cli.main()


if __name__ == "__main__":
    main(sys.argv[1:])
