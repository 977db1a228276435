"""What the operator's screen shows: one state, one word, one instruction. No Streamlit."""

from dataclasses import dataclass, replace

from softcal.app.line.facts import SHOWN_RUNS, LineFacts, LineRun
from softcal.app.texts.reasons import Words, said
from softcal.app.views.common import percent, phase_said
from softcal.app.views.line_states import STATES, Card, verdict_of
from softcal.core.messages.reason import plain
from softcal.core.orders import Condition, OrderKind, RunState, Signal

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
    name = next(name for name, state in STATES.items() if state.holds(facts))
    state, card = STATES[name], Card(facts, name, _run_of(facts, name), words)
    gate = facts.heartbeat.gate if facts.heartbeat and state.shows_gate else ()
    lot_id = facts.lot.id if facts.lot else ""
    over = [r for r in facts.runs if r[0].kind is OrderKind.UNIT and r[0].lot_id == lot_id and not r[1].state.is_active]
    looks = [(order.serial, _look_of(facts, (order, progress))) for order, progress in over[:SHOWN_RUNS]]
    view = LineView(
        state=name,
        word=state_word(name, words),
        serial=card.serial,
        instruction=state.instruction(card),
        details=(*card.weight, *state.details(card), *card.news),
        why=card.why,
        conditions=tuple(Condition(plain(said(c.name, words)), c.is_good, plain(said(c.says, words))) for c in gate),
        cells=_cells(facts, operator, words),
        chips=tuple(Chip(serial, STATES[look].tone, state_word(look, words)) for serial, look in looks),
        # Without a unit there is nothing to take back.
        actions=state.actions if facts.serial or not state.is_before_run else (),
        version=facts.place.version,
    )
    if card.run is None or not state.is_busy:
        return view
    progress, remaining = card.run[1], ""
    if progress.remaining_s >= 90:
        remaining = words("line.remaining_min", minutes=round(progress.remaining_s / 60))
    elif progress.remaining_s >= 1:
        remaining = words("line.remaining_s", seconds=round(progress.remaining_s))
    phase = phase_said(progress.phase, words)
    return replace(view, phase=phase, remaining=remaining, fraction=progress.fraction, signal=progress.signal)


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


def _run_of(facts: LineFacts, state: str) -> LineRun | None:
    """Return the run that a state is about."""
    if state != "stopped":
        return facts.active or (facts.result_run if state != "silent" else None)
    # It may stand still because of a device between runs.
    run, beat = facts.newest, facts.heartbeat
    return run if run and beat and run[1].code and set(run[1].message) <= set(beat.reasons) else None


def _look_of(facts: LineFacts, run: LineRun) -> str:
    return "broken" if run[1].state is not RunState.DONE else verdict_of(facts, run) or "recorded"


def _cells(facts: LineFacts, operator: str, words: Words) -> tuple[tuple[str, str], ...]:
    station, lot = facts.station or "–", facts.lot
    if facts.heartbeat is not None:
        station = f"{station} · {words(f'station.state.{facts.station_state}')}"
    counts = dict(lot.counts) if lot else {}
    judged = sum(counts.values()) - counts.get("none", 0)
    decided = judged - counts.get("conditional", 0)
    target = (lot.rules.target if lot else None) or (sum(counts.values()) if counts.get("none") else None)
    if not operator and facts.place.operator:
        operator = words("line.badge" if facts.operator else "line.badge.over", name=facts.place.operator)
    return (
        (words("station.station"), station),
        (words("choose.lot"), lot.id if lot else "–"),
        (words("line.cell.product"), (lot.lot.sensor_model if lot else "") or "–"),
        (words("role.operator"), operator or "–"),
        (words("line.cell.units"), f"{judged} / {target}" if target else str(judged)),
        (words("line.cell.yield"), percent(counts.get("pass", 0) / decided if decided else None)),
    )
