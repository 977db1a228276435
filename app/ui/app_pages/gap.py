"""The gap between the twin and a rig: choose a case, run the diagnosis, read it, press what it proposes."""

import streamlit as st

from softcal.app.ui.components.gap_case import add_case, choose_case
from softcal.app.ui.components.gap_report import gap_report
from softcal.app.ui.components.job_panel import begin_job, is_running, job_panel, newest_job
from softcal.app.ui.desk import empty, say
from softcal.app.ui.panels import heading


def render() -> None:
    with heading("gap"):
        case = choose_case()
    add_case()
    if case is None:
        empty("gap.none")
        return
    job = newest_job("diagnose", case=str(case))
    label = say("gap.diagnose" if job is None else "gap.diagnose.again")
    if st.button(label, type="primary" if job is None else "secondary", disabled=is_running(job), key="diagnose"):
        begin_job("diagnose", case=str(case))
        st.rerun()
    if job is not None and job_panel(job):
        gap_report(job, case)
