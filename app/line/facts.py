"""State of a line, read from the registry alone, so that every screen shows the same.

The unit that waits, the last sentence and the badge lie there, too, a row a station: they outlive a restart.
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime, timedelta

from softcal.app.bootstrap import is_alive
from softcal.app.line.scan_codes import numbered
from softcal.core.lot import Lot
from softcal.core.orders import Heartbeat, Order, OrderKind, Progress, RunState, StationState
from softcal.core.quality.known_loads import KnownLoad, asked_loads, next_step
from softcal.core.quality.line_rules import LineRules
from softcal.core.unit.verdict import Verdict
from softcal.db.entries import RunEntry, UnitResult
from softcal.db.queues.order_queue import STATION_SILENT_AFTER, LinePlaces
from softcal.db.registry import Registry
from softcal.db.repositories.networks import NetworkState
from softcal.db.schema.deadline import is_silent

NEWEST_RUNS = 40
HUNG_AFTER = timedelta(seconds=15)
"""A service that is seen to live may be late with its beat for so long: it trains, or waits."""

SHOWN_RUNS = 14
"""So many of the last units a screen shows."""

MOST_AT_ONCE = 16
"""So many units of one run are looked for."""

SILENT = "silent"
"""State of a station that gives no sign of life and did not end in good order."""

LineRun = tuple[Order, Progress]

BADGE_HOLDS = timedelta(hours=10)
"""A badge names whoever stands at the line for one shift."""


@dataclass(frozen=True)
class Note:
    """One sentence about the last scan, the text `note.KEY`; a run newer than `run` ends it."""

    key: str
    values: Mapping[str, str] = field(default_factory=dict)
    is_refusal: bool = True
    run: str = ""
    is_meanwhile: bool = False


@dataclass(frozen=True)
class Place:
    """Session of a line between its runs.

    Args:
        version: counts the changes; 0 before the first.
        after_run: the newest run when the unit in the hand last changed or became unknown; None: nothing since its
            run. Once there is a newer run, it alone says what stands at the line.
        serial: scanned and not pressed yet; "" if it is uncertain which unit is in the hand.
        is_golden: whether that serial is a golden unit, pressed to check the station.
        is_new: whether the lot has neither that serial nor one that looks like it.
        is_confirmed: whether a person has said yes to a unit that is new, or has a result already.
        process: the station's service when it was scanned; another one has moved the stage since.
        lot_id: chosen by a scan; "" leaves it to the only one, or the last one used.
    """

    version: int = 0
    after_run: str | None = None
    serial: str = ""
    is_golden: bool = False
    is_new: bool = False
    is_confirmed: bool = False
    process: str = ""
    lot_id: str = ""
    tab: str = ""
    note: Note | None = None
    operator: str = ""
    badged_at: datetime | None = None

    def emptied(self, newest_run: str) -> "Place":
        """Return the session after the unit in the hand became uncertain."""
        return replace(self, after_run=newest_run, serial="", is_golden=False, is_new=False, is_confirmed=False)

    def is_badge_over(self, now: datetime) -> bool:
        return self.badged_at is not None and is_silent(self.badged_at, now, BADGE_HOLDS)


def read_place(places: LinePlaces, station: str) -> Place:
    """Return the session of the line of a station."""
    version, values = places.read(station)
    if not values:
        return Place(version)
    note, badged_at = values.get("note"), values.get("badged_at")
    facts = {
        "note": Note(**note) if note else None,
        "badged_at": datetime.fromisoformat(badged_at).astimezone(UTC) if badged_at else None,
    }
    return Place(version, **{**values, **facts})


def write_place(places: LinePlaces, station: str, place: Place) -> bool:
    """Replace the session; return False without a change if another screen was first."""
    values = asdict(place) | {"badged_at": place.badged_at.isoformat() if place.badged_at else None}
    return places.write(station, values.pop("version"), values)


def state_of(beat: Heartbeat, now: datetime, is_alive: bool | None) -> str:
    """Return the state of a station for every screen; `ready` means that it takes a unit.

    None for `is_alive` means that its process cannot be checked from this machine.
    """
    patience = HUNG_AFTER if is_alive else STATION_SILENT_AFTER
    is_there = is_alive is not False and not is_silent(beat.at, now, patience)
    return str(beat.state) if is_there or beat.state is StationState.OFF else SILENT


@dataclass(frozen=True)
class Screen:
    """Kind of screen of a line.

    Args:
        station: chosen; "" leaves it to the only one.
        seen: version of the session on the screen at the key press; None if unknown.
        until_s: `time.monotonic()` after which it says that the key was not taken.
    """

    station: str = ""
    tab: str = ""
    seen: int | None = None
    until_s: float | None = None


@dataclass(frozen=True)
class LotAtLine:
    """Data of a lot that a line needs.

    The released network gives the verdict of a unit; `counts` has its units by verdict, `none` without.
    """

    lot: Lot
    rules: LineRules
    network: NetworkState | None
    counts: Mapping[str, int]

    @property
    def id(self) -> str:
        return self.lot.id


@dataclass(frozen=True)
class LineFacts:
    """State of a line.

    Args:
        stations: every station that ever gave a sign of life.
        heartbeat: of the chosen station, or None.
        runs: newest runs of the station, newest first.
        results: in this lot, oldest first, of the unit that waits, else of the unit pressed last.
        standings: status of the units of the runs, and of the waiting unit, by serial.
    """

    now: datetime
    stations: tuple[str, ...] = ()
    heartbeat: Heartbeat | None = None
    is_alive: bool | None = None
    lots: tuple[str, ...] = ()
    lot: LotAtLine | None = None
    active: LineRun | None = None
    runs: tuple[LineRun, ...] = ()
    place: Place = Place()
    results: tuple[RunEntry, ...] = ()
    standings: Mapping[str, UnitResult] = field(default_factory=dict)

    @property
    def station(self) -> str:
        """Name of the station, "" where none is chosen."""
        return self.heartbeat.station if self.heartbeat else ""

    @property
    def station_state(self) -> str:
        """State of the station by `state_of`; "" without a chosen station."""
        return state_of(self.heartbeat, self.now, self.is_alive) if self.heartbeat else ""

    @property
    def is_answering(self) -> bool:
        """Whether the service runs: its process is alive, or its heartbeat is fresh."""
        return self.station_state not in ("", SILENT, StationState.OFF)

    @property
    def is_stopped(self) -> bool:
        """Whether a person must acknowledge a stop before any motion, also with a late heartbeat."""
        return self.heartbeat is not None and self.heartbeat.state is StationState.STOPPED

    @property
    def newest_run(self) -> str:
        """Id of the newest run, over or not; "" before the first."""
        run = self.active or (self.runs[0] if self.runs else None)
        return run[0].order_id if run else ""

    @property
    def newest(self) -> LineRun | None:
        return next((run for run in self.runs if not run[1].state.is_active), None)

    @property
    def result_run(self) -> LineRun | None:
        """Newest run whose result the line shows. None before one, or if another unit may be in the hand since."""
        run = None if self.active or self.is_in_doubt else self.newest
        if run is None or run[1].state is not RunState.DONE or self.load is not None:
            return run
        return run if run[0].kind.presses or run[0].kind is OrderKind.LOAD else None

    @property
    def is_in_doubt(self) -> bool:
        """Whether the unit in the hand changed, or became unknown, since the newest run."""
        return self.place.after_run == self.newest_run

    @property
    def serial(self) -> str:
        """Serial of the scanned unit before its press; "" if it is uncertain."""
        is_same_service = self.heartbeat is not None and self.place.process == self.heartbeat.process
        return self.place.serial if self.is_in_doubt and is_same_service else ""

    @property
    def load_step(self) -> int:
        """Number, from 1, of the next known load of the last unit; 0 without one.

        Not after a restart of the service, as events in between are unknown.
        """
        if self.newest is None or self.active is not None or self.is_in_doubt or self.is_stopped:
            return 0
        order, progress = self.newest
        if not order.kind.is_about_unit or progress.state is not RunState.DONE or progress.verdict:
            return 0
        is_same_service = self.heartbeat is not None and self.place.process == self.heartbeat.process
        return next_step(progress.message) if is_same_service else 0

    @property
    def load(self) -> KnownLoad | None:
        if not self.load_step or self.newest is None:
            return None
        return asked_loads(self.newest[1].message)[self.load_step - 1]

    @property
    def is_golden(self) -> bool:
        return bool(self.serial) and self.place.is_golden

    @property
    def may_press(self) -> bool:
        beat = self.heartbeat
        is_closed = beat is None or beat.state in (StationState.CLOSED, StationState.STARTING)
        is_open_to_golden = beat is not None and beat.state is StationState.CLOSED and self.is_golden
        return self.is_answering and (not is_closed or is_open_to_golden)

    @property
    def retests_left(self) -> int:
        """Number of further presses allowed for the unit that `results` refer to."""
        if self.lot is None or not self.results:
            return 0
        return self.lot.rules.retests_left(self.results[-1].verdict, len(self.results))

    @property
    def open_question(self) -> str:
        """Question that a person must confirm before the waiting unit is pressed; "" without one."""
        if not self.serial or self.is_golden:
            return ""
        if self.results and self.retests_left == 0:
            return "used_up"
        if self.place.is_confirmed or (self.results and self.results[-1].verdict == "retest"):
            return ""
        return "ask" if self.results else "ask_new" if self.place.is_new else ""

    @property
    def operator(self) -> str:
        """Name that the badge of this shift gave; "" without."""
        return "" if self.place.is_badge_over(self.now) else self.place.operator

    @property
    def note(self) -> Note | None:
        """Sentence about the last scan, while it applies."""
        note = self.place.note
        if note is None or note.run != self.newest_run:
            return None
        if not note.is_meanwhile or self.active is not None:
            return note
        return replace(note, key="meanwhile") if note.key == "busy" else None


def read_line(
    registry: Registry, screen: Screen, look_at_lot: Callable[[Registry, str], LotAtLine] | None = None
) -> LineFacts:
    """Return the state of a line. A screen that polls twice a second gives a `look_at_lot` with a cache.

    Raises:
        RegistryError: the registry is away.
    """
    queue, now = registry.order_queue, datetime.now(UTC)
    beats = queue.stations()
    chosen = [beat for beat in beats if beat.station == screen.station] or (beats if len(beats) == 1 else [])
    facts = LineFacts(now, tuple(b.station for b in beats), lots=tuple(registry.lots.ids()))
    if chosen:
        # In this order: a run that begins between must not find a place read after it.
        beat, place = chosen[0], read_place(registry.line_places, chosen[0].station)
        active = queue.active(beat.station)
        runs = tuple(run for run in queue.runs(beat.station, NEWEST_RUNS) if run[0].kind.is_run)
        facts = replace(facts, heartbeat=beat, is_alive=is_alive(beat.process), active=active, runs=runs, place=place)
    last_lot = next((run[0].lot_id for run in facts.runs if run[0].lot_id), "")
    wanted = (facts.place.lot_id, last_lot)
    lot_id = next((lot for lot in wanted if lot in facts.lots), facts.lots[0] if len(facts.lots) == 1 else "")
    if not lot_id:
        return facts
    facts = replace(facts, lot=(look_at_lot or read_lot)(registry, lot_id))
    subject = facts.serial or (facts.newest[0].serial if facts.newest else "")
    results = tuple(registry.lots.runs(lot_id, subject)) if subject else ()
    # Where the units stand that the line shows, each of a run of several, too
    over = [run for run in facts.runs if run[0].lot_id == lot_id and run[1].state is RunState.DONE][:SHOWN_RUNS]
    shown = list(dict.fromkeys((*filter(None, [facts.serial]), *(order.serial for order, _ in over))))
    standings = dict(registry.pages.standings(lot_id, shown)) if shown else {}
    judged = {order.serial for order, done in over if done.verdict and order.serial not in standings}
    if several := [numbered(serial, k) for serial in judged for k in range(MOST_AT_ONCE)]:
        standings |= registry.pages.standings(lot_id, several)
    return replace(facts, results=results, standings=standings)


def standing_of(facts: LineFacts, run: LineRun) -> tuple[UnitResult, ...]:
    """Return the status of the units of a run, the worst first; none if the run decided none."""
    order, progress = run
    if not order.kind.is_about_unit or facts.lot is None or order.lot_id != facts.lot.id:
        return ()
    serials = (order.serial, *(numbered(order.serial, k) for k in range(MOST_AT_ONCE)))
    known = (facts.standings[serial] for serial in serials if serial in facts.standings)
    # A run without a verdict leaves the unit as it was judged before.
    decided = [s for s in known if progress.verdict or (order.created and s.made_at and s.made_at >= order.created)]
    return tuple(sorted(decided, key=lambda standing: -Verdict(standing.verdict).severity))


def read_lot(registry: Registry, lot_id: str) -> LotAtLine:
    """Return the data of a lot that a line needs."""
    lot = registry.lots.get(lot_id)
    counts = registry.pages.verdict_counts(lot.id)
    return LotAtLine(lot, registry.lots.line_rules(lot), registry.networks.released(lot.id), counts)
