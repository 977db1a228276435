"""What the operator's screen shows: one state, one word, one instruction. No Streamlit."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from softcal.app.line.facts import SHOWN_RUNS, LineFacts, LineRun, standing_of
from softcal.app.texts.reasons import Words, plainly, said
from softcal.app.views.common import number, phase_said
from softcal.core.orders import Condition, OrderKind, RunState, Signal
from softcal.core.quality.known_loads import KnownLoad, asked_loads
from softcal.core.words.reason import Reason, plain, root_of
from softcal.db.entries import RunEntry, UnitStanding

MOST_SENTENCES = 3
KEYS = {"START": "F2", "OK": "F4", "CANCEL": "F6", "STOP": "F8"}
"""Command → function key, also a bar code, `CMD:START`. START alone moves anything."""

COMMAND_OF_KEY = {key: command for command, key in KEYS.items()}
"""Function key → command, the same in every state: none is lost while a screen is drawn."""


@dataclass(frozen=True)
class Chip:
    """One of the last units: its serial, the look and the word of its result."""

    serial: str
    tone: str
    word: str


@dataclass(frozen=True)
class LineView:
    """One moment of the operator's screen.

    Args:
        state: key of `STATES`, which has what does not depend on the moment.
        serial: the unit that is meant, "" without.
        details: plain sentences: why it is so, what the station says, its code.
        why: the same reasons with their numbers; shown when somebody asks.
        cells: (label, value) that are always visible.
        version: of what stands at the line, so that a key names what its person has seen.
    """

    state: str
    word: str
    serial: str
    instruction: str
    details: tuple[str, ...] = ()
    why: tuple[str, ...] = ()
    conditions: tuple[Condition, ...] = ()
    cells: tuple[tuple[str, str], ...] = ()
    chips: tuple[Chip, ...] = ()
    actions: tuple[str, ...] = ()
    phase: str = ""
    fraction: float = 0.0
    remaining: str = ""
    signal: Signal = Signal()
    version: int = 0

    @property
    def tone(self) -> str:
        return STATES[self.state].tone

    @property
    def spoken(self) -> str:
        """What a screen reader says when the state changes."""
        return ". ".join(part for part in (self.word, self.serial, self.instruction) if part)

    @property
    def seen(self) -> int:
        """What a key of this card says: the version of what it offered to start, -1 for nothing."""
        return self.version if "START" in self.actions else -1

    @property
    def is_busy(self) -> bool:
        """Whether a run is in progress, so that the screen looks often."""
        return STATES[self.state].is_busy


def line_view(facts: LineFacts, operator: str, words: Words) -> LineView:
    """Return what the screen shows to the person who signed in at it, "" to the badge's."""
    name, run = _state(facts)
    card, state = _Card(facts, name, run, words), STATES[name]
    progress = run[1] if run and state.is_busy else None
    gate = facts.heartbeat.gate if facts.heartbeat and state.shows_gate else ()
    lot_id = facts.lot.id if facts.lot else ""
    over = [r for r in facts.runs if r[0].kind is OrderKind.UNIT and r[0].lot_id == lot_id and not r[1].state.is_active]
    chips = []
    for pressed in over[:SHOWN_RUNS]:
        look = "broken" if pressed[1].state is not RunState.DONE else verdict_of(facts, pressed) or "recorded"
        chips.append(Chip(pressed[0].serial, STATES[look].tone, state_word(look, words)))
    remaining, remaining_s = "", progress.remaining_s if progress else 0.0
    if remaining_s >= 90:
        remaining = words("line.remaining_min", minutes=round(remaining_s / 60))
    elif remaining_s >= 1:
        remaining = words("line.remaining_s", seconds=round(remaining_s))
    return LineView(
        state=name,
        word=state_word(name, words),
        serial=card.serial,
        instruction=state.instruction(card),
        details=(*card.weight, *state.details(card), *card.news),
        why=card.why,
        conditions=tuple(Condition(plain(said(c.name, words)), c.is_good, plain(said(c.says, words))) for c in gate),
        cells=_cells(facts, operator, words),
        chips=tuple(chips),
        # Without a unit there is nothing to take back.
        actions=state.actions if facts.serial or not state.is_before_run else (),
        phase=phase_said(progress.phase, words) if progress else "",
        fraction=progress.fraction if progress else 0.0,
        remaining=remaining,
        signal=progress.signal if progress else Signal(),
        version=facts.place.version,
    )


def state_word(state: str, words: Words) -> str:
    """Return the word of a state; a verdict's is the word that every other page has for it."""
    verdict = STATES[state].verdict
    return words(f"verdict.{verdict}").upper() if verdict else words(f"line.{state}")


def action_said(command: str, state: str, words: Words) -> str:
    """Return what a key does in a state; in most it does the same."""
    try:
        return words(f"line.action.{command}.{state}")
    except KeyError:
        return words(f"line.action.{command}")


def note_said(facts: LineFacts, words: Words) -> tuple[str, bool] | None:
    """Return the sentence about the last scan, and whether it was a refusal."""
    note = facts.note
    return None if note is None else (words(f"note.{note.key}", **note.values), note.is_refusal)


def away_view(kept: int, operator: str, words: Words) -> LineView:
    """Return what the screen shows without a registry, `kept` runs being on the station's disk."""
    details = (words("line.kept", count=kept),) if kept else ()
    cells = ((words("role.operator"), operator or "–"),)
    return LineView("away", words("line.away"), "", words("line.away.do"), details, cells=cells)


def _state(facts: LineFacts) -> tuple[str, LineRun | None]:
    """Return the state and the run it is about."""
    if facts.heartbeat is None:
        return "no_station", None
    if not facts.is_answering:
        return "silent", facts.active
    if facts.active is not None:
        return "reading" if facts.active[0].kind is OrderKind.LOAD else "running", facts.active
    run = facts.newest
    if facts.is_stopped:
        # It may stand still because of a device between runs.
        is_why = run is not None and run[1].code and set(run[1].message) <= set(facts.heartbeat.reasons)
        return "stopped", run if is_why else None
    if facts.serial:
        armed = "armed_golden" if facts.is_golden else "armed"
        return facts.open_question or (armed if facts.may_press else "closed"), None
    if facts.is_in_doubt or run is None:
        return _idle(facts), None
    order, progress = run
    if progress.state is not RunState.DONE:
        return "broken", run
    if facts.load is not None:
        return "load", run
    if not order.kind.presses and order.kind is not OrderKind.LOAD:
        return _idle(facts), None
    if order.kind is OrderKind.GOLDEN:
        return f"golden_{progress.verdict or 'fail'}", run
    verdict = verdict_of(facts, run)
    if verdict == "retest" and not facts.retests_left:
        return "retest_used_up", run
    return verdict or "recorded", run


def _idle(facts: LineFacts) -> str:
    """Return the state where nobody knows which unit is in the hand, or none was pressed yet."""
    if not facts.may_press:
        return "closed"
    if facts.lot is None:
        return "no_lot"
    return "hand" if facts.is_in_doubt or facts.newest is not None else "ready"


def verdict_of(facts: LineFacts, run: LineRun) -> str:
    """Return the verdict of a run's unit as every page says it now, of several units the worst; "" without one.

    The run keeps what was decided when it was pressed; an audit, a new limit or a batch may have decided since.
    """
    now = standing_of(facts, run)
    return now[0].verdict if now else run[1].verdict


@dataclass(frozen=True)
class _Card:
    """What the sentences of a state are made of: the line, the state and its run."""

    facts: LineFacts
    name: str
    run: LineRun | None
    words: Words

    @property
    def state(self) -> "LineState":
        return STATES[self.name]

    @property
    def serial(self) -> str:
        if self.state.is_before_run:
            return self.facts.serial
        return self.run[0].serial if self.run else ""

    @property
    def standing(self) -> UnitStanding | None:
        """Where the unit of the run stands now; of several the worst."""
        return next(iter(standing_of(self.facts, self.run)), None) if self.run else None

    @property
    def earlier(self) -> UnitStanding | RunEntry:
        return self.facts.standings.get(self.facts.serial) or self.facts.results[-1]

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """Why the unit of the card stands as it does."""
        if self.state.has_earlier:
            return self.earlier.reasons
        if self.run is None or self.state.is_busy or (self.state.asks_load and not self.was_load):
            return ()
        return self.standing.reasons if self.standing else self.run[1].message

    @property
    def was_load(self) -> bool:
        """Whether a known load was read last: its weight lies on the unit still."""
        return self.run is not None and self.run[0].kind is OrderKind.LOAD

    @property
    def in_short(self) -> tuple[str, ...]:
        """The same without numbers."""
        return tuple(dict.fromkeys(plainly(reason, self.words) for reason in self.reasons))[:MOST_SENTENCES]

    @property
    def why(self) -> tuple[str, ...]:
        """The reasons with their numbers, where the card says them without."""
        numbered = tuple(said(reason, self.words) for reason in self.reasons) if self.state.has_why else ()
        is_shown_already = self.state.details is _say_why and numbered == self.in_short
        return () if is_shown_already else numbered

    @property
    def weight(self) -> tuple[str, ...]:
        is_over = self.was_load and not self.state.is_busy and not self.state.asks_load
        return (self.words("line.weight_off"),) if is_over else ()

    @property
    def changed(self) -> tuple[str, ...]:
        """The sentence that somebody or something decided anew since the unit was pressed."""
        now = self.standing
        if self.run is None or now is None or self.run[1].verdict in ("", now.verdict):
            return ()
        return (self.words("line.changed", verdict=self.words(f"verdict.{self.run[1].verdict}"), at=now.made_at),)

    @property
    def code(self) -> tuple[str, ...]:
        code = self.run[1].code if self.run and not self.state.is_busy else ""
        return (self.words("line.code", code=code),) if code else ()

    @property
    def news(self) -> tuple[str, ...]:
        """The sentence that another network is in use since the last unit was pressed."""
        facts, network = self.facts, self.facts.lot.network if self.facts.lot else None
        pressed = [order.created for order, _ in facts.runs if order.kind is OrderKind.UNIT and order.created]
        is_known = network is not None and pressed and pressed[0] > network.since
        if network is None or not network.reason or is_known or not self.state.has_news:
            return ()
        values = {"at": network.since, "actor": network.actor, "reason": network.reason}
        return (self.words("line.network_changed", network=network.network.id[:8], **values),)

    def do(self, key: str = "", **values: object) -> str:
        """Return the instruction of the state; a key names another one."""
        lot = self.facts.lot.id if self.facts.lot else ""
        known = {"serial": self.serial, "lot": lot, "station": self.facts.station}
        return self.words(key or f"line.{self.name}.do", **known, **values)


def _do_again(card: _Card) -> str:
    last = card.earlier
    return card.do(verdict=card.words(f"verdict.{last.verdict}"), at=last.made_at, left=card.facts.retests_left)


def _do_put_on(card: _Card) -> str:
    """Name the load: which of how many, and how well it must be known."""
    load, message = card.facts.load or KnownLoad(0.0), card.run[1].message if card.run else ()
    known = f" ± {load.expanded:g}" if load.expanded else ""
    shown = f"{load.value:.5g}{known} {message[0].values.get('unit', '')}"
    key = "line.load.do" if load.value else "line.load.do.nothing"
    return card.do(key, step=card.facts.load_step, of=len(asked_loads(message)), load=shown)


def _do_mend(card: _Card) -> str:
    """Say what to do about the code that a run ended with."""
    if card.run is None:
        return card.do()
    is_free = any(root_of(why).code == "rig.no_contact" for why in card.run[1].message)
    try:
        return card.words("code.no_contact" if is_free else f"code.{card.run[1].code}")
    except KeyError:
        return card.words("code.other")


def _say_why(card: _Card) -> tuple[str, ...]:
    return (*card.in_short, *card.changed, *card.code)


def _say_what_stands(card: _Card) -> tuple[str, ...]:
    """Say why the station stands still, where its gate does not say it below."""
    beat = card.facts.heartbeat
    reasons = () if beat is None or (card.state.shows_gate and beat.gate) else beat.reasons
    return (*(said(why, card.words) for why in reasons), *card.code)


def _say_what_will_lack(card: _Card) -> tuple[str, ...]:
    lot = card.facts.lot
    lacks = {"line.no_network": lot and lot.network is None, "line.no_weights": lot and lot.rules.loads}
    return tuple(card.words(key) for key, is_so in lacks.items() if is_so)


def _say_error(card: _Card) -> tuple[str, ...]:
    """Say what a good unit got: its error beside the lot's limit."""
    facts, summary = card.facts, card.standing.summary if card.standing else None
    kind, rmse = "", facts.results[-1].predicted_rmse if facts.results else None
    if summary is not None:
        state = summary.state
        measured = state.scores if state.decision.is_audited else None
        kind, rmse = ("", state.predicted_rmse) if measured is None else (".measured", measured.after.rmse)
    if facts.lot is None or rmse is None:
        return card.changed
    unit, limit = facts.lot.lot.reference_unit, facts.lot.lot.limit_rmse
    key = f"line.result{kind}" if limit is None else f"line.result{kind}.limit"
    return (card.words(key, rmse=number(rmse, unit, limit), limit=number(limit, unit, limit)), *card.changed)


@dataclass(frozen=True)
class LineState:
    """How a state of the line looks, what it says and what can be done in it.

    Args:
        tone: colour and mark. FAIL (the unit is bad) never looks like STOPPED (the station is).
        actions: commands that make sense.
        verdict: whose word it shows, in capitals: the desk's word of the same unit; "" has its own.
        is_before_run: it is about the unit that was scanned, not about the one pressed last.
        has_earlier: that unit was pressed before, and is as it was judged then.
        asks_load: a known load is to be put on.
        shows_gate: what the gate looked at stands below.
        has_news: another network is told of.
        has_why: its reasons open with their numbers.
        instruction: the one thing to do now.
    """

    tone: str
    actions: tuple[str, ...] = ()
    verdict: str = ""
    is_before_run: bool = False
    has_earlier: bool = False
    asks_load: bool = False
    is_busy: bool = False
    shows_gate: bool = False
    has_news: bool = True
    has_why: bool = True
    instruction: Callable[[_Card], str] = _Card.do
    details: Callable[[_Card], tuple[str, ...]] = _say_why


_START, _AGREE = ("START", "CANCEL"), ("OK", "CANCEL")
_SCANNED = partial(LineState, is_before_run=True)
_AT_WORK = partial(LineState, "running", ("STOP",), is_busy=True, has_news=False)
STATES = {
    "no_station": LineState("stopped", has_news=False),
    "silent": LineState("stopped", has_news=False),
    "away": LineState("stopped"),
    "stopped": LineState(
        "stopped", ("OK",), has_news=False, has_why=False, instruction=_do_mend, details=_say_what_stands
    ),
    "broken": LineState("stopped", ("OK",), has_why=False, instruction=_do_mend),
    "closed": _SCANNED("closed", ("CANCEL",), shows_gate=True, has_why=False, details=_say_what_stands),
    "no_lot": LineState("ready"),
    "ready": LineState("ready", shows_gate=True),
    "hand": LineState("ready", shows_gate=True),
    "armed": _SCANNED("ready", _START, shows_gate=True, details=_say_what_will_lack),
    "armed_golden": _SCANNED("golden", _START),
    "ask": _SCANNED("repeat", _AGREE, has_earlier=True, instruction=_do_again),
    "ask_new": _SCANNED("repeat", _AGREE),
    "used_up": _SCANNED("check", ("CANCEL",), has_earlier=True),
    "load": LineState("load", _START, asks_load=True, has_news=False, instruction=_do_put_on),
    "reading": _AT_WORK(),
    "running": _AT_WORK(),
    "pass": LineState("pass", verdict="pass", details=_say_error),
    "conditional": LineState("check", verdict="conditional"),
    "fail": LineState("fail", verdict="fail"),
    "retest": LineState("repeat", verdict="retest"),
    "retest_used_up": LineState("check", verdict="retest"),
    "golden_pass": LineState("pass", verdict="pass"),
    "golden_fail": LineState("fail", verdict="fail"),
    "recorded": LineState("ready"),
}
"""The one table of what an operator can see."""


def _cells(facts: LineFacts, operator: str, words: Words) -> tuple[tuple[str, str], ...]:
    station, lot = facts.station or "–", facts.lot
    if facts.heartbeat is not None:
        station = f"{station} · {words(f'station.state.{facts.station_state}')}"
    counts = dict(lot.counts) if lot else {}
    judged = sum(counts.values()) - counts.get("none", 0)
    target = (lot.rules.target if lot else None) or (sum(counts.values()) if counts.get("none") else None)
    share = f"{counts.get('pass', 0) / judged:.0%}" if judged else "–"
    if not operator and facts.place.operator:
        operator = words("line.badge" if facts.operator else "line.badge.over", name=facts.place.operator)
    return (
        (words("station.station"), station),
        (words("choose.lot"), lot.id if lot else "–"),
        (words("line.cell.product"), (lot.lot.sensor_model if lot else "") or "–"),
        (words("role.operator"), operator or "–"),
        (words("line.cell.units"), f"{judged} / {target}" if target else str(judged)),
        (words("line.cell.yield"), share),
    )
