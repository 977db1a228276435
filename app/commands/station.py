"""`softcal station`: find and test the rig, press the source unit or a target unit and record it."""

import argparse
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from softcal.app.commands.options import add_json, add_registry
from softcal.app.output import print_table, say, write_json
from softcal.core.errors import InputError

if TYPE_CHECKING:
    from softcal.app.workflow.station_recover import Recovered
    from softcal.station.acquisition import OnProgress
    from softcal.station.self_test import Finding

EXAMPLES = """examples:
  softcal station check                                       look at every USB serial port
  softcal station check --port /dev/ttyACM0 --port /dev/ttyACM1 --write station.toml
  softcal station check --station station.toml                test all devices, home, move 2 mm
  softcal station source --station station.toml --serial A0 --out lot-1/source/A0.csv
  softcal station unit --station station.toml --serial A1 --out lot-1/units/A1.csv
  softcal station unit --simulated --serial A1 --out A1.csv   the same on the simulated rig
  softcal station unit --simulated --serial A1 A2 A3 --out units   several channels pressed at once

  softcal station calibrate-cell --station station.toml --weights 0 0.2 0.5 1
  softcal station serve --station station.toml --name line-1  own the ports for screens and programs
  softcal station recover --out recovered                     after a power cut in mid-run

Exit code 3: a device is missing or failed; the stage was stopped and no file was written.
"""

SPOOL_HELP = "where samples go as they come; default: the user's data folder"


def add_parser(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `softcal station` and its actions."""
    parser = commands.add_parser(
        "station",
        help="the rig: find devices, self-test, press and record a unit",
        description="The rig: find its devices, test it, press a unit with a profile and record it.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    _add_check(actions)
    for kind, what in (("source", "with the load cell: output and reference"), ("unit", "output only")):
        _add_press(actions, kind, what)
    _add_calibrate_cell(actions)
    _add_recover(actions)
    _add_serve(actions)


def _add_check(actions: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    check = actions.add_parser(
        "check",
        help="find ports, identify devices, test them, and say everything that is missing",
        description="Find the devices, read every channel, home the stage and move it by 2 mm. All faults at once.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    check.add_argument("--port", action="append", default=[], metavar="PORT", help="look at this port only; repeatable")
    _add_station(check)
    check.add_argument("--write", type=Path, metavar="FILE", help="write a station file from what was found")
    check.add_argument("--no-motion", action="store_true", help="do not home or move the stage")
    add_json(check)
    check.set_defaults(run=run_check)


def _add_press(actions: "argparse._SubParsersAction[argparse.ArgumentParser]", kind: str, what: str) -> None:
    press = actions.add_parser(
        kind,
        help=f"press a {kind} unit and record it {what}",
        description=f"Home, find contact, press with the {kind} profile and record {what}. Whole or not at all.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    press.add_argument("--serial", nargs="+", required=True, metavar="S", help="serial; one per channel of the readout")
    press.add_argument("--out", type=Path, required=True, metavar="FILE", help="CSV or Parquet; a folder for channels")
    press.add_argument("--seconds", type=_positive, metavar="S", help="how long to press")
    press.add_argument("--depth", type=_positive, default=3.5, metavar="MM", help="deepest press (default 3.5 mm)")
    press.add_argument("--profile-seed", type=int, default=0, help="draws the random presses (default 0)")
    press.add_argument("--spool", type=Path, metavar="DIR", help=SPOOL_HELP)
    _add_station(press)
    add_json(press)
    press.set_defaults(run=run_press, kind=kind)


def _add_calibrate_cell(actions: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    calibrate = actions.add_parser(
        "calibrate-cell",
        help="find the scale of the load cell with dead weights",
        description="Asks for one weight after the other, reads the cell, and writes its scale into the station file.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    calibrate.add_argument("--station", type=Path, required=True, metavar="FILE", help="station file; it is updated")
    calibrate.add_argument(
        "--weights", type=_weight, nargs="+", required=True, metavar="KG", help="weights in kg, 0 for the unloaded cell"
    )
    add_json(calibrate)
    calibrate.set_defaults(run=run_calibrate_cell)


def _add_serve(actions: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    serve = actions.add_parser(
        "serve",
        help="own the ports and perform what screens and programs order through the registry",
        description="The resident service of one station. Ctrl-C gives the ports back; nothing resumes by itself.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    serve.add_argument("--name", required=True, metavar="NAME", help="name of the station, as orders call it")
    serve.add_argument("--spool", type=Path, metavar="DIR", help=SPOOL_HELP)
    serve.add_argument("--warm-up", type=float, default=15.0, metavar="MIN", help="of the load cell (default 15 min)")
    serve.add_argument("--shift", type=float, default=8.0, metavar="H", help="a golden unit each so many h (default 8)")
    serve.add_argument("--override", metavar="REASON", help="run in spite of a closed gate for 8 h; it is audited")
    serve.add_argument("--depth", type=_positive, default=3.5, metavar="MM", help="deepest press (default 3.5 mm)")
    _add_station(serve)
    add_registry(serve)
    serve.set_defaults(run=run_serve)


def _add_recover(actions: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    recover = actions.add_parser(
        "recover",
        help="write what runs that were cut off had read",
        description="Read the spools: finished runs become recordings, all others files marked as aborted.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    recover.add_argument("--spool", type=Path, metavar="DIR", help=SPOOL_HELP)
    recover.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the files")
    add_json(recover)
    recover.set_defaults(run=run_recover)


def _add_station(parser: argparse.ArgumentParser) -> None:
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--station", type=Path, metavar="FILE", help="station file (TOML)")
    where.add_argument(
        "--simulated", nargs="?", type=int, const=0, metavar="SEED", help="the simulated rig, faster than real time"
    )


def _positive(text: str) -> float:
    value = float(text)
    if not 0 < value < 1e5:
        raise argparse.ArgumentTypeError(f"{text}: a number above 0 was expected")
    return value


def _weight(text: str) -> float:
    value = float(text)
    if not 0 <= value < 1000:
        raise argparse.ArgumentTypeError(f"{text}: a weight in kg, 0 or more, was expected")
    return value


def run_check(options: argparse.Namespace) -> int:
    """Identify, test, report."""
    from softcal.app.workflow.station import check_station

    check = check_station(options.port, options.station, options.simulated, may_move=not options.no_motion)
    if check.devices:
        print_table(("port", "is", "dialect", "says"), [(d.port, d.role, d.kind, d.description) for d in check.devices])
    if check.findings:
        print_table(("device", "what", "value", "to do"), [_row(finding) for finding in check.findings])
    if options.write:
        from softcal.app.files import write_text
        from softcal.station.config import station_toml

        write_text(options.write, station_toml(check.config))
        say(f"{options.write}: station file written; set the safety bounds and the load cell's calibration in it")
    if options.json:
        write_json(options.json, check.as_json())
    faults = [finding for finding in check.findings if not finding.is_good]
    for finding in faults:
        say(f"{finding.device}, {finding.what}: {finding.cure}")
    say(f"station {check.config.name}: " + (f"{len(faults)} fault(s)" if faults else "good"))
    return 3 if faults else 0


def run_press(options: argparse.Namespace) -> int:
    """Press one unit and write its recording."""
    from softcal.app.workflow.station import chosen_bench, profile_for, record_to_files, run_json, spool_folder

    profile = profile_for(options.kind, options.profile_seed, options.seconds, options.depth)
    with chosen_bench(options.station, options.simulated, len(options.serial)) as bench:
        with_reference, spools = options.kind == "source", spool_folder(options.spool)
        run = record_to_files(bench, options.serial, options.out, profile, with_reference, spools, _progress())
    for path in run.files:
        say(f"{path}: {len(run.recording.t_s)} samples in {run.seconds:.0f} s of station time")
    if options.json:
        write_json(options.json, run_json(run))
    return 0


def run_calibrate_cell(options: argparse.Namespace) -> int:
    """Ask for weights, fit, write the station file."""
    from softcal.app.files import write_text
    from softcal.app.workflow.station_cell import calibrate_cell
    from softcal.station.config import read_station_file, station_toml

    def wait_for(mass_kg: float) -> None:
        say(f"put {mass_kg:g} kg on the load cell and press Enter" if mass_kg else "unload the cell and press Enter")
        if not sys.stdin.readline():
            raise InputError("no Enter came; the station file is as it was")

    found, config = calibrate_cell(read_station_file(options.station), options.weights, wait_for)
    rows = zip(found.mass_kg.tolist(), found.reading.tolist(), found.noise.tolist(), strict=True)
    print_table(("weight, kg", "reading", "noise"), list(rows))
    write_text(options.station, station_toml(config))
    say(f"{options.station}: {found.per_N:.6g} counts per N, off by {found.largest_error_N:.3g} N at most")
    if options.json:
        values = {"per_N": found.per_N, "zero": found.zero, "largest_error_N": found.largest_error_N}
        write_json(options.json, {"schema": "softcal.station-cell/1", **values})
    return 0


def run_recover(options: argparse.Namespace) -> int:
    """Write what the spools hold."""
    from softcal.app.workflow.station import spool_folder
    from softcal.app.workflow.station_recover import recover

    found = recover(spool_folder(options.spool), options.out)
    print_table(("serial", "profile", "ended", "samples", "file"), [_recovered_row(run) for run in found])
    if options.json:
        runs = [vars(run) | {"spool": str(run.spool), "file": str(run.file)} for run in found]
        write_json(options.json, {"schema": "softcal.station-recover/1", "runs": runs})
    say(f"{len(found)} spool(s) read; they were left where they are")
    return 0


def run_serve(options: argparse.Namespace) -> int:
    """Serve until Ctrl-C or a terminate signal."""
    from datetime import UTC, datetime, timedelta

    from softcal.app.bootstrap import current_user, open_chosen_registry
    from softcal.app.workflow.station import spool_folder
    from softcal.app.workflow.station_gate import GateRules
    from softcal.app.workflow.station_serve import Serving, serve
    from softcal.core.station_gate import Override

    override = None
    if options.override:
        override = Override(current_user(), options.override, datetime.now(UTC) + timedelta(hours=8))
    rules = GateRules(timedelta(minutes=options.warm_up), timedelta(hours=options.shift))
    serving = Serving(
        options.name, options.station, options.simulated, depth_mm=options.depth, rules=rules, override=override
    )
    is_wanted = True

    def end(signal_number: int, frame: object) -> None:
        nonlocal is_wanted
        is_wanted = False

    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, end)
    say(f"station {options.name}: serving; Ctrl-C ends it after the order in progress")
    with open_chosen_registry(options.registry) as registry:
        serve(registry, serving, spool_folder(options.spool), lambda: is_wanted)
    say(f"station {options.name}: ports given back")
    return 0


def _recovered_row(run: "Recovered") -> tuple[str, str, str, int, str]:
    return run.serial, run.profile, run.end[:60], run.samples, str(run.file)


def _row(finding: "Finding") -> tuple[str, str, str, str]:
    return finding.device, finding.what, finding.value, finding.cure or "good"


def _progress() -> "OnProgress":
    from softcal.station.acquisition import RunProgress

    shown_phase, shown_percent = "", -10

    def tell(progress: RunProgress) -> None:
        nonlocal shown_phase, shown_percent
        percent = int(100 * progress.fraction)
        if progress.phase != shown_phase or percent >= shown_percent + 10:
            shown_phase, shown_percent = progress.phase, percent
            say(f"{percent:3d} % {progress.phase}, about {progress.remaining_s:.0f} s left")

    return tell
