"""The tabs of the stations: what each does and its set-up, load cells and golden units, profiles."""

import tempfile
from datetime import UTC, date, datetime
from pathlib import Path

import numpy as np
import streamlit as st

from softcal.app.bootstrap import is_alive
from softcal.app.charts.station import golden_figure, profile_figure
from softcal.app.files.profile_file import profile_toml, read_profile
from softcal.app.jobs.launch import SIMULATED
from softcal.app.line.cell_certificate import certificate_from
from softcal.app.line.station_gate import quarantine
from softcal.app.line.status import state_of
from softcal.app.ui.account import actor, allows, permit
from softcal.app.ui.actions import ask_reason, finish, show_finished, show_refusals
from softcal.app.ui.components.job_panel import begin_job, is_running, job_panel, newest_job
from softcal.app.ui.components.station_run import (
    choose_station,
    newest_run,
    place_order,
    run_panel,
    switch_simulated_station,
)
from softcal.app.ui.panels import lot_link, numbers, rest_may_follow, show_figure, table, unit_link
from softcal.app.ui.presentation import (
    colours,
    empty,
    format_instant,
    label_formatter,
    localize,
    show_errors,
    translate,
    zone,
)
from softcal.app.ui.server_cache import registry
from softcal.app.views.common import number
from softcal.app.views.station import bounds, golden_units
from softcal.core.errors import InputError
from softcal.core.lot import UnitKey
from softcal.core.messages.reason import Reason
from softcal.core.orders import OrderKind
from softcal.core.profiles import BUILT_IN
from softcal.station.devices.config import FixtureConfig, SafetyConfig
from softcal.station.wire.link import available_ports

MAX_RUNS = 25
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
        st.header(translate("station.runs"))
        rows = [
            {
                translate("column.made"): format_instant(order.created),
                translate("column.kind"): translate(f"order.{order.kind}"),
                translate("column.serial"): order.serial and unit_link(UnitKey(order.lot_id, order.serial)),
                translate("choose.lot"): order.lot_id and lot_link(order.lot_id),
                translate("station.result"): translate(f"run.{progress.state}"),
                translate("column.remark"): localize(progress.message),
                translate("column.actor"): order.actor,
            }
            for order, progress in registry().order_queue.runs(station, MAX_RUNS)
        ]
        table(rows, translate("station.runs.none"))
    st.header(translate("station.setup"))
    st.caption(translate("setup.how"))
    job = newest_job("station_check")
    if allows("set_up"):
        rig = st.segmented_control(
            translate("setup.rig"), RIGS, default="ports", format_func=label_formatter("setup"), key="rig"
        )
        request: dict[str, object] = {"ports": [], "file": None, "simulated": None}
        if rig == "ports":
            request["ports"] = st.multiselect(
                translate("setup.at"), available_ports(), placeholder=translate("setup.every")
            )
        elif rig == "file":
            request["file"] = str(
                st.text_input(translate("setup.path"), placeholder="/etc/softcal/station.toml")
            ).strip()
        else:
            request["simulated"] = 0
        may_move = st.checkbox(translate("setup.move"), value=False)
        st.caption(translate("setup.move.warning"))
        is_off = is_running(job) or request["file"] == ""
        if st.button(translate("setup.do"), disabled=is_off, icon=":material/search:"):
            begin_job("station_check", "set_up", **request, may_move=may_move)
            st.rerun()
    if job is None or not job_panel(job):
        return
    result = job.result
    if result["is_good"]:
        st.success(translate("setup.good", station=result["station"]), icon=":material/check:")
    if result.get("ports"):
        table(
            {
                translate("setup.port"): port,
                translate("setup.is"): translate(f"setup.role.{role or 'none'}") + (f" ({kind})" if kind else ""),
                translate("setup.says"): localize(Reason.parse(answer)),
            }
            for port, role, kind, answer in result["ports"]
        )
    table(
        {
            translate("station.good"): MARKS[not cure],
            translate("setup.device"): localize(Reason.parse(device)),
            translate("setup.what"): localize(Reason.parse(item)),
            translate("setup.value"): localize(Reason.parse(value)),
            translate("setup.cure"): localize(Reason.parse(cure or "")),
        }
        for device, item, value, cure in result["found"]
    )
    with st.expander(translate("setup.file"), icon=":material/description:"):
        st.code(result["toml"], language="toml")
        st.download_button(
            translate("setup.save"), result["toml"], "station.toml", "application/toml", on_click="ignore"
        )


@st.fragment(run_every=POLL_S)
@show_errors()
def _state(station: str) -> None:
    """Draw what the station says of itself, as it says it."""
    status = registry().order_queue.heartbeat(station)
    if status is None:
        return
    state = translate(f"station.state.{state_of(status, datetime.now(UTC), is_alive(status.process))}")
    cells = (("column.state", state), ("station.seen", format_instant(status.at)), ("station.by", status.process))
    st.markdown(" · ".join(f"{translate(label)}: **{value}**" for label, value in cells))
    for reason in status.reasons:
        st.warning(localize(reason), icon=":material/lock:")
    if status.gate:
        table(
            {
                translate("station.good"): MARKS[condition.is_good],
                translate("station.condition"): localize(condition.name),
                translate("station.fact"): localize(condition.says),
            }
            for condition in status.gate
        )


def _actions(station: str) -> None:
    if quarantined := quarantine(registry(), station, datetime.now(UTC)):
        st.error(
            translate("station.quarantine", count=len(quarantined), first=quarantined[0]), icon=":material/front_hand:"
        )
    if allows("set_up"):
        with st.container(horizontal=True):
            if st.button(translate("station.check"), icon=":material/fact_check:"):
                place_order(station, OrderKind.CHECK)
            if st.button(translate("station.acknowledge"), icon=":material/done_all:"):
                place_order(station, OrderKind.ACKNOWLEDGE)
            if station == SIMULATED:
                switch_simulated_station()
        if run := newest_run(station, (OrderKind.CHECK,)):
            if run_panel(run):
                st.success(localize(run[1].message) or translate("station.check.done"), icon=":material/check:")
    with st.expander(translate("station.override"), icon=":material/lock_open:"):
        reason = ask_reason(f"override-{station}", translate("station.override"), "override")
    if reason is not None:
        place_order(station, OrderKind.OVERRIDE, reason=reason)


LARGEST_BYTES = 20_000_000
FIRST_DAY, LAST_DAY = date(2000, 1, 1), date(2100, 1, 1)
TEXTS = {"cell_serial": "cells.serial", "number": "cells.number", "laboratory": "cells.laboratory"}
DAYS = {"issued_on": "cells.issued", "due_on": "cells.due"}
FORCES = {"capacity_N": "cells.capacity", "uncertainty_N": "cells.uncertainty"}


def draw_cells() -> None:
    """Draw why a station's references can be trusted: certificates, golden units."""
    show_finished("cells")
    certificates, today = registry().stations.certificates(), datetime.now(UTC).astimezone(zone()).date()
    rows = [
        {
            translate("cells.serial"): entry.cell_serial,
            translate("cells.number"): entry.number,
            translate("cells.laboratory"): entry.laboratory,
            translate("cells.issued"): f"{entry.issued_on}",
            translate("cells.due"): f"{entry.due_on}",
            translate("cells.capacity"): number(entry.capacity_N, "N"),
            translate("cells.uncertainty"): number(entry.uncertainty_N, "N"),
            translate("column.state"): translate("cells.valid", days=(entry.due_on - today).days)
            if entry.is_valid(today)
            else translate("cells.invalid"),
        }
        for entry in reversed(certificates)
    ]
    if rows:
        table(rows)
    else:
        empty("cells.none")
    if allows("set_up"):
        _certificate_form()
    st.header(translate("golden.title"))
    if not rest_may_follow():
        return
    for unit in golden_units(registry()):
        last = unit.runs[-1]
        word = translate("golden.passed" if last.passed else "golden.failed")
        key = UnitKey(unit.lot_id, unit.serial)
        st.markdown(f"**{unit_link(key).markdown}** · {lot_link(unit.lot_id).markdown} · {unit.station} · {word}")
        show_figure(
            golden_figure(unit.runs, unit.chart, colours(), translate),
            f"golden-{unit.station}-{unit.lot_id}-{unit.serial}",
        )
        for line in (*last.reasons, unit.note):
            if line:
                st.caption(localize(line))
    if not registry().stations.golden_runs():
        st.caption(translate("golden.none"))
    if allows("set_up"):
        with st.container(border=True):
            station = choose_station()
            serial = str(st.text_input(translate("golden.serial"), key="golden-serial")).strip()
            if (
                st.button(translate("golden.do"), disabled=not (station and serial), icon=":material/verified:")
                and station
            ):
                if place_order(station, OrderKind.GOLDEN, serial):
                    st.info(translate("golden.ordered"), icon=":material/hourglass:")


def _certificate_form() -> None:
    with st.form("certificate", border=True):
        st.markdown(f"**{translate('cells.add')}**")
        document = st.file_uploader(translate("cells.dcc"), type=["xml"])
        st.caption(translate("cells.typed"))
        values: dict[str, object] = {}
        for column, (name, label) in zip(st.columns(4), TEXTS.items(), strict=False):
            values[name] = str(column.text_input(translate(label), key=f"cell-{name}")).strip() or None
        columns = st.columns(4)
        for column, (name, label) in zip(columns[:2], DAYS.items(), strict=True):
            values[name] = column.date_input(translate(label), None, FIRST_DAY, LAST_DAY, key=f"cell-{name}")
        for column, (name, label) in zip(columns[2:], FORCES.items(), strict=True):
            title = f"{translate(label)} [N]"
            values[name] = column.number_input(title, 0.0, value=None, format="%.4g", key=f"cell-{name}")
        if not st.form_submit_button(translate("cells.store"), type="primary"):
            return
    permit("set_up")
    with show_refusals(), tempfile.TemporaryDirectory(prefix="softcal-dcc-") as folder:
        file = None
        if document is not None:
            if document.size > LARGEST_BYTES:
                raise InputError(f"the document has {document.size} bytes; at most {LARGEST_BYTES} are taken")
            file = Path(folder) / "certificate.xml"
            file.write_bytes(document.getvalue())
        certificate = certificate_from(values, file)
        registry().stations.add_certificate(certificate, actor=actor())
        finish("cells", translate("cells.stored", number=certificate.number))


FILE = "file"

BOUND_LABELS = {"depth": "reached", "speed": "speed"}
"""How a profile's reach is called: its depth counts from its beginning, the bound from the stage."""


def draw_profiles() -> None:
    """Draw the profiles a station presses with, and whether they keep its bounds."""
    name = st.selectbox(translate("profiles.profile"), [*BUILT_IN, FILE], format_func=label_formatter("profile"))
    left, right = st.columns([1, 3])
    profile = None
    with left:
        if name != FILE:
            depth_mm = st.number_input(f"{translate('profiles.depth')} [mm]", 0.1, 50.0, 3.5, 0.1)
            seed = int(st.number_input(translate("networks.seed"), 0, 10**6, 0))
            profile = BUILT_IN[name](np.random.default_rng(seed), depth_mm)
        elif (file := st.file_uploader(translate("profiles.file"), type=["toml"])) is not None:
            with tempfile.TemporaryDirectory(prefix="softcal-profile-") as folder:
                path = Path(folder) / "profile.toml"
                path.write_bytes(file.getvalue())
                profile = read_profile(path)
        # The bounds of a station live in its file, at its machine.
        st.caption(translate("profiles.bounds_typed"))
        deepest_mm = st.number_input(f"{translate('profiles.deepest')} [mm]", 0.1, 500.0, SafetyConfig().deepest_mm)
        speed_mm_s = st.number_input(f"{translate('profiles.fastest')} [mm/s]", 0.01, 500.0, SafetyConfig().speed_mm_s)
        safety = SafetyConfig(deepest_mm=deepest_mm, speed_mm_s=speed_mm_s)
    if profile is None:
        return
    start_mm = FixtureConfig().approach_mm
    limits = bounds(profile, safety.deepest_mm, safety.speed_mm_s, start_mm)
    with right:
        numbers(
            (
                (translate("column.duration"), f"{profile.duration_s:.0f} s", None),
                (translate("profiles.presses"), str(profile.presses), None),
                *(
                    (translate(f"profiles.{BOUND_LABELS[bound.name]}"), f"{bound.value:.3g} {bound.unit}", None)
                    for bound in limits
                ),
            ),
            narrowest_px=185,
        )
        for bound in (bound for bound in limits if not bound.is_within):
            limit = f"{bound.largest:g} {bound.unit}"
            st.error(translate(f"profiles.{bound.name}.broken", limit=limit), icon=":material/block:")
        if all(bound.is_within for bound in limits):
            st.caption(translate("profiles.kept"))
        if not rest_may_follow():
            return
        figure = profile_figure(profile, start_mm, safety.deepest_mm, safety.speed_mm_s, colours(), translate)
        show_figure(figure, "profile")
        file_name = f"{profile.name.replace(' ', '-').replace('/', '-')}.toml"
        st.download_button(translate("profiles.save"), profile_toml(profile), file_name, on_click="ignore")
