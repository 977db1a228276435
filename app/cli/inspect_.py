"""`softcal inspect`: content of a logger's table or a calibration file."""

import argparse

from softcal.app.cli.options import FILE, add_columns, add_shared, column_names
from softcal.app.output import print_table, write_json

EXAMPLES = """examples:
  softcal inspect logger.csv --output-column output_V --reference-column force_N
  softcal inspect my-lot/source/A1.csv --json -
  softcal inspect my-lot/audit/A2.csv --source my-lot/source/A1.csv
  softcal inspect files/unit-A1.ssc --network files/network-0123456789abcdef.ssc

Of a table: how it was read, its rate, gaps, samples that cannot be with line and value, jumps, and what is wrong with
the reference. A damaged calibration file is refused with the reason; with --network the unit's self-tests are run as a
device would.
"""
DEVICE_FILES = (".ssc", ".json")


def arguments(parser: argparse.ArgumentParser) -> None:
    """Inspect a table of one unit, or check a network or unit file (.ssc, or JSON)."""
    parser.add_argument("file", **FILE, help="a table (CSV and other text, .xlsx, Parquet, ...), .ssc or .json")
    parser.add_argument("--network", **FILE, help="the network file, to run a unit's self-tests")
    add_columns(parser)
    parser.add_argument("--reference-column", metavar="NAME", help="column of the reference; default: reference")
    parser.add_argument("--source", **FILE, help="the source's table: what differs in unit of measure or sign is named")
    add_shared(parser, "json", "csv")


def run(options: argparse.Namespace) -> None:
    """Read and show one file."""
    if options.file.suffix.lower() in DEVICE_FILES:
        _show_device_file(options)
    else:
        _show_table(options)


def _show_table(options: argparse.Namespace) -> None:
    from softcal.app.files.inspected_table import (
        FINDINGS_HEADER,
        compare_files,
        finding_rows,
        inspect_file,
        inspection_json,
        summary_rows,
    )

    names, reference = column_names(options), options.reference_column
    file = inspect_file(options.file, names, reference)
    source = None if options.source is None else inspect_file(options.source, names, reference)
    source_remarks = [] if source is None else compare_files(source, file)
    write_json(options.json, inspection_json(file, source_remarks))
    findings = finding_rows(file)
    if options.csv:
        print_table(FINDINGS_HEADER, findings)
    elif options.json != "-":
        print_table(("what", "value"), summary_rows(file))
        remarks = (*file.remarks, *source_remarks)
        for text in remarks:
            print(f"- {text}")
        if not remarks:
            print("nothing is wrong with it that can be seen without its unit")


def _show_device_file(options: argparse.Namespace) -> None:
    from softcal.app.export.check import file_rows, file_values, read_device_file
    from softcal.core.errors import InputError
    from softcal.core.export.blob import NetworkFile

    file, is_proven = read_device_file(options.file)
    network = read_device_file(options.network)[0] if options.network else None
    if network is not None and not isinstance(network, NetworkFile):
        raise InputError(f"{options.network}: a network file was expected, this one is of unit {network.serial}")
    rows = file_rows(file, is_proven, network)
    write_json(options.json, file_values(file, is_proven))
    if options.json != "-" or options.csv:
        print_table(("what", "value"), rows)
