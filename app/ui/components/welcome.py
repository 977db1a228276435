"""The front door: the demo, a lot out of files, a station."""

import streamlit as st

from softcal.app.jobs.launch import DEMO
from softcal.app.ui.account import allows
from softcal.app.ui.components.job_panel import begin_job, is_running, job_panel, newest_job
from softcal.app.ui.panels import go_to
from softcal.app.ui.presentation import translate
from softcal.app.ui.server_cache import registry
from softcal.core.orders import RunState

UNITS = 4
"""Units of the demo: enough to see a lot, few enough to wait for."""

WAYS = (("files", "lots", "files", "upload_file"), ("station", "station", "", "precision_manufacturing"))


def welcome() -> None:
    """Draw the ways to a first lot."""
    st.markdown(translate("start.why"))
    demo, *others = st.columns(3)
    with demo, st.container(border=True):
        st.markdown(f"## :material/science: {translate('start.demo')}")
        st.markdown(translate("start.demo.how", units=UNITS))
        job = newest_job("demo")
        if DEMO in registry().lots.ids() and not is_running(job):
            if job is not None and job.state is RunState.DONE:
                # Lead to the lot whoever has waited for it here
                if st.session_state.pop("demo-asked", "") == job.job_id:
                    go_to("lot", lot=DEMO)
            if st.button(translate("start.demo.open"), type="primary", width="stretch", key="demo-open"):
                go_to("lot", lot=DEMO)
        else:
            if st.button(
                translate("start.demo"), type="primary", width="stretch", disabled=is_running(job), key="demo"
            ):
                st.session_state["demo-asked"] = begin_job("demo", "calibrate", units=UNITS)
                st.rerun()
            if job is not None:
                job_panel(job)

    # Who may not take one is asked for a sign-in where it leads.
    for column, (name, page, tab, icon) in zip(others, WAYS, strict=True):
        with column, st.container(border=True):
            st.markdown(f"## :material/{icon}: {translate(f'start.{name}')}")
            st.markdown(translate(f"start.{name}.how"))
            if not allows("set_up"):
                st.caption(translate("start.sign_in" if registry().people.all() else "start.first"))
            if st.button(translate(f"start.{name}.do"), width="stretch", key=f"start-{name}"):
                go_to(page, **({"tab": tab} if tab else {}))
