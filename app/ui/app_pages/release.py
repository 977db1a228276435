"""What leaves the house for a lot: the statement on its units, their files and certificates as one archive."""

from collections.abc import Sequence
from dataclasses import fields, replace
from datetime import date
from typing import Any

import streamlit as st

from softcal.app.batch.release import judge_lot, lot_standing
from softcal.app.export.certificates.laboratory import (
    NO_COUNTRY,
    NOT_STATED,
    Conditions,
    LoadCell,
    Party,
    Person,
    keep_laboratory,
    kept_laboratory,
    read_laboratory,
)
from softcal.app.export.certificates.lot_statement import lot_statement_facts, lot_statement_pdf
from softcal.app.export.names import FORMATS
from softcal.app.jobs.lot_jobs import archive_path
from softcal.app.jobs.process import start_job
from softcal.app.texts.reasons import said
from softcal.app.ui.account import actor, permit, person
from softcal.app.ui.callbacks import in_one_piece
from softcal.app.ui.components.job_panel import job_panel, newest_job
from softcal.app.ui.desk import errors_in_words, in_words, registry, words
from softcal.app.ui.panels import lot_heading, numbers, table, units_of
from softcal.app.views.common import number
from softcal.core.errors import InputError
from softcal.core.quality.lot_release import LotRelease
from softcal.core.quality.lot_standing import LotStanding, UnitInLot, Way
from softcal.db.access.people import may
from softcal.db.entries import CellCertificate

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


PARTS = {"laboratory": Party, "customer": Party, "person": Person}


def laboratory_form() -> None:
    """Draw the form, filled with what is kept; what it says stands on every certificate from then on."""
    say = words()
    with st.expander(say("laboratory.title"), icon=":material/badge:"):
        st.caption(say("laboratory.how"))
        kept = read_laboratory(kept_laboratory())
        if not may(person(), "set_up"):
            st.caption(say("reason.not_allowed", role=say(f"role.{person().role}")))
            return
        cells = {entry.cell_serial: entry for entry in registry().stations.certificates()}
        with st.form("laboratory", border=False):
            given = {name: _section(name, getattr(kept, name)) for name in PARTS}
            conditions = _conditions(kept.conditions)
            cell = _cell(kept.load_cell, list(cells))
            if not st.form_submit_button(say("laboratory.save"), type="primary"):
                return
        permit("set_up")
        try:
            parts: dict[str, Any] = {name: PARTS[name](**values) for name, values in given.items()}
            load_cell = _of_certificate(cells[cell]) if cell in cells else kept.load_cell
            stated = replace(kept, **parts, conditions=conditions, load_cell=load_cell)
        except InputError as error:
            st.error(in_words(error), icon=":material/error:")
            return
        keep_laboratory(stated)
        registry().trail.add("change", "laboratory", ("certificates",), {**given, "load_cell": cell}, actor=actor())
        st.session_state["release-done"] = say("laboratory.saved")
        st.rerun()


def _section(name: str, kept: Party | Person) -> dict[str, str]:
    say = words()
    st.markdown(f"**{say(f'laboratory.{name}')}**")
    names = [field.name for field in fields(kept)]
    given = {}
    for column, field in zip(st.columns(len(names)), names, strict=True):
        value = str(getattr(kept, field))
        shown = "" if value in (NOT_STATED, NO_COUNTRY) else value
        text = str(column.text_input(say(f"laboratory.{field}"), shown, key=f"laboratory-{name}-{field}")).strip()
        given[field] = text or (NO_COUNTRY if field == "country" else NOT_STATED)
    return given


def _conditions(kept: Conditions) -> Conditions:
    say = words()
    st.markdown(f"**{say('laboratory.conditions')}**")
    left, right, _, _ = st.columns(4)
    temperature_C = left.number_input(
        f"{say('laboratory.temperature')} [°C]", -50.0, 150.0, value=kept.temperature_C, format="%.1f"
    )
    humidity_pct = right.number_input(
        f"{say('laboratory.humidity')} [%]", 0.0, 100.0, value=kept.humidity_pct, format="%.0f"
    )
    return replace(kept, temperature_C=temperature_C, humidity_pct=humidity_pct)


def _cell(kept: LoadCell, known: list[str]) -> str:
    say = words()
    st.markdown(f"**{say('laboratory.load_cell')}**")
    options = [kept.serial, *(serial for serial in known if serial != kept.serial)]
    shown = {NOT_STATED: say("laboratory.not_stated")}
    left, _ = st.columns(2)
    chosen = str(
        left.selectbox(
            say("cells.serial"), options, format_func=lambda serial: shown.get(serial, serial), key="laboratory-cell"
        )
    )
    due: date | None = kept.due_on if chosen == kept.serial else None
    if due is not None:
        st.caption(say("laboratory.due", due=f"{due:%Y-%m-%d}"))
    return chosen


def _of_certificate(entry: CellCertificate) -> LoadCell:
    """Return what certificates say of a load cell whose certificate the registry has; its due date with it."""
    return LoadCell(
        serial=entry.cell_serial,
        certificate=entry.number,
        laboratory=entry.laboratory,
        issued_on=entry.issued_on,
        due_on=entry.due_on,
        uncertainty_N=entry.uncertainty_N,
    )
