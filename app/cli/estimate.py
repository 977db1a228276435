"""`softcal estimate`: estimates of one unit with interval and flags."""

import argparse
from pathlib import Path

from softcal.app.cli.options import (
    COUNT,
    add_columns,
    add_shared,
    answer,
    column_names,
    echo_caution,
    echo_layout,
    registry_of,
)
from softcal.app.output import echo

EXAMPLES = """examples:
  softcal estimate --serial A1 recording.csv --out estimate.csv
  softcal estimate --serial A1 recording.parquet --out estimate.parquet --revision 2
  softcal estimate --serial A1 logger.csv --output-column output_V --sample-rate 50 --out estimate.csv

Columns of the result: t_s, estimate, lower, upper (a 90 % interval), flag (why a row is not to be trusted).
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Estimate the reference from the columns t_s, output of a recording with the unit's current map."""
    add = parser.add_argument
    add("recording", type=Path, metavar="IN", help="table with t_s, output: CSV and other text, .xlsx, Parquet, ...")
    add("--out", required=True, type=Path, metavar="OUT", help="CSV or Parquet to write")
    add_shared(parser, "serial")
    add_columns(parser)
    add("--revision", **COUNT, help="an older map; default: the current one")
    add_shared(parser, "lot", "registry", "json")


def run(options: argparse.Namespace) -> None:
    """Print or write the estimates, with counts of the flags."""
    from softcal.app.registry.estimate import estimate_file

    with registry_of(options) as registry:
        unit = options.serial, options.revision, options.lot
        estimation = estimate_file(registry, options.recording, options.out, *unit, names=column_names(options))
        echo_caution(registry, unit, "estimate")
    result, file = estimation.estimate, estimation.file
    echo_layout(str(options.recording), file.table.layout, file.remarks)
    flags = [flag for flag in result.flag if flag]
    counts = {flag: flags.count(flag) for flag in sorted(set(flags))}
    flag_text = ", ".join(f"{count} {flag}" for flag, count in counts.items()) or "no row flagged"
    echo(f"{options.out}: {len(result.flag)} rows; {flag_text}")
    answer(
        options,
        "estimate/1",
        {"rows": len(result.flag), "flags": counts, "layout": file.table.layout, "remarks": list(file.remarks)},
    )
