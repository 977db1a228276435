"""The shared networks of a lot: train one, release one, compare them and the map families."""

from collections.abc import Callable, Sequence
from functools import partial

import streamlit as st

from softcal.app.registry.limit import limit_or_none
from softcal.app.ui.account import actor, allows, permit
from softcal.app.ui.actions import ask_reason, finish, role_allows, show_finished, show_refusals
from softcal.app.ui.components.job_panel import begin_job, is_running, job_panel, newest_job
from softcal.app.ui.components.verdict_changes import draw_changes
from softcal.app.ui.panels import drop_empty_columns, headline, rest_may_follow, table
from softcal.app.ui.presentation import colours, empty, format_instant, translate
from softcal.app.ui.server_cache import registry, remembered_network_changes
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
    error = _error_format(lot)
    rows = network_rows(registry(), lot.id)
    if rows:
        # Which network is in use and how well it was trained, in one sentence.
        in_use = next((row for row in rows if row.is_in_use), None)
        values = {"network": in_use.id[:12], "error": error(in_use.validation_rmse)} if in_use else {}
        headline(translate("networks.headline" if in_use else "networks.none_in_use", count=len(rows), **values))
    else:
        empty("networks.none")
    if not rest_may_follow():
        return
    if rows:
        listed = [
            {
                translate("column.network"): row.id[:12],
                translate("column.state"): translate("networks.in_use")
                if row.is_in_use
                else translate(f"networks.state.{row.state}"),
                translate("networks.decided"): row.decided,
                translate("column.made"): format_instant(row.added_at),
                translate("networks.hidden"): row.layers,
                translate("networks.members"): row.members,
                translate("networks.seed"): row.seed,
                translate("networks.validation"): error(row.validation_rmse),
                translate("networks.epochs"): row.epochs,
                translate("networks.train_s"): number(row.train_s, "s"),
                translate("column.remark"): translate("networks.stale") if row.is_stale else "",
            }
            for row in rows
        ]
        table(drop_empty_columns(listed))
        release(lot, rows)
    training(lot)
    if rows:
        comparison(lot, rows)


def release(lot: Lot, rows: Sequence[NetworkRow]) -> None:
    """Draw which network the line uses, and the two decisions on the others."""
    st.header(translate("networks.release"))
    in_use = next((row for row in rows if row.is_in_use), None)
    st.caption(
        translate("networks.release.how", network=in_use.id[:12]) if in_use else translate("networks.release.none")
    )
    show_finished("network")
    error = _error_format(lot)
    names = {row.id: f"{row.id[:12]} · {row.layers} · {error(row.validation_rmse)}" for row in rows}
    chosen = st.selectbox(
        translate("column.network"), list(names), format_func=names.__getitem__, key=f"release-{lot.id}"
    )
    row = next(row for row in rows if row.id == chosen)
    networks = registry().networks
    decisions = (
        ("release", not row.is_in_use, networks.release),
        ("withdraw", row.state == RELEASED, networks.withdraw),
    )
    with show_refusals():
        for action, is_open, decide in decisions:
            if not is_open:
                continue
            with st.container(border=True):
                if allows("release"):
                    draw_changes(remembered_network_changes(lot.id, action, row.id).changed)
                reason = ask_reason(
                    f"{action}-{row.id[:12]}-{row.state}", translate(f"networks.{action}.do"), "release"
                )
            if reason is not None:
                decide(row.id, reason=reason, actor=actor())
                finish("network", translate(f"networks.{action}.done", network=row.id[:12]))


DEFAULTS = NetworkConfig()
MAX_UNITS = 200


def training(lot: Lot) -> None:
    """Draw the form beside the newest training of the lot."""
    st.header(translate("networks.train"))
    left, right = st.columns([2, 3])
    job = newest_job("train", lot=lot.id)
    is_sent = False
    with left:
        if role_allows("set_up"):
            with st.form("train", border=True):
                hidden = st.text_input(
                    translate("networks.hidden"), "-".join(map(str, DEFAULTS.hidden)), key="train-hidden"
                )
                first, second, third = st.columns(3)
                members = first.number_input(
                    translate("networks.members"), 1, 10, DEFAULTS.members, key="train-members"
                )
                seed = second.number_input(translate("networks.seed"), 0, 10**6, DEFAULTS.seed, key="train-seed")
                epochs = third.number_input(
                    translate("networks.max_epochs"), 5, 2000, DEFAULTS.max_epochs, key="train-epochs"
                )
                is_sent = st.form_submit_button(
                    translate("networks.train.do"), type="primary", disabled=is_running(job)
                )
        if is_sent:
            permit("set_up")
            with show_refusals():
                widths = hidden_widths(str(hidden))
                begin_job("train", lot=lot.id, hidden=widths, seed=seed, members=members, max_epochs=epochs)
                st.rerun()
    with right:
        if job is None:
            st.caption(translate("networks.train.how"))
        elif job_panel(job, lambda running: _loss(running, lot)):
            message = translate("networks.trained" if job.result["is_new"] else "networks.found", network=job.message)
            st.success(message, icon=":material/check:")
            _loss(job, lot)


def _loss(job: Job, lot: Lot) -> None:
    trace = job.trace or job.result.get("trace", {})
    if trace.get("epoch"):
        names = {name: translate(f"networks.{name}") for name in ("epoch", "train", "validation")}
        spec = loss_spec(trace, lot.reference_unit, names | {"train": translate("networks.training_error")})
        spec["color"] = [colours().mapped, colours().raw]
        st.echarts_chart(spec, height=300, key=f"loss-{job.job_id}")


def comparison(lot: Lot, rows: Sequence[NetworkRow]) -> None:
    """Draw the choice of what to compare and the newest comparison."""
    st.header(translate("networks.compare"))
    st.caption(translate("networks.compare.how"))
    job = newest_job("compare", lot=lot.id)
    if allows("set_up"):
        names = {row.id: f"{row.id[:12]} · {row.layers}" for row in rows}
        some = translate("choose.some")
        with st.form("compare", border=True):
            left, middle, right = st.columns([3, 3, 1], vertical_alignment="bottom")
            networks = left.multiselect(
                translate("tab.networks"),
                list(names),
                default=list(names)[:2],
                format_func=names.__getitem__,
                placeholder=some,
            )
            families = middle.multiselect(
                translate("column.family"), [DEFAULT, *FAMILIES], default=[DEFAULT, "affine"], placeholder=some
            )
            units = right.number_input(translate("lot.units"), 1, MAX_UNITS, 12)
            is_sent = st.form_submit_button(translate("networks.compare.do"), disabled=is_running(job))
        if is_sent and networks and families:
            begin_job("compare", lot=lot.id, networks=networks, families=families, units=units)
            st.rerun()
        elif is_sent:
            st.warning(translate("networks.compare.choose"), icon=":material/edit:")
    if job is None or not job_panel(job):
        return
    error = _error_format(lot)
    table(
        {
            translate("column.network"): row["network"][:12],
            translate("column.family"): row["family"],
            translate("lot.units"): row["units"],
            translate("verdict.pass"): row["passed"],
            translate("networks.refused"): row["refused"],
            translate("column.predicted"): error(row["predicted"]),
            translate("lot.audited"): row["audited"],
            translate("column.before"): error(row["before"]),
            translate("column.after"): error(row["after"]),
            translate("networks.after_95"): error(row["after_95"]),
        }
        for row in job.result["rows"]
    )


def _error_format(lot: Lot) -> Callable[[float | None], str]:
    """Return how errors of a lot are written: with its unit and the decimals of its limit."""
    limit = limit_or_none(registry(), lot.id)
    return partial(number, unit=lot.reference_unit, limit=None if limit is None else limit.maximum_rmse)
