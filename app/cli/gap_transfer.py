"""`softcal gap transfer`: how far calibration results in simulation predict those on the rig."""

import argparse
from pathlib import Path

from softcal.app.cli.options import add_json

_EXAMPLES = """examples:
  softcal gap diagnose rig-7 --json rig-7.gap.json
  softcal gap transfer --report rig-7.gap.json --lot lot-1
  softcal gap transfer --report rig-7.gap.json --lot lot-1 --json transfer.json

The lot's recordings must hold stage_mm: simulated units are pressed along the same positions.
"""
_WORDS = {
    "before": "error without a map, N",
    "after": "error with the map, N",
    "own": "error of an own calibration, N",
    "after_by_own": "with the map / own calibration",
}


def add_parser(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `softcal gap transfer`."""
    parser = commands.add_parser(
        "transfer",
        help="compare calibration results in simulation with those on the rig",
        description="Calibrate three lots in the same way: pressed on the rig, simulated with the refitted base twin, "
        "and with the explained twin. Show which twin foretells the rig's results.",
        epilog=_EXAMPLES,
    )
    parser.add_argument("--report", type=Path, required=True, metavar="FILE", help="JSON of softcal gap diagnose")
    parser.add_argument("--lot", type=Path, required=True, metavar="DIR", help="lot folder with audits, from the rig")
    parser.add_argument("--seed", type=int, default=0, help="of the simulated units' spread and noise (default 0)")
    add_json(parser)
    parser.set_defaults(run=_transfer)


def _transfer(options: argparse.Namespace) -> int:
    from softcal.app.gap.transfer import check_transfer
    from softcal.app.output import print_table, say, write_json

    found = check_transfer(options.report, options.lot, options.seed, say)
    write_json(options.json, found.to_record())
    if options.json != "-":
        header = ("median over units", "rig", "base twin", "explained twin", "base off by", "explained off by")
        print_table(header, [(_WORDS[n], *v, f"{b:.0%}", f"{e:.0%}") for n, *v, b, e in found.rows()])
    return 0
