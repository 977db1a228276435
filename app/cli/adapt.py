"""`softcal adapt`: estimates of a unit in long use, its map following the drift."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from softcal.app.cli.options import (
    COUNT,
    FILE,
    add_columns,
    add_shared,
    column_names,
    echo_caution,
    echo_layout,
    registry_of,
    table_options,
)
from softcal.app.output import ProgressLine, echo, write_json
from softcal.core.errors import InputError

if TYPE_CHECKING:
    from softcal.app.operation.adapt import AdaptReport
    from softcal.db.registry import Registry

EXAMPLES = """examples:
  a recorded stream, with a figure of drift, map and predicted error:
    softcal adapt --serial A1 week.csv --out estimates.csv --html drift.html
  day by day, each file going on where the one before ended:
    softcal adapt --serial A1 monday.csv --out monday-estimates.csv --stream hall-3
    softcal adapt --serial A1 tuesday.csv --out tuesday-estimates.csv --stream hall-3 --resume
  the online method of Kim et al. (2020), where every queue of windows is used as the source was:
    softcal adapt --serial A1 week.csv --out estimates.csv --mode ot --queue 512
  live, from a sensor readout, from a pipe, or simulated; to a file, standard output or a socket:
    softcal adapt --serial A1 serial:/dev/ttyACM0 --out live.csv
    logger | softcal adapt --serial A1 - --out -
    softcal adapt --serial A1 simulated --duration 60 --out tcp://127.0.0.1:7007

Only t_s and output of IN are read. Row k of OUT depends on rows up to k alone; columns t_s, estimate, lower, upper
(a 90 % interval that widens with the doubt about the drift) and flag: why a row is not to be trusted, if so
(`recalibrate` once a calibration with a reference is due), and whether its map is `unwatched` (nothing to compare the
use with yet), `held` (use or drift, which cannot be told) or `followed`. Damaged samples are flagged and move nothing.
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Estimate the reference from a long stream of a unit's output while its map follows the sensor's drift.

    If drift and a change of use are not identifiable, the map is held and the flags say so.
    """
    add = parser.add_argument
    add("source", metavar="IN", help="CSV or Parquet with t_s, output; -, serial:PORT or simulated")
    add("--out", required=True, metavar="OUT", help="CSV or Parquet; live also - or tcp://HOST:PORT")
    add_shared(parser, "serial")
    add("--revision", **COUNT, help="calibration to start from; default: the current one")
    modes = ("improved", "none", "ot", "ot-improved")
    add("--mode", choices=modes, default="improved", help=MODE_HELP)
    add("--queue", **COUNT, help="windows in a queue of ot and ot-improved; default 512")
    add("--stream", metavar="NAME", help="name of the stream in the registry; default: from its content")
    add(
        "--loads",
        **FILE,
        help="known loads at the start of the stream: columns output, reference; the unit is trimmed by them first",
    )
    add("--resume", action="store_true", help="go on from the last state of the stream in the registry")
    add("--html", **FILE, help="figure of drift, map, estimate and predicted error")
    add_columns(parser)
    live = parser.add_argument_group("live")
    live.add_argument("--station", **FILE, help="station file with the readout's scale and rate")
    live.add_argument("--duration", type=float, metavar="S", help="stop after so many seconds; default: until Ctrl-C")
    live.add_argument("--view", action="store_true", help="show the estimate in the terminal")
    add_shared(parser, "lot", "registry", "json")


MODE_HELP = (
    "improved (default): compare with the calibration and with uses learnt since. "
    "none: leave the map as it is. ot: the method of Kim et al. (2020). A queue of windows is mapped onto those of the "
    "source by the exact plan of optimal transport; its map holds once the next queue is full. ot-improved: the same, "
    "and each queue with its best estimates is the source of the next. Both take a change of use for drift"
)


def run(options: argparse.Namespace) -> None:
    """Adapt the stream, and print what was followed, held and flagged."""
    from softcal.app.calibration.trim import trimmed_by
    from softcal.app.files.recording_file import PLAIN
    from softcal.app.files.stream_file import count_rows
    from softcal.app.operation.adapt import AdaptOptions, adapt_file
    from softcal.core.operation.adapter import QUEUES, AdaptConfig
    from softcal.core.operation.method import DriftTracking, OnlineConfig

    if options.html is not None:  # What the page needs is asked for before the stream, not after it.
        import softcal.app.operation.course_page  # noqa: F401
    method = DriftTracking()
    if options.queue is not None:
        if options.mode not in QUEUES:
            raise InputError(f"--queue is for --mode {' and '.join(QUEUES)}; this is --mode {options.mode}")
        method = DriftTracking(online=OnlineConfig(options.queue))
    config = AdaptConfig(options.mode, method)
    with registry_of(options) as registry:
        revision = options.revision
        if options.loads is not None:
            if revision is not None or options.resume:
                raise InputError(
                    "--loads trims the map in use at the start of a stream; without --revision and --resume. "
                    "`softcal trim` between two streams does the rest"
                )
            revision = trimmed_by(registry, options.serial, options.loads, options.lot, table_options(options))
            echo(f"{options.serial}: followed from revision {revision}, trimmed by {options.loads}")
        adapt = AdaptOptions(config, revision, options.stream, options.resume, lot_id=options.lot)
        names = column_names(options)
        if options.source in ("-", "simulated") or options.source.startswith(("serial:", "simulated:")):
            if names != PLAIN:
                raise InputError(f"IN is {options.source}: columns and sample rate are named for files only")
            from softcal.app.operation.live import LiveOptions, adapt_live

            live = LiveOptions(options.source, options.out, options.station, options.duration, options.view)
            report = adapt_live(registry, options.serial, live, adapt)
        else:
            source, out = Path(options.source), Path(options.out)
            progress = ProgressLine("rows", count_rows(source))
            report = adapt_file(registry, options.serial, source, out, adapt, progress.show_progress, names)
            echo_layout(str(source), report.layout, report.remarks)
        echo_caution(registry, (report.serial, report.revision, report.lot.id), "adapt")
        _report(registry, options, report)


def _report(registry: "Registry", options: argparse.Namespace, report: "AdaptReport") -> None:
    from softcal.app.operation.adapt import map_changes, report_json

    flags = [f"{count} {flag}" for flag, count in sorted(report.flags.items()) if flag]
    verdicts = ", ".join(f"{count} x {verdict}" for verdict, count in report.verdicts.items() if verdict != "start")
    echo(f"{options.out}: {report.rows} rows; {', '.join(flags) or 'no row flagged'}")
    unit = report.lot.reference_unit
    echo(f"map: {verdicts or 'never moved'}; predicted error {report.current.predicted_rmse:.3g} {unit}")
    echo(f"method: {report.method.id[:12]}")
    if report.changed:
        echo(f"the method has changed since this stream was last followed: {'; '.join(report.changed)}")
    if report.current.reason:
        echo(f"{report.current.verdict}: {report.current.reason}")
    if report.current.alarm:
        echo(f"ALARM: {report.current.alarm}")
    if options.html is None and not options.json:
        return
    course = registry.adaptations.all(report.unit, report.stream)
    if options.html is not None:
        from softcal.app.operation.course_page import write_course_page

        write_course_page(options.html, report, map_changes(course))
    write_json(options.json, report_json(report, course))
