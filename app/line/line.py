"""Use cases of the operator: take a scan and send its order. No Streamlit here.

START alone ever orders a run or a reading. It presses only the unit that was scanned since the last run, stop, refusal
or restart: after any of these nobody knows which unit is in the hand, and it is asked for. Where the card asks for a
known load, START reads the unit pressed last, and presses nothing. OK takes as read and moves nothing.
"""

import time
import uuid
from dataclasses import dataclass, replace
from datetime import UTC, datetime

from softcal.app.line.facts import LineFacts, Note, Place, Screen, read_line, read_place, write_place
from softcal.app.line.scan_codes import Scan, is_unheard_of, lots_of, read_scan
from softcal.core.errors import InputError, StationBusy
from softcal.core.lot import check_serial
from softcal.core.messages.reason import Reason
from softcal.core.orders import Order, OrderKind, RunState
from softcal.core.quality.known_loads import load_order
from softcal.db.registry import Registry

NEWEST_LOTS = 8
MOST_CONFLICTS = 5

START_S = 2.5
"""A start that could not be ordered for so long moves nothing: nobody expects it then."""

NOBODY = "operator"
"""Who presses where nobody has signed in or scanned a badge."""

BADGE_MARK = " (badge)"
"""Behind a name that a badge gave: nobody has shown that it is theirs."""


@dataclass(frozen=True)
class Step:
    """Result of a scan; its order is sent once the session is written."""

    place: Place
    order: Order | None = None


def take_scan(registry: Registry, screen: Screen, text: str, actor: str = "") -> LineFacts:
    """Perform the action of a scan and store the result at the line, for every screen.

    `actor` has signed in at this screen; "" leaves the name to the badge.

    Raises:
        RegistryError: the registry is away; nothing was ordered.
        InputError: there is no station that it could be for; nothing was ordered.
    """
    scan, until_s = read_scan(text), time.monotonic() + START_S
    # A browser's deadline can only be the shorter one: it may know another clock.
    screen = replace(screen, until_s=until_s if screen.until_s is None else min(until_s, screen.until_s))
    for _ in range(MOST_CONFLICTS):
        facts = read_line(registry, screen)
        if facts.heartbeat is None:
            raise InputError(Reason("line.no_station"))
        step = _step(registry, facts, screen, scan, actor or _badged(facts.operator))
        if write_place(registry.line_places, facts.station, step.place):
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
    for _ in range(MOST_CONFLICTS):
        facts = read_line(registry, screen)
        if write_place(registry.line_places, facts.station, _told(facts, refusal)):
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
    beats = [] if station else queue.stations()
    station = beats[0].station if len(beats) == 1 else station
    active = queue.active(station)
    if active is None:
        return False
    place = read_place(registry.line_places, station)
    operator = "" if place.is_badge_over(datetime.now(UTC)) else place.operator
    queue.place(_stop_order(station, active[0], _badged(operator)))
    return True


def _stop_order(station: str, run: Order, who: str) -> Order:
    return Order(f"stop-{run.order_id}"[:64], station, OrderKind.STOP, actor=who)


def _step(registry: Registry, facts: LineFacts, screen: Screen, scan: Scan, who: str) -> Step:
    if scan.kind == "command":
        return _COMMANDS[scan.value](facts, screen, who)
    if scan.kind == "badge":
        # One that opens more than the line needs its PIN.
        name = scan.value
        if not name:
            return Step(_told(facts, Note("badge_off", {}, False), replace(facts.place, operator="", badged_at=None)))
        if any(user.name.lower() == name.lower() and user.role != "operator" for user in registry.people.all()):
            return Step(_told(facts, Note("badge_needs_pin", {"name": name[:60]})))
        badged = replace(facts.place, operator=name[:60], badged_at=facts.now)
        return Step(_told(facts, Note("badge", {"name": name[:60]}, False), badged))
    if facts.active is not None:
        return Step(_told(facts, Note("busy", {**_running(facts), "scanned": scan.value[:40]})))
    if facts.is_stopped:
        return Step(_told(facts, Note("acknowledge_first")))
    place = _unit(registry, facts, scan)
    if isinstance(place, Note):
        # Whatever it was, it is not the unit that was shown: no key may press that one now.
        return Step(_told(facts, place, facts.place.emptied(facts.newest_run)))
    beat = facts.heartbeat
    place = replace(place, process=beat.process if beat else "", tab=screen.tab, note=None)
    return Step(_told(facts, Note("lot", {"lot": place.lot_id}, False), place) if scan.kind == "lot" else place)


def _told(facts: LineFacts, note: Note, place: Place | None = None) -> Place:
    said = replace(note, run=facts.newest_run, is_meanwhile=facts.active is not None)
    return replace(place or facts.place, note=said)


def _running(facts: LineFacts) -> dict[str, str]:
    return {"serial": facts.active[0].serial if facts.active else ""}


def _badged(operator: str) -> str:
    return f"{operator}{BADGE_MARK}" if operator else NOBODY


def _unit(registry: Registry, facts: LineFacts, scan: Scan) -> Place | Note:
    emptied = facts.place.emptied(facts.newest_run)
    if scan.kind == "unreadable":
        return Note("unreadable", {"text": scan.value[:40]})
    if scan.kind == "lot":
        lot_id = next((known for known in facts.lots if known.lower() == scan.value.lower()), None)
        if lot_id is None:
            known = ", ".join(facts.lots[:NEWEST_LOTS]) or "–"
            return Note("unknown_lot", {"lot": scan.value[:40], "known": known})
        return replace(emptied, lot_id=lot_id)
    golden = {run.lot_id for run in registry.stations.golden_runs(facts.station, scan.value)}
    is_here = facts.lot is not None and facts.lot.id not in golden and facts.lot.id in lots_of(registry, scan.value)
    if scan.kind == "golden" or (golden and not is_here):
        return replace(emptied, serial=scan.value, is_golden=True)
    if facts.lot is None:
        return Note("no_lot", {"serial": scan.value[:40]})
    if scan.lot_id and scan.lot_id.lower() != facts.lot.id.lower():
        return Note("other_lot", {"serial": scan.value, "other": scan.lot_id, "lot": facts.lot.id})
    lot = facts.lot
    serial = lot.rules.spelled(scan.value)
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
        fitting = (lot_id for lot_id, other in rules if other.serial_pattern and other.fits(other.spelled(serial)))
        if other := min(holders) if holders else next(fitting, ""):
            return Note("other_lot", {"serial": serial, "other": other, "lot": lot.id})
    if not fits:
        return Note("bad_serial", {"serial": serial, "lot": lot.id})
    pressed = {run[0].serial for run in facts.runs if run[0].lot_id == lot.id}
    is_new = is_unheard_of(registry, lot.lot, lot.rules, serial, pressed)
    return replace(emptied, lot_id=lot.id, serial=serial, is_new=is_new)


def _start(facts: LineFacts, screen: Screen, who: str) -> Step:
    """Press the unit that waits, or read the load that is asked for; the only way to either."""
    refusal = _start_refusal(facts, screen)
    if refusal is None and who == NOBODY and facts.lot is not None and facts.lot.rules.is_badge_needed:
        refusal = Note("badge_first", {"lot": facts.lot.id})
    if refusal is not None:
        return Step(_told(facts, refusal))
    if facts.load is not None and facts.newest is not None:
        pressed, loaded = facts.newest[0], load_order(facts.load_step, facts.load)
        unit = (pressed.serial, pressed.lot_id, who, loaded)
        return Step(replace(facts.place, note=None), Order(uuid.uuid4().hex, facts.station, OrderKind.LOAD, *unit))
    is_of_lot = facts.lot is not None and (not facts.is_golden or facts.serial == facts.lot.lot.source)
    lot_id = facts.lot.id if facts.lot and is_of_lot else ""
    kind = OrderKind.GOLDEN if facts.is_golden else OrderKind.UNIT
    reason = f"re-test after {facts.results[-1].verdict}" if facts.results and not facts.is_golden else ""
    order = Order(uuid.uuid4().hex, facts.station, kind, facts.serial, lot_id, who, reason)
    return Step(replace(facts.place.emptied(facts.newest_run), note=None), order)


def _start_refusal(facts: LineFacts, screen: Screen) -> Note | None:
    if facts.active is not None:
        return Note("busy_key", _running(facts))
    if facts.is_stopped:
        return Note("acknowledge_first")
    if facts.load is not None:
        # Whoever has not seen which load is asked for has not put it on.
        is_seen = screen.seen is None or screen.seen == facts.place.version
        return None if facts.is_answering and is_seen else Note("look_at_load" if facts.is_answering else "silent")
    if not facts.serial:
        return Note("scan_first")
    if facts.open_question:
        return Note(f"{facts.open_question}_first", {"serial": facts.serial})
    if not facts.is_answering:
        return Note("silent")
    if not facts.may_press:
        return Note("closed")
    is_shown = screen.seen is None or screen.seen == facts.place.version
    return None if is_shown or screen.tab == facts.place.tab else Note("look_again", {"serial": facts.serial})


def _confirm(facts: LineFacts, screen: Screen, who: str) -> Step:
    """Confirm a stop, an aborted run, or a question. Nothing moves."""
    if facts.active is not None:
        return Step(_told(facts, Note("busy_key", _running(facts))))
    emptied = facts.place.emptied(facts.newest_run)
    if facts.is_stopped:
        order = Order(uuid.uuid4().hex, facts.station, OrderKind.ACKNOWLEDGE, actor=who)
        return Step(_told(facts, Note("acknowledged", {}, False), emptied), order)
    if facts.open_question in ("ask", "ask_new"):
        return Step(replace(facts.place, is_confirmed=True, note=None))
    if facts.open_question:
        return Step(_told(facts, Note("used_up_first", {"serial": facts.serial})))
    if facts.newest is not None and not facts.is_in_doubt and facts.newest[1].state is not RunState.DONE:
        return Step(replace(emptied, note=None))
    return Step(_told(facts, Note("nothing_to_confirm", {}, False)))


def _stop(facts: LineFacts, screen: Screen, who: str) -> Step:
    if facts.active is None:
        return Step(_told(facts, Note("nothing_runs", {}, False)))
    return Step(_told(facts, Note("stopping", {}, False)), _stop_order(facts.station, facts.active[0], who))


def _cancel(facts: LineFacts, screen: Screen, who: str) -> Step:
    """Discard the waiting unit; the unit in the hand is then uncertain."""
    if facts.active is not None:
        return Step(_told(facts, Note("busy_key", _running(facts))))
    is_open = bool(facts.serial) or facts.load is not None
    return Step(replace(facts.place.emptied(facts.newest_run), note=None) if is_open else facts.place)


_COMMANDS = {"START": _start, "STOP": _stop, "REPEAT": _confirm, "OK": _confirm, "CANCEL": _cancel}
