"""The tabs of the stations: what each does and its set-up, load cells and golden units, profiles."""

import tempfile
from datetime import UTC, date, datetime
from pathlib import Path

import numpy as np
import streamlit as st

from softcal.app.bootstrap import is_alive
from softcal.app.charts.station import golden_figure, profile_figure
from softcal.app.files.profile_file import profile_toml, read_profile
from softcal.app.line.cell_certificate import certificate_from
from softcal.app.line.facts import state_of
from softcal.app.line.gate_facts import quarantine
from softcal.app.ui.account import actor, allows, permit
from softcal.app.ui.actions import ask_reason, finish, refusals_in_words, say_finished
from softcal.app.ui.components.job_panel import begin_job, is_running, job_panel, newest_job
from softcal.app.ui.components.station_run import choose_station, newest_run, place, run_panel
from softcal.app.ui.desk import colours, empty, errors_in_words, in_words, instant, named, say, zone
from softcal.app.ui.panels import numbers, rest_may_follow, show_figure, table
from softcal.app.ui.server_memory import registry
from softcal.app.views.common import number
from softcal.app.views.station import bounds, golden_units
from softcal.core.errors import InputError
from softcal.core.messages.reason import Reason
from softcal.core.orders import OrderKind
from softcal.core.profiles import BUILT_IN
from softcal.station.devices.config import FixtureConfig, SafetyConfig
from softcal.station.wire.link import available_ports

RUNS = 25
POLL_S = 2.0
RIGS = ("ports", "file", "simulated")
MARKS = {True: "✓", False: "✕"}


def draw_state() -> None:
    """Draw what each station does, why its gate is closed, its runs, and the set-up of a rig."""
    station = choose_station()
    if station is not None:
        _state(station)
        _actions(station)
        if not rest_may_follow():
            return
        st.header(say("station.runs"))
        rows = [
            {
                say("column.made"): instant(order.created),
                say("column.kind"): say(f"order.{order.kind}"),
                say("column.serial"): order.serial,
                say("choose.lot"): order.lot_id,
                say("station.result"): say(f"run.{progress.state}"),
                say("column.remark"): in_words(progress.message),
                say("column.actor"): order.actor,
            }
            for order, progress in registry().order_queue.runs(station, RUNS)
        ]
        table(rows, say("station.runs.none"))
    st.header(say("station.setup"))
    st.caption(say("setup.how"))
    job = newest_job("station_check")
    if allows("set_up"):
        rig = st.segmented_control(say("setup.rig"), RIGS, default="ports", format_func=named("setup"), key="rig")
        request: dict[str, object] = {"ports": [], "file": None, "simulated": None}
        if rig == "ports":
            request["ports"] = st.multiselect(say("setup.at"), available_ports(), placeholder=say("setup.every"))
        elif rig == "file":
            request["file"] = str(st.text_input(say("setup.path"), placeholder="/etc/softcal/station.toml")).strip()
        else:
            request["simulated"] = 0
        may_move = st.checkbox(say("setup.move"), value=False)
        st.caption(say("setup.move.warning"))
        is_off = is_running(job) or request["file"] == ""
        if st.button(say("setup.do"), disabled=is_off, icon=":material/search:"):
            begin_job("station_check", "set_up", **request, may_move=may_move)
            st.rerun()
    if job is None or not job_panel(job):
        return
    result = job.result
    if result["is_good"]:
        st.success(say("setup.good", station=result["station"]), icon=":material/check:")
    if result.get("ports"):
        table(
            {
                say("setup.port"): port,
                say("setup.is"): say(f"setup.role.{role or 'none'}") + (f" ({kind})" if kind else ""),
                say("setup.says"): in_words(Reason.parse(answer)),
            }
            for port, role, kind, answer in result["ports"]
        )
    table(
        {
            say("station.good"): MARKS[not cure],
            say("setup.device"): in_words(Reason.parse(device)),
            say("setup.what"): in_words(Reason.parse(what)),
            say("setup.value"): in_words(Reason.parse(value)),
            say("setup.cure"): in_words(Reason.parse(cure or "")),
        }
        for device, what, value, cure in result["found"]
    )
    with st.expander(say("setup.file"), icon=":material/description:"):
        st.code(result["toml"], language="toml")
        st.download_button(say("setup.save"), result["toml"], "station.toml", "application/toml", on_click="ignore")


@st.fragment(run_every=POLL_S)
@errors_in_words()
def _state(station: str) -> None:
    """Draw what the station says of itself, as it says it."""
    beat = registry().order_queue.heartbeat(station)
    if beat is None:
        return
    state = say(f"station.state.{state_of(beat, datetime.now(UTC), is_alive(beat.process))}")
    cells = (("column.state", state), ("station.seen", instant(beat.at)), ("station.by", beat.process))
    st.markdown(" · ".join(f"{say(label)}: **{value}**" for label, value in cells))
    for reason in beat.reasons:
        st.warning(in_words(reason), icon=":material/lock:")
    if beat.gate:
        table(
            {
                say("station.good"): MARKS[condition.is_good],
                say("station.condition"): in_words(condition.name),
                say("station.fact"): in_words(condition.says),
            }
            for condition in beat.gate
        )


def _actions(station: str) -> None:
    if held := quarantine(registry(), station, datetime.now(UTC)):
        st.error(say("station.quarantine", count=len(held), first=held[0]), icon=":material/front_hand:")
    if allows("set_up"):
        with st.container(horizontal=True):
            if st.button(say("station.check"), icon=":material/fact_check:"):
                place(station, OrderKind.CHECK)
            if st.button(say("station.acknowledge"), icon=":material/done_all:"):
                place(station, OrderKind.ACKNOWLEDGE)
        if run := newest_run(station, (OrderKind.CHECK,)):
            if run_panel(run):
                st.success(in_words(run[1].message) or say("station.check.done"), icon=":material/check:")
    with st.expander(say("station.override"), icon=":material/lock_open:"):
        why = ask_reason(f"override-{station}", say("station.override"), "override")
    if why is not None:
        place(station, OrderKind.OVERRIDE, reason=why)


LARGEST_BYTES = 20_000_000
FIRST_DAY, LAST_DAY = date(2000, 1, 1), date(2100, 1, 1)
TEXTS = {"cell_serial": "cells.serial", "number": "cells.number", "laboratory": "cells.laboratory"}
DAYS = {"issued_on": "cells.issued", "due_on": "cells.due"}
FORCES = {"capacity_N": "cells.capacity", "uncertainty_N": "cells.uncertainty"}


def draw_cells() -> None:
    """Draw why a station's references can be trusted: certificates, golden units."""
    say_finished("cells")
    certificates, today = registry().stations.certificates(), datetime.now(UTC).astimezone(zone()).date()
    rows = [
        {
            say("cells.serial"): entry.cell_serial,
            say("cells.number"): entry.number,
            say("cells.laboratory"): entry.laboratory,
            say("cells.issued"): f"{entry.issued_on}",
            say("cells.due"): f"{entry.due_on}",
            say("cells.capacity"): number(entry.capacity_N, "N"),
            say("cells.uncertainty"): number(entry.uncertainty_N, "N"),
            say("column.state"): say("cells.valid", days=(entry.due_on - today).days)
            if entry.is_valid(today)
            else say("cells.invalid"),
        }
        for entry in reversed(certificates)
    ]
    if rows:
        table(rows)
    else:
        empty("cells.none")
    if allows("set_up"):
        _certificate_form()
    st.header(say("golden.title"))
    if not rest_may_follow():
        return
    for unit in golden_units(registry()):
        last = unit.runs[-1]
        word = say("golden.passed" if last.passed else "golden.failed")
        st.markdown(f"**{unit.serial}** · {unit.lot_id} · {unit.station} · {word}")
        show_figure(
            golden_figure(unit.runs, unit.chart, colours(), say), f"golden-{unit.station}-{unit.lot_id}-{unit.serial}"
        )
        for line in (*last.reasons, unit.note):
            if line:
                st.caption(in_words(line))
    if not registry().stations.golden_runs():
        st.caption(say("golden.none"))
    if allows("set_up"):
        with st.container(border=True):
            station = choose_station()
            serial = str(st.text_input(say("golden.serial"), key="golden-serial")).strip()
            if st.button(say("golden.do"), disabled=not (station and serial), icon=":material/verified:") and station:
                if place(station, OrderKind.GOLDEN, serial):
                    st.info(say("golden.ordered"), icon=":material/hourglass:")


def _certificate_form() -> None:
    with st.form("certificate", border=True):
        st.markdown(f"**{say('cells.add')}**")
        document = st.file_uploader(say("cells.dcc"), type=["xml"])
        st.caption(say("cells.typed"))
        given: dict[str, object] = {}
        for column, (name, label) in zip(st.columns(4), TEXTS.items(), strict=False):
            given[name] = str(column.text_input(say(label), key=f"cell-{name}")).strip() or None
        columns = st.columns(4)
        for column, (name, label) in zip(columns[:2], DAYS.items(), strict=True):
            given[name] = column.date_input(say(label), None, FIRST_DAY, LAST_DAY, key=f"cell-{name}")
        for column, (name, label) in zip(columns[2:], FORCES.items(), strict=True):
            title = f"{say(label)} [N]"
            given[name] = column.number_input(title, 0.0, value=None, format="%.4g", key=f"cell-{name}")
        if not st.form_submit_button(say("cells.store"), type="primary"):
            return
    permit("set_up")
    with refusals_in_words(), tempfile.TemporaryDirectory(prefix="softcal-dcc-") as folder:
        file = None
        if document is not None:
            if document.size > LARGEST_BYTES:
                raise InputError(f"the document has {document.size} bytes; at most {LARGEST_BYTES} are taken")
            file = Path(folder) / "certificate.xml"
            file.write_bytes(document.getvalue())
        certificate = certificate_from(given, file)
        registry().stations.add_certificate(certificate, actor=actor())
        finish("cells", say("cells.stored", number=certificate.number))


FILE = "file"

REACHED = {"depth": "reached", "speed": "speed"}
"""How a profile's reach is called: its depth counts from its beginning, the bound from the stage."""


def draw_profiles() -> None:
    """Draw the profiles a station presses with, and whether they keep its bounds."""
    name = st.selectbox(say("profiles.profile"), [*BUILT_IN, FILE], format_func=named("profile"))
    left, right = st.columns([1, 3])
    profile = None
    with left:
        if name != FILE:
            depth_mm = st.number_input(f"{say('profiles.depth')} [mm]", 0.1, 50.0, 3.5, 0.1)
            seed = int(st.number_input(say("networks.seed"), 0, 10**6, 0))
            profile = BUILT_IN[name](np.random.default_rng(seed), depth_mm)
        elif (file := st.file_uploader(say("profiles.file"), type=["toml"])) is not None:
            with tempfile.TemporaryDirectory(prefix="softcal-profile-") as folder:
                path = Path(folder) / "profile.toml"
                path.write_bytes(file.getvalue())
                profile = read_profile(path)
        # The bounds of a station live in its file, at its machine.
        st.caption(say("profiles.bounds_typed"))
        deepest_mm = st.number_input(f"{say('profiles.deepest')} [mm]", 0.1, 500.0, SafetyConfig().deepest_mm)
        speed_mm_s = st.number_input(f"{say('profiles.fastest')} [mm/s]", 0.01, 500.0, SafetyConfig().speed_mm_s)
        safety = SafetyConfig(deepest_mm=deepest_mm, speed_mm_s=speed_mm_s)
    if profile is None:
        return
    start_mm = FixtureConfig().approach_mm
    limits = bounds(profile, safety.deepest_mm, safety.speed_mm_s, start_mm)
    with right:
        numbers(
            (
                (say("column.duration"), f"{profile.duration_s:.0f} s", None),
                (say("profiles.presses"), str(profile.presses), None),
                *(
                    (say(f"profiles.{REACHED[bound.name]}"), f"{bound.value:.3g} {bound.unit}", None)
                    for bound in limits
                ),
            ),
            narrowest_px=185,
        )
        for bound in (bound for bound in limits if not bound.is_kept):
            limit = f"{bound.largest:g} {bound.unit}"
            st.error(say(f"profiles.{bound.name}.broken", limit=limit), icon=":material/block:")
        if all(bound.is_kept for bound in limits):
            st.caption(say("profiles.kept"))
        if not rest_may_follow():
            return
        figure = profile_figure(profile, start_mm, safety.deepest_mm, safety.speed_mm_s, colours(), say)
        show_figure(figure, "profile")
        file_name = f"{profile.name.replace(' ', '-').replace('/', '-')}.toml"
        st.download_button(say("profiles.save"), profile_toml(profile), file_name, on_click="ignore")
