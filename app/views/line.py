"""What the operator's screen shows, computed without Streamlit: one state, one word, one instruction."""

from collections.abc import Callable
from dataclasses import dataclass

from softcal.app.line.facts import SHOWN_RUNS, LineFacts, LineRun, standing_of
from softcal.app.texts.reasons import plainly, said
from softcal.app.views.common import number, phase_said
from softcal.core.orders import Condition, OrderKind, Progress, RunState, Signal
from softcal.core.quality.known_loads import KnownLoad, asked_loads
from softcal.core.words.reason import Reason, plain, root_of

Words = Callable[..., str]

MOST_SENTENCES = 3
VERDICTS = {
    "pass": "pass",
    "conditional": "conditional",
    "fail": "fail",
    "retest": "retest",
    "retest_used_up": "retest",
    "golden_pass": "pass",
    "golden_fail": "fail",
}
"""State → verdict whose word it shows: the desk's word in capitals, so that both say the same of a unit."""

TONES = {
    "no_station": "stopped",
    "silent": "stopped",
    "away": "stopped",
    "stopped": "stopped",
    "broken": "stopped",
    "closed": "closed",
    "no_lot": "ready",
    "ready": "ready",
    "hand": "ready",
    "armed": "ready",
    "armed_golden": "golden",
    "ask": "repeat",
    "ask_new": "repeat",
    "used_up": "check",
    "load": "load",
    "reading": "running",
    "running": "running",
    "pass": "pass",
    "conditional": "check",
    "fail": "fail",
    "retest": "repeat",
    "retest_used_up": "check",
    "golden_pass": "pass",
    "golden_fail": "fail",
    "recorded": "ready",
}
"""State → look: colour and mark. FAIL (the unit is bad) never looks like STOPPED (the station is)."""

ACTIONS = {
    "armed": ("START", "CANCEL"),
    "armed_golden": ("START", "CANCEL"),
    "ask": ("OK", "CANCEL"),
    "ask_new": ("OK", "CANCEL"),
    "used_up": ("CANCEL",),
    "closed": ("CANCEL",),
    "load": ("START", "CANCEL"),
    "reading": ("STOP",),
    "running": ("STOP",),
    "stopped": ("OK",),
    "broken": ("OK",),
}
KEYS = {"START": "F2", "OK": "F4", "CANCEL": "F6", "STOP": "F8"}
"""Command → function key; a command is also a bar code, `CMD:START`. START alone moves anything, in every state."""

COMMAND_OF_KEY = {key: command for command, key in KEYS.items()}
"""Function key → command, in every state the same, so that no key is lost while a screen is drawn."""

BUSY = ("running", "reading")
"""States in which the station is at work."""

BEFORE_RUN = ("armed", "armed_golden", "ask", "ask_new", "used_up", "closed")
"""States that are about the unit that was scanned, not about the one pressed last."""

NO_CONTACT = "rig.no_contact"
"""How the message of a run begins that found no unit in the fixture."""


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
        state: key of `TONES`.
        word: READY (a unit can be pressed), RUNNING, PASS, FAIL, STOPPED, ... in the language of the screen.
        serial: the unit that is meant, "" without.
        instruction: the one thing to do now.
        details: plain sentences: why it is so, what the station says, its code.
        why: the same reasons with their numbers; shown when somebody asks.
        conditions: what the gate looked at; shown before a run.
        cells: (label, value) that are always visible.
        chips: the last units, newest first.
        actions: commands that make sense now.
        phase, fraction, remaining: of a run.
        signal: live signal of a run.
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
        """The look of the state."""
        return TONES[self.state]

    @property
    def spoken(self) -> str:
        """What a screen reader says when the state changes."""
        return ". ".join(part for part in (self.word, self.serial, self.instruction) if part)

    @property
    def seen(self) -> int:
        """What a key says that was pressed at this card: the version of what it offered to start, -1 where nothing."""
        return self.version if "START" in self.actions else -1

    @property
    def is_busy(self) -> bool:
        """Whether a run is in progress, so that the screen looks often."""
        return self.state in BUSY


def line_view(facts: LineFacts, operator: str, words: Words) -> LineView:
    """Return what the screen shows.

    Args:
        facts: where the line stands.
        operator: name of who has signed in at this screen; "" leaves it to the badge.
        words: texts of the language.
    """
    state, run = _state(facts)
    order = run[0] if run else None
    serial = facts.serial if state in BEFORE_RUN else order.serial if order else ""
    progress = run[1] if run and state in BUSY else None
    return LineView(
        state=state,
        word=state_word(state, words),
        serial=serial,
        instruction=_instruction(facts, state, serial, run, words),
        details=(*_weight(state, run, words), *_details(facts, state, run, words), *_news(facts, state, words)),
        why=_why(facts, state, run, words),
        conditions=_conditions(facts, words) if state in ("armed", "closed", "ready", "hand") else (),
        cells=_cells(facts, operator, words),
        chips=_chips(facts, words),
        actions=_actions(facts, state),
        phase=phase_said(progress.phase, words) if progress else "",
        fraction=progress.fraction if progress else 0.0,
        remaining=_remaining(progress.remaining_s, words) if progress else "",
        signal=progress.signal if progress else Signal(),
        version=facts.place.version,
    )


def state_word(state: str, words: Words) -> str:
    """Return the word of a state; a verdict's is the word that every other page has for it."""
    return words(f"verdict.{VERDICTS[state]}").upper() if state in VERDICTS else words(f"line.{state}")


def note_said(facts: LineFacts, words: Words) -> tuple[str, bool] | None:
    """Return the sentence about the last scan and whether it was a refusal; None where there is none."""
    note = facts.note
    return None if note is None else (words(f"note.{note.key}", **note.values), note.is_refusal)


def away_view(kept: int, operator: str, words: Words) -> LineView:
    """Return what the screen shows while the registry does not answer.

    Args:
        kept: runs that the station has on its disk and the registry does not have yet.
    """
    details = (words("line.kept", count=kept),) if kept else ()
    cells = ((words("line.cell.operator"), operator or "–"),)
    return LineView("away", words("line.away"), "", words("line.away.do"), details, cells=cells)


def _state(facts: LineFacts) -> tuple[str, LineRun | None]:
    """Return the state and the run it is about."""
    if facts.heartbeat is None:
        return "no_station", None
    if not facts.is_answering:
        return "silent", facts.active
    if facts.active is not None:
        return "reading" if facts.active[0].kind is OrderKind.LOAD else "running", facts.active
    if facts.is_stopped:
        run = facts.newest
        return "stopped", run if run is not None and _is_why_stopped(facts, run) else None
    if facts.serial:
        return _before_run(facts), None
    if facts.is_in_doubt or facts.newest is None:
        return _idle(facts), None
    return _after_run(facts, facts.newest)


def _before_run(facts: LineFacts) -> str:
    if facts.open_question:
        return facts.open_question
    if not facts.may_press:
        return "closed"
    return "armed_golden" if facts.is_golden else "armed"


def _idle(facts: LineFacts) -> str:
    """Return the state where nobody knows which unit is in the hand; before the first run there is none yet."""
    if not facts.may_press:
        return "closed"
    if facts.lot is None:
        return "no_lot"
    return "hand" if facts.is_in_doubt or facts.newest is not None else "ready"


def _after_run(facts: LineFacts, run: LineRun) -> tuple[str, LineRun | None]:
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


def verdict_of(facts: LineFacts, run: LineRun) -> str:
    """Return the verdict of a run's unit as every page says it now, of several units the worst; "" without one.

    The run keeps what was decided when it was pressed; an audit, a new limit or a batch may have decided since.
    """
    now = standing_of(facts, run)
    return now[0].verdict if now else run[1].verdict


def _actions(facts: LineFacts, state: str) -> tuple[str, ...]:
    if state == "closed" and not facts.serial:
        return ()
    return ACTIONS.get(state, ())


def _instruction(facts: LineFacts, state: str, serial: str, run: LineRun | None, words: Words) -> str:
    values: dict[str, object] = {"serial": serial, "lot": facts.lot.id if facts.lot else "", "station": facts.station}
    if state == "load" and facts.load is not None and run is not None:
        return words(f"line.load.do{'' if facts.load.value else '.nothing'}", **values, **_load_values(facts, run))
    if state == "ask":
        last = facts.standings.get(serial) or facts.results[-1]
        values |= {"verdict": words(f"verdict.{last.verdict}"), "at": last.made_at}
        return words("line.ask.do", **values, left=facts.retests_left)
    if run is not None and state in ("broken", "stopped"):
        return words(_code_key(run[1], words))
    return words(f"line.{state}.do", **values)


def _details(facts: LineFacts, state: str, run: LineRun | None, words: Words) -> tuple[str, ...]:
    beat = facts.heartbeat
    if state == "closed" and beat is not None:
        return () if beat.gate else tuple(said(why, words) for why in beat.reasons)
    if state == "stopped" and beat is not None:
        code = (words("line.code", code=run[1].code),) if run else ()
        return (*(said(why, words) for why in beat.reasons), *code)
    if state == "armed" and facts.lot is not None:
        bare = (words("line.no_network"),) if facts.lot.network is None else ()
        return (*bare, words("line.no_weights")) if facts.lot.rules.loads else bare
    if state == "pass" and run is not None:
        return (*_result(facts, run, words), *_changed(facts, run, words))
    code = (words("line.code", code=run[1].code),) if run is not None and run[1].code and state not in BUSY else ()
    return (*_plain(_reasons(facts, state, run), words), *_changed(facts, run, words), *code)


def _weight(state: str, run: LineRun | None, words: Words) -> tuple[str, ...]:
    """Return the sentence that a weight lies on the unit still: its reading was the last thing that was done."""
    is_on = run is not None and run[0].kind is OrderKind.LOAD and state not in (*BUSY, "load")
    return (words("line.weight_off"),) if is_on else ()


def _reasons(facts: LineFacts, state: str, run: LineRun | None) -> tuple[Reason, ...]:
    """Return why the unit of a card stands as it does."""
    if state in ("ask", "used_up"):
        return (facts.standings.get(facts.serial) or facts.results[-1]).reasons
    if run is None or state in BUSY:
        return ()
    if state == "load" and run[0].kind is not OrderKind.LOAD:
        return ()
    now = standing_of(facts, run)
    return now[0].reasons if now else run[1].message


def _load_values(facts: LineFacts, run: LineRun) -> dict[str, object]:
    """Return what the instruction names: which load of how many, and how well it must be known."""
    load, loads = facts.load or KnownLoad(0.0), asked_loads(run[1].message)
    unit = str(run[1].message[0].values.get("unit", ""))
    known = f" ± {load.expanded:g}" if load.expanded else ""
    return {"step": facts.load_step, "of": len(loads), "load": f"{load.value:.5g}{known} {unit}"}


def _plain(reasons: tuple[Reason, ...], words: Words) -> tuple[str, ...]:
    return tuple(dict.fromkeys(plainly(reason, words) for reason in reasons))[:MOST_SENTENCES]


def _why(facts: LineFacts, state: str, run: LineRun | None, words: Words) -> tuple[str, ...]:
    """Return the reasons with their numbers, where the card says them without."""
    reasons = _reasons(facts, state, run) if state not in ("closed", "stopped", "broken") else ()
    numbered = tuple(said(reason, words) for reason in reasons)
    return numbered if state == "pass" or numbered != _plain(reasons, words) else ()


def _changed(facts: LineFacts, run: LineRun | None, words: Words) -> tuple[str, ...]:
    """Return the sentence that somebody or something decided anew since the unit was pressed."""
    now = standing_of(facts, run) if run else ()
    if run is None or not now or run[1].verdict in ("", now[0].verdict):
        return ()
    return (words("line.changed", verdict=words(f"verdict.{run[1].verdict}"), at=now[0].made_at),)


def _result(facts: LineFacts, run: LineRun, words: Words) -> tuple[str, ...]:
    """Return what a good unit got: its own error beside the lot's limit, and nothing of how either was found."""
    now = standing_of(facts, run)
    made = now[0].made if now else None
    kind, rmse = "", facts.results[-1].predicted_rmse if facts.results else None
    if made is not None:
        kind, rmse = (".measured", made.after_rmse) if made.is_audited else ("", made.predicted_rmse)
    if facts.lot is None or rmse is None:
        return ()
    lot = facts.lot.lot
    said_rmse = number(rmse, lot.reference_unit)
    if lot.limit_rmse is None:
        return (words(f"line.result{kind}", rmse=said_rmse),)
    return (words(f"line.result{kind}.limit", rmse=said_rmse, limit=number(lot.limit_rmse, lot.reference_unit)),)


def _news(facts: LineFacts, state: str, words: Words) -> tuple[str, ...]:
    """Return the sentence that another network is in use since the last unit was pressed."""
    network = facts.lot.network if facts.lot else None
    pressed = [order.created for order, _ in facts.runs if order.kind is OrderKind.UNIT and order.created is not None]
    if network is None or not network.reason or state in (*BUSY, "load", "stopped", "silent", "no_station"):
        return ()
    if pressed and pressed[0] > network.since:
        return ()
    values = {"network": network.network.id[:8], "at": network.since, "actor": network.actor, "reason": network.reason}
    return (words("line.network_changed", **values),)


def _conditions(facts: LineFacts, words: Words) -> tuple[Condition, ...]:
    gate = facts.heartbeat.gate if facts.heartbeat else ()
    return tuple(Condition(plain(said(c.name, words)), c.is_good, plain(said(c.says, words))) for c in gate)


def _is_why_stopped(facts: LineFacts, run: LineRun) -> bool:
    """Whether the station stands still because of this run, and not because of a device between runs."""
    return facts.heartbeat is not None and bool(run[1].code) and set(run[1].message) <= set(facts.heartbeat.reasons)


def _cells(facts: LineFacts, operator: str, words: Words) -> tuple[tuple[str, str], ...]:
    station, lot = facts.station or "–", facts.lot
    if facts.heartbeat is not None:
        station = f"{station} · {words(f'station.state.{facts.station_state}')}"
    counts = dict(lot.counts) if lot else {}
    judged = sum(counts.values()) - counts.get("none", 0)
    target = (lot.rules.target if lot else None) or (sum(counts.values()) if counts.get("none") else None)
    share = f"{counts.get('pass', 0) / judged:.0%}" if judged else "–"
    return (
        (words("line.cell.station"), station),
        (words("line.cell.lot"), lot.id if lot else "–"),
        (words("line.cell.product"), (lot.lot.sensor_model if lot else "") or "–"),
        (words("line.cell.operator"), operator or _badge_said(facts, words)),
        (words("line.cell.units"), f"{judged} / {target}" if target else str(judged)),
        (words("line.cell.yield"), share),
    )


def _badge_said(facts: LineFacts, words: Words) -> str:
    if facts.operator:
        return words("line.badge", name=facts.operator)
    return words("line.badge.over", name=facts.place.operator) if facts.place.operator else "–"


def _chips(facts: LineFacts, words: Words) -> tuple[Chip, ...]:
    lot_id = facts.lot.id if facts.lot else ""
    over = [r for r in facts.runs if r[0].kind is OrderKind.UNIT and r[0].lot_id == lot_id and not r[1].state.is_active]
    return tuple(_chip(facts, run, words) for run in over[:SHOWN_RUNS])


def _chip(facts: LineFacts, run: LineRun, words: Words) -> Chip:
    order, progress = run
    state = "broken" if progress.state is not RunState.DONE else verdict_of(facts, run) or "recorded"
    return Chip(order.serial, TONES[state], state_word(state, words))


def _code_key(progress: Progress, words: Words) -> str:
    is_free = any(root_of(why).code == NO_CONTACT for why in progress.message)
    key = "code.no_contact" if is_free else f"code.{progress.code}"
    try:
        words(key)
    except KeyError:
        return "code.other"
    return key


def _remaining(remaining_s: float, words: Words) -> str:
    if remaining_s < 1:
        return ""
    if remaining_s < 90:
        return words("line.remaining_s", seconds=round(remaining_s))
    return words("line.remaining_min", minutes=round(remaining_s / 60))
