"""How far a job is, live, with a way to stop it; the page finds it again after a reload."""

from collections.abc import Callable
from datetime import UTC, datetime

import streamlit as st

from softcal.app.jobs.launch import start_job
from softcal.app.texts.reasons import translate_phrase
from softcal.app.ui.account import actor, permit
from softcal.app.ui.actions import finish
from softcal.app.ui.presentation import localize, show_errors, translate
from softcal.app.ui.server_cache import registry
from softcal.core.orders import RunState
from softcal.db.queues.job_board import Job

POLL_S = 1.0
Live = Callable[[Job], None]


def newest_job(kind: str, **request: object) -> Job | None:
    """Return the newest job of a kind whose request has these values, with its trace and result."""
    board = registry().job_board
    for job in board.jobs(kind):
        if all(job.request.get(name) == value for name, value in request.items()):
            return board.job(job.job_id)
    return None


def is_running(job: Job | None) -> bool:
    """Whether there is a job that is not over yet."""
    return job is not None and job.state.is_active


def begin_job(kind: str, action: str = "set_up", **request: object) -> str:
    """Start a job for who is at the screen and return its id; the role must allow `action`."""
    permit(action)
    return start_job(registry(), kind, request, actor())


def job_panel(job: Job, live: Live | None = None) -> bool:
    """Draw a job, its trace by `live`; return whether it is done and its result can be shown."""
    if job.is_lost(datetime.now(UTC)):
        st.error(translate("job.lost"), icon=":material/heart_broken:")
        registry().job_board.end(job.job_id, RunState.ERROR, translate("job.lost"))
    elif job.state.is_active:
        _running(job.job_id, live)
    elif job.state is RunState.ERROR:
        st.error(localize(job.message), icon=":material/error:")
    elif job.state is RunState.CANCELLED:
        st.info(translate("job.cancelled"), icon=":material/cancel:")
    return job.state is RunState.DONE


def awaits_calibration(key: str, lot_id: str) -> bool:
    """Draw the calibration that was asked for on this page; return whether it is under way.

    The session keeps its job as `key`; the text ASKED.done says that it is over.
    """
    job = newest_job("calibrate", lot=lot_id)
    if job is None or st.session_state.get(key) != job.job_id:
        return False
    if job_panel(job):
        del st.session_state[key]
        finish(key, translate(f"{key}.done"))
    return job.state.is_active


@st.fragment(run_every=POLL_S)
@show_errors()
def _running(job_id: str, live: Live | None) -> None:
    board = registry().job_board
    job = board.job(job_id)
    if not job.state.is_active or job.is_lost(datetime.now(UTC)):
        st.rerun()
    step = job.trace.get("step")
    text = (
        translate(f"step.{step}", **job.trace["values"]) if step else translate_phrase("step", job.message, translate)
    )
    text = text or translate("job.starting")
    # One below the other: beside each other they do not fit a narrow place.
    st.progress(job.fraction, text=translate("job.stopping") if job.is_cancel_wanted else text)
    if st.button(
        translate("job.cancel"), key=f"cancel-{job_id}", disabled=job.is_cancel_wanted, icon=":material/cancel:"
    ):
        board.cancel(job_id)
    if live is not None and job.trace and "step" not in job.trace:
        live(job)
