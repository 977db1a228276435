"""Calibrate a lot from its page, or again: with progress, and a way to stop it."""

import streamlit as st

from softcal.app.jobs.process import start_job
from softcal.app.ui.account import actor, permit, person
from softcal.app.ui.components.job_panel import job_panel, newest_job
from softcal.app.ui.desk import registry, words
from softcal.core.orders import RunState
from softcal.db.access.people import may

SEEN = "calibrate-seen"


def calibrate_again(lot_id: str) -> None:
    """Draw the button for whom the role allows it, and how far a calibration of the lot is for everybody."""
    say = words()
    job = newest_job("calibrate", lot=lot_id)
    is_busy = job is not None and job.state.is_active
    has_source = bool(registry().recordings(lot_id, kind="source"))
    if may(person(), "set_up") and has_source and not is_busy:
        if st.button(say("lot.again"), icon=":material/replay:", help=say("lot.again.help"), key="calibrate-again"):
            permit("set_up")
            st.session_state[SEEN] = start_job(registry(), "calibrate", {"lot": lot_id}, actor())
            st.rerun()
    if job is None or (not is_busy and st.session_state.get(SEEN) != job.job_id):
        return
    st.session_state[SEEN] = job.job_id
    if job_panel(job) and job.state is RunState.DONE:
        st.success(say("lot.again.done", new=job.result["new"], known=job.result["known"]), icon=":material/check:")
