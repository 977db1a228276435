"""`softcal import`: a lot folder out of the files that loggers and laboratories write."""

import argparse
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from softcal.app.cli.limit import LIMIT, limit_rmse
from softcal.app.cli.options import (
    COUNT,
    FILE,
    SAMPLE_RATE_HELP,
    TIME_COLUMN_HELP,
    add_layout,
    add_shared,
    answer,
    converted,
    echo_layouts,
    echo_unused_input,
    positive,
    table_options,
    unused_json,
)
from softcal.app.output import echo
from softcal.core.errors import InputError

if TYPE_CHECKING:
    from softcal.app.files.import_plan import ImportPlan
    from softcal.app.files.importing import ImportedLot
    from softcal.app.files.unused_input import UnusedInput

MAX_NAMES = 8
"""So many new names are proposed."""

EXAMPLES = """examples:
  one file per unit; S1 has a load cell; the others' forces are their audits:
    softcal import S1.csv S2.csv --source S1 --output-column output_V --reference-column force_N \\
        --sample-rate 50 --audit --limit 0.4 --out lot-1
  one wide file, a column per unit:
    softcal import insole.parquet --source taxel_001 --output-column 'taxel_*' --reference-column pressure_bar \\
        --time-column t_s --reference-quantity pressure --reference-unit bar --output-unit count --limit 5% --out lot-2
then: softcal batch lot-1
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Make a lot folder: one file per unit, or one wide file with a column per unit. Nothing is written unless every
    file can be used.
    """
    parser.add_argument(
        "files", nargs="+", **FILE, help="CSV and other text, .xlsx, .ods, Parquet, .mat, .h5, .tdms; of a folder, all"
    )
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
    group.add_argument("--time-column", help=TIME_COLUMN_HELP)
    group.add_argument("--stage-column", default="stage_mm", help="column of the stage position in mm")
    group.add_argument("--sample-rate", type=positive, metavar="HZ", help=SAMPLE_RATE_HELP)
    parser.add_argument(
        "--serial",
        action="append",
        metavar="[OLD=]NEW",
        help="serial of the file or column OLD, or of each file in order; default: the names of files or columns",
    )
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
    parser.add_argument("--reference-quantity", default="force")
    parser.add_argument("--reference-unit", default="N")
    parser.add_argument("--output-unit", default="V")
    parser.add_argument("--limit", **LIMIT)
    add_layout(parser)
    add_shared(parser, "json")


def _rows(text: str) -> tuple[int, int]:
    start, _, stop = text.partition(":")
    return int(start), int(stop)


def run(options: argparse.Namespace) -> None:
    """Import the tables, and print the result."""
    from softcal.app.files.import_plan import Columns, ImportPlan
    from softcal.app.files.importing import detect_rate_Hz, import_lot, list_tables
    from softcal.core.lot import Lot

    files = [file for path in options.files for file in list_tables(path)]
    columns = Columns(options.output_column, options.reference_column, options.time_column, options.stage_column)
    table = table_options(options)
    rate_Hz = options.sample_rate or detect_rate_Hz(files[0], columns, table)
    first, *more = map(_check_source, options.source)
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
    )
    serials, renames = _serials(options.serial or [])
    plan = ImportPlan(
        files, columns, lot, options.audit, options.rows, options.audit_rows, table, serials, renames, more_sources=more
    )
    imported = import_lot(plan, options.out)
    _write_limit(options, lot.reference_unit, imported.reference_range)
    _report(options, plan, imported)


def _check_source(name: str) -> str:
    from softcal.core.lot import check_serial, propose_serial

    try:
        return check_serial(name)
    except InputError as error:
        if (proposed := propose_serial(name)) is None:
            raise
        option = shlex.quote(f"{name}={proposed}")
        raise InputError(f"{error}: --source {proposed} --serial {option}") from error


def _serials(values: list[str]) -> tuple[list[str] | None, dict[str, str]]:
    """Return serials of files in order, or new serials by the names of files or columns."""
    renames = dict(text.rsplit("=", 1) for text in values if "=" in text)
    if renames and len(renames) < len(values):
        raise InputError("--serial: give either OLD=NEW for names, or one serial per file in order, not both")
    return (None, renames) if renames or not values else (values, {})


def _report(options: argparse.Namespace, plan: "ImportPlan", imported: "ImportedLot") -> None:
    """Print the created lot, the layout of the files, and the unused inputs."""
    from softcal.app.files.unused_parts import unread_files

    lot = plan.lot
    echo_layouts(imported.layouts)
    units = f"target units: {len(imported.units)}"
    echo(f"{options.out}: lot {lot.id!r}, source {', '.join(options.source)}, {units}, {lot.sample_rate_Hz:g} Hz")
    not_used = (*(item for path in options.files for item in unread_files(path)), *imported.not_used)
    if plan.audit:
        cause = next((f"; {item.why}" for item in not_used if item.kind == "audit"), "")
        echo(f"audits: {len(imported.audits)} of {len(imported.units)}{cause}")
    echo_unused_input(not_used, imported.remarks)
    if unnamed := [item for item in imported.not_used if item.why.code.startswith("name.")]:
        echo(f"note: {_rename_options(plan, unnamed)} gives a file or a column another serial")
    content: dict[str, object] = {"lot": lot.id, "source": lot.source, "units": list(imported.units)}
    content |= {"audits": list(imported.audits), "layouts": dict(imported.layouts)}
    answer(options, "import/1", content | unused_json(not_used, imported.remarks))


def _rename_options(plan: "ImportPlan", unnamed: "Sequence[UnusedInput]") -> str:
    """Return the options that would give names which are no serials others."""
    from softcal.core.lot import propose_serial

    renamed = {*plan.renames, *plan.renames.values()}
    names = [item.name if item.kind == "column" else Path(item.name).stem for item in unnamed]
    proposed = {name: propose_serial(name) for name in names if name not in renamed and plan.serials is None}
    options = [f"--serial {shlex.quote(f'{name}={new}')}" for name, new in proposed.items() if new not in (None, name)]
    return " ".join([*options[:MAX_NAMES], *(["..."] if len(options) > MAX_NAMES else [])]) or "--serial 'OLD=NEW'"


def _write_limit(options: argparse.Namespace, unit: str, full_range: float) -> None:
    """Write the limit, given or asked for, into the created folder."""
    from softcal.app.files.lot_toml import update_limit

    limit = limit_rmse(options.limit, unit, full_range, options.out / "lot.toml")
    if limit is not None:
        update_limit(options.out, limit)
