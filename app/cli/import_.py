"""`softcal import`: a lot folder out of CSV, Excel or Parquet files."""

import argparse
from pathlib import Path

from softcal.app.cli.options import COUNT, FILE, add_shared, answer, converted, say_unused, unused_json
from softcal.app.output import say
from softcal.core.errors import InputError

EXAMPLES = """examples:
  one file per unit; S1 has a load cell; the others' forces are their audits:
    softcal import S1.csv S2.csv --source S1 --output-column output_V --reference-column force_N \\
        --sample-rate 50 --audit --out lot-1
  one wide file, a column per unit:
    softcal import insole.parquet --source taxel_001 --output-column 'taxel_*' --reference-column pressure_bar \\
        --time-column t_s --reference-quantity pressure --reference-unit bar --output-unit count --out lot-2
then: softcal batch lot-1
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Make a lot folder: one file per unit, or one wide file with a column per unit. Nothing is written unless every
    file can be used.
    """
    parser.add_argument("files", nargs="+", **FILE, help="CSV, .xlsx or Parquet; of a folder, all")
    parser.add_argument("--out", required=True, type=Path, help="lot folder to make; must not exist yet")
    parser.add_argument(
        "--source",
        required=True,
        action="append",
        metavar="SERIAL",
        help="unit with the reference that trains f; again for further sources: each unit takes the nearest",
    )
    parser.add_argument("--lot-id", help="default: the name of the lot folder")
    parser.add_argument("--sensor-model", default="")
    group = parser.add_argument_group("columns, where they are not t_s, output, reference and stage_mm")
    group.add_argument("--output-column", default="output", help="column of the output; with * one unit per column")
    group.add_argument("--reference-column", default="reference", help="column of the load cell; the source has one")
    group.add_argument("--time-column", help="column of the time in s")
    group.add_argument("--stage-column", default="stage_mm", help="column of the stage position in mm")
    group.add_argument(
        "--sample-rate", type=float, metavar="HZ",
        help="default: what the time column shows; without --time-column it makes the time",
    )  # fmt: skip
    parser.add_argument("--serial", action="append", metavar="S", help="serial of each file in order; else its name")
    parser.add_argument(
        "--audit",
        action="store_true",
        help="keep the targets' references in audit/: they decide about their units, no map is fitted to them",
    )
    rows = converted(_rows, "{!r}: START:STOP was expected, for example 0:800")
    parser.add_argument("--rows", type=rows, metavar="A:B", help="data rows that fit, counted from 0")
    parser.add_argument("--audit-rows", type=rows, metavar="A:B", help="data rows of the audit")
    parser.add_argument(
        "--most-cells", default=20_000_000, **COUNT,
        help="refuse larger tables before they are read (default 20 million; a tenth of it for Excel)",
    )  # fmt: skip
    parser.add_argument("--sheet", help="sheet of an Excel file")
    parser.add_argument("--reference-quantity", default="force")
    parser.add_argument("--reference-unit", default="N")
    parser.add_argument("--output-unit", default="V")
    parser.add_argument("--limit", type=float, metavar="RMSE", help="largest acceptable error, in the reference unit")
    add_shared(parser, "json")


def _rows(text: str) -> tuple[int, int]:
    start, _, stop = text.partition(":")
    return int(start), int(stop)


def run(options: argparse.Namespace) -> None:
    """Import, and say what was made."""
    from softcal.app.files.importing import Columns, ImportPlan, import_lot, median_rate_Hz, tables_of
    from softcal.app.files.not_used import unread_files
    from softcal.core.lot import Lot

    time = options.time_column or (None if options.sample_rate else "t_s")
    files = [file for path in options.files for file in tables_of(path)]
    rate_Hz = options.sample_rate or median_rate_Hz(
        files[0], options.time_column or "t_s", options.sheet, options.most_cells
    )
    first, *more = options.source
    if len(set(options.source)) < len(options.source):
        raise InputError(f"--source {' --source '.join(options.source)}: give each source once")
    lot = Lot(
        id=options.lot_id or options.out.name,
        source=first,
        sample_rate_Hz=rate_Hz,
        sensor_model=options.sensor_model,
        reference_quantity=options.reference_quantity,
        reference_unit=options.reference_unit,
        output_unit=options.output_unit,
        limit_rmse=options.limit,
    )
    columns = Columns(options.output_column, options.reference_column, time, options.stage_column)
    plan = ImportPlan(
        files, columns, lot, options.audit, options.rows, options.audit_rows, options.sheet, options.serial,
        options.most_cells, more_sources=more,
    )  # fmt: skip
    made = import_lot(plan, options.out)
    not_used = (*(item for path in options.files for item in unread_files(path)), *made.not_used)
    units, sources = len(made.units), ", ".join(options.source)
    say(f"{options.out}: lot {lot.id!r}, source {sources}, {units} target units, {rate_Hz:g} Hz")
    if options.audit:
        say(f"audits: {len(made.audits)} of {units}")
    say_unused(not_used, made.remarks)
    facts = {"lot": lot.id, "source": lot.source, "units": list(made.units), "audits": list(made.audits)}
    answer(options, "import/1", facts | unused_json(not_used, made.remarks))
