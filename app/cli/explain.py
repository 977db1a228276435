"""`softcal explain`: the reasons of one unit's verdict."""

import argparse

from softcal.app.cli.options import COUNT, FILE, add_shared, answer, registry_of
from softcal.app.output import echo, print_reasons, print_table, write_json

EXAMPLES = """examples:
  softcal explain --serial A1
  softcal explain --serial A1 --out why-A1.html       the same as a figure, to open in a browser
  softcal explain --serial A1 --method                every number it was calibrated with, and where each comes from
  softcal batch lot-1 --plots why                     a figure of every unit
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Show what a unit's verdict rests on: reasons, what the predicted error is made of, limit."""
    add_shared(parser, "serial")
    parser.add_argument("--revision", **COUNT, help="an older map; default: the current one")
    parser.add_argument("--method", action="store_true", help="print every number of the method, with its origin")
    parser.add_argument("--out", **FILE, help="write the figure as a page (.html)")
    add_shared(parser, "lot", "registry", "json", "csv")


def run(options: argparse.Namespace) -> None:
    """Print reasons and budget, and write the figure; or print the numbers of the method."""
    from softcal.app.charts.explanation import explain_unit, explanation_json
    from softcal.app.registry.unit_status import find_unit_status
    from softcal.app.views.unit import unit_view
    from softcal.core.messages.reason import to_line
    from softcal.core.unit.explanation import contributions
    from softcal.core.unit.method import Method

    if options.method:
        with registry_of(options) as registry:
            method = registry.calibrations.get(options.serial, options.revision, lot_id=options.lot).state.fit.method
        current_method = Method()
        current_numbers = {name: value for name, value, _ in current_method.numbers()}
        if answer(options, "method/1", {"id": method.id, "numbers": dict(method.to_json())}):
            stale = "" if method.is_current else ", stale: this version uses another"
            print(f"{options.serial}: method {method.id[:12]}{stale}")
            for name, value, origin in method.numbers():
                now = "" if current_numbers.get(name) == value else f"; this version: {current_numbers.get(name)}"
                print(f"{name} = {value}{now}\n    {origin}")
        return

    with registry_of(options) as registry:
        unit = registry.calibrations.unit_key(options.serial, options.lot)
        if options.out is None:
            view = unit_view(registry, unit, options.revision)
        else:
            view = explain_unit(registry, unit, options.out, options.revision)
            echo(f"{options.out}: the figure of {options.serial}")
        status = find_unit_status(registry, view.stored)
    content = explanation_json(view)
    if status.calibration is None:
        since = to_line(status.reasons)
        echo(f"note: {options.serial} is {status.verdict} since: {since}; explained is the map it had before")
    write_json(options.json, content)
    if options.json != "-" or options.csv:
        state = view.stored.state
        print_reasons(f"{options.serial} {state.verdict} ({state.correspondence})", state.decision.reasons)
        rows = [[name, value] for name, value in contributions(view.stored.state.fit).items()]
        print_table(("part of the predicted error", view.lot.reference_unit), rows)
