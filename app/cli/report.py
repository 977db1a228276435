"""`softcal report`: one page with the state of a lot."""

import argparse
from datetime import datetime
from functools import partial
from importlib.metadata import version
from pathlib import Path

from softcal.app.cli.options import FILE, add_shared, lot_id_of, registry_of
from softcal.app.output import echo

EXAMPLES = """examples:
  softcal report lot-1                              writes lot-1.html
  softcal report lot-1 --out report.html --language ko
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Write one standalone HTML page of a lot in the registry: yields, errors predicted and measured, control chart,
    why units did not pass, every unit. It needs no network to be read.
    """
    parser.add_argument("lot", metavar="LOT", help="id of a lot in the registry, or its lot folder")
    parser.add_argument("--out", **FILE, help="default: LOT.html")
    parser.add_argument("--language", choices=("en", "ko"), default="en")
    add_shared(parser, "registry")


def run(options: argparse.Namespace) -> None:
    """Write the page."""
    from softcal.app.charts.lot_page import lot_page
    from softcal.app.files.atomic import write_text
    from softcal.app.texts.catalogue import text
    from softcal.app.views.lot import lot_view

    render = partial(text, options.language)
    creation_note = render("report.made", at=datetime.now().astimezone(), version=version("softcal"))
    with registry_of(options) as registry:
        lot_id = lot_id_of(options.lot)
        view = lot_view(registry, lot_id)
        units = [unit for unit in registry.lots.units(lot_id) if unit.role == "target"]
    out = options.out or Path(f"{lot_id}.html")
    write_text(out, lot_page(view, units, render, creation_note))
    echo(f"{out}: lot {lot_id}, {view.decided} of {view.total} units have a result")
