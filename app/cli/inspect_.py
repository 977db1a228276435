"""`softcal inspect`: what a calibration file holds."""

import argparse

from softcal.app.cli.options import FILE, add_shared
from softcal.app.output import print_table, write_json

EXAMPLES = """examples:
  softcal inspect files/unit-A1.ssc
  softcal inspect files/unit-A1.ssc --network files/network-0123456789abcdef.ssc
  softcal inspect files/unit-A1.json --json -

A damaged file is refused with the reason; with --network the unit's self-tests are run as a device would.
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Show a network or unit file (.ssc, or its JSON twin), after checking all that can be checked."""
    parser.add_argument("file", **FILE, help=".ssc or .json")
    parser.add_argument("--network", **FILE, help="the network file, to run a unit's self-tests")
    add_shared(parser, "json", "csv")


def run(options: argparse.Namespace) -> None:
    """Read, check and show one file."""
    from softcal.app.export.check import file_rows, file_values, read_device_file
    from softcal.core.errors import InputError
    from softcal.core.export.blob import NetworkFile

    file = read_device_file(options.file)
    network = read_device_file(options.network) if options.network else None
    if network is not None and not isinstance(network, NetworkFile):
        raise InputError(f"{options.network}: a network file was expected, this one is of unit {network.serial}")
    rows = file_rows(file, network)
    write_json(options.json, file_values(file))
    if options.json != "-" or options.csv:
        print_table(("what", "value"), rows)
