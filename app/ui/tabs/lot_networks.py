"""The shared networks of a lot: train one, release one, compare them and the map families."""

from collections.abc import Sequence

import streamlit as st

from softcal.app.ui.account import actor, allows, permit
from softcal.app.ui.actions import ask_reason, finish, refusals_in_words, role_allows, say_finished
from softcal.app.ui.components.job_panel import begin_job, is_running, job_panel, newest_job
from softcal.app.ui.components.verdict_changes import draw_changes
from softcal.app.ui.desk import empty, instant, say
from softcal.app.ui.panels import headline, rest_may_follow, table, told
from softcal.app.ui.server_memory import registry, remembered_network_changes
from softcal.app.views.common import number
from softcal.app.views.network import NetworkRow, hidden_widths, loss_spec, network_rows
from softcal.core.lot import Lot
from softcal.core.maps.catalogue import FAMILIES
from softcal.core.maps.config import DEFAULT
from softcal.core.network.config import NetworkConfig
from softcal.db.queues.job_board import Job
from softcal.db.repositories.networks import RELEASED


def draw_networks(lot_id: str) -> None:
    lot = registry().lots.get(lot_id)
    rows = network_rows(registry(), lot.id)
    if rows:
        # Which network is in use and how well it was trained, in one sentence.
        used = next((row for row in rows if row.is_in_use), None)
        facts = {"network": used.id[:12], "error": number(used.validation_rmse, lot.reference_unit)} if used else {}
        headline(say("networks.headline" if used else "networks.none_in_use", count=len(rows), **facts))
    else:
        empty("networks.none")
    if not rest_may_follow():
        return
    if rows:
        listed = [
            {
                say("column.network"): row.id[:12],
                say("column.state"): say("networks.in_use") if row.is_in_use else say(f"networks.state.{row.state}"),
                say("networks.decided"): row.decided,
                say("column.made"): instant(row.added_at),
                say("networks.hidden"): row.layers,
                say("networks.members"): row.members,
                say("networks.seed"): row.seed,
                say("networks.validation"): number(row.validation_rmse, lot.reference_unit),
                say("networks.epochs"): row.epochs,
                say("networks.train_s"): number(row.train_s, "s"),
                say("column.remark"): say("networks.stale") if row.is_stale else "",
            }
            for row in rows
        ]
        table(told(listed))
        release(lot, rows)
    training(lot)
    if rows:
        comparison(lot, rows)


def release(lot: Lot, rows: Sequence[NetworkRow]) -> None:
    """Draw which network the line uses, and the two decisions on the others."""
    st.header(say("networks.release"))
    used = next((row for row in rows if row.is_in_use), None)
    st.caption(say("networks.release.how", network=used.id[:12]) if used else say("networks.release.none"))
    say_finished("network")
    names = {
        row.id: f"{row.id[:12]} · {row.layers} · {number(row.validation_rmse, lot.reference_unit)}" for row in rows
    }
    chosen = st.selectbox(say("column.network"), list(names), format_func=names.__getitem__, key=f"release-{lot.id}")
    row = next(row for row in rows if row.id == chosen)
    networks = registry().networks
    decisions = (
        ("release", not row.is_in_use, networks.release),
        ("withdraw", row.state == RELEASED, networks.withdraw),
    )
    with refusals_in_words():
        for what, is_open, decide in decisions:
            if not is_open:
                continue
            with st.container(border=True):
                if allows("release"):
                    draw_changes(remembered_network_changes(lot.id, what, row.id).changed)
                reason = ask_reason(f"{what}-{row.id[:12]}-{row.state}", say(f"networks.{what}.do"), "release")
            if reason is not None:
                decide(row.id, reason=reason, actor=actor())
                finish("network", say(f"networks.{what}.done", network=row.id[:12]))


USUAL = NetworkConfig()
MOST_UNITS = 200


def training(lot: Lot) -> None:
    """Draw the form beside the newest training of the lot."""
    st.header(say("networks.train"))
    left, right = st.columns([2, 3])
    job = newest_job("train", lot=lot.id)
    is_sent = False
    with left:
        if role_allows("set_up"):
            with st.form("train", border=True):
                hidden = st.text_input(say("networks.hidden"), "-".join(map(str, USUAL.hidden)), key="train-hidden")
                first, second, third = st.columns(3)
                members = first.number_input(say("networks.members"), 1, 10, USUAL.members, key="train-members")
                seed = second.number_input(say("networks.seed"), 0, 10**6, USUAL.seed, key="train-seed")
                epochs = third.number_input(say("networks.max_epochs"), 5, 2000, USUAL.max_epochs, key="train-epochs")
                is_sent = st.form_submit_button(say("networks.train.do"), type="primary", disabled=is_running(job))
        if is_sent:
            permit("set_up")
            with refusals_in_words():
                widths = hidden_widths(str(hidden))
                begin_job("train", lot=lot.id, hidden=widths, seed=seed, members=members, max_epochs=epochs)
                st.rerun()
    with right:
        if job is None:
            st.caption(say("networks.train.how"))
        elif job_panel(job, lambda running: _loss(running, lot)):
            message = say("networks.trained" if job.result["is_new"] else "networks.found", network=job.message)
            st.success(message, icon=":material/check:")
            _loss(job, lot)


def _loss(job: Job, lot: Lot) -> None:
    trace = job.trace or job.result.get("trace", {})
    if trace.get("epoch"):
        names = {name: say(f"networks.{name}") for name in ("epoch", "train", "validation")}
        spec = loss_spec(trace, lot.reference_unit, names | {"train": say("networks.training_error")})
        st.echarts_chart(spec, height=300, key=f"loss-{job.job_id}")


def comparison(lot: Lot, rows: Sequence[NetworkRow]) -> None:
    """Draw the choice of what to compare and the newest comparison."""
    st.header(say("networks.compare"))
    st.caption(say("networks.compare.how"))
    job = newest_job("compare", lot=lot.id)
    if allows("set_up"):
        names = {row.id: f"{row.id[:12]} · {row.layers}" for row in rows}
        some = say("choose.some")
        with st.form("compare", border=True):
            left, middle, right = st.columns([3, 3, 1], vertical_alignment="bottom")
            networks = left.multiselect(
                say("tab.networks"),
                list(names),
                default=list(names)[:2],
                format_func=names.__getitem__,
                placeholder=some,
            )
            families = middle.multiselect(
                say("column.family"), [DEFAULT, *FAMILIES], default=[DEFAULT, "affine"], placeholder=some
            )
            units = right.number_input(say("lot.units"), 1, MOST_UNITS, 12)
            is_asked = st.form_submit_button(say("networks.compare.do"), disabled=is_running(job))
        if is_asked and networks and families:
            begin_job("compare", lot=lot.id, networks=networks, families=families, units=units)
            st.rerun()
        elif is_asked:
            st.warning(say("networks.compare.choose"), icon=":material/edit:")
    if job is None or not job_panel(job):
        return
    unit, compared = lot.reference_unit, job.result["rows"]
    table(
        {
            say("column.network"): row["network"][:12],
            say("column.family"): row["family"],
            say("lot.units"): row["units"],
            say("verdict.pass"): row["passed"],
            say("networks.refused"): row["refused"],
            say("column.predicted"): number(row["predicted"], unit),
            say("lot.audited"): row["audited"],
            say("column.before"): number(row["before"], unit),
            say("column.after"): number(row["after"], unit),
            say("networks.after_95"): number(row["after_95"], unit),
        }
        for row in compared
    )
