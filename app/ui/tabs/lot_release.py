"""What of a lot leaves the house: nothing yet and why, what can be released, or what was; and its archive."""

import streamlit as st

from softcal.app.calibration.changes import Changes, reached_lots
from softcal.app.calibration.release import decide_lot
from softcal.app.export.certificates.lot_statement import build_lot_statement, lot_statement_pdf
from softcal.app.export.export import withdraw_given
from softcal.app.export.names import FORMATS
from softcal.app.jobs.jobs import archive_path, archived_state
from softcal.app.ui.account import actor, allows, permit
from softcal.app.ui.actions import download, finish, say_finished
from softcal.app.ui.components.job_panel import begin_job, is_running, job_panel, newest_job
from softcal.app.ui.components.verdict_changes import draw_changes
from softcal.app.ui.desk import in_words, instant, named, say, verdict_word, words
from softcal.app.ui.panels import has_units, numbers, table, unit_link
from softcal.app.ui.server_memory import (
    registry,
    remembered_release_changes,
    remembered_standing,
    remembered_step,
)
from softcal.app.views.common import number
from softcal.app.views.next_step import release_record
from softcal.core.lot import UnitKey
from softcal.core.quality.lot_standing import LotStanding, Way

USUAL_FORMATS = ("json", "pdf")
MOST_ROWS, MOST_OPEN = 200, 8
"""So many units are listed, and so many stand open on the page."""


def draw_release(lot_id: str) -> None:
    say_finished("release")
    if not has_units(lot_id):
        return
    standing = remembered_standing(lot_id)
    numbers([(verdict_word(word), str(count), None) for word, count in standing.counts.items() if count])
    record = release_record(registry(), standing)
    left, right = st.columns(2)
    with left, st.container(border=True):
        st.markdown(f"## {say('release.state')}")
        if record is not None:
            by = say("release.by", name=record.actor) if record.actor else ""
            st.success(
                say("release.is", count=len(record.serials), at=instant(record.at), by=by), icon=":material/check:"
            )
        may_decide = allows("release") and standing.decided is not None
        changes = remembered_release_changes(lot_id) if may_decide else None
        if changes is not None and changes.changed:
            _decide(lot_id, changes)
        elif record is None:
            st.info(say("release.nothing", why=remembered_step(lot_id).render(words())), icon=":material/hourglass:")
    with right, st.container(border=True):
        _statement(standing)
    with right, st.container(border=True):
        _archive(lot_id)
    for name, units in (("withdrawn", standing.withdrawn), ("waiting", standing.on(Way.WAITING))):
        if not units:
            continue
        st.markdown(f"## {say(f'release.{name}')}: {len(units)}")
        st.caption(say(f"release.{name}.means"))
        rows = [
            {
                say("column.serial"): unit_link(UnitKey(lot_id, unit.serial)),
                say("column.verdict"): verdict_word(unit.verdict),
                say("column.reasons"): in_words(unit.reasons[:1]),
            }
            for unit in units[:MOST_ROWS]
        ]
        with st.expander(say("release.refused.which"), expanded=len(units) <= MOST_OPEN):
            table(rows)


def _decide(lot_id: str, changes: Changes) -> None:
    """Draw what a release would change, by the very decision that would be made, and make it."""
    for kind, units in (("released", changes.released), ("withdrawn", changes.withdrawn)):
        if units:
            st.markdown(say(f"release.then.{kind}", count=len(units)))
            with st.expander(say("release.refused.which"), expanded=len(units) <= MOST_OPEN):
                draw_changes(units)
    is_withdrawing = bool(changes.withdrawn)
    label = say("release.do.withdrawing" if is_withdrawing else "release.do", count=len(changes.withdrawn))
    if st.button(label, type="primary", icon=":material/verified:", key="release-do"):
        permit("release")
        decide_lot(registry(), lot_id, actor())
        withdraw_given(registry(), reached_lots(registry(), lot_id))
        finish("release", say("release.done", count=len(changes.released), lot=lot_id))


def _statement(standing: LotStanding) -> None:
    decided, lot_id = standing.decided, standing.lot_id
    if decided is None:
        st.caption(say("release.none"))
        return
    unit, audits = registry().lots.get(lot_id).reference_unit, decided.audits
    limit = decided.limit.maximum_rmse
    st.markdown(say("release.evidence", audits=len(audits)))
    with st.expander(say("release.words"), icon=":material/article:"):
        st.caption(in_words(decided.statement))
        if audits:
            table(
                {
                    say("column.serial"): audit.serial,
                    say("release.forecast"): number(audit.forecast_rmse, unit, limit),
                    say("release.measured"): number(audit.measured_rmse, unit, limit),
                }
                for audit in sorted(audits, key=lambda audit: -audit.ratio)[:10]
            )
    if standing.releasable:
        # The page would promise units that nobody has released yet.
        return

    def make() -> bytes:
        return lot_statement_pdf(build_lot_statement(registry(), standing, decided), said)

    said = words()
    exported = ("lots", (lot_id,), {"file": "statement.pdf"})
    download(say("release.pdf"), f"{lot_id}-statement.pdf", make, "release-pdf", exported=exported)


def _archive(lot_id: str) -> None:
    st.markdown(f"## {say('release.archive')}")
    formats = st.multiselect(
        say("unit.files.format"), FORMATS, USUAL_FORMATS, format_func=named("format"), placeholder=say("choose.some")
    )
    conditional = st.toggle(say("release.conditional"), help=say("release.conditional.help"))
    job = newest_job("archive", lot=lot_id)
    is_off = is_running(job) or not formats
    if st.button(say("release.pack"), icon=":material/folder_zip:", disabled=is_off, key="pack"):
        release = "conditional" if conditional else "pass"
        begin_job("archive", "look", lot=lot_id, serials=None, formats=formats, release=release)
        st.rerun()
    if job is None:
        st.caption(say("release.pack.how"))
    elif job_panel(job):
        path = archive_path(job)
        if not path.is_file():
            st.caption(say("release.pack.gone"))
            return
        if job.result["state"] != archived_state(registry(), lot_id):
            st.caption(say("release.pack.old"))
            return
        label = say("release.take", units=job.result["units"])
        download(label, f"{lot_id}.zip", path.read_bytes, "archive", kind="primary")
        if refused := job.result["refused"]:
            st.caption(say("release.refused", count=len(refused)))
            with st.expander(say("release.refused.which")):
                table([{say("column.serial"): serial} for serial, _ in refused])
