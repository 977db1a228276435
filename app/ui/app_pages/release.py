"""What leaves the house for a lot: the statement on its units, their files and certificates as one archive."""

from collections.abc import Sequence

import streamlit as st

from softcal.app.batch.release import judge_lot, lot_standing
from softcal.app.export.certificates.lot_facts import lot_statement_facts
from softcal.app.export.certificates.lot_statement import lot_statement_pdf
from softcal.app.export.names import FORMATS
from softcal.app.jobs.lot_jobs import archive_path
from softcal.app.jobs.process import start_job
from softcal.app.texts.reasons import said
from softcal.app.ui.account import actor, permit, person
from softcal.app.ui.callbacks import in_one_piece
from softcal.app.ui.components.job_panel import job_panel, newest_job
from softcal.app.ui.components.laboratory_form import laboratory_form
from softcal.app.ui.desk import errors_in_words, in_words, registry, words
from softcal.app.ui.panels import lot_heading, numbers, table, units_of
from softcal.app.views.common import number
from softcal.core.quality.lot_release import LotRelease
from softcal.core.quality.lot_standing import LotStanding, UnitInLot, Way
from softcal.db.access.people import may

USUAL_FORMATS = ("json", "pdf")
MOST_ROWS = 200


def render() -> None:
    """Draw the page."""
    say = words()
    with errors_in_words():
        lot_id = lot_heading("release", registry().lots.ids())
        if lot_id is None:
            return
        if done := st.session_state.pop("release-done", ""):
            st.success(done, icon=":material/check:")
        if not units_of(lot_id):
            return
        standing = lot_standing(registry(), lot_id)
        numbers([(say(f"verdict.{word}"), str(count), None) for word, count in standing.counts.items()])
        left, right = st.columns(2)
        with left, st.container(border=True):
            _statement(standing)
        with right, st.container(border=True):
            _archive(lot_id)
        for name, units in (("withdrawn", standing.withdrawn), ("waiting", standing.on(Way.WAITING))):
            _kept_back(name, units)
        laboratory_form()


def _kept_back(name: str, units: Sequence[UnitInLot]) -> None:
    """Draw the units that are not released, with the first reason of each; nothing where there are none."""
    say = words()
    if not units:
        return
    st.markdown(f"## {say(f'release.{name}')}: {len(units)}")
    st.caption(say(f"release.{name}.means"))
    rows = [
        {
            say("column.serial"): unit.serial,
            say("column.verdict"): say(f"verdict.{unit.verdict or 'none'}"),
            say("column.reasons"): "; ".join(said(why, say) for why in unit.reasons[:1]),
        }
        for unit in units[:MOST_ROWS]
    ]
    table(rows)


def _statement(standing: LotStanding) -> None:
    say, decided, lot_id = words(), standing.decided, standing.lot_id
    st.markdown(f"## {say('release.statement')}")
    if decided is None:
        st.caption(say("release.none"))
        return
    _said(decided, lot_id)
    if not may(person(), "release"):
        st.caption(say("reason.not_allowed", role=say(f"role.{person().role}")))
        return
    if st.button(say("release.do"), type="primary", icon=":material/verified:", key="release-do"):
        permit("release")
        made = judge_lot(registry(), lot_id, actor())
        released = len(made.released) if made is not None else 0
        st.session_state["release-done"] = say("release.done", count=released, lot=lot_id)
        st.rerun()
    facts = lot_statement_facts(registry(), standing, decided)
    st.download_button(
        say("release.pdf"),
        data=lambda: lot_statement_pdf(facts, say),
        file_name=f"{lot_id}-statement.pdf",
        mime="application/pdf",
        icon=":material/download:",
        key="release-pdf",
        on_click=_tell_statement,
        args=(lot_id,),
    )


def _said(decided: LotRelease, lot_id: str) -> None:
    say, unit = words(), registry().lots.get(lot_id).reference_unit
    limit = number(decided.limit.maximum_rmse, unit)
    audits = decided.audits
    st.markdown(say("release.counts", released=len(decided.released), open=len(decided.forecasts), limit=limit))
    st.markdown(say("release.evidence", audits=len(audits)))
    if audits:
        rows = [
            {
                say("column.serial"): audit.serial,
                say("release.forecast"): number(audit.forecast_rmse, unit),
                say("release.measured"): number(audit.measured_rmse, unit),
            }
            for audit in sorted(audits, key=lambda audit: -audit.ratio)[:10]
        ]
        table(rows)
    with st.expander(say("release.words"), icon=":material/article:"):
        st.caption(in_words(decided.statement))


@in_one_piece
def _tell_statement(lot_id: str) -> None:
    registry().trail.add("export", "lots", (lot_id,), {"file": "statement.pdf"}, actor=actor())


def _archive(lot_id: str) -> None:
    say = words()
    st.markdown(f"## {say('release.archive')}")
    formats = st.multiselect(
        say("unit.files.format"),
        FORMATS,
        USUAL_FORMATS,
        format_func=lambda name: say(f"format.{name}"),
        placeholder=say("choose.some"),
    )
    conditional = st.toggle(say("release.conditional"), help=say("release.conditional.help"))
    job = newest_job("archive", lot=lot_id)
    is_busy = job is not None and job.state.is_active
    if st.button(say("release.pack"), icon=":material/folder_zip:", disabled=is_busy or not formats, key="pack"):
        release = "conditional" if conditional else "pass"
        request = {"lot": lot_id, "serials": None, "formats": formats, "release": release}
        start_job(registry(), "archive", request, actor())
        st.rerun()
    if job is None:
        st.caption(say("release.pack.how"))
    elif job_panel(job):
        path = archive_path(job)
        if not path.is_file():
            st.caption(say("release.pack.gone"))
            return
        st.download_button(
            say("release.take", units=job.result["units"]),
            data=path.read_bytes,
            file_name=f"{lot_id}.zip",
            mime="application/zip",
            type="primary",
            icon=":material/download:",
            key="archive",
            on_click="ignore",
        )
        if refused := job.result["refused"]:
            st.caption(say("release.refused", count=len(refused)))
            with st.expander(say("release.refused.which")):
                table([{say("column.serial"): serial} for serial, _ in refused])
