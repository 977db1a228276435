"""Use cases of the operator: take a scan and send its order. No Streamlit here.

START alone ever orders a run or a reading. It presses only the unit that was scanned since the last run, stop, refusal
or restart: after any of these nobody knows which unit is in the hand, and it is asked for. Where the card asks for a
known load, START reads the unit pressed last, and presses nothing. OK takes as read and moves nothing.
"""

import time
import uuid
from dataclasses import dataclass, replace
from datetime import UTC, datetime

from softcal.app.line.scan_codes import Scan, is_unfamiliar, lots_of, read_scan
from softcal.app.line.status import LineSession, LineStatus, Note, Screen, read_line, read_session, write_session
from softcal.core.errors import InputError, StationBusy
from softcal.core.lot import check_serial
from softcal.core.messages.reason import Reason
from softcal.core.orders import Order, OrderKind, RunState
from softcal.core.quality.known_loads import load_order
from softcal.db.registry import Registry

NEWEST_LOTS = 8
MAX_CONFLICTS = 5

START_S = 2.5
"""A start that could not be ordered for so long moves nothing: nobody expects it then."""

DEFAULT_OPERATOR = "operator"
"""Who presses where nobody has signed in or scanned a badge."""

BADGE_MARK = " (badge)"
"""Behind a name that a badge gave: nobody has shown that it is theirs."""


@dataclass(frozen=True)
class Step:
    """Result of a scan; its order is sent once the session is written."""

    session: LineSession
    order: Order | None = None


def take_scan(registry: Registry, screen: Screen, text: str, actor: str = "") -> LineStatus:
    """Perform the action of a scan and store the result at the line, for every screen.

    `actor` has signed in at this screen; "" leaves the name to the badge.

    Raises:
        RegistryError: the registry is away; nothing was ordered.
        InputError: there is no station that it could be for; nothing was ordered.
    """
    scan, until_s = read_scan(text), time.monotonic() + START_S
    # A browser's deadline can only be the shorter one: it may know another clock.
    screen = replace(screen, until_s=until_s if screen.until_s is None else min(until_s, screen.until_s))
    for _ in range(MAX_CONFLICTS):
        line = read_line(registry, screen)
        if line.heartbeat is None:
            raise InputError(Reason("line.no_station"))
        step = _step(registry, line, screen, scan, actor or _badged(line.operator))
        if write_session(registry.line_sessions, line.station, step.session):
            break
    else:
        raise InputError(Reason("line.other_screens"))
    # The unit waits no longer: no order comes twice.
    if step.order is None:
        return read_line(registry, screen)
    try:
        if registry.order_queue.place(step.order, until_s=screen.until_s if step.order.kind.is_run else None):
            return read_line(registry, screen)
        refusal = Note("late_start")
    except StationBusy:
        refusal = Note("busy_key", _running(read_line(registry, screen)))
    # Why nothing moved is said also where another screen writes at the same time.
    for _ in range(MAX_CONFLICTS):
        line = read_line(registry, screen)
        if write_session(registry.line_sessions, line.station, _with_note(line, refusal)):
            return read_line(registry, screen)
    raise InputError(Reason("line.other_screens"))


def order_stop(registry: Registry, station: str) -> bool:
    """Order a station to stop its run and return whether something runs.

    Repeated requests are one order. It reads as little as possible, so that the stop key does not wait for what a
    screen shows.

    Raises:
        RegistryError: the registry is away; nothing was ordered.
    """
    queue = registry.order_queue
    heartbeats = [] if station else queue.stations()
    station = heartbeats[0].station if len(heartbeats) == 1 else station
    active = queue.active(station)
    if active is None:
        return False
    session = read_session(registry.line_sessions, station)
    operator = "" if session.is_badge_over(datetime.now(UTC)) else session.operator
    queue.place(_stop_order(station, active[0], _badged(operator)))
    return True


def _stop_order(station: str, run: Order, actor: str) -> Order:
    return Order(f"stop-{run.order_id}"[:64], station, OrderKind.STOP, actor=actor)


def _step(registry: Registry, line: LineStatus, screen: Screen, scan: Scan, actor: str) -> Step:
    if scan.kind == "command":
        return _COMMANDS[scan.value](line, screen, actor)
    if scan.kind == "badge":
        # One that opens more than the line needs its PIN.
        name = scan.value
        if not name:
            return Step(
                _with_note(line, Note("badge_off", {}, False), replace(line.session, operator="", badged_at=None))
            )
        if any(user.name.lower() == name.lower() and user.role != "operator" for user in registry.people.all()):
            return Step(_with_note(line, Note("badge_needs_pin", {"name": name[:60]})))
        badged = replace(line.session, operator=name[:60], badged_at=line.now)
        return Step(_with_note(line, Note("badge", {"name": name[:60]}, False), badged))
    if line.active is not None:
        return Step(_with_note(line, Note("busy", {**_running(line), "scanned": scan.value[:40]})))
    if line.is_stopped:
        return Step(_with_note(line, Note("acknowledge_first")))
    session = _unit(registry, line, scan)
    if isinstance(session, Note):
        # Whatever it was, it is not the unit that was shown: no key may press that one now.
        return Step(_with_note(line, session, line.session.emptied(line.newest_run)))
    heartbeat = line.heartbeat
    session = replace(session, process=heartbeat.process if heartbeat else "", tab=screen.tab, note=None)
    return Step(
        _with_note(line, Note("lot", {"lot": session.lot_id}, False), session) if scan.kind == "lot" else session
    )


def _with_note(line: LineStatus, note: Note, session: LineSession | None = None) -> LineSession:
    noted = replace(note, run=line.newest_run, is_during_run=line.active is not None)
    return replace(session or line.session, note=noted)


def _running(line: LineStatus) -> dict[str, str]:
    return {"serial": line.active[0].serial if line.active else ""}


def _badged(operator: str) -> str:
    return f"{operator}{BADGE_MARK}" if operator else DEFAULT_OPERATOR


def _unit(registry: Registry, line: LineStatus, scan: Scan) -> LineSession | Note:
    emptied = line.session.emptied(line.newest_run)
    if scan.kind == "unreadable":
        return Note("unreadable", {"text": scan.value[:40]})
    if scan.kind == "lot":
        lot_id = next((listed for listed in line.lots if listed.lower() == scan.value.lower()), None)
        if lot_id is None:
            listed = ", ".join(line.lots[:NEWEST_LOTS]) or "–"
            return Note("unknown_lot", {"lot": scan.value[:40], "known": listed})
        return replace(emptied, lot_id=lot_id)
    golden = {run.lot_id for run in registry.stations.golden_runs(line.station, scan.value)}
    is_in_lot = line.lot is not None and line.lot.id not in golden and line.lot.id in lots_of(registry, scan.value)
    if scan.kind == "golden" or (golden and not is_in_lot):
        return replace(emptied, serial=scan.value, is_golden=True)
    if line.lot is None:
        return Note("no_lot", {"serial": scan.value[:40]})
    if scan.lot_id and scan.lot_id.lower() != line.lot.id.lower():
        return Note("other_lot", {"serial": scan.value, "other": scan.lot_id, "lot": line.lot.id})
    lot = line.lot
    serial = lot.rules.spell(scan.value)
    try:
        serial = check_serial(serial)
    except InputError:
        return Note("bad_serial", {"serial": serial[:40], "lot": lot.id})
    if serial == lot.lot.source:
        return Note("is_source", {"serial": serial, "lot": lot.id})
    holders, fits = lots_of(registry, serial), lot.rules.fits(serial)
    if lot.id not in holders and (holders or not fits):
        # It belongs to the lot that it stands in, or the only one that it fits.
        rules = ((other.id, registry.lots.line_rules(other)) for other in registry.lots.all() if other.id != lot.id)
        fitting = (lot_id for lot_id, other in rules if other.serial_pattern and other.fits(other.spell(serial)))
        if other := min(holders) if holders else next(fitting, ""):
            return Note("other_lot", {"serial": serial, "other": other, "lot": lot.id})
    if not fits:
        return Note("bad_serial", {"serial": serial, "lot": lot.id})
    pressed_serials = {run[0].serial for run in line.runs if run[0].lot_id == lot.id}
    is_new = is_unfamiliar(registry, lot.lot, lot.rules, serial, pressed_serials)
    return replace(emptied, lot_id=lot.id, serial=serial, is_new=is_new)


def _start(line: LineStatus, screen: Screen, actor: str) -> Step:
    """Press the unit that waits, or read the load that is asked for; the only way to either."""
    refusal = _start_refusal(line, screen)
    if refusal is None and actor == DEFAULT_OPERATOR and line.lot is not None and line.lot.rules.is_badge_needed:
        refusal = Note("badge_first", {"lot": line.lot.id})
    if refusal is not None:
        return Step(_with_note(line, refusal))
    if line.load is not None and line.newest is not None:
        newest_order, loaded = line.newest[0], load_order(line.load_step, line.load)
        unit = (newest_order.serial, newest_order.lot_id, actor, loaded)
        return Step(replace(line.session, note=None), Order(uuid.uuid4().hex, line.station, OrderKind.LOAD, *unit))
    is_of_lot = line.lot is not None and (not line.is_golden or line.serial == line.lot.lot.source)
    lot_id = line.lot.id if line.lot and is_of_lot else ""
    kind = OrderKind.GOLDEN if line.is_golden else OrderKind.UNIT
    reason = f"re-test after {line.results[-1].verdict}" if line.results and not line.is_golden else ""
    order = Order(uuid.uuid4().hex, line.station, kind, line.serial, lot_id, actor, reason)
    return Step(replace(line.session.emptied(line.newest_run), note=None), order)


def _start_refusal(line: LineStatus, screen: Screen) -> Note | None:
    if line.active is not None:
        return Note("busy_key", _running(line))
    if line.is_stopped:
        return Note("acknowledge_first")
    if line.load is not None:
        # Whoever has not seen which load is asked for has not put it on.
        is_load_shown = screen.version is None or screen.version == line.session.version
        return None if line.is_answering and is_load_shown else Note("look_at_load" if line.is_answering else "silent")
    if not line.serial:
        return Note("scan_first")
    if line.open_question:
        return Note(f"{line.open_question}_first", {"serial": line.serial})
    if not line.is_answering:
        return Note("silent")
    if not line.may_press:
        return Note("closed")
    is_shown = screen.version is None or screen.version == line.session.version
    return None if is_shown or screen.tab == line.session.tab else Note("look_again", {"serial": line.serial})


def _confirm(line: LineStatus, screen: Screen, actor: str) -> Step:
    """Confirm a stop, an aborted run, or a question. Nothing moves."""
    if line.active is not None:
        return Step(_with_note(line, Note("busy_key", _running(line))))
    emptied = line.session.emptied(line.newest_run)
    if line.is_stopped:
        order = Order(uuid.uuid4().hex, line.station, OrderKind.ACKNOWLEDGE, actor=actor)
        return Step(_with_note(line, Note("acknowledged", {}, False), emptied), order)
    if line.open_question in ("ask", "ask_new"):
        return Step(replace(line.session, is_confirmed=True, note=None))
    if line.open_question:
        return Step(_with_note(line, Note("used_up_first", {"serial": line.serial})))
    if line.newest is not None and not line.is_unit_uncertain and line.newest[1].state is not RunState.DONE:
        return Step(replace(emptied, note=None))
    return Step(_with_note(line, Note("nothing_to_confirm", {}, False)))


def _stop(line: LineStatus, screen: Screen, actor: str) -> Step:
    if line.active is None:
        return Step(_with_note(line, Note("nothing_runs", {}, False)))
    return Step(_with_note(line, Note("stopping", {}, False)), _stop_order(line.station, line.active[0], actor))


def _cancel(line: LineStatus, screen: Screen, actor: str) -> Step:
    """Discard the waiting unit; the unit in the hand is then uncertain."""
    if line.active is not None:
        return Step(_with_note(line, Note("busy_key", _running(line))))
    is_open = bool(line.serial) or line.load is not None
    return Step(replace(line.session.emptied(line.newest_run), note=None) if is_open else line.session)


_COMMANDS = {"START": _start, "STOP": _stop, "REPEAT": _confirm, "OK": _confirm, "CANCEL": _cancel}
