"""What the operator's screen shows: one state, one word, one instruction. No Streamlit."""

from dataclasses import dataclass, replace

from softcal.app.line.status import MAX_SHOWN_RUNS, LineRun, LineStatus
from softcal.app.texts.reasons import Translator, render_reason
from softcal.app.views.common import percent, render_phase
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
        reason_details: the same reasons with their numbers; shown when somebody asks.
        cells: (label, value) that are always visible.
        version: of what stands at the line, so that a key names what its person has seen.
    """

    state: str
    word: str
    serial: str
    instruction: str
    details: tuple[str, ...] = ()
    reason_details: tuple[str, ...] = ()
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
    def announcement(self) -> str:
        """What a screen reader says when the state changes."""
        return ". ".join(part for part in (self.word, self.serial, self.instruction) if part)

    @property
    def start_version(self) -> int:
        """What a key of this card says: the version of what it offered to start, -1 for nothing."""
        return self.version if "START" in self.actions else -1

    @property
    def is_busy(self) -> bool:
        """Whether a run is in progress, so that the screen looks often."""
        return STATES[self.state].is_busy


def line_view(line: LineStatus, operator: str, translate: Translator) -> LineView:
    """Return what the screen shows to the person who signed in at it, "" to the badge's."""
    name = next(name for name, state in STATES.items() if state.holds(line))
    state, card = STATES[name], Card(line, name, _run_of(line, name), translate)
    gate = line.heartbeat.gate if line.heartbeat and state.shows_gate else ()
    lot_id = line.lot.id if line.lot else ""
    over = [r for r in line.runs if r[0].kind is OrderKind.UNIT and r[0].lot_id == lot_id and not r[1].state.is_active]
    results = [(order.serial, _result_state(line, (order, progress))) for order, progress in over[:MAX_SHOWN_RUNS]]
    view = LineView(
        state=name,
        word=state_word(name, translate),
        serial=card.serial,
        instruction=state.instruction(card),
        details=(*card.weight, *state.details(card), *card.news),
        reason_details=card.reason_details,
        conditions=tuple(
            Condition(plain(render_reason(c.name, translate)), c.is_good, plain(render_reason(c.says, translate)))
            for c in gate
        ),
        cells=_cells(line, operator, translate),
        chips=tuple(Chip(serial, STATES[look].tone, state_word(look, translate)) for serial, look in results),
        # Without a unit there is nothing to take back.
        actions=state.actions if line.serial or not state.is_before_run else (),
        version=line.session.version,
    )
    if card.run is None or not state.is_busy:
        return view
    progress, remaining = card.run[1], ""
    if progress.remaining_s >= 90:
        remaining = translate("line.remaining_min", minutes=round(progress.remaining_s / 60))
    elif progress.remaining_s >= 1:
        remaining = translate("line.remaining_s", seconds=round(progress.remaining_s))
    phase = render_phase(progress.phase, translate)
    return replace(view, phase=phase, remaining=remaining, fraction=progress.fraction, signal=progress.signal)


def state_word(state: str, translate: Translator) -> str:
    """Return the word of a state; a verdict's is the word that every other page has for it."""
    verdict = STATES[state].verdict
    return translate(f"verdict.{verdict}").upper() if verdict else translate(f"line.{state}")


def action_label(command: str, state: str, translate: Translator) -> str:
    """Return what a key does in a state; in most it does the same."""
    try:
        return translate(f"line.action.{command}.{state}")
    except KeyError:
        return translate(f"line.action.{command}")


def render_note(line: LineStatus, translate: Translator) -> tuple[str, bool] | None:
    """Return the sentence about the last scan, and whether it was a refusal."""
    note = line.note
    return None if note is None else (translate(f"note.{note.key}", **note.values), note.is_refusal)


def away_view(spooled_count: int, operator: str, translate: Translator) -> LineView:
    """Return what the screen shows without a registry, `spooled_count` runs being on the station's disk."""
    details = (translate("line.kept", count=spooled_count),) if spooled_count else ()
    cells = ((translate("role.operator"), operator or "–"),)
    return LineView("away", translate("line.away"), "", translate("line.away.do"), details, cells=cells)


def _run_of(line: LineStatus, state: str) -> LineRun | None:
    """Return the run that a state is about."""
    if state != "stopped":
        return line.active or (line.result_run if state != "silent" else None)
    # It may stand still because of a device between runs.
    run, heartbeat = line.newest, line.heartbeat
    return run if run and heartbeat and run[1].code and set(run[1].message) <= set(heartbeat.reasons) else None


def _result_state(line: LineStatus, run: LineRun) -> str:
    return "broken" if run[1].state is not RunState.DONE else verdict_of(line, run) or "recorded"


def _cells(line: LineStatus, operator: str, translate: Translator) -> tuple[tuple[str, str], ...]:
    station, lot = line.station or "–", line.lot
    if line.heartbeat is not None:
        station = f"{station} · {translate(f'station.state.{line.station_state}')}"
    counts = dict(lot.counts) if lot else {}
    pressed = sum(counts.values()) - counts.get("none", 0)
    decided = pressed - counts.get("conditional", 0)
    target = (lot.rules.target if lot else None) or (sum(counts.values()) if counts.get("none") else None)
    if not operator and line.session.operator:
        operator = translate("line.badge" if line.operator else "line.badge.over", name=line.session.operator)
    return (
        (translate("station.station"), station),
        (translate("choose.lot"), lot.id if lot else "–"),
        (translate("line.cell.product"), (lot.lot.sensor_model if lot else "") or "–"),
        (translate("role.operator"), operator or "–"),
        (translate("line.cell.units"), f"{pressed} / {target}" if target else str(pressed)),
        (translate("line.cell.yield"), percent(counts.get("pass", 0) / decided if decided else None)),
    )
