"""The operator's screen: one state, one instruction, and a field that always listens."""

from functools import partial

import streamlit as st

from softcal.app.charts.live import live_signal
from softcal.app.line.line import take_scan
from softcal.app.line.rig import spool_folder
from softcal.app.line.status import LotAtLine, read_line, read_lot
from softcal.app.ui.account import allows, is_signed_in, person
from softcal.app.ui.browser_memory import remember, screen
from softcal.app.ui.callbacks import run_uninterrupted
from softcal.app.ui.components import line_card
from softcal.app.ui.components.scan_field import scan_field
from softcal.app.ui.components.sign_in import ask_sign_in
from softcal.app.ui.components.wall import wall
from softcal.app.ui.panels import go_to
from softcal.app.ui.presentation import choose_language, colours, in_one_language, localize, translate
from softcal.app.ui.server_cache import registry
from softcal.app.views.line import COMMAND_OF_KEY, KEYS, LineView, action_label, away_view, line_view, render_note
from softcal.core.errors import InputError, RegistryError
from softcal.db.registry import Registry

BUSY_S, IDLE_S = 0.5, 1.0
"""Between two looks, during a run and else: another screen may start a run."""

IS_BUSY, REFUSED = "line-is-busy", "line-refused"


def render() -> None:
    if "wall" in st.query_params:
        wall()
        return
    if not allows("calibrate"):
        ask_sign_in(("calibrate",))
        return
    st.html(line_card.style() + line_card.theme(colours()))
    is_busy = bool(st.session_state.get(IS_BUSY))
    st.fragment(_screen, run_every=BUSY_S if is_busy else IDLE_S)()
    # Drawn last, though it stands at the top: the state is what a person looks for.
    with st.container(key="line-setup"), st.popover("", icon=":material/tune:", help=translate("line.setup")):
        choose_language()
        try:
            line = read_line(registry(), screen())
            station = _choose(translate("station.station"), "station", list(line.stations), line.station)
            if station:
                remember("station", station)
                st.rerun()
            lot = _choose(translate("choose.lot"), "lot", list(line.lots), line.lot.id if line.lot else "")
            if lot:
                take_scan(registry(), screen(), f"LOT:{lot}")
                st.rerun()
        except (RegistryError, InputError) as error:
            st.caption(localize(error))
        st.caption(translate("line.setup.codes"))


@in_one_language()
def _screen() -> None:
    view, note = _look()
    with st.container(key="line-screen"):
        st.html(line_card.cells_html(view))
        st.html(line_card.card_html(view, translate("line.why")))
        with st.container(key="line-note"):
            if note is not None:
                st.html(line_card.note_html(*note))
        # The field has one place whatever stands beside it: drawn anew in another, it would miss what is typed then.
        with st.container(key="line-actions", horizontal=True):
            with st.container(key="line-buttons", horizontal=True, width="content"):
                if view.state == "no_station" and allows("set_up"):
                    if st.button(translate("start.station.do"), key="line-to-station", type="primary"):
                        go_to("station")
                for number, command in enumerate(view.actions):
                    label = f"{action_label(command, view.state, translate)} · {KEYS[command]}"
                    draw = partial(st.button, label, key=f"line-{command}", on_click=run_uninterrupted(_on_scan))
                    draw(args=(f"CMD:{command}", view.start_version), type="primary" if number == 0 else "secondary")
            texts = {
                "label": translate("line.scan"),
                "placeholder": translate("line.scan.hint"),
                "late": translate("line.scan.late"),
            }
            texts["spoken"] = note[0] if note else view.announcement
            scan_field(texts, view.start_version, COMMAND_OF_KEY, screen().station, _on_scan)
        if view.signal.t_s:
            st.echarts_chart(live_signal(view.signal, colours(), translate), height=220, key="live-signal")
        elif view.conditions:
            st.html(line_card.conditions_html(view, translate("line.gate")))
        st.html(line_card.chips_html(view, translate("line.last"), translate("line.last.none")))
    if view.is_busy != bool(st.session_state.get(IS_BUSY)):
        st.session_state[IS_BUSY] = view.is_busy
        st.rerun()


def _look() -> tuple[LineView, tuple[str, bool] | None]:
    """Return what the screen shows and the sentence about the last scan."""
    # Why the last scan was not taken, where the registry cannot keep it: it is away, or there is no station.
    refusal = st.session_state.get(REFUSED)
    refused = (translate("note.refused", why=refusal), True) if refusal else None
    try:
        line = read_line(registry(), screen(), _lot_at_line)
    except RegistryError:
        # Runs that lie on this machine's disk and not in the registry.
        folder = spool_folder(None)
        spooled_count = sum(1 for _ in folder.glob("*.spool")) if folder.is_dir() else 0
        return away_view(spooled_count, _signed_in(), translate), refused
    return line_view(line, _signed_in(), translate), refused or render_note(line, translate)


def _lot_at_line(of: Registry, lot_id: str) -> LotAtLine:
    """Read a lot, or remember it while nothing of it changes; asked once a second."""
    name = str(of.database.name)
    return _cached_lot(name, lot_id, _marker(name, lot_id))


@st.cache_resource(ttl="1s", max_entries=16, show_spinner=False)
def _marker(registry_name: str, lot_id: str) -> str:  # noqa: V107
    return registry().pages.change_marker(lot_id)


@st.cache_resource(max_entries=16, show_spinner=False)
def _cached_lot(registry_name: str, lot_id: str, marker: str) -> LotAtLine:  # noqa: V107
    return read_lot(registry(), lot_id)


def _signed_in() -> str:
    """Return who signed in at this screen; a badge is no proof and stands at the line."""
    return person().name if is_signed_in() else ""


def _on_scan(text: str, version: int | None, until_s: float | None = None) -> None:
    refusal = ""
    try:
        take_scan(registry(), screen(version, until_s), text, _signed_in())
    except RegistryError:
        refusal = translate("line.away")
    except InputError as error:
        refusal = localize(error)
    st.session_state[REFUSED] = refusal


def _choose(label: str, name: str, names: list[str], current: str) -> str:
    """Return what a person chose instead of what holds now, "" where nothing was."""
    # The key carries what is chosen now: a scan may have changed it since.
    index = names.index(current) if current in names else None
    chosen = st.selectbox(label, names, index, key=f"line-{name}-{current}", placeholder="–")
    return str(chosen) if chosen and chosen != current else ""
