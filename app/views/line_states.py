"""The states of the operator's screen in one table: when each holds, its sentences, look and keys. No Streamlit."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

from softcal.app.line.status import LineRun, LineStatus, unit_statuses_of
from softcal.app.texts.reasons import Translator, render_plain_reason, render_reason
from softcal.app.views.common import limit_number, number
from softcal.core.messages.reason import Reason, root_of
from softcal.core.orders import OrderKind, RunState
from softcal.core.quality.known_loads import KnownLoad, requested_loads
from softcal.db.entries import RunEntry, UnitResult

MAX_SENTENCES = 3
CAUSES = ("no_contact", "host_paused")
"""Causes `rig.CAUSE` that say more than the code of the run: each has its own text `code.CAUSE`."""


def verdict_of(line: LineStatus, run: LineRun) -> str:
    """Return the verdict of a run's unit as every page says it now, of several units the worst; "" without one.

    The run keeps what was decided when it was pressed; an audit, a new limit or a batch may have decided since.
    """
    now = unit_statuses_of(line, run)
    return now[0].verdict if now else run[1].verdict


def _render_briefly(reason: Reason, translate: Translator) -> str:
    """Return a reason plainly, with the moment or the count where there is one that helps at the line."""
    inner = reason.values.get("observed")
    cause = inner if isinstance(inner, Reason) else reason
    location = cause.values.get("first")
    while isinstance(location, Reason) and "at" not in location.values:
        location = location.values.get("place")
    at = location.values["at"] if isinstance(location, Reason) else None
    try:
        return translate(f"line.reason.{cause.code}", **{**cause.values, "at": at})
    except KeyError:
        return render_plain_reason(reason, translate)


@dataclass(frozen=True)
class Card:
    """What the sentences of a state are made of: the line, the state and its run."""

    line: LineStatus
    name: str
    run: LineRun | None
    translate: Translator

    @property
    def state(self) -> "LineState":
        return STATES[self.name]

    @property
    def serial(self) -> str:
        return self.line.serial if self.state.is_before_run else self.run[0].serial if self.run else ""

    @property
    def now(self) -> UnitResult | None:
        """Where the unit of the run stands now; of several the worst."""
        return next(iter(unit_statuses_of(self.line, self.run)), None) if self.run else None

    @property
    def earlier(self) -> UnitResult | RunEntry:
        return self.line.unit_statuses.get(self.line.serial) or self.line.results[-1]

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """Why the unit of the card stands as it does."""
        if self.state.has_earlier:
            return self.earlier.reasons
        if self.run is None or self.state.is_busy or (self.name == "load" and not self.was_load):
            return ()
        return self.now.reasons if self.now else self.run[1].message

    @property
    def was_load(self) -> bool:
        """Whether a known load was read last: its weight lies on the unit still."""
        return self.run is not None and self.run[0].kind is OrderKind.LOAD

    @property
    def brief_reasons(self) -> tuple[str, ...]:
        """The same in few words."""
        return tuple(dict.fromkeys(_render_briefly(reason, self.translate) for reason in self.reasons))[:MAX_SENTENCES]

    @property
    def reason_details(self) -> tuple[str, ...]:
        """The reasons with their numbers, where the card says them without."""
        numbered = (
            tuple(render_reason(reason, self.translate) for reason in self.reasons) if self.state.has_details else ()
        )
        return () if self.state.details is _describe_result and numbered == self.brief_reasons else numbered

    @property
    def weight(self) -> tuple[str, ...]:
        is_over = self.was_load and not self.state.is_busy and self.name != "load"
        return (self.translate("line.weight_off"),) if is_over else ()

    @property
    def changed(self) -> tuple[str, ...]:
        """The sentence that somebody or something decided anew since the unit was pressed."""
        before, now = self.run[1].verdict if self.run else "", self.now
        if now is None or before in ("", now.verdict):
            return ()
        return (self.translate("line.changed", verdict=self.translate(f"verdict.{before}"), at=now.made_at),)

    @property
    def code(self) -> tuple[str, ...]:
        code = self.run[1].code if self.run and not self.state.is_busy else ""
        return (self.translate("line.code", code=code),) if code else ()

    @property
    def news(self) -> tuple[str, ...]:
        """The sentence that another network is in use since the last unit was pressed."""
        network = self.line.lot.network if self.line.lot else None
        pressed_at = [order.created for order, _ in self.line.runs if order.kind is OrderKind.UNIT and order.created]
        if network is None or not (network.reason and self.state.has_news) or pressed_at[:1] > [network.since]:
            return ()
        values = {"at": network.since, "actor": network.actor, "reason": network.reason}
        return (self.translate("line.network_changed", network=network.network.id[:8], **values),)

    def do(self, key: str = "", **values: object) -> str:
        """Return the instruction of the state; a key names another one."""
        lot = self.line.lot.id if self.line.lot else ""
        context = {"serial": self.serial, "lot": lot, "station": self.line.station}
        return self.translate(key or f"line.{self.name}.do", **context, **values)


def _instruct_retest(card: Card) -> str:
    last = card.earlier
    return card.do(verdict=card.translate(f"verdict.{last.verdict}"), at=last.made_at, left=card.line.remaining_retests)


def _instruct_load(card: Card) -> str:
    """Name the load: which of how many, and how well it must be known."""
    load, message = card.line.load or KnownLoad(0.0), card.run[1].message if card.run else ()
    load_text = f"{load} {message[0].values.get('unit', '')}"
    key = "line.load.do" if load.value else "line.load.do.nothing"
    return card.do(key, step=card.line.load_step, of=len(requested_loads(message)), load=load_text)


def _instruct_repair(card: Card) -> str:
    """Say what to do about what a run ended with: its cause, else its code."""
    if card.run is None:
        return card.do()
    causes = [root_of(reason).code.removeprefix("rig.") for reason in card.run[1].message]
    for key in (*filter(CAUSES.__contains__, causes), card.run[1].code):
        with suppress(KeyError):
            return card.translate(f"code.{key}")
    return card.translate("code.other")


def _describe_result(card: Card) -> tuple[str, ...]:
    return (*card.brief_reasons, *card.changed, *card.code)


def _describe_stop(card: Card) -> tuple[str, ...]:
    """Say why the station stands still, where its gate does not say it below."""
    heartbeat = card.line.heartbeat
    reasons = () if heartbeat is None or (card.state.shows_gate and heartbeat.gate) else heartbeat.reasons
    return (*(render_reason(reason, card.translate) for reason in reasons), *card.code)


def _describe_missing(card: Card) -> tuple[str, ...]:
    lot = card.line.lot
    missing_texts = {"line.no_network": lot and lot.network is None, "line.no_weights": lot and lot.rules.loads}
    return tuple(card.translate(key) for key, applies in missing_texts.items() if applies)


def _describe_error(card: Card) -> tuple[str, ...]:
    """Say what a good unit got: its error beside the lot's limit."""
    line, state = card.line, card.now.state if card.now else None
    kind, rmse = "", line.results[-1].predicted_rmse if line.results else None
    if state is not None:
        scores = state.scores
        kind, rmse = ("", state.predicted_rmse) if scores is None else (".measured", scores.after.rmse)
    if line.lot is None or rmse is None:
        return card.changed
    unit, limit = line.lot.lot.reference_unit, line.lot.lot.limit_rmse
    key = f"line.result{kind}" if limit is None else f"line.result{kind}.limit"
    return (card.translate(key, rmse=number(rmse, unit, limit), limit=limit_number(limit, unit)), *card.changed)


@dataclass(frozen=True)
class LineState:
    """When a state of the line holds, how it looks, what it says and what can be done in it.

    Args:
        holds: whether it does, where none above it in `STATES` does.
        tone: colour and mark. FAIL (the unit is bad) never looks like STOPPED (the station is).
        actions: commands that make sense.
        verdict: whose word it shows, in capitals: the desk's word of the same unit; "" has its own.
        is_before_run: it is about the unit that was scanned, not about the one pressed last.
        has_earlier: that unit was pressed before, and is as it was judged then.
        shows_gate: what the gate looked at stands below.
        has_news: another network is told of.
        has_details: its reasons open with their numbers.
        instruction: the one thing to do now.
    """

    holds: Callable[[LineStatus], object]
    tone: str
    actions: tuple[str, ...] = ()
    verdict: str = ""
    is_before_run: bool = False
    has_earlier: bool = False
    is_busy: bool = False
    shows_gate: bool = False
    has_news: bool = True
    has_details: bool = True
    instruction: Callable[[Card], str] = Card.do
    details: Callable[[Card], tuple[str, ...]] = _describe_result


def _decided(verdict: str, tone: str, is_last: bool = False, **more: Any) -> LineState:
    def holds(line: LineStatus) -> bool:
        is_it = line.result_run is not None and verdict_of(line, line.result_run) == verdict
        return is_it and not (is_last and line.remaining_retests)

    return LineState(holds, tone, verdict=verdict, **more)


def _is_result_of(kind: OrderKind, verdict: str = "") -> Callable[[LineStatus], object]:
    return lambda f: f.result_run and f.result_run[0].kind is kind and verdict in ("", f.result_run[1].verdict)


_START, _AGREE = ("START", "CANCEL"), ("OK", "CANCEL")
_STILL = partial(LineState, tone="stopped", has_news=False)
_SCANNED = partial(LineState, is_before_run=True)
_AT_WORK = partial(LineState, tone="running", actions=("STOP",), is_busy=True, has_news=False)
_REPAIR: Any = {"actions": ("OK",), "has_details": False, "instruction": _instruct_repair}
_CLOSED: Any = {"actions": ("CANCEL",), "shows_gate": True, "has_details": False, "details": _describe_stop}
STATES = {
    "away": LineState(lambda f: False, "stopped"),
    "no_station": _STILL(lambda f: f.heartbeat is None),
    "silent": _STILL(lambda f: not f.is_answering),
    "reading": _AT_WORK(lambda f: f.active and f.active[0].kind is OrderKind.LOAD),
    "running": _AT_WORK(lambda f: f.active),
    "stopped": _STILL(lambda f: f.is_stopped, details=_describe_stop, **_REPAIR),
    "ask": _SCANNED(
        lambda f: f.open_question == "ask", "repeat", _AGREE, has_earlier=True, instruction=_instruct_retest
    ),
    "ask_new": _SCANNED(lambda f: f.open_question == "ask_new", "repeat", _AGREE),
    "used_up": _SCANNED(lambda f: f.open_question == "used_up", "check", ("CANCEL",), has_earlier=True),
    "closed": _SCANNED(lambda f: not (f.may_press or f.result_run), "closed", **_CLOSED),
    "armed_golden": _SCANNED(lambda f: f.is_golden, "golden", _START),
    "armed": _SCANNED(lambda f: f.serial, "ready", _START, shows_gate=True, details=_describe_missing),
    "no_lot": LineState(lambda f: not (f.result_run or f.lot), "ready"),
    "hand": LineState(lambda f: not f.result_run and (f.is_unit_uncertain or f.newest), "ready", shows_gate=True),
    "ready": LineState(lambda f: not f.result_run, "ready", shows_gate=True),
    "broken": LineState(lambda f: f.result_run and f.result_run[1].state is not RunState.DONE, "stopped", **_REPAIR),
    "load": LineState(lambda f: f.load, "load", _START, has_news=False, instruction=_instruct_load),
    "golden_pass": LineState(_is_result_of(OrderKind.GOLDEN, "pass"), "pass", verdict="pass"),
    "golden_fail": LineState(_is_result_of(OrderKind.GOLDEN), "fail", verdict="fail"),
    "pass": _decided("pass", "pass", details=_describe_error),
    "conditional": _decided("conditional", "check"),
    "fail": _decided("fail", "fail"),
    "retest_used_up": _decided("retest", "check", is_last=True),
    "retest": _decided("retest", "repeat"),
    "recorded": LineState(lambda f: f.result_run, "ready"),
}
"""The one table of what an operator can see: the first state that holds is shown."""
