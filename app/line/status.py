"""State of a line, read from the registry alone, so that every screen shows the same.

The unit that waits, the last sentence and the badge lie there, too, a row a station: they outlive a restart.
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime, timedelta

from softcal.app.bootstrap import is_alive
from softcal.app.line.scan_codes import channel_serial
from softcal.core.lot import Lot
from softcal.core.orders import Heartbeat, Order, OrderKind, Progress, RunState, StationState
from softcal.core.quality.known_loads import KnownLoad, next_step, requested_loads
from softcal.core.quality.line_rules import LineRules
from softcal.core.unit.verdict import Verdict
from softcal.db.entries import RunEntry, UnitResult
from softcal.db.queues.order_queue import STATION_SILENT_AFTER, LineSessions
from softcal.db.registry import Registry
from softcal.db.repositories.networks import NetworkState
from softcal.db.schema.deadline import is_silent

NEWEST_RUNS = 40
HUNG_AFTER = timedelta(seconds=15)
"""A service that is seen to live may be late with its beat for so long: it trains, or waits."""

MAX_SHOWN_RUNS = 14
"""So many of the last units a screen shows."""

MAX_CHANNELS = 16
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
    is_during_run: bool = False


@dataclass(frozen=True)
class LineSession:
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

    def emptied(self, newest_run: str) -> "LineSession":
        """Return the session after the unit in the hand became uncertain."""
        return replace(self, after_run=newest_run, serial="", is_golden=False, is_new=False, is_confirmed=False)

    def is_badge_over(self, now: datetime) -> bool:
        return self.badged_at is not None and is_silent(self.badged_at, now, BADGE_HOLDS)


def read_session(sessions: LineSessions, station: str) -> LineSession:
    """Return the session of the line of a station."""
    version, values = sessions.read(station)
    if not values:
        return LineSession(version)
    note, badged_at = values.get("note"), values.get("badged_at")
    fields = {
        "note": Note(**note) if note else None,
        "badged_at": datetime.fromisoformat(badged_at).astimezone(UTC) if badged_at else None,
    }
    return LineSession(version, **{**values, **fields})


def write_session(sessions: LineSessions, station: str, session: LineSession) -> bool:
    """Replace the session; return False without a change if another screen was first."""
    values = asdict(session) | {"badged_at": session.badged_at.isoformat() if session.badged_at else None}
    return sessions.write(station, values.pop("version"), values)


def state_of(heartbeat: Heartbeat, now: datetime, is_alive: bool | None) -> str:
    """Return the state of a station for every screen; `ready` means that it takes a unit.

    None for `is_alive` means that its process cannot be checked from this machine.
    """
    timeout = HUNG_AFTER if is_alive else STATION_SILENT_AFTER
    is_present = is_alive is not False and not is_silent(heartbeat.at, now, timeout)
    return str(heartbeat.state) if is_present or heartbeat.state is StationState.OFF else SILENT


@dataclass(frozen=True)
class Screen:
    """Kind of screen of a line.

    Args:
        station: chosen; "" leaves it to the only one.
        version: version of the session on the screen at the key press; None if unknown.
        until_s: `time.monotonic()` after which it says that the key was not taken.
    """

    station: str = ""
    tab: str = ""
    version: int | None = None
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
class LineStatus:
    """State of a line.

    Args:
        stations: every station that ever gave a sign of life.
        heartbeat: of the chosen station, or None.
        runs: newest runs of the station, newest first.
        results: in this lot, oldest first, of the unit that waits, else of the unit pressed last.
        unit_statuses: status of the units of the runs, and of the waiting unit, by serial.
    """

    now: datetime
    stations: tuple[str, ...] = ()
    heartbeat: Heartbeat | None = None
    is_alive: bool | None = None
    lots: tuple[str, ...] = ()
    lot: LotAtLine | None = None
    active: LineRun | None = None
    runs: tuple[LineRun, ...] = ()
    session: LineSession = LineSession()
    results: tuple[RunEntry, ...] = ()
    unit_statuses: Mapping[str, UnitResult] = field(default_factory=dict)

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
        run = None if self.active or self.is_unit_uncertain else self.newest
        if run is None or run[1].state is not RunState.DONE or self.load is not None:
            return run
        return run if run[0].kind.presses or run[0].kind is OrderKind.LOAD else None

    @property
    def is_unit_uncertain(self) -> bool:
        """Whether the unit in the hand changed, or became unknown, since the newest run."""
        return self.session.after_run == self.newest_run

    @property
    def serial(self) -> str:
        """Serial of the scanned unit before its press; "" if it is uncertain."""
        is_same_service = self.heartbeat is not None and self.session.process == self.heartbeat.process
        return self.session.serial if self.is_unit_uncertain and is_same_service else ""

    @property
    def load_step(self) -> int:
        """Number, from 1, of the next known load of the last unit; 0 without one.

        Not after a restart of the service, as events in between are unknown.
        """
        if self.newest is None or self.active is not None or self.is_unit_uncertain or self.is_stopped:
            return 0
        order, progress = self.newest
        if not order.kind.is_about_unit or progress.state is not RunState.DONE or progress.verdict:
            return 0
        is_same_service = self.heartbeat is not None and self.session.process == self.heartbeat.process
        return next_step(progress.message) if is_same_service else 0

    @property
    def load(self) -> KnownLoad | None:
        if not self.load_step or self.newest is None:
            return None
        return requested_loads(self.newest[1].message)[self.load_step - 1]

    @property
    def is_golden(self) -> bool:
        return bool(self.serial) and self.session.is_golden

    @property
    def may_press(self) -> bool:
        heartbeat = self.heartbeat
        is_closed = heartbeat is None or heartbeat.state in (StationState.CLOSED, StationState.STARTING)
        is_open_to_golden = heartbeat is not None and heartbeat.state is StationState.CLOSED and self.is_golden
        return self.is_answering and (not is_closed or is_open_to_golden)

    @property
    def remaining_retests(self) -> int:
        """Number of further presses allowed for the unit that `results` refer to."""
        if self.lot is None or not self.results:
            return 0
        return self.lot.rules.remaining_retests(self.results[-1].verdict, len(self.results))

    @property
    def open_question(self) -> str:
        """Question that a person must confirm before the waiting unit is pressed; "" without one."""
        if not self.serial or self.is_golden:
            return ""
        if self.results and self.remaining_retests == 0:
            return "used_up"
        if self.session.is_confirmed or (self.results and self.results[-1].verdict == "retest"):
            return ""
        return "ask" if self.results else "ask_new" if self.session.is_new else ""

    @property
    def operator(self) -> str:
        """Name that the badge of this shift gave; "" without."""
        return "" if self.session.is_badge_over(self.now) else self.session.operator

    @property
    def note(self) -> Note | None:
        """Sentence about the last scan, while it applies."""
        note = self.session.note
        if note is None or note.run != self.newest_run:
            return None
        if not note.is_during_run or self.active is not None:
            return note
        return replace(note, key="meanwhile") if note.key == "busy" else None


def read_line(
    registry: Registry, screen: Screen, look_at_lot: Callable[[Registry, str], LotAtLine] | None = None
) -> LineStatus:
    """Return the state of a line. A screen that polls twice a second gives a `look_at_lot` with a cache.

    Raises:
        RegistryError: the registry is away.
    """
    queue, now = registry.order_queue, datetime.now(UTC)
    heartbeats = queue.stations()
    chosen = [heartbeat for heartbeat in heartbeats if heartbeat.station == screen.station] or (
        heartbeats if len(heartbeats) == 1 else []
    )
    line = LineStatus(now, tuple(b.station for b in heartbeats), lots=tuple(registry.lots.ids()))
    if chosen:
        # In this order: a run that begins between must not find a place read after it.
        heartbeat, session = chosen[0], read_session(registry.line_sessions, chosen[0].station)
        active = queue.active(heartbeat.station)
        runs = tuple(run for run in queue.runs(heartbeat.station, NEWEST_RUNS) if run[0].kind.is_run)
        line = replace(
            line, heartbeat=heartbeat, is_alive=is_alive(heartbeat.process), active=active, runs=runs, session=session
        )
    last_lot = next((run[0].lot_id for run in line.runs if run[0].lot_id), "")
    candidates = (line.session.lot_id, last_lot)
    lot_id = next((lot for lot in candidates if lot in line.lots), line.lots[0] if len(line.lots) == 1 else "")
    if not lot_id:
        return line
    line = replace(line, lot=(look_at_lot or read_lot)(registry, lot_id))
    subject = line.serial or (line.newest[0].serial if line.newest else "")
    results = tuple(registry.lots.runs(lot_id, subject)) if subject else ()
    # Where the units stand that the line shows, each of a run of several, too
    over = [run for run in line.runs if run[0].lot_id == lot_id and run[1].state is RunState.DONE][:MAX_SHOWN_RUNS]
    shown_serials = list(dict.fromkeys((*filter(None, [line.serial]), *(order.serial for order, _ in over))))
    unit_statuses = dict(registry.pages.unit_statuses(lot_id, shown_serials)) if shown_serials else {}
    undecided = {order.serial for order, progress in over if progress.verdict and order.serial not in unit_statuses}
    if channel_serials := [channel_serial(serial, k) for serial in undecided for k in range(MAX_CHANNELS)]:
        unit_statuses |= registry.pages.unit_statuses(lot_id, channel_serials)
    return replace(line, results=results, unit_statuses=unit_statuses)


def unit_statuses_of(line: LineStatus, run: LineRun) -> tuple[UnitResult, ...]:
    """Return the status of the units of a run, the worst first; none if the run decided none."""
    order, progress = run
    if not order.kind.is_about_unit or line.lot is None or order.lot_id != line.lot.id:
        return ()
    serials = (order.serial, *(channel_serial(order.serial, k) for k in range(MAX_CHANNELS)))
    statuses = (line.unit_statuses[serial] for serial in serials if serial in line.unit_statuses)
    # A run without a verdict leaves the unit as it was judged before.
    decided = [s for s in statuses if progress.verdict or (order.created and s.made_at and s.made_at >= order.created)]
    return tuple(sorted(decided, key=lambda status: -Verdict(status.verdict).severity))


def read_lot(registry: Registry, lot_id: str) -> LotAtLine:
    """Return the data of a lot that a line needs."""
    lot = registry.lots.get(lot_id)
    counts = registry.pages.verdict_counts(lot.id)
    return LotAtLine(lot, registry.lots.line_rules(lot), registry.networks.released(lot.id), counts)
