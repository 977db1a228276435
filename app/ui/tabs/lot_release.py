"""What of a lot leaves the house: nothing yet and why, what can be released, or what was; and its archive."""

import streamlit as st

from softcal.app.calibration.changes import Changes, list_affected_lots
from softcal.app.calibration.release import decide_lot
from softcal.app.export.certificates.lot_statement import build_lot_statement, lot_statement_pdf
from softcal.app.export.export import withdraw_recalled_files
from softcal.app.export.names import FORMATS
from softcal.app.jobs.jobs import archive_path, archived_state
from softcal.app.ui.account import actor, allows, permit
from softcal.app.ui.actions import download, finish, show_finished
from softcal.app.ui.components.job_panel import begin_job, is_running, job_panel, newest_job
from softcal.app.ui.components.verdict_changes import draw_changes
from softcal.app.ui.panels import has_units, numbers, table, unit_link
from softcal.app.ui.presentation import (
    current_translator,
    format_instant,
    label_formatter,
    localize,
    translate,
    verdict_word,
)
from softcal.app.ui.server_cache import (
    cached_lot_status,
    cached_next_step,
    cached_release_changes,
    registry,
)
from softcal.app.views.common import number
from softcal.app.views.next_step import release_record
from softcal.core.lot import UnitKey
from softcal.core.quality.lot_status import Disposition, LotStatus

DEFAULT_FORMATS = ("json", "pdf")
MAX_ROWS, MAX_OPEN = 200, 8
"""So many units are listed, and so many stand open on the page."""


def draw_release(lot_id: str) -> None:
    show_finished("release")
    if not has_units(lot_id):
        return
    status = cached_lot_status(lot_id)
    numbers([(verdict_word(word), str(count), None) for word, count in status.counts.items() if count])
    record = release_record(registry(), status)
    left, right = st.columns(2)
    with left, st.container(border=True):
        st.markdown(f"## {translate('release.state')}")
        if record is not None:
            by = translate("release.by", name=record.actor) if record.actor else ""
            st.success(
                translate("release.is", count=len(record.serials), at=format_instant(record.at), by=by),
                icon=":material/check:",
            )
        may_decide = allows("release") and status.decided is not None
        changes = cached_release_changes(lot_id) if may_decide else None
        if changes is not None and changes.changed:
            _decide(lot_id, changes)
        elif record is None:
            st.info(
                translate("release.nothing", why=cached_next_step(lot_id).render(current_translator())),
                icon=":material/hourglass:",
            )
    with right, st.container(border=True):
        _statement(status)
    with right, st.container(border=True):
        _archive(lot_id)
    for name, units in (("withdrawn", status.withdrawn), ("waiting", status.on(Disposition.WAITING))):
        if not units:
            continue
        st.markdown(f"## {translate(f'release.{name}')}: {len(units)}")
        st.caption(translate(f"release.{name}.means"))
        rows = [
            {
                translate("column.serial"): unit_link(UnitKey(lot_id, unit.serial)),
                translate("column.verdict"): verdict_word(unit.verdict),
                translate("column.reasons"): localize(unit.reasons[:1]),
            }
            for unit in units[:MAX_ROWS]
        ]
        with st.expander(translate("release.refused.which"), expanded=len(units) <= MAX_OPEN):
            table(rows)


def _decide(lot_id: str, changes: Changes) -> None:
    """Draw what a release would change, by the very decision that would be made, and make it."""
    for kind, units in (("released", changes.released), ("withdrawn", changes.withdrawn)):
        if units:
            st.markdown(translate(f"release.then.{kind}", count=len(units)))
            with st.expander(translate("release.refused.which"), expanded=len(units) <= MAX_OPEN):
                draw_changes(units)
    is_withdrawing = bool(changes.withdrawn)
    label = translate("release.do.withdrawing" if is_withdrawing else "release.do", count=len(changes.withdrawn))
    if st.button(label, type="primary", icon=":material/verified:", key="release-do"):
        permit("release")
        decide_lot(registry(), lot_id, actor())
        withdraw_recalled_files(registry(), list_affected_lots(registry(), lot_id))
        finish("release", translate("release.done", count=len(changes.released), lot=lot_id))


def _statement(status: LotStatus) -> None:
    decided, lot_id = status.decided, status.lot_id
    if decided is None:
        st.caption(translate("release.none"))
        return
    unit, audits = registry().lots.get(lot_id).reference_unit, decided.audits
    limit = decided.limit.maximum_rmse
    st.markdown(translate("release.evidence", audits=len(audits)))
    with st.expander(translate("release.words"), icon=":material/article:"):
        st.caption(localize(decided.statement))
        if audits:
            table(
                {
                    translate("column.serial"): unit_link(UnitKey(audit.lot_id or lot_id, audit.serial)),
                    translate("release.forecast"): number(audit.forecast_rmse, unit, limit),
                    translate("release.measured"): number(audit.measured_rmse, unit, limit),
                }
                for audit in sorted(audits, key=lambda audit: -audit.ratio)[:10]
            )
    if status.releasable:
        # The page would promise units that nobody has released yet.
        return

    def make() -> bytes:
        return lot_statement_pdf(build_lot_statement(registry(), status, decided), translator)

    translator = current_translator()
    exported = ("lots", (lot_id,), {"file": "statement.pdf"})
    download(translate("release.pdf"), f"{lot_id}-statement.pdf", make, "release-pdf", exported=exported)


def _archive(lot_id: str) -> None:
    st.markdown(f"## {translate('release.archive')}")
    formats = st.multiselect(
        translate("unit.files.format"),
        FORMATS,
        DEFAULT_FORMATS,
        format_func=label_formatter("format"),
        placeholder=translate("choose.some"),
    )
    conditional = st.toggle(translate("release.conditional"), help=translate("release.conditional.help"))
    job = newest_job("archive", lot=lot_id)
    is_off = is_running(job) or not formats
    if st.button(translate("release.pack"), icon=":material/folder_zip:", disabled=is_off, key="pack"):
        release = "conditional" if conditional else "pass"
        begin_job("archive", "look", lot=lot_id, serials=None, formats=formats, release=release)
        st.rerun()
    if job is None:
        st.caption(translate("release.pack.how"))
    elif job_panel(job):
        path = archive_path(job)
        if not path.is_file():
            st.caption(translate("release.pack.gone"))
            return
        if job.result["state"] != archived_state(registry(), lot_id):
            st.caption(translate("release.pack.old"))
            return
        label = translate("release.take", units=job.result["units"])
        download(label, f"{lot_id}.zip", path.read_bytes, "archive", kind="primary")
        if refused := job.result["refused"]:
            st.caption(translate("release.refused", count=len(refused)))
            with st.expander(translate("release.refused.which")):
                table([{translate("column.serial"): unit_link(UnitKey(lot_id, serial))} for serial, _ in refused])
