"""`softcal batch`: calibrate a whole lot without a screen."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from softcal.app.cli.confirm import withdraw_files
from softcal.app.cli.options import (
    COUNT,
    DIR,
    FILE,
    add_network,
    add_shared,
    batch_callbacks,
    echo_layouts,
    echo_unused_input,
    network_config,
    registry_of,
)
from softcal.app.output import echo, print_reasons, print_sentence, print_table, write_json

if TYPE_CHECKING:
    from softcal.app.batch.report import BatchReport
    from softcal.db.registry import Registry

EXAMPLES = """examples:
  softcal batch lot-1
  softcal batch lot-1 --map exact
  softcal batch lot-1 --jobs 2 --out calibration-files --json report.json
  softcal batch lot-1 --engine dask --scheduler tcp://10.0.0.5:8786 --registry postgresql://line@db/softcal

Stopped in the middle? Run the same command again: finished units are kept.
Exit code 0: every unit passed; 1: done, but some unit did not pass.
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Calibrate a lot folder. One bad unit never stops the lot; finished work is never repeated."""
    add = parser.add_argument
    add("lot", type=Path, metavar="LOT", help="lot folder")
    add_shared(parser, "registry")
    add("--out", **DIR, help="write calibration files of the released units here")
    add_shared(parser, "release")
    add("--plots", **DIR, help="write a figure per unit: why its verdict")
    add("--jobs", default=1, **COUNT, help="worker processes (default 1)")
    add("--engine", choices=("local", "dask"), default="local")
    add("--scheduler", metavar="ADDR", help="a running Dask scheduler; default: one for this run")
    add(
        "--anchors",
        **FILE,
        help="known loads: columns serial, output, reference; default: LOT/anchors.csv, where there is one",
    )
    add("--no-own", action="store_true", help="do not train own calibrations on audits for comparison")
    add(
        "--map",
        metavar="FAMILY",
        dest="family",
        help="how every unit's map is found: auto (default: by each unit's evidence); the paper's optimal transport of "
        "windows, exact (discrete plan, eq. 3) or joint (map and network together, eq. 5); one-dimensional transport, "
        "monotone (equal quantiles); pairs, synchronous (equal time) or stage_matched (equal stage position); "
        "two_point (rest and peak), averaged (of monotone and two_point), affine (two quantiles), identity; or one of "
        "a plug-in. Kept with the lot until another is given; lot.toml states it as [map] family",
    )
    add("--refit", action="store_true", help="fit again what the registry already has, once with each build of softcal")
    add(
        "--parquet",
        type=_parquet,
        metavar="FILE",
        help="write the results of the lot as a .parquet table, a row a unit",
    )
    add_network(parser)
    add_shared(parser, "json", "csv")


def _parquet(text: str) -> Path:
    if not text.lower().endswith(".parquet"):
        raise argparse.ArgumentTypeError(f"{text}: a name that ends in .parquet was expected")
    return Path(text)


def run(options: argparse.Namespace) -> int:
    """Run the batch, print the table, write the report."""
    from softcal.app.batch.batch import run_batch
    from softcal.app.batch.engine import EngineChoice
    from softcal.app.batch.lot_work import BatchConfig
    from softcal.app.batch.report import TABLE_HEADER, audit_lines, report_json, table_row
    from softcal.app.extras import lacking
    from softcal.app.files.anchors import read_anchors
    from softcal.app.files.lot_folder import open_lot_folder
    from softcal.app.texts.reason_groups import reasons_by_verdict
    from softcal.core.maps.catalogue import check_family
    from softcal.core.unit.verdict import VERDICTS, Release

    folder = open_lot_folder(options.lot)
    for remark in folder.remarks:
        echo(f"note: {remark}")
    lack = None if options.no_own else lacking("torch", "no own calibration is trained for comparison")
    anchors = {} if options.anchors is None else read_anchors(options.anchors, folder.unit_paths)
    config = BatchConfig(
        anchors=anchors,
        network=network_config(options),
        engine=EngineChoice(options.engine, options.jobs, options.scheduler),
        score_own=not options.no_own and lack is None,
        refit=options.refit,
        family=None if options.family is None else check_family(options.family),
        release=Release(options.release),
    )
    with registry_of(options, create=True) as registry:
        if lack:
            echo(f"note: {lack}")
        report = run_batch(folder, registry, config, batch_callbacks(folder.lot.reference_unit))
        if options.out is not None:
            _write_files(registry, report, options.out)
        if options.parquet is not None:
            from softcal.app.calibration.results import lot_results, parquet_bytes
            from softcal.app.files.atomic import write_bytes

            write_bytes(options.parquet, parquet_bytes(lot_results(registry, report.lot_id)))
            echo(f"{options.parquet}: results of lot {report.lot_id}")
        if options.plots is not None:
            from softcal.app.charts.explanation import explain_units

            mapped = [u.serial for u in report.units if u.calibration is not None]
            explain_units(registry, report.lot_id, mapped, options.plots)
            echo(f"{options.plots}: figures of units: {len(mapped)}")
    if options.refit and report.units and not any(unit.is_new for unit in report.units):
        echo("note: this build fitted every unit again already; nothing was fitted")
    echo_layouts(report.layouts)
    print_table(TABLE_HEADER, [table_row(unit) for unit in report.units])
    for subject, reasons in reasons_by_verdict(report.units, reversed(VERDICTS[1:])):
        print_reasons(subject, reasons)
    for line in audit_lines(report):
        print_sentence(line)
    counts = ", ".join(f"{count} {word}" for word, count in report.counts.items())
    in_all = f"units: {sum(report.counts.values())} in {report.wall_s:.1f} s"
    print(f"{in_all}: {counts}; errors are RMSE in {folder.lot.reference_unit}")
    echo_unused_input(report.not_used, report.remarks)
    write_json(options.json, report_json(report))
    return 0 if report.has_passed else 1


def _write_files(registry: "Registry", report: "BatchReport", out: Path) -> None:
    from softcal.app.export.calibrated_unit import ExportOptions
    from softcal.app.export.export import export_units
    from softcal.app.export.manifest import withdraw_units
    from softcal.core.unit.verdict import Release

    released = [unit.serial for unit in report.units if report.releases(unit)]
    verdicts = {unit.serial: unit.verdict for unit in report.units}
    for serial in withdraw_units(out, report.lot_id, released, verdicts):
        echo(f"{out}: files of {serial} were taken back; its verdict no longer releases them")
    withdraw_files(registry, report.lot_id)
    export_units(registry, released, ("json",), out, ExportOptions(release=report.release, lot_id=report.lot_id))
    conditional = report.counts["conditional"] if report.release is Release.PASS else 0
    more = f"; {conditional} conditional units have theirs with --release conditional" if conditional else ""
    echo(f"{out}: calibration files of {len(released)} units{more}")
