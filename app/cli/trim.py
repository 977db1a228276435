"""`softcal trim`: adjust a unit's map by known loads at the place of use."""

import argparse
from functools import partial

from softcal.app.cli.confirm import NOT_CONFIRMED, may_do, withdraw_files
from softcal.app.cli.options import FILE, add_layout, add_shared, answer, echo_layout, registry_of, table_options
from softcal.app.output import echo

EXAMPLES = """examples:
  softcal trim --serial A1 --loads loads.csv       columns output, reference: the output at rest under each known load

Two loads fix zero and span: nothing on the unit, and a weight near the top of its range. Every trim is a
revision of its own; `softcal registry rollback` takes it back.
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Correct gain and zero of a unit's map by known loads at its place of use."""
    add_shared(parser, "serial")
    parser.add_argument("--loads", required=True, **FILE, help="CSV or Parquet: output, reference")
    add_layout(parser)
    add_shared(parser, "yes", "lot", "registry", "json")


def run(options: argparse.Namespace) -> int:
    """Trim the unit, and print the changes."""
    from softcal.app.calibration.trim import trim_unit
    from softcal.app.tables.read import read_table

    table = read_table(options.loads, table_options(options))
    echo_layout(str(options.loads), table.layout, table.remarks)
    with registry_of(options) as registry:
        act = partial(trim_unit, registry, options.serial, options.loads, options.lot, table_options(options))
        lot_id = registry.calibrations.get(options.serial, lot_id=options.lot).lot_id
        if not may_do(registry, lot_id, act, options.yes):
            return NOT_CONFIRMED
        trimmed, revision = act()
        withdraw_files(registry, lot_id)
    gain, offset = trimmed.gain, trimmed.offset
    content = {"serial": options.serial, "revision": revision, "gain": gain, "offset": offset}
    content["layout"] = table.layout
    content |= {name: getattr(trimmed, name) for name in ("gain_error", "rest_error", "before_rmse", "after_rmse")}
    if answer(options, "trim/1", content):
        print(
            f"{options.serial} revision {revision}: gain times {gain:.4g} ± {trimmed.gain_error:.1%}, "
            f"offset {offset:+.4g}, estimate at rest ± {trimmed.rest_error:.2g} (one standard uncertainty)"
        )
        print(f"error at the loads: RMSE {trimmed.before_rmse:.3g} before, {trimmed.after_rmse:.3g} after")
    echo("a trimmed unit is conditional at best, and one that failed its audit stays so, until it is audited again")
    return 0
