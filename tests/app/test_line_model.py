"""The line as a model: every event in every state that can be reached, and the properties that hold in all of them.

It is gone through twice, without known loads and with two. Then the rules of the line are broken one by one, and each
time the model must find it. The use cases and the view are the product's own. The registry and the station are played
by one frozen value, so that a state can be kept and gone on from in several ways. SOFTCAL_LINE_WORLDS sets how many
states are gone through.
"""

import os
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from types import SimpleNamespace
from typing import Any

import pytest

from softcal.app.line import line as use_cases
from softcal.app.line.line import Step, take_scan
from softcal.app.line.status import LineSession, LineStatus, Screen, read_line, read_session
from softcal.app.texts import catalogue as texts
from softcal.app.views.line import LineView, line_view
from softcal.app.views.line_states import STATES
from softcal.core.errors import InputError
from softcal.core.lot import Lot
from softcal.core.messages.reason import plain as sentence
from softcal.core.messages.reason import reason
from softcal.core.orders import Heartbeat, Order, OrderKind, Progress, RunState, StationState
from softcal.core.quality.known_loads import KnownLoad, loads_text, ordered_load
from softcal.core.quality.line_rules import LineRules
from softcal.db.entries import RunEntry, UnitResult

NOW = datetime(2026, 5, 4, 8, 0, tzinfo=UTC)
TRANSLATE = partial(texts.text, "en")
LOTS = {"L1": Lot("L1", "A0", 50.0), "L2": Lot("L2", "B0", 50.0)}
RULES = LineRules(retests={"fail": 1, "retest": 1})
LOADS = (KnownLoad(0.0), KnownLoad(2.0, 0.002))
RESULTS = ("pass", "conditional", "fail", "retest", "recorded", "retest_used_up", "golden_pass", "golden_fail")
REFUSED = ("A0", "X7", "not a serial!", "http://x", "LOT:L9")
SCANS = ("A1", "A123", *REFUSED, "LOT:L1", "GOLDEN:G1", "BADGE:Kim")
KEYS = ("CMD:START", "CMD:OK", "CMD:REPEAT", "CMD:CANCEL", "CMD:STOP")
STATION = ("take", "pass", "fail", "retest", "break", "cut off", "restart", "restart stopped", "close", "open", "go")
READINGS = {"unsteady": "load.unsteady", "contradict": "load.contradict"}
"""What else the station says of a reading: it is taken again, or all of them are."""
TABS = ("left", "right")


@dataclass(frozen=True)
class World:
    """Registry, station and two screens at one moment.

    Args:
        session: values of the line's row, as the registry keeps them.
        orders: runs, newest first, as (id, kind, serial, state, verdict, what it said, its step); the newest two
            matter.
        results: (serial, verdict) in the lot, at most two of a serial.
        station, process: of the heartbeat; `silent` gives none.
        is_read: whether somebody has acknowledged the stop.
        shown: what each screen showed last: version of the place, and what F2 would do there.
        loads: that the lot asks for.
    """

    session: tuple[int, Any] = (0, None)
    orders: tuple[tuple[str, OrderKind, str, RunState, str, str, int], ...] = ()
    results: tuple[tuple[str, str], ...] = ()
    station: StationState = StationState.READY
    process: int = 0
    is_read: bool = False
    shown: tuple[tuple[int, str], ...] = ((0, ""), (0, ""))
    loads: tuple[KnownLoad, ...] = ()


@dataclass
class Played:
    """What the use cases need of a registry, played on a world; it counts what was ordered."""

    world: World
    ordered: list[Order] = field(default_factory=list)

    stations = SimpleNamespace(golden_runs=lambda station, serial=None: [])

    @property
    def order_queue(self) -> Any:
        return SimpleNamespace(stations=self._heartbeats, runs=self._orders, active=self.active, place=self.place)

    @property
    def line_sessions(self) -> "Played":
        return self

    def _heartbeats(self) -> list[Heartbeat]:
        if self.world.station is StationState.OFF:
            return [Heartbeat("line-1", StationState.OFF, datetime.now(UTC), process=f"elsewhere:{self.world.process}")]
        return [Heartbeat("line-1", self.world.station, datetime.now(UTC), process=f"elsewhere:{self.world.process}")]

    def _orders(self, station: str = "line-1", count: int = 2) -> Any:
        return [_run(values, self.world.loads) for values in self.world.orders]

    def _results(self, lot_id: str, serial: str) -> list[RunEntry]:
        return [RunEntry(one, NOW, verdict, ("because",)) for one, verdict in self.world.results if one == serial]

    def active(self, station: str) -> Any:
        return next((run for run in self._orders() if run[1].state.is_active), None)

    def place(self, order: Order, until_s: float | None = None) -> bool:
        self.ordered.append(order)
        if order.kind.is_run:
            if self.active("line-1"):
                raise InputError("busy")
            step = ordered_load(order.reason)[0] if order.kind is OrderKind.LOAD else 0
            values = (order.order_id, order.kind, order.serial, RunState.QUEUED, "", "", step)
            self.world = replace(self.world, orders=(values, *self.world.orders[:1]))
        elif order.kind is OrderKind.ACKNOWLEDGE:
            self.world = replace(self.world, is_read=True)
        return True

    def read(self, station: str) -> Any:
        version, values = self.world.session
        return version, dict(values) if values else {}

    def write(self, station: str, seen_version: int, session: Any) -> bool:
        assert seen_version == self.world.session[0]
        frozen = tuple((key, session[key]) for key in sorted(session))
        self.world = replace(self.world, session=(seen_version + 1, frozen))
        return True

    @property
    def lots(self) -> Any:
        return SimpleNamespace(
            ids=lambda: list(LOTS),
            get=LOTS.__getitem__,
            all=lambda: list(LOTS.values()),
            units=self._units,
            runs=self._results,
            line_rules=lambda lot: replace(RULES, loads=self.world.loads),
        )

    networks = SimpleNamespace(released=lambda lot_id: None)
    people = SimpleNamespace(all=lambda: [])

    @property
    def pages(self) -> Any:
        return SimpleNamespace(
            verdict_counts=lambda lot_id: {},
            unit_statuses=self._standings,
            unit_page=lambda *_, **__: SimpleNamespace(units=()),
        )

    def _standings(self, lot_id: str, serials: Any) -> dict[str, UnitResult]:
        newest = dict(self.world.results)
        return {s: UnitResult(s, newest[s], (sentence("because"),), NOW) for s in serials if s in newest}

    def _units(self, serial: str) -> list[Any]:
        lots = {"X7": "L2", **{one: "L1" for one, _ in self.world.results}}
        if serial not in lots:
            raise InputError("not in the registry")
        return [SimpleNamespace(lot_id=lots[serial])]


def _run(values: Any, loads: tuple[KnownLoad, ...]) -> tuple[Order, Progress]:
    order_id, kind, serial, state, verdict, reason_text, step = values
    is_gone = state is RunState.ERROR
    load_values: dict[str, Any] = {"step": step, "of": len(loads), "loads": loads_text(loads), "unit": "N"}
    load_values |= {"level": 0.1, "drift": 0.1, "spread": 0.1, "why": "exchanged"}
    message = (sentence("gone"),) if is_gone else (reason(reason_text, **load_values),) if reason_text else ()
    progress = Progress(order_id, state, code="E-SILENT" if is_gone else "", message=message, verdict=verdict)
    return Order(order_id, "line-1", kind, serial, "L1", "kim", created=NOW), progress


def played_station(world: World, event: str) -> World | None:
    """Return the world after something at the station, None where it cannot happen."""
    newest = world.orders[0] if world.orders else None
    state = newest[3] if newest else None
    if event == "take":
        return _ended(world, RunState.RUNNING) if state is RunState.QUEUED else None
    if event in READINGS:
        is_reading = newest is not None and newest[1] is OrderKind.LOAD and state is RunState.RUNNING
        return _ended(world, RunState.DONE, "", READINGS[event]) if is_reading else None
    if event in ("pass", "fail", "retest"):
        if state is not RunState.RUNNING or newest is None:
            return None
        if world.loads and newest[1] is OrderKind.UNIT:
            return _ended(world, RunState.DONE, "", "load.wanted") if event == "pass" else None
        if newest[1] is OrderKind.LOAD and newest[6] < len(world.loads):
            return _ended(world, RunState.DONE, "", "load.read") if event == "pass" else None
        ended = _ended(
            world, RunState.DONE, event if newest[1] is not OrderKind.GOLDEN or event != "retest" else "fail"
        )
        own_results = [entry for entry in world.results if entry[0] == newest[2]][-1:]
        others = [entry for entry in world.results if entry[0] != newest[2]]
        is_unit = newest[1] is not OrderKind.GOLDEN
        own_results = [(newest[2], event)] if own_results else []  # Which verdict came first changes nothing.
        return replace(ended, results=tuple(sorted([*others, *own_results, (newest[2], event)]))) if is_unit else ended
    if event == "break":
        broken = _ended(world, RunState.ERROR) if state is RunState.RUNNING else world
        return replace(broken, station=StationState.STOPPED, is_read=False)
    if event == "cut off":
        return _ended(world, RunState.ERROR) if state in (RunState.RUNNING, RunState.QUEUED) else None
    if event in ("restart", "restart stopped"):
        cut = _ended(world, RunState.ERROR) if state in (RunState.RUNNING, RunState.QUEUED) else world
        after = StationState.READY if event == "restart" else StationState.STOPPED
        return replace(cut, process=1 - world.process, station=after, is_read=False)
    if event == "close":
        return replace(world, station=StationState.CLOSED) if world.station is StationState.READY else None
    if event == "open":
        if world.station is StationState.STOPPED and not world.is_read:
            return None
        return replace(world, station=StationState.READY, is_read=False)
    return replace(world, station=StationState.OFF) if state not in (RunState.RUNNING, RunState.QUEUED) else None


def _ended(world: World, state: RunState, verdict: str = "", message: str = "") -> World:
    order_id, kind, serial, _, _, _, step = world.orders[0]
    return replace(world, orders=((order_id, kind, serial, state, verdict, message, step), *world.orders[1:]))


def line_view_of(registry: Any, tab: str) -> LineView:
    return line_view(read_line(registry, Screen(tab=tab)), "", TRANSLATE)


def offered(view: LineView) -> str:
    """What F2 does at a card: the serial it presses, or the load it reads."""
    if view.state == "load":
        return f"{view.serial}: {view.instruction}"
    return view.serial if view.state in ("armed", "armed_golden") else ""


def plain(world: World) -> tuple[Any, ...]:
    """Return what tells worlds apart by what can follow: notes and badges lead nowhere."""
    version, values = world.session
    session = dict(values or ())
    newest = world.orders[0] if world.orders else ("", None, "", None, "", "", 0)
    is_unit_uncertain = session.get("after_run") == newest[0]
    serial = session.get("serial", "") if is_unit_uncertain else ""
    waits = (serial, session["process"] == f"elsewhere:{world.process}") if serial else ()
    is_same = session.get("process") == f"elsewhere:{world.process}" if newest[5] else True
    pending = (session["is_new"], session["is_confirmed"], session["tab"]) if serial else ()
    screens = tuple((seen_version == version, screen) for seen_version, screen in world.shown)
    return (
        session.get("lot_id", ""),
        is_unit_uncertain,
        waits,
        pending,
        is_same,
        newest[1:],
        world.results,
        world.station,
        world.is_read,
        screens,
    )


@dataclass
class Broken(AssertionError):
    """A property does not hold."""

    what: str
    trail: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.what} after {' → '.join(self.trail)}"


def events(loads: tuple[KnownLoad, ...]) -> Iterator[tuple[str, str]]:
    yield from (("station", event) for event in (*STATION, *(READINGS if loads else ())))
    yield from (("left", code) for code in (*SCANS, *KEYS, "look"))
    # The screens are alike: one of them does everything, the other one holds a stale picture and starts from it.
    yield from (("right", code) for code in ("CMD:START", "look"))


def after(world: World, who: str, event: str, trail: tuple[str, ...]) -> World | None:
    """Return the world after one event, and check that nothing moved that should not."""
    if who == "station":
        return played_station(world, event)
    registry, at = Played(world), TABS.index(who)
    if event != "look":
        before = line_view_of(registry, who)
        seen_version, serial = world.shown[at]
        take_scan(registry, Screen(tab=who, version=seen_version), event)
        moved = [order for order in registry.ordered if order.kind.presses]
        read = [order for order in registry.ordered if order.kind is OrderKind.LOAD]
        if (moved or read) and event != "CMD:START":
            raise Broken(f"{event} began a run", trail)
        if read and (before.state != "load" or read[0].serial != before.serial):
            raise Broken(f"a load was read on {read[0].serial} under a card of {before.state} {before.serial}", trail)
        if read and offered(before) != serial:
            raise Broken(f"a load was read at a screen that showed {serial or 'none'}", trail)
        if moved and offered(before) != moved[0].serial:
            raise Broken(f"{moved[0].serial} was pressed under a card of {before.state} {before.serial}", trail)
        scanned_here = dict(world.session[1] or ()).get("tab") == who
        if moved and moved[0].serial != serial and not scanned_here:
            raise Broken(f"{moved[0].serial} was pressed at a screen that showed {serial or 'no unit'}", trail)
    view = line_view_of(registry, who)
    screens = list(registry.world.shown)
    screens[at] = (view.start_version, offered(view))
    return replace(registry.world, shown=tuple(screens))


def check_card(world: World, who: str, event: str, before: LineView, trail: tuple[str, ...]) -> LineView:
    """Check what stands there after an event; return it."""
    view, other = line_view_of(Played(world), "left"), line_view_of(Played(world), "a new one")
    if view != other:
        raise Broken("two screens show different things", trail)
    newest = world.orders[0] if world.orders else None
    if view.state in RESULTS and (newest is None or newest[3] is not RunState.DONE or newest[2] != view.serial):
        raise Broken(f"{view.state} of {view.serial} though the newest run is {newest}", trail)
    session = read_session(Played(world), "line-1")  # type: ignore[arg-type]
    if view.state in RESULTS and newest is not None and session.after_run == newest[0]:
        raise Broken(f"{view.state} of {view.serial} though another unit may be in the hand", trail)
    if STATES[view.state].is_before_run and view.serial and view.serial != session.serial:
        raise Broken(f"{view.serial} stands there, {session.serial} was scanned", trail)
    if view.state == "load":
        is_pressed = newest is not None and newest[3] is RunState.DONE and newest[2] == view.serial
        if not is_pressed or newest is None or newest[1] is OrderKind.GOLDEN or session.after_run == newest[0]:
            raise Broken(f"a load is asked for of {view.serial} though the newest run is {newest}", trail)
        if session.process != f"elsewhere:{world.process}":
            raise Broken(f"a load is asked for of {view.serial} after a restart", trail)
    irregular = who != "station" and before.state not in ("running", "reading", "stopped") and event in REFUSED
    if irregular and view.state not in ("hand", "closed", "silent", "no_lot"):
        raise Broken(f"{view.state} of {view.serial} after a refused scan", trail)
    return view


TO_FIRST_LOAD = (
    ("left", "LOT:L1"),
    ("left", "A1"),
    ("left", "CMD:START"),
    ("station", "take"),
    ("station", "pass"),
    ("left", "look"),
)
"""Where a lot asks for loads, the states behind its first run are gone through: those before it are as without."""


TO_LAST_LOAD = (
    *TO_FIRST_LOAD,
    ("left", "CMD:START"),
    ("station", "take"),
    ("station", "pass"),
    ("left", "look"),
    ("left", "CMD:START"),
    ("station", "take"),
)


def explore(
    loads: tuple[KnownLoad, ...], max_worlds: int, begin: tuple[tuple[str, str], ...] = ()
) -> tuple[int, int, set[str]]:
    """Go through every event in so many states; return how many states, events and cards there were.

    Raises:
        Broken: the first property that does not hold, with the way there.
    """
    first, way = World(loads=loads), ()
    for who, event in begin:
        way = (*way, f"{who}: {event}")
        first = after(first, who, event, way) or first
    explored, steps, states = {plain(first)}, 0, set()
    open_worlds: deque[tuple[World, tuple[str, ...]]] = deque([(first, way)])
    while open_worlds:
        world, trail = open_worlds.popleft()
        before = line_view_of(Played(world), "left")
        for who, event in events(loads):
            history = (*trail, f"{who}: {event}")
            then = after(world, who, event, history)
            if then is None:
                continue
            steps += 1
            states.add(check_card(then, who, event, before, history).state)
            if plain(then) not in explored and len(explored) < max_worlds:
                explored.add(plain(then))
                open_worlds.append((then, history))
    return len(explored), steps, states


MAX_WORLDS = int(os.environ.get("SOFTCAL_LINE_WORLDS", "400"))
CARDS = {"armed", "armed_golden", "ask", "ask_new", "used_up", "hand", "stopped", "broken", "pass", "fail", "retest"}


@pytest.fixture(autouse=True)
def numbered_orders(monkeypatch: pytest.MonkeyPatch) -> None:
    ids = iter(range(10**9))
    monkeypatch.setattr(use_cases.uuid, "uuid4", lambda: SimpleNamespace(hex=f"order-{next(ids)}"))


@pytest.mark.parametrize(
    ("loads", "begin", "cards"),
    [
        ((), (), CARDS),
        pytest.param((), (("left", "LOT:L1"), ("left", "A1"), ("left", "CMD:START")), CARDS, marks=pytest.mark.long),
        pytest.param(
            LOADS,
            TO_FIRST_LOAD,
            {"load", "reading", "armed", "hand", "recorded", "stopped", "broken"},
            marks=pytest.mark.long,
        ),
        pytest.param(
            LOADS,
            TO_LAST_LOAD,
            {"load", "reading", "armed", "hand", "pass", "fail", "stopped", "broken", "ask"},
            marks=pytest.mark.long,
        ),
    ],
    ids=["no loads", "no loads, a unit pressed", "two loads, from the first", "two loads, from the last"],
)
def test_all_events_in_all_states_keep_the_properties(
    loads: tuple[KnownLoad, ...], begin: tuple[tuple[str, str], ...], cards: set[str], capsys: Any
) -> None:
    worlds, steps, states = explore(loads, MAX_WORLDS // 2 if loads else MAX_WORLDS, begin)
    with capsys.disabled():
        print(f"\nline model: {worlds} worlds, {steps} events, {len(states)} cards: {', '.join(sorted(states))}")
    assert states >= cards


REAL = SimpleNamespace(
    note_given=use_cases._with_note,
    start=use_cases._start,
    refusal=use_cases._start_refusal,
    step=use_cases._step,
    emptied=LineSession.emptied,
    serial=LineStatus.serial.fget,
    is_unclear=LineStatus.is_unit_uncertain.fget,
)


def _pressed_at_once(registry: Any, context: Any, screen: Any, scan: Any, who: str) -> Step:
    outcome = REAL.step(registry, context, screen, scan, who)
    is_unit = scan.kind == "serial" and outcome.session.serial and not context.active
    return (
        Step(outcome.session, Order("at-once", "line-1", OrderKind.UNIT, outcome.session.serial))
        if is_unit
        else outcome
    )


def _press_for_reading(context: Any, screen: Any, who: str) -> Step:
    outcome = REAL.start(context, screen, who)
    is_reading = outcome.order is not None and outcome.order.kind is OrderKind.LOAD
    return replace(outcome, order=replace(outcome.order, kind=OrderKind.UNIT)) if is_reading else outcome


def _same_service(context: Any) -> int:
    session = replace(context.session, process=context.heartbeat.process) if context.heartbeat else context.session
    return REAL.load_step(replace(context, session=session))


REAL.load_step = LineStatus.load_step.fget
HAZARDS: dict[str, tuple[Any, str, Any, bool]] = {
    "F4 starts": (use_cases._COMMANDS, "OK", REAL.start, False),
    "F6 starts": (use_cases._COMMANDS, "CANCEL", REAL.start, False),
    "an old REPEAT label starts": (use_cases._COMMANDS, "REPEAT", REAL.start, False),
    "a scan starts": (use_cases, "_step", _pressed_at_once, False),
    "a refused scan leaves READY under the old serial": (
        use_cases,
        "_with_note",
        lambda status, note, place=None: REAL.note_given(status, note, None if note.is_refusal else place),
        False,
    ),
    "a unit that nobody knows in the hand stays the old one": (
        LineSession,
        "emptied",
        lambda place, newest: replace(REAL.emptied(place, newest), serial=place.serial),
        False,
    ),
    "a question need not be answered": (
        use_cases,
        "_start_refusal",
        lambda status, screen: None if status.open_question and not status.active else REAL.refusal(status, screen),
        False,
    ),
    "F2 at a screen that showed another unit": (
        use_cases,
        "_start_refusal",
        lambda status, screen: REAL.refusal(status, replace(screen, version=None)),
        False,
    ),
    "a result stands there though another unit may be in the hand": (
        LineStatus,
        "is_unit_uncertain",
        property(lambda status: REAL.is_unclear(status) and bool(status.session.serial)),
        False,
    ),
    "F2 presses where a load is asked for": (use_cases._COMMANDS, "START", _press_for_reading, True),
    "F2 reads a load that its screen had not shown": (
        use_cases,
        "_start_refusal",
        lambda status, screen: REAL.refusal(status, replace(screen, version=None) if status.load else screen),
        True,
    ),
    "a load is asked for after a restart": (LineStatus, "load_step", property(_same_service), True),
    "F4 reads a load": (
        use_cases._COMMANDS,
        "OK",
        lambda status, screen, who: (REAL.start if status.load else REAL.confirm)(status, screen, who),
        True,
    ),
    "a load is asked for though another unit was scanned": (
        LineStatus,
        "is_unit_uncertain",
        property(lambda status: REAL.is_unclear(status) and not _was_load(status)),
        True,
    ),
}
"""A rule of the line that is broken: where, its name, what stands in its place, whether it is about known loads."""

REAL.confirm = use_cases._confirm


def _was_load(context: Any) -> bool:
    return bool(context.newest and context.newest[1].message and context.newest[1].message[0].code.startswith("load."))


@pytest.mark.parametrize("hazard", HAZARDS)
def test_the_model_finds_every_rule_that_is_broken(hazard: str, monkeypatch: pytest.MonkeyPatch) -> None:
    where, name, instead, needs_loads = HAZARDS[hazard]
    change: Callable[..., None] = monkeypatch.setitem if isinstance(where, dict) else monkeypatch.setattr
    change(where, name, instead)
    with pytest.raises(Broken):
        explore(LOADS if needs_loads else (), MAX_WORLDS, TO_FIRST_LOAD if needs_loads else ())
