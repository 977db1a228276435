"""`softcal paper`: the tables of Kim et al. (2020), computed again."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from softcal.app.cli.options import (
    FILE,
    SAMPLE_RATE_HELP,
    TIME_COLUMN_HELP,
    add_network,
    add_shared,
    answer,
    network_config,
    positive,
)
from softcal.app.output import echo, print_table
from softcal.core.errors import InputError

if TYPE_CHECKING:
    from softcal.app.files.recording_file import ColumnNames
    from softcal.app.operation.paper import PaperTables
    from softcal.core.recording import LabelledRecording

EXAMPLES = """examples:
  softcal paper
  softcal paper S1.csv S2.csv --output-column output_V --reference-column force_N --sample-rate 50
  softcal paper S1.csv S2.csv --stream strain.parquet --json -

Exit code 0: what the paper says of a map holds here; 1: some row does not.
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Compute Tables 1 to 3 of Kim et al.

    (2020), and the data of Figures 8 and 9. They are computed by the paper's own method and by the default, next to
    the published values. Without files the pair is simulated.
    """
    parser.add_argument("source", type=Path, nargs="?", metavar="SOURCE", help="labelled recording of the source")
    parser.add_argument("target", type=Path, nargs="?", metavar="TARGET", help="labelled recording of another unit")
    parser.add_argument("--stream", **FILE, help="labelled recording of long use; its first quarter calibrates it")
    group = parser.add_argument_group("columns of the files, where they are not t_s, output and reference")
    group.add_argument("--output-column", metavar="NAME", help="column of the output")
    group.add_argument("--reference-column", metavar="NAME", help="column of the reference")
    group.add_argument("--stream-output", metavar="NAME", help="the same of the stream")
    group.add_argument("--stream-reference", metavar="NAME", help="the same of the stream")
    group.add_argument("--time-column", metavar="NAME", help=TIME_COLUMN_HELP)
    group.add_argument("--sample-rate", type=positive, metavar="HZ", help=SAMPLE_RATE_HELP)
    add_network(parser)
    add_shared(parser, "json")


def run(options: argparse.Namespace) -> int:
    """Print the tables and return 1 where a row does not hold."""
    from softcal.app.files.recording_file import PLAIN, ColumnNames
    from softcal.app.operation import paper

    if (options.source is None) != (options.target is None):
        raise InputError("SOURCE is given without TARGET; two labelled recordings were expected, or none")
    names = ColumnNames(
        options.output_column or PLAIN.output,
        options.time_column,
        reference=options.reference_column or PLAIN.reference,
        rate_Hz=options.sample_rate,
    )
    files = [path for path in (options.source, options.target) if path is not None]
    pair = [_labelled(path, names) for path in files]
    stream = None
    if options.stream is not None:
        columns = ColumnNames(
            options.stream_output or PLAIN.output, reference=options.stream_reference or PLAIN.reference
        )
        stream = _labelled(options.stream, columns)
    if not pair:
        echo("note: the pair is simulated; name two labelled recordings for measured ones")
    source, target = pair or paper.simulated_pair(options.seed)
    tables = paper.compute_tables(source, target, stream, network_config(options))
    goals = tables.goals
    _print(tables, source.reference_unit)
    for name, is_reached in goals.items():
        print(f"{'holds' if is_reached else 'DOES NOT HOLD'}: {name}")
    content = {"errors": tables.errors, "shares": tables.shares, "seconds": tables.seconds, "courses": tables.courses}
    answer(options, "paper/1", {**content, "published": paper.PUBLISHED, "goals": goals})
    return 0 if all(goals.values()) else 1


def _labelled(path: Path, names: "ColumnNames") -> "LabelledRecording":
    from softcal.app.files.recording_file import inspect_recording

    return inspect_recording(path, path.stem, names.rate_Hz, names=names, with_reference=True).labelled("N")


def _print(tables: "PaperTables", unit: str) -> None:
    from softcal.app.operation.paper import COURSE_PARTS, COURSES, OWN_CALIBRATION, PUBLISHED, SHARES

    print(f"Table 1. Published: {PUBLISHED[1]}.\n")
    own_rmse = tables.errors[OWN_CALIBRATION]
    print_table(("method", f"RMSE [{unit}]", "after / own"), [(n, e, e / own_rmse) for n, e in tables.errors.items()])
    print(f"\nTable 2, RMSE [{unit}] by the share of the unit's windows. Published: {PUBLISHED[2]}.\n")
    print_table(
        ("map", *(f"{share:.0%}" for share in SHARES)), [(n, *_nan_to_none(e)) for n, e in tables.shares.items()]
    )
    print(f"\nTable 3, processor time. Published: {PUBLISHED[3]}.\n")
    train_s = tables.seconds["network"]
    print_table(("step", "s", "of the network's time"), [(n, s, _part(s, train_s)) for n, s in tables.seconds.items()])
    if tables.courses:
        print(f"\nFigures 8 and 9, RMSE over the stream in {COURSE_PARTS} parts. Published: {PUBLISHED[8]}.\n")
        print_table(
            ("softcal adapt --mode", *map(str, range(1, COURSE_PARTS + 1))), [(m, *tables.courses[m]) for m in COURSES]
        )
    print()


def _nan_to_none(errors: list[float]) -> list[float | None]:
    return [None if error != error else error for error in errors]


def _part(seconds: float, total_s: float) -> str:
    return "1" if seconds == total_s else f"1/{total_s / max(seconds, 1e-9):.0f}"
