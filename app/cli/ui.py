"""`softcal ui`: the Streamlit application, in the browser or in a separate window."""

import argparse

from softcal.app.cli.options import FILE, add_shared

EXAMPLES = """examples:
  softcal ui                       open the application in the default browser
  softcal ui --window              as an application window (Chromium or Edge)
  softcal ui --window --kiosk      full screen, for the panel at the line
  softcal ui --station line-1      the screen of one of several stations
  softcal ui --no-browser --port 8501 --registry postgresql://line@db/softcal

Closing the application never stops the station: its service is a process of its own (softcal station serve).
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Serve the Streamlit application on this machine only and open it. Needs no internet."""
    add_shared(parser, "registry")
    parser.add_argument("--port", type=int, default=0, help="default: the first free one from 8501")
    parser.add_argument("--address", default="127.0.0.1", help="default: this machine only")
    parser.add_argument("--window", action="store_true", help="open as an application window instead of a browser tab")
    parser.add_argument("--kiosk", action="store_true", help="with --window: full screen")
    parser.add_argument("--no-browser", action="store_true", help="serve only")
    parser.add_argument("--station", metavar="NAME", help="the station at this screen; default: the only one there is")
    parser.add_argument(
        "--host",
        action="append",
        default=[],
        metavar="NAME",
        help="another name under which browsers reach this server; every other name is refused",
    )
    parser.add_argument("--accounts", **FILE, help="TOML with [auth]: sign in by company account (OIDC)")


def run(options: argparse.Namespace) -> int:
    """Serve until the window is closed or Ctrl-C."""
    from softcal.app.ui.desktop import UiOptions, serve

    return serve(
        UiOptions(
            registry=options.registry,
            port=options.port,
            address=options.address,
            is_window=options.window or options.kiosk,
            is_kiosk=options.kiosk,
            opens_browser=not options.no_browser,
            station=options.station,
            accounts=options.accounts,
            hosts=tuple(options.host),
        )
    )
