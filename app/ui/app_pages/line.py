"""The operator's screen: one state, one instruction, and a field that always listens. It only reads rows and orders."""

from functools import partial

import streamlit as st

from softcal.app.charts.live import live_signal
from softcal.app.line.line import Answer, Note, read_line, take_scan
from softcal.app.ui.account import actor, person
from softcal.app.ui.components import line_card
from softcal.app.ui.components.line_setup import line_setup
from softcal.app.ui.components.scan_field import scan_field
from softcal.app.ui.desk import colours, registry, words
from softcal.app.ui.line_memory import choice, kept_runs, lot_at_line, note, remember_answer
from softcal.app.views.line import COMMAND_OF_KEY, KEYS, LineView, away_view, line_view
from softcal.core.errors import RegistryError

BUSY_S, IDLE_S = 0.5, 2.0
"""Between two looks: during a run, and else; an idle screen looks too, since another one may have started a run."""

IS_BUSY = "line-is-busy"


def render() -> None:
    """Draw the page."""
    st.html(line_card.style() + line_card.theme(colours()))
    is_busy = bool(st.session_state.get(IS_BUSY))
    st.fragment(_screen, run_every=BUSY_S if is_busy else IDLE_S)()
    # Drawn last, though it stands at the top: the state is what a person looks for.
    with st.container(key="line-setup"), st.popover("", icon=":material/tune:", help=words()("line.setup")):
        line_setup()


def _screen() -> None:
    view = _look()
    with st.container(key="line-screen"):
        st.html(line_card.cells_html(view))
        st.html(line_card.card_html(view))
        said = _note()
        with st.container(key="line-actions", horizontal=True):
            _actions(view)
            texts = {"label": words()("line.scan"), "placeholder": words()("line.scan.hint")}
            scan_field(texts | {"spoken": said or view.spoken}, COMMAND_OF_KEY, _on_scan)
        _below(view)
    if view.is_busy != bool(st.session_state.get(IS_BUSY)):
        st.session_state[IS_BUSY] = view.is_busy
        st.rerun()


def _look() -> LineView:
    try:
        facts = read_line(registry(), choice(), lot_at_line)
    except RegistryError:
        return away_view(kept_runs(), person().name, words())
    return line_view(facts, person().name, words())


def _on_scan(text: str) -> None:
    try:
        answer = take_scan(registry(), choice(), text, actor())
    except RegistryError:
        answer = Answer(choice(), Note("away"))
    remember_answer(answer)


def _actions(view: LineView) -> None:
    for number, command in enumerate(view.actions):
        label = f"{words()(f'line.action.{command}')} · {KEYS[command]}"
        draw = partial(st.button, label, key=f"line-{command}", on_click=_on_scan, args=(f"CMD:{command}",))
        draw(type="primary" if number == 0 else "secondary")


def _note() -> str:
    """Show the sentence about the last scan; it stays until the next one."""
    found = note()
    if found is None:
        return ""
    said = words()(f"note.{found.key}", **found.values)
    st.html(line_card.note_html(said, found.is_refusal))
    return said


def _below(view: LineView) -> None:
    say = words()
    if view.signal.t_s:
        st.echarts_chart(live_signal(view.signal, colours(), say), height=220, key="live-signal")
    elif view.conditions:
        st.html(line_card.conditions_html(view, say("line.gate")))
    st.html(line_card.chips_html(view, say("line.last"), say("line.last.none")))
