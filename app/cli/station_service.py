"""The resident service of a station: serve it, send orders, print its status, certify its load cell."""

import argparse
import signal
import time
import uuid
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from functools import partial
from typing import TYPE_CHECKING, Any

from softcal.app.bootstrap import current_user, is_alive
from softcal.app.cli.options import (
    FILE,
    Action,
    add_network,
    add_shared,
    add_station,
    answer,
    converted,
    network_config,
    positive,
    registry_of,
)
from softcal.app.output import echo, print_table
from softcal.app.texts.catalogue import format_local_instant
from softcal.core.errors import DeviceError, InputError
from softcal.core.orders import Order, OrderKind, Progress, RunState, StationState

if TYPE_CHECKING:
    from softcal.db.queues.order_queue import OrderQueue
    from softcal.db.registry import Registry

SILENCE_TIMEOUT_S = 10.0
"""A busy machine may keep a service from its heartbeat for seconds; it is there all the same."""

EXAMPLES = """examples:
  softcal station serve --station station.toml --name line-1       one process owns the ports
  softcal station serve --simulated --name line-1 --speed 10       the simulated rig, ten times faster than real
  softcal station certificate --cell K1 --number 17 --laboratory Lab --issued 2026-01-05 --due 2027-01-05 \\
      --capacity 20 --uncertainty 0.02                              the load cell may be used until then
  softcal station certificate --dcc K1.xml                          the same from a Digital Calibration Certificate
  softcal station order --name line-1 source --serial A0 --lot L1   press the source unit, train f
  softcal station order --name line-1 unit --serial A1 --lot L1     press a unit, wait for its verdict
  softcal station order --name line-1 golden --serial G1            the check of the shift
  softcal station order --name line-1 acknowledge                   after a stop: the next run homes first
  softcal station order --name line-1 override --reason "certificate is in the post"
  softcal station order --name line-1 fault --reason "load cell unplugged while pressing"   simulated rig only
  softcal station status                                            every station: state, gate, run, quarantine

Exit code 1: the unit did not pass. Exit code 2: the order makes no sense, nothing moved. Exit code 3: the run was
stopped; the sentence says what to do.
"""

POLL_S = 0.2


def add_service_actions(action: Action) -> None:
    """Add `serve`, `order`, `status` and `certificate`."""
    action = partial(action, epilog=EXAMPLES)
    day = converted(date.fromisoformat, "{}: a day as 2026-01-31 was expected")
    serve = action("serve", "own the ports and perform what screens and programs order through the registry", run_serve)
    serve.add_argument("--name", required=True, metavar="NAME", help="name of the station, as orders call it")
    add_shared(serve, "spool")
    serve.add_argument("--warm-up", type=float, metavar="MIN", help="of the load cell (default 15 min; gate rig: 0)")
    serve.add_argument(
        "--shift", type=positive, default=8.0, metavar="H", help="hours between golden units (default 8)"
    )
    serve.add_argument(
        "--gate",
        choices=("full", "rig"),
        help="full: certificate and golden unit too (default); rig: what the rig alone shows (default when simulated)",
    )
    serve.add_argument(
        "--needs-qualification",
        action="store_true",
        help="no unit before `softcal station qualify --name` has passed; one that is on file counts in any case",
    )
    serve.add_argument("--override", default="", metavar="REASON", help="open a closed gate for a shift; audited")
    add_shared(serve, "depth")
    serve.add_argument("--unit-seconds", type=positive, metavar="S", help="how long a unit is pressed (25 s)")
    serve.add_argument("--source-seconds", type=positive, metavar="S", help="how long a source is (default 170 s)")
    for kind in ("unit", "source"):
        profile_help = f"TOML file of moves instead of the {kind} profile (`softcal station profiles`)"
        serve.add_argument(f"--{kind}-profile", **FILE, help=profile_help)
    serve.add_argument(
        "--speed", type=positive, default=1.0, metavar="X", help="simulated seconds a second (default 1)"
    )
    add_station(serve, "the simulated rig")
    add_network(serve)
    add_shared(serve, "registry")
    order = action("order", "ask a resident station for something, and wait until it is done", run_order)
    order.add_argument("kind", choices=[kind.value for kind in OrderKind], help="what to do")
    order.add_argument("--name", required=True, metavar="NAME", help="name of the station")
    order.add_argument("--serial", default="", metavar="S", help="the unit, for source, unit and golden")
    order.add_argument("--lot", default="", metavar="LOT", help="its lot; golden: where several have the serial")
    order.add_argument("--reason", default="", metavar="TEXT", help="why; for override and repeats; fault: which one")
    add_shared(order, "registry", "json")
    status = action("status", "every station: state, gate, run in progress, units in quarantine", run_status)
    status.add_argument("--name", metavar="NAME", help="this station only")
    add_shared(status, "registry", "json")
    certificate = action(
        "certificate", "put a load cell's calibration certificate on file, or list them", run_certificate
    )
    add = certificate.add_argument
    add("--cell", metavar="SERIAL", help="serial of the load cell, as in the station file")
    add("--number", metavar="TEXT", help="number of the certificate")
    add("--laboratory", default="", metavar="TEXT", help="who issued it")
    add("--issued", type=day, metavar="YYYY-MM-DD", help="first day it holds")
    add("--due", type=day, metavar="YYYY-MM-DD", help="first day it no longer holds")
    add("--capacity", type=float, metavar="N", help="largest force it covers, N")
    add("--uncertainty", type=float, metavar="N", help="expanded uncertainty, k = 2, N")
    add("--dcc", **FILE, help="import it from this DCC; options above fill gaps")
    add_shared(certificate, "registry", "json")


def run_serve(options: argparse.Namespace) -> None:
    """The resident service of one station. Ctrl-C stops a run in progress and gives the ports back;
    nothing resumes by itself.
    """
    from softcal.app.line.rig import spool_folder
    from softcal.app.line.serve import Serving, serve
    from softcal.app.line.station_gate import RIG_ONLY, GateRules

    is_rig_only = options.gate == "rig" or (options.gate is None and options.simulated is not None)
    rules = replace(
        RIG_ONLY if is_rig_only else GateRules(),
        shift=timedelta(hours=options.shift),
        needs_qualification=options.needs_qualification,
    )
    if options.warm_up is not None:
        rules = replace(rules, warm_up=timedelta(minutes=options.warm_up))
    serving = Serving(
        options.name,
        options.station,
        options.simulated,
        options.speed,
        options.source_seconds,
        options.unit_seconds,
        options.depth,
        source_profile=options.source_profile,
        unit_profile=options.unit_profile,
        rules=rules,
        override=options.override,
        network=network_config(options),
    )
    is_serving = True

    def end(signal_number: int, frame: object) -> None:  # noqa: V107
        nonlocal is_serving
        is_serving = False

    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, end)
    echo(f"station {options.name}: serving; Ctrl-C stops a run in progress and ends it")
    with registry_of(options, create=True) as registry:
        serve(registry, serving, spool_folder(options.spool), lambda: is_serving)
    echo(f"station {options.name}: ports given back")


def run_order(options: argparse.Namespace) -> int:
    """Write an order into the registry, show its progress, print how it ended. Ctrl-C stops a run."""
    kind = OrderKind(options.kind)
    if kind.presses and not options.serial:
        raise InputError(f"an order of kind {kind} needs the serial of a unit: give --serial")
    order_id = uuid.uuid4().hex
    with registry_of(options) as registry:
        queue = registry.order_queue
        if not _is_serving(queue, options.name):
            raise DeviceError(f"station {options.name!r} is not served; start `softcal station serve` first")
        details = (options.serial, options.lot, current_user(), options.reason)
        queue.place(Order(order_id, options.name, kind, *details))
        try:
            progress = _wait_for_end(registry, options.name, order_id)
        except KeyboardInterrupt:
            queue.place(Order(uuid.uuid4().hex, options.name, OrderKind.STOP, actor=details[2]))
            progress = _wait_for_end(registry, options.name, order_id)
    names = ("order_id", "state", "code", "verdict", "recording_sha256")
    outcome = {name: getattr(progress, name) for name in names} | {"message": progress.text}
    answer(options, "station-order/1", {"kind": options.kind, "serial": options.serial, **outcome})
    echo(f"{f'{kind} {options.serial}'.strip()}: {progress.verdict or progress.state}: {progress.text}")
    if progress.state is not RunState.DONE:
        return 2 if progress.code == "E-ORDER" else 3
    return 0 if progress.verdict in ("", "pass") else 1


def _is_serving(queue: "OrderQueue", station: str) -> bool:
    """Return whether a station's service runs: its heartbeat is fresh, or late while its process lives."""
    from softcal.db.queues.order_queue import TAKEOVER_AFTER

    heartbeat = queue.heartbeat(station)
    if heartbeat is None or heartbeat.state is StationState.OFF or is_alive(heartbeat.process) is False:
        return False
    is_late_alone = bool(is_alive(heartbeat.process)) and datetime.now(UTC) - heartbeat.at <= TAKEOVER_AFTER
    return is_late_alone or queue.is_answering(station)


def _wait_for_end(registry: "Registry", station: str, order_id: str) -> Progress:
    """Wait for the end of an order; print each new phase and every tenth of the way."""
    last_step, last_sign_s = ("", -1), time.monotonic()
    while (progress := registry.order_queue.progress(order_id)).state.is_active:
        step = (progress.phase, int(10 * progress.fraction))
        if progress.phase and step != last_step:
            last_step = step
            remaining = f", about {progress.remaining_s:.0f} s left" if progress.remaining_s else ""
            echo(f"{100 * progress.fraction:3.0f} % {progress.phase}{remaining}")
        if _is_serving(registry.order_queue, station):
            last_sign_s = time.monotonic()
        elif time.monotonic() - last_sign_s > SILENCE_TIMEOUT_S:
            raise DeviceError(
                f"station {station!r} does not answer any more; look at the rig, then start its service again"
            )
        time.sleep(POLL_S)
    return progress


def run_status(options: argparse.Namespace) -> None:
    """Print the status of stations, and the units pressed since the last good golden unit."""
    from softcal.app.line.station_gate import quarantine
    from softcal.app.line.status import SILENT, state_of

    with registry_of(options) as registry:
        heartbeats = [b for b in registry.order_queue.stations() if options.name in (None, b.station)]
        if options.name and not heartbeats:
            raise InputError(f"station {options.name!r} never gave a sign of life in this registry")
        rows: list[dict[str, Any]] = []
        for heartbeat in heartbeats:
            now, active = datetime.now(UTC), registry.order_queue.active(heartbeat.station)
            state, run = state_of(heartbeat, now, is_alive(heartbeat.process)), ""
            if active is not None:
                order, progress = active
                run = f"{order.kind} {order.serial}, {progress.phase or progress.state}".strip()
            rows.append(
                {
                    "station": heartbeat.station,
                    "state": f"not answering (was {heartbeat.state})" if state == SILENT else state,
                    "at": format_local_instant(heartbeat.at),
                    "process": heartbeat.process,
                    "reasons": list(map(str, heartbeat.reasons)),
                    "is_overridden": heartbeat.is_overridden,
                    "gate": [{"name": str(c.name), "is_good": c.is_good, "says": str(c.says)} for c in heartbeat.gate],
                    "run": run,
                    "quarantine": list(quarantine(registry, heartbeat.station, now)),
                }
            )
    answer(options, "station-status/1", {"stations": rows})
    if not heartbeats:
        echo("no station yet; start one with `softcal station serve`")
    for heartbeat, row in zip(heartbeats, rows, strict=True):
        echo(f"station {row['station']}: {row['state']}, last seen {row['at']}, run: {row['run'] or 'none'}")
        if heartbeat.gate:
            conditions = [(str(c.name), "good" if c.is_good else "CLOSED", str(c.says)) for c in heartbeat.gate]
            print_table(("gate", "is", "says"), conditions)
        if serials := row["quarantine"]:
            echo(f"in quarantine since the last good golden unit: {', '.join(serials)}")


def run_certificate(options: argparse.Namespace) -> None:
    """Enter a certificate, import its DCC (XML), or list the stored ones. Without one the gate stays closed."""
    from softcal.app.line.cell_certificate import certificate_from

    values = {
        "cell_serial": options.cell,
        "number": options.number,
        "laboratory": options.laboratory or None,
        "issued_on": options.issued,
        "due_on": options.due,
        "capacity_N": options.capacity,
        "uncertainty_N": options.uncertainty,
    }
    with registry_of(options, create=True) as registry:
        if options.dcc is not None or any(value is not None for name, value in values.items() if name != "cell_serial"):
            certificate = certificate_from(values, options.dcc)
            registry.stations.add_certificate(certificate)
            echo(f"load cell {certificate.cell_serial}: certificate {certificate.number} is on file")
        entries = registry.stations.certificates(options.cell)
    names = ("cell_serial", "number", "laboratory", "issued_on", "due_on", "capacity_N", "uncertainty_N")
    rows = [{name: getattr(entry, name) for name in names} for entry in entries]
    texts = [{name: str(value) if isinstance(value, date) else value for name, value in row.items()} for row in rows]
    answer(options, "cell-certificates/1", {"certificates": texts})
    if not rows:
        echo("no certificate on file; give --cell, --number, --issued, --due, --capacity and --uncertainty, or --dcc")
        return
    print_table(names, [tuple(row.values()) for row in rows])
