"""The process behind `softcal ui`: reads the pages' modules, then hands over to Streamlit."""

import gc
import importlib
import socket
import sys
from functools import wraps
from pathlib import Path

from streamlit.web import cli
from streamlit.web.server.starlette import starlette_server

from softcal.app.ui.pages import PAGES
from softcal.app.ui.uploads import server_folder

WEB_APP = Path(__file__).with_name("web_app.py")
PRELOADED_MODULES = (
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


def send_at_once() -> None:
    """Let Streamlit's connections send each message at once.

    Streamlit binds its socket without naming TCP, so asyncio leaves Nagle's algorithm on: every answer in two pieces,
    as each script of a page, then waits 40 ms for the browser's delayed acknowledgement (RFC 1122, 4.2.3.2). Accepted
    connections inherit the option (tcp(7)).
    """
    bind = starlette_server._bind_socket

    @wraps(bind)
    def bound(address: str, port: int, backlog: int) -> socket.socket:
        listening = bind(address, port, backlog)
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return listening

    starlette_server._bind_socket = bound


def main(flags: list[str]) -> None:
    """Serve with Streamlit's own flags; returns when the server ends."""
    page_modules = [f"softcal.app.ui.app_pages.{page.name}" for page in PAGES]
    page_modules += [page.module_of(tab.name) for page in PAGES for tab in page.tabs]
    for name in (*PRELOADED_MODULES, *page_modules):
        importlib.import_module(name)

    server_folder()
    # Streamlit collects garbage after every run of a page: without this it looks through all modules each time, 0.13 s,
    # and while a large lot is read again and again.
    gc.collect()
    gc.freeze()
    gc.set_threshold(200_000, 20, 100)
    send_at_once()
    sys.argv = ["streamlit", "run", str(WEB_APP), *flags]
    cli.main()


if __name__ == "__main__":
    main(sys.argv[1:])
