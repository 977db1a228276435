"""`softcal station`: find and test the rig, press a source or a target unit and record it."""

import argparse
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from softcal.app.cli.options import (
    DIR,
    FILE,
    Action,
    actions_of,
    add_shared,
    add_station,
    answer,
    positive,
    registry_of,
)
from softcal.app.cli.station_service import add_service_actions
from softcal.app.output import echo, print_table, write_json
from softcal.core.errors import InputError
from softcal.core.messages.reason import Reason
from softcal.core.quality.gate import MAX_QUALIFIED

if TYPE_CHECKING:
    from softcal.station.tasks.acquisition import RunProgress
    from softcal.station.tasks.identify import DeviceIdentity

EXAMPLES = """examples:
  softcal station check                                       look at every USB serial port
  softcal station check --port /dev/ttyACM0 --port /dev/ttyACM1 --write station.toml
  softcal station check --station station.toml                test all devices, home, move 2 mm
  softcal station source --station station.toml --serial A0 --out lot-1/source/A0.csv
  softcal station unit --station station.toml --serial A1 --out lot-1/units/A1.csv
  softcal station unit --simulated --serial A1 --out A1.csv   the same on the simulated rig
  softcal station unit --simulated --serial A1 A2 A3 --out units   several channels pressed at once
  softcal station unit --simulated --twin rig-7.twin.json --serial A1 --out A1.csv   on the twin of a diagnosis

  softcal station qualify --station station.toml --out station.md --stiffness 5 --name line-1
                                                              measure the chain on a spring of 5 N/mm, for the gate
  softcal station profiles --write unit unit.toml             a profile as a file: edit it, give it to --profile
  softcal station calibrate-cell --station station.toml --weights 0 0.2 0.5 1
  softcal station serve --station station.toml --name line-1  own the ports for screens and programs
  softcal station order --name line-1 unit --serial A1 --lot L1  press a unit on it, and wait for the verdict
  softcal station status                                      every station, its gate, its run, its quarantine
  softcal station drivers                                     every device softcal can use, and its keys
  softcal station recover --out recovered                     after a power cut in mid-run

Exit code 3: a device is missing or failed; the stage was stopped and no file was written.
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    """The rig: find its devices, test it, press a unit with a profile and record it."""
    action = partial(actions_of(parser), epilog=EXAMPLES)
    check = action("check", "find ports, identify devices, test them, and say everything that is missing", run_check)
    check.add_argument("--port", action="append", default=[], metavar="PORT", help="look at this port only; repeatable")
    add_station(check)
    check.add_argument("--write", **FILE, help="write a station file from what was found")
    check.add_argument("--no-motion", action="store_true", help="do not home or move the stage")
    add_shared(check, "json")
    _add_qualify(action)
    for kind, content in (("source", "with the load cell: output and reference"), ("unit", "output only")):
        press = action(
            kind,
            f"press a {'source unit' if kind == 'source' else 'unit'} and record it {content}",
            run_press,
            f"Home, find contact, press with the {kind} profile and record {content}. Whole or not at all.",
        )
        add = press.add_argument
        add("--serial", nargs="+", required=True, metavar="S", help="serial; one per channel of the readout")
        add("--out", required=True, **FILE, help="CSV or Parquet; a folder for channels")
        add("--seconds", type=positive, metavar="S", help="how long to press")
        add_shared(press, "depth")
        add("--profile", **FILE, help="TOML file of moves instead (`station profiles`)")
        add_shared(press, "profile-seed", "spool")
        add_station(press)
        add("--twin", **FILE, help="with --simulated: the unit of this twin (softcal gap apply)")
        add_shared(press, "json")
        press.set_defaults(kind=kind)
    profiles = action("profiles", "the stage profiles there are, and how long each takes", run_profiles)
    add_shared(profiles, "depth", "profile-seed")
    profiles.add_argument("--write", nargs=2, metavar=("NAME", "FILE"), help="write this profile into a TOML file")
    add_shared(profiles, "json")
    calibrate = action("calibrate-cell", "find the scale of the load cell with dead weights", run_calibrate_cell)
    calibrate.add_argument("--station", required=True, **FILE, help="station file; it is updated")
    calibrate.add_argument(
        "--weights", type=_weight, nargs="+", required=True, metavar="KG", help="weights in kg, 0 for the unloaded cell"
    )
    add_shared(calibrate, "json")
    recover = action("recover", "write what runs that were cut off had read", run_recover)
    add_shared(recover, "spool")
    recover.add_argument("--out", required=True, **DIR, help="folder for the files")
    add_shared(recover, "json")
    drivers = action(
        "drivers",
        "the devices softcal can use, their keys in the station file, and the package each comes from",
        run_drivers,
    )
    drivers.add_argument("--kind", metavar="KIND", help="this kind only, with what its keys mean")
    add_shared(drivers, "json", "csv")
    add_service_actions(action)


def _add_qualify(action: Action) -> None:
    qualify = action(
        "qualify",
        "measure the whole chain on a stiff spring or any unit, and write a page that the gate reads",
        run_qualify,
    )
    add = qualify.add_argument
    add("--out", required=True, **FILE, help="page with figures, limits and how long it holds (Markdown)")
    add("--depth", type=positive, default=2.0, metavar="MM", help="how deep to press below the contact (default 2)")
    add("--specimen", default="a stiff spring", metavar="TEXT", help="what is pressed, for the page")
    add("--stiffness", type=positive, metavar="N/MM", help="of the spring: then the frame's compliance is told from it")
    days = f"1 to {MAX_QUALIFIED.days} days; how long a passed qualification holds (default 90)"
    add("--valid-days", type=_valid_days, default=90, metavar="N", help=days)
    add("--name", metavar="NAME", help="keep it in the registry for the gate of this station")
    add_station(qualify)
    add_shared(qualify, "registry", "json")


def _valid_days(text: str) -> int:
    days = int(text)
    if not 1 <= days <= MAX_QUALIFIED.days:
        raise argparse.ArgumentTypeError(f"{text}: 1 to {MAX_QUALIFIED.days} days were expected")
    return days


def _weight(text: str) -> float:
    value = float(text)
    if not 0 <= value < 1000:
        raise argparse.ArgumentTypeError(f"{text}: a weight in kg, 0 or more, was expected")
    return value


def run_check(options: argparse.Namespace) -> int:
    """Find the devices, read every channel, home the stage and move it by 2 mm. Report all faults at once."""
    from softcal.app.line.rig import check_station

    with _signals_as_ctrl_c():
        choose = _choose if options.write else None
        check = check_station(options.port, options.station, options.simulated, not options.no_motion, choose)
    if check.devices:
        print_table(("port", "is", "dialect", "says"), [(d.port, d.role, d.kind, str(d.says)) for d in check.devices])
    if check.findings:
        rows = [(str(f.device), str(f.what), str(f.value), str(f.cure or "good")) for f in check.findings]
        print_table(("device", "what", "value", "to do"), rows)
    if options.write:
        from softcal.app.files.atomic import write_text
        from softcal.station.bench.station_file import station_toml

        # What a port that nobody chose may be
        either = "; ".join(f"{device.port} ({device.says})" for device in check.devices if device.channels)
        write_text(options.write, station_toml(check.config, either))
        echo(
            f"{options.write}: station file written; set the safety bounds, the load cell's serial and its scale in it"
        )
        if not check.findings:
            echo(f"{options.write}: one port is still open, marked CHOOSE; nothing was tested, fill it in first")
            return 3
    write_json(options.json, check.as_json())
    faults = [finding for finding in check.findings if not finding.is_good]
    for finding in faults:
        echo(f"{finding.device}, {finding.what}: {finding.cure}")
    echo(f"station {check.config.name}: " + (f"{len(faults)} fault(s)" if faults else "good"))
    return 3 if faults else 0


def run_qualify(options: argparse.Namespace) -> int:
    """Press equal presses, slow and fast, and measure delay and bandwidth of the load cell, backlash, lost motion,
    compliance, repeatability and noise. Exit code 1: not passed.
    """
    from datetime import UTC, datetime

    from softcal.app.bootstrap import current_user
    from softcal.app.line.qualification import HEAD, QualificationPage, store_qualification
    from softcal.app.line.rig import chosen_bench
    from softcal.station.tasks.qualify import qualify

    with _signals_as_ctrl_c(), chosen_bench(options.station, options.simulated) as bench:
        qualification = qualify(bench, options.depth, options.stiffness, on_progress=_progress_printer())
        config = bench.config
    name, made_at = options.name or config.name, datetime.now(UTC)
    page = QualificationPage(name, config, options.specimen, qualification, made_at, options.valid_days)
    page.write(options.out)
    if options.name:
        with registry_of(options, create=True) as registry:
            store_qualification(registry, page, current_user())
    answer(options, "station-qualification/1", page.to_json())
    print_table(HEAD, page.rows)
    echo(f"station {name}: {page.verdict}; {options.out} has the page")
    return 0 if qualification.is_passed else 1


def _choose(part: Reason, candidates: Sequence["DeviceIdentity"]) -> "DeviceIdentity | None":
    """Ask for the device of a part; return None without a person to ask."""
    from softcal.app.cli.init import ask_value

    echo("\n".join(f"{device.port}: {device.says}" for device in candidates))
    try:
        return ask_value(f"which port is {part}", {device.port: device for device in candidates}.__getitem__, None)
    except InputError:
        return None


def run_profiles(options: argparse.Namespace) -> None:
    """List the built-in profiles, or write one as a file to edit and give to --profile."""
    import numpy as np

    from softcal.app.files.atomic import write_text
    from softcal.app.files.profile_file import profile_toml
    from softcal.core.profiles import BUILT_IN

    profiles = {
        name: make(np.random.default_rng(options.profile_seed), options.depth) for name, make in BUILT_IN.items()
    }
    if options.write:
        name, file = options.write
        if name not in profiles:
            raise InputError(f"profile {name!r} is unknown; known are {', '.join(profiles)}")
        write_text(Path(file), profile_toml(profiles[name]))
        echo(f"{file}: profile {name!r} written; edit it, then give it to --profile")
        return
    names = ("duration_s", "presses", "deepest_mm", "fastest_mm_s")
    rows = [{"name": name} | {field: getattr(profile, field) for field in names} for name, profile in profiles.items()]
    print_table(
        ("profile", "seconds", "presses", "deepest, mm", "fastest, mm/s"), [tuple(row.values()) for row in rows]
    )
    answer(options, "station-profiles/1", {"profiles": rows})


def run_press(options: argparse.Namespace) -> None:
    """Press one unit and write its recording."""
    from softcal.app.gap.diagnose import read_twin
    from softcal.app.line.rig import chosen_bench, profile_for, record_to_files, run_json, spool_folder

    profile = profile_for(options.kind, options.profile_seed, options.seconds, options.depth, options.profile)
    if options.twin is not None and options.simulated is None:
        raise InputError("--twin is the unit of the simulated rig; give --simulated as well, or leave it out")
    twin, print_progress = None if options.twin is None else read_twin(options.twin), _progress_printer()
    bench_of = chosen_bench(options.station, options.simulated, len(options.serial), twin)
    with _signals_as_ctrl_c(), bench_of as bench:
        with_reference, spools = options.kind == "source", spool_folder(options.spool)
        run = record_to_files(bench, options.serial, options.out, profile, with_reference, spools, print_progress)
    for path in run.files:
        echo(f"{path}: {len(run.recording.t_s)} samples in {run.seconds:.0f} s of station time")
    for remark in run.remarks:
        echo(remark)
    write_json(options.json, run_json(run))


def _progress_printer() -> "Callable[[RunProgress], None]":
    """Return a callback that prints each new phase and every tenth of the progress."""
    last_phase, last_percent = "", -10

    def print_progress(progress: "RunProgress") -> None:
        nonlocal last_phase, last_percent
        percent = int(100 * progress.fraction)
        if progress.phase != last_phase or percent >= last_percent + 10:
            last_phase, last_percent = progress.phase, percent
            echo(f"{percent:3d} % {progress.phase}, about {progress.remaining_s:.0f} s left")

    return print_progress


@contextmanager
def _signals_as_ctrl_c() -> Iterator[None]:
    """Handle terminate and hang-up like Ctrl-C, so that the stage is lifted, not left on the unit."""

    def interrupt(signal_number: int, frame: object) -> None:  # noqa: V107
        raise KeyboardInterrupt

    names = ("SIGTERM", "SIGHUP")  # Windows has no SIGHUP.
    handlers = {number: signal.signal(number, interrupt) for n in names if (number := getattr(signal, n, None))}
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def run_calibrate_cell(options: argparse.Namespace) -> None:
    """Asks for one weight after the other, reads the cell, and writes its scale into the station
    file.
    """
    from softcal.app.files.atomic import write_text
    from softcal.app.line.cell_scale import calibrate_cell
    from softcal.station.bench.station_file import read_station_file, station_toml

    def wait_for(mass_kg: float) -> None:
        echo(f"put {mass_kg:g} kg on the load cell and press Enter" if mass_kg else "unload the cell and press Enter")
        if not sys.stdin.readline():
            raise InputError("no Enter came; the station file is as it was")

    scale, config = calibrate_cell(read_station_file(options.station), options.weights, wait_for)
    rows = zip(scale.mass_kg.tolist(), scale.reading.tolist(), scale.noise.tolist(), strict=True)
    print_table(("weight, kg", "reading", "noise"), list(rows))
    write_text(options.station, station_toml(config))
    echo(f"{options.station}: {scale.per_N:.6g} counts per N, off by {scale.largest_error_N:.3g} N at most")
    content = {"per_N": scale.per_N, "zero": scale.zero, "largest_error_N": scale.largest_error_N}
    answer(options, "station-cell/1", content)


def run_drivers(options: argparse.Namespace) -> int:
    """List every driver: those of softcal and those of installed packages. Exit code 3 when a
    package's driver cannot be loaded.
    """
    from softcal.station.bench.catalogue import SECTIONS, list_drivers
    from softcal.station.bench.station_file import meanings

    chosen = [offer for offer in list_drivers() if options.kind in (None, offer.kind)]
    if not chosen:
        raise InputError(f"no driver of kind {options.kind!r}; `softcal station drivers` lists them all")
    rows, records = [], []
    for offer in chosen:
        driver, purpose, wires = offer.driver, "cannot be loaded", ""
        record: dict[str, object] = {
            "role": offer.role,
            "kind": offer.kind,
            "package": offer.package,
            "version": offer.version,
            "fault": offer.fault,
        }
        if driver is not None:
            purpose, wires = driver.what, "/".join(driver.wires)
            record |= {"for": purpose, "wires": list(driver.wires), "keys": driver.keys}
        rows.append((f"[{SECTIONS[offer.role]}]", offer.kind, purpose, wires, f"{offer.package} {offer.version}"))
        records.append(record)
    answer(options, "station-drivers/1", {"drivers": records})
    print_table(("section", "kind", "for", "port", "from"), rows)
    for offer in chosen:
        if offer.driver is None:
            echo(f"{offer.kind} of {offer.package}: {offer.fault}")
        elif options.kind:
            print_table((f"[{SECTIONS[offer.role]}]", "type", "default", "unit"), offer.driver.described_keys)
            echo("\n".join(f"  {line.strip()}" for line in meanings(offer.driver.config)))
    return 3 if any(offer.driver is None for offer in chosen) else 0


def run_recover(options: argparse.Namespace) -> None:
    """Read the spools: finished runs become recordings, all others files marked as aborted."""
    from softcal.app.line.recover import recover
    from softcal.app.line.rig import spool_folder

    recovered = recover(spool_folder(options.spool), options.out)
    rows = [(r.serial, r.profile, r.end[:60], r.samples, ", ".join(map(str, r.files))) for r in recovered]
    print_table(("serial", "profile", "ended", "samples", "file"), rows)
    runs = [vars(run) | {"spool": str(run.spool), "files": [str(file) for file in run.files]} for run in recovered]
    answer(options, "station-recover/1", {"runs": runs})
    for run in recovered:
        if not run.files:
            echo(run.end)
    echo(f"{len(recovered)} spool(s) read; they were left where they are")
