"""Find and test the devices of a rig as a job, and give its station file to be kept and edited."""

from collections.abc import Mapping
from typing import Any

import streamlit as st

from softcal.app.jobs.process import start_job
from softcal.app.ui.account import actor, permit, person
from softcal.app.ui.components.job_panel import job_panel, newest_job
from softcal.app.ui.desk import in_words, registry, words
from softcal.app.ui.panels import table
from softcal.core.words.reason import Reason
from softcal.db.access.people import may
from softcal.station.link import available_ports

RIGS = ("ports", "file", "simulated")


def rig_setup() -> None:
    """Draw the choice of the rig, the newest check and its station file."""
    say = words()
    st.caption(say("setup.how"))
    job = newest_job("station_check")
    if may(person(), "set_up"):
        _ask(is_busy=job is not None and job.state.is_active)
    if job is not None and job_panel(job):
        _found(job.result)


def _ask(is_busy: bool) -> None:
    say = words()
    rig = st.segmented_control(
        say("setup.rig"), RIGS, default="ports", format_func=lambda name: say(f"setup.{name}"), key="rig"
    )
    request: dict[str, object] = {"ports": [], "file": None, "simulated": None}
    if rig == "ports":
        request["ports"] = st.multiselect(say("setup.at"), available_ports(), placeholder=say("setup.every"))
    elif rig == "file":
        request["file"] = str(st.text_input(say("setup.path"), placeholder="/etc/softcal/station.toml")).strip()
    else:
        request["simulated"] = 0
    may_move = st.checkbox(say("setup.move"), value=False)
    st.caption(say("setup.move.warning"))
    if st.button(say("setup.do"), disabled=is_busy or request["file"] == "", icon=":material/search:"):
        permit("set_up")
        start_job(registry(), "station_check", request | {"may_move": may_move}, actor())
        st.rerun()


def _found(result: Mapping[str, Any]) -> None:
    say = words()
    if result["is_good"]:
        st.success(say("setup.good", station=result["station"]), icon=":material/check:")
    if result.get("ports"):
        table([_port_row(*port) for port in result["ports"]])
    marks = {True: "✓", False: "✕"}
    table(
        [
            {
                say("station.good"): marks[not cure],
                say("setup.device"): in_words(Reason.of(device)),
                say("setup.what"): in_words(Reason.of(what)),
                say("setup.value"): in_words(Reason.of(value)),
                say("setup.cure"): in_words(Reason.of(cure or "")),
            }
            for device, what, value, cure in result["found"]
        ]
    )
    with st.expander(say("setup.file_of"), icon=":material/description:"):
        st.code(result["toml"], language="toml")
        st.download_button(say("setup.save"), result["toml"], "station.toml", "application/toml", on_click="ignore")


def _port_row(port: str, role: str, kind: str, says: object) -> dict[str, str]:
    say = words()
    return {
        say("setup.port"): port,
        say("setup.is"): " ".join(filter(None, (say(f"setup.role.{role or 'none'}"), kind and f"({kind})"))),
        say("setup.says"): in_words(Reason.of(says)),
    }
