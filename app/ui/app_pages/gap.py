"""The gap between the twin and a rig: choose a case, run the diagnosis, read it, press what it proposes."""

import streamlit as st

from softcal.app.jobs.process import start_job
from softcal.app.ui.account import actor, permit
from softcal.app.ui.components.gap_case import add_case, choose_case
from softcal.app.ui.components.gap_report import gap_report
from softcal.app.ui.components.job_panel import job_panel, newest_job
from softcal.app.ui.desk import empty, registry, words
from softcal.app.ui.panels import heading


def render() -> None:
    say = words()
    with heading("gap"):
        case = choose_case()
    add_case()
    if case is None:
        empty(say("gap.none"), say("gap.none.how"))
        return
    job = newest_job("diagnose", case=str(case))
    is_busy = job is not None and job.state.is_active
    label = say("gap.diagnose" if job is None else "gap.diagnose.again")
    if st.button(label, type="primary" if job is None else "secondary", disabled=is_busy, key="diagnose"):
        permit("set_up")
        start_job(registry(), "diagnose", {"case": str(case)}, actor())
        st.rerun()
    if job is not None and job_panel(job):
        gap_report(job, case)
