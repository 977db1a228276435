"""The operator's use cases: read where the line stands, take a scan, order what it means. No Streamlit here.

Everything shown comes from rows of the registry, so that a reload or a killed screen loses nothing; what a person is in
the middle of (`Choice`) is a few words that the browser remembers.
"""

import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

from softcal.app.line.scan_codes import Scan, read_scan
from softcal.core.errors import InputError
from softcal.core.lot import Lot, check_serial
from softcal.core.orders import Heartbeat, Order, OrderKind, Progress, RunState, StationState
from softcal.core.quality.line_rules import LineRules
from softcal.db.entries import RunEntry
from softcal.db.order_queue import SILENT_AFTER
from softcal.db.registry import Registry

NEWEST_RUNS = 40
NEWEST_LOTS = 8
Run = tuple[Order, Progress]


@dataclass(frozen=True)
class Choice:
    """What the person at the screen is in the middle of.

    Args:
        station, lot_id: chosen; "" leaves it to the only one, or the last one used.
        serial: scanned and not pressed yet.
        is_golden: whether that serial is a golden unit, pressed to check the station.
        since: when it was scanned; a run ordered later ends the choice.
    """

    station: str = ""
    lot_id: str = ""
    serial: str = ""
    is_golden: bool = False
    since: datetime = datetime.min.replace(tzinfo=UTC)


@dataclass(frozen=True)
class LotAtLine:
    """What a line needs to know of a lot.

    Args:
        lot, rules: the lot and its rules at the line.
        has_network: whether f of the lot is trained, so that a unit gets a verdict.
        counts: its units by verdict, `none` without.
    """

    lot: Lot
    rules: LineRules
    has_network: bool
    counts: Mapping[str, int]

    @property
    def id(self) -> str:
        """Name of the lot."""
        return self.lot.id


@dataclass(frozen=True)
class LineFacts:
    """Where a line stands.

    Args:
        now: this instant.
        stations: every station that ever gave a sign of life.
        heartbeat: of the chosen one; None where there is none.
        lots: of the registry.
        lot: chosen or last used.
        active: the run that occupies the station.
        runs: newest runs of the station, newest first.
        serial: scanned and not pressed yet.
        is_golden: whether that serial is a golden unit.
        results: in this lot, oldest first, of that serial, else of the unit pressed last.
    """

    now: datetime
    stations: tuple[str, ...] = ()
    heartbeat: Heartbeat | None = None
    lots: tuple[str, ...] = ()
    lot: LotAtLine | None = None
    active: Run | None = None
    runs: tuple[Run, ...] = ()
    serial: str = ""
    is_golden: bool = False
    results: tuple[RunEntry, ...] = ()

    @property
    def station(self) -> str:
        """Name of the station, "" where none is chosen."""
        return self.heartbeat.station if self.heartbeat else ""

    @property
    def is_answering(self) -> bool:
        """Whether the station's service gave a sign of life in the last seconds."""
        beat = self.heartbeat
        return beat is not None and beat.state is not StationState.OFF and self.now - beat.at <= SILENT_AFTER

    @property
    def is_stopped(self) -> bool:
        """Whether somebody must acknowledge before anything moves; so too while the station is late with its beat."""
        return self.heartbeat is not None and self.heartbeat.state is StationState.STOPPED

    @property
    def newest(self) -> Run | None:
        """The newest run of a unit that is over."""
        over = (run for run in self.runs if not run[1].state.is_active and run[0].kind.presses)
        return next(over, None)

    @property
    def retests_left(self) -> int:
        """How often the unit that `results` are of may be pressed again."""
        if self.lot is None or not self.results:
            return 0
        return self.lot.rules.retests_left(self.results[-1].verdict, len(self.results))


@dataclass(frozen=True)
class Note:
    """One sentence about the last scan.

    Args:
        key: of the text `note.KEY`.
        values: that it names.
        is_refusal: whether the scan was refused.
    """

    key: str
    values: dict[str, str] = field(default_factory=dict)
    is_refusal: bool = True


@dataclass(frozen=True)
class Answer:
    """What a scan led to.

    Args:
        choice: what the person is in the middle of now.
        note: to be shown until the next scan.
        badge: name of the operator, where a badge was scanned.
    """

    choice: Choice
    note: Note | None = None
    badge: str | None = None


def read_line(
    registry: Registry, choice: Choice, look_at_lot: Callable[[Registry, str], LotAtLine] | None = None
) -> LineFacts:
    """Read where a line stands.

    Args:
        look_at_lot: reads a lot; a screen that asks twice a second gives one that remembers.

    Raises:
        RegistryError: the registry is away.
    """
    queue, now = registry.order_queue, datetime.now(UTC)
    beats = queue.stations()
    chosen = [beat for beat in beats if beat.station == choice.station] or (beats if len(beats) == 1 else [])
    beat = chosen[0] if chosen else None
    runs = tuple(run for run in queue.runs(beat.station, NEWEST_RUNS) if run[0].kind.is_run) if beat else ()
    active = queue.active(beat.station) if beat else None
    facts = LineFacts(now, tuple(b.station for b in beats), beat, active=active, runs=runs)
    lots = tuple(registry.lot_ids())
    last_lot = next((run[0].lot_id for run in runs if run[0].lot_id), "")
    chosen_lot = next((lot for lot in (choice.lot_id, last_lot) if lot in lots), lots[0] if len(lots) == 1 else "")
    if not chosen_lot:
        return replace(facts, lots=lots)
    pressed_since = any(order.serial == choice.serial and _created(order) >= choice.since for order, _ in runs)
    serial = "" if pressed_since else choice.serial
    lot = (look_at_lot or read_lot)(registry, chosen_lot)
    facts = replace(facts, lots=lots, lot=lot, serial=serial, is_golden=bool(serial) and choice.is_golden)
    subject = serial or (facts.newest[0].serial if facts.newest else "")
    return replace(facts, results=tuple(registry.runs(chosen_lot, subject)) if subject else ())


def read_lot(registry: Registry, lot_id: str) -> LotAtLine:
    """Read what a line needs to know of a lot."""
    lot = registry.lot(lot_id)
    has_network = any(network.lot_id == lot.id for network in registry.networks())
    return LotAtLine(lot, registry.line_rules(lot), has_network, registry.verdict_counts(lot.id))


def take_scan(registry: Registry, choice: Choice, text: str, actor: str) -> Answer:
    """Do what a scan means.

    Args:
        choice: what the person is in the middle of.
        text: as the scanner typed it.
        actor: who stands at the line, for the orders.

    Raises:
        RegistryError: the registry is away; nothing was ordered.
    """
    facts, scan = read_line(registry, choice), read_scan(text)
    if scan.kind == "unreadable":
        return Answer(choice, Note("unreadable", {"text": scan.value[:40]}))
    if scan.kind == "badge":
        note = Note("badge", {"name": scan.value}, False) if scan.value else Note("badge_off", {}, False)
        return Answer(choice, note, badge=scan.value[:60])
    if scan.kind == "command":
        return _COMMANDS[scan.value](registry, facts, choice, actor)
    if facts.active is not None:
        return Answer(choice, Note("busy", {"serial": facts.active[0].serial}))
    if facts.is_stopped:
        return Answer(choice, Note("acknowledge_first"))
    if scan.kind == "lot":
        return _choose_lot(facts, choice, scan.value)
    if scan.kind == "golden" or scan.value in {run.serial for run in registry.golden_runs(facts.station)}:
        return Answer(replace(choice, serial=scan.value, is_golden=True, since=datetime.now(UTC)))
    return _take_serial(registry, facts, choice, scan)


def _choose_lot(facts: LineFacts, choice: Choice, lot_id: str) -> Answer:
    found = next((known for known in facts.lots if known.lower() == lot_id.lower()), None)
    if found is None:
        known = ", ".join(facts.lots[:NEWEST_LOTS]) or "–"
        return Answer(choice, Note("unknown_lot", {"lot": lot_id[:40], "known": known}))
    return Answer(replace(choice, lot_id=found, serial=""), Note("lot", {"lot": found}, False))


def _take_serial(registry: Registry, facts: LineFacts, choice: Choice, scan: Scan) -> Answer:
    if facts.lot is None:
        return Answer(choice, Note("no_lot", {"serial": scan.value[:40]}))
    if scan.lot_id and scan.lot_id.lower() != facts.lot.id.lower():
        return Answer(choice, Note("other_lot", {"serial": scan.value, "other": scan.lot_id, "lot": facts.lot.id}))
    serial = facts.lot.rules.spelled(scan.value)
    refusal = _serial_refusal(registry, facts.lot, serial)
    if refusal is not None:
        return Answer(choice, refusal)
    return Answer(replace(choice, lot_id=facts.lot.id, serial=serial, is_golden=False, since=datetime.now(UTC)))


def _serial_refusal(registry: Registry, lot: LotAtLine, serial: str) -> Note | None:
    try:
        check_serial(serial)
    except InputError:
        return Note("bad_serial", {"serial": serial[:40], "lot": lot.id})
    if serial == lot.lot.source:
        return Note("is_source", {"serial": serial, "lot": lot.id})
    other = _other_lot(registry, lot, serial)
    if other:
        return Note("other_lot", {"serial": serial, "other": other, "lot": lot.id})
    if not lot.rules.fits(serial):
        return Note("bad_serial", {"serial": serial, "lot": lot.id})
    return None


def _other_lot(registry: Registry, lot: LotAtLine, serial: str) -> str:
    """Return the lot that a serial belongs to instead of this one: it stands there already, or only fits there."""
    try:
        known = {unit.lot_id for unit in registry.units(serial=serial)}
    except InputError:
        known = set()
    if lot.id in known:
        return ""
    if known:
        return sorted(known)[0]
    if lot.rules.fits(serial):
        return ""
    rules = ((other.id, registry.line_rules(other)) for other in registry.lots() if other.id != lot.id)
    return next((lot_id for lot_id, other in rules if other.serial_pattern and other.fits(other.spelled(serial))), "")


def _start(registry: Registry, facts: LineFacts, choice: Choice, actor: str) -> Answer:
    if facts.active is not None:
        return Answer(choice, Note("busy", {"serial": facts.active[0].serial}))
    if facts.is_stopped:
        return Answer(choice, Note("acknowledge_first"))
    if not facts.serial:
        return Answer(choice, Note("scan_first"))
    if facts.results and not facts.is_golden:
        return Answer(choice, Note("repeat_instead", {"serial": facts.serial}))
    return _press(registry, facts, choice, facts.serial, actor, "")


def _repeat(registry: Registry, facts: LineFacts, choice: Choice, actor: str) -> Answer:
    """Press a unit again: the scanned one, else the newest; a run that ended without a verdict is no test."""
    if facts.active is not None:
        return Answer(choice, Note("busy", {"serial": facts.active[0].serial}))
    if facts.is_stopped:
        return _acknowledge(registry, facts, choice, actor)
    serial = facts.serial or _unfinished(facts)
    if not serial or facts.lot is None:
        return Answer(choice, Note("scan_first"))
    if not facts.results or facts.is_golden:
        return _press(registry, facts, choice, serial, actor, "")
    if facts.retests_left == 0:
        return Answer(choice, Note("no_retest", {"serial": serial}))
    return _press(registry, facts, choice, serial, actor, f"re-test after {facts.results[-1].verdict}")


def _unfinished(facts: LineFacts) -> str:
    """Return the serial of the newest run where it ended without a result to stand on, "" else."""
    if facts.newest is None:
        return ""
    order, progress = facts.newest
    is_done = progress.state is RunState.DONE and progress.verdict != "retest"
    return "" if is_done or order.kind is OrderKind.SOURCE else order.serial


def _press(registry: Registry, facts: LineFacts, choice: Choice, serial: str, actor: str, reason: str) -> Answer:
    if not facts.is_answering:
        return Answer(choice, Note("silent"))
    is_golden, beat = facts.is_golden, facts.heartbeat
    if beat is not None and beat.state is StationState.CLOSED and not is_golden:
        return Answer(choice, Note("closed"))
    lot_id = facts.lot.id if facts.lot and not is_golden else ""
    kind = OrderKind.GOLDEN if is_golden else OrderKind.UNIT
    order = Order(uuid.uuid4().hex, facts.station, kind, serial, lot_id, actor, reason)
    try:
        registry.order_queue.place(order)
    except InputError:
        return Answer(choice, Note("busy", {"serial": serial}))
    return Answer(replace(choice, serial=""))


def _acknowledge(registry: Registry, facts: LineFacts, choice: Choice, actor: str) -> Answer:
    """Take the reason of a stop as read; the unit that lay in the fixture is asked for again, nothing moves yet."""
    if not facts.is_stopped:
        return Answer(choice, Note("nothing_to_confirm", {}, False))
    registry.order_queue.place(Order(uuid.uuid4().hex, facts.station, OrderKind.ACKNOWLEDGE, actor=actor))
    broken = facts.newest
    if broken is None or broken[1].state is RunState.DONE or broken[0].kind is not OrderKind.UNIT:
        return Answer(replace(choice, serial=""))
    order = broken[0]
    return Answer(replace(choice, lot_id=order.lot_id, serial=order.serial, since=datetime.now(UTC)))


def _stop(registry: Registry, facts: LineFacts, choice: Choice, actor: str) -> Answer:
    if facts.active is None:
        return Answer(choice, Note("nothing_runs", {}, False))
    registry.order_queue.place(Order(uuid.uuid4().hex, facts.station, OrderKind.STOP, actor=actor))
    return Answer(choice, Note("stopping", {}, False))


def _cancel(registry: Registry, facts: LineFacts, choice: Choice, actor: str) -> Answer:
    return Answer(replace(choice, serial=""))


def _created(order: Order) -> datetime:
    return order.created or datetime.min.replace(tzinfo=UTC)


_COMMANDS = {"START": _start, "STOP": _stop, "REPEAT": _repeat, "OK": _acknowledge, "CANCEL": _cancel}
