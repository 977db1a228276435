"""What leaves the house for a lot: the statement on its units, their files and certificates."""

from dataclasses import fields, replace
from functools import partial
from typing import Any

import streamlit as st

from softcal.app.batch.changes import reached_lots
from softcal.app.batch.release import decide_lot, lot_standing
from softcal.app.export.certificates import laboratory
from softcal.app.export.certificates.lot_statement import lot_statement_facts, lot_statement_pdf
from softcal.app.export.export import withdraw_given
from softcal.app.export.names import FORMATS
from softcal.app.jobs.jobs import archive_path
from softcal.app.ui.account import actor, permit
from softcal.app.ui.actions import download, finish, refusals_in_words, role_allows, say_finished
from softcal.app.ui.components.job_panel import begin_job, is_running, job_panel, newest_job
from softcal.app.ui.desk import in_words, named, say, words
from softcal.app.ui.panels import for_lot, has_units, numbers, table
from softcal.app.ui.server_memory import registry
from softcal.app.views.common import number
from softcal.core.quality.lot_standing import LotStanding, Way

USUAL_FORMATS = ("json", "pdf")
MOST_ROWS = 200


@for_lot("release")
def render(lot_id: str) -> None:
    say_finished("release")
    if not has_units(lot_id):
        return
    standing = lot_standing(registry(), lot_id)
    numbers([(say(f"verdict.{word}"), str(count), None) for word, count in standing.counts.items()])
    left, right = st.columns(2)
    with left, st.container(border=True):
        _statement(standing)
    with right, st.container(border=True):
        _archive(lot_id)
    for name, units in (("withdrawn", standing.withdrawn), ("waiting", standing.on(Way.WAITING))):
        if not units:
            continue
        st.markdown(f"## {say(f'release.{name}')}: {len(units)}")
        st.caption(say(f"release.{name}.means"))
        table(
            {
                say("column.serial"): unit.serial,
                say("column.verdict"): say(f"verdict.{unit.verdict or 'none'}"),
                say("column.reasons"): in_words(unit.reasons[:1]),
            }
            for unit in units[:MOST_ROWS]
        )
    with st.expander(say("laboratory.title"), icon=":material/badge:"):
        _laboratory()


def _statement(standing: LotStanding) -> None:
    decided, lot_id = standing.decided, standing.lot_id
    st.markdown(f"## {say('release.statement')}")
    if decided is None:
        st.caption(say("release.none"))
        return
    unit, audits = registry().lots.get(lot_id).reference_unit, decided.audits
    limit = number(decided.limit.maximum_rmse, unit)
    st.markdown(say("release.counts", released=len(decided.released), open=len(decided.forecasts), limit=limit))
    st.markdown(say("release.evidence", audits=len(audits)))
    if audits:
        table(
            {
                say("column.serial"): audit.serial,
                say("release.forecast"): number(audit.forecast_rmse, unit),
                say("release.measured"): number(audit.measured_rmse, unit),
            }
            for audit in sorted(audits, key=lambda audit: -audit.ratio)[:10]
        )
    with st.expander(say("release.words"), icon=":material/article:"):
        st.caption(in_words(decided.statement))
    if not role_allows("release"):
        return
    if st.button(say("release.do"), type="primary", icon=":material/verified:", key="release-do"):
        permit("release")
        made = decide_lot(registry(), lot_id, actor())
        withdraw_given(registry(), reached_lots(registry(), lot_id))
        released = len(made.released) if made is not None else 0
        finish("release", say("release.done", count=released, lot=lot_id))
    make = partial(lot_statement_pdf, lot_statement_facts(registry(), standing, decided), words())
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
        label = say("release.take", units=job.result["units"])
        download(label, f"{lot_id}.zip", path.read_bytes, "archive", kind="primary")
        if refused := job.result["refused"]:
            st.caption(say("release.refused", count=len(refused)))
            with st.expander(say("release.refused.which")):
                table([{say("column.serial"): serial} for serial, _ in refused])


PARTS = {"laboratory": laboratory.Party, "customer": laboratory.Party, "person": laboratory.Person}


def _laboratory() -> None:
    """Draw the form, filled with what is kept, of what every later certificate says."""
    st.caption(say("laboratory.how"))
    kept = laboratory.registry_laboratory(registry())
    if not role_allows("set_up"):
        return
    cells = {entry.cell_serial: entry for entry in registry().stations.certificates()}
    given: dict[str, dict[str, str]] = {}
    with st.form("laboratory", border=False):
        for name in PARTS:
            st.markdown(f"**{say(f'laboratory.{name}')}**")
            part, given[name] = getattr(kept, name), {}
            names = [field.name for field in fields(part)]
            for column, field in zip(st.columns(len(names)), names, strict=True):
                value = str(getattr(part, field))
                shown = "" if value in (laboratory.NOT_STATED, laboratory.NO_COUNTRY) else value
                label, key = say(f"laboratory.{field}"), f"laboratory-{name}-{field}"
                nothing = laboratory.NO_COUNTRY if field == "country" else laboratory.NOT_STATED
                given[name][field] = str(column.text_input(label, shown, key=key)).strip() or nothing

        st.markdown(f"**{say('laboratory.conditions')}**")
        left, right, _, _ = st.columns(4)
        label, usual = f"{say('laboratory.temperature')} [°C]", kept.conditions
        temperature_C = left.number_input(label, -50.0, 150.0, usual.temperature_C, format="%.1f")
        label = f"{say('laboratory.humidity')} [%]"
        humidity_pct = right.number_input(label, 0.0, 100.0, usual.humidity_pct, format="%.0f")

        st.markdown(f"**{say('laboratory.load_cell')}**")
        load_cell = kept.load_cell
        options = [load_cell.serial, *(serial for serial in cells if serial != load_cell.serial)]
        unstated = {laboratory.NOT_STATED: say("laboratory.not_stated")}
        left, _ = st.columns(2)
        chosen = str(
            left.selectbox(say("cells.serial"), options, 0, lambda one: unstated.get(one, one), "laboratory-cell")
        )
        if chosen == load_cell.serial and load_cell.due_on is not None:
            st.caption(say("laboratory.due", due=f"{load_cell.due_on}"))
        if not st.form_submit_button(say("laboratory.save"), type="primary"):
            return
    permit("set_up")
    with refusals_in_words():
        changed: dict[str, Any] = {name: PARTS[name](**values) for name, values in given.items()}
        changed["conditions"] = replace(usual, temperature_C=temperature_C, humidity_pct=humidity_pct)
        if entry := cells.get(chosen):
            same = ("laboratory", "issued_on", "due_on", "uncertainty_N")
            facts = {name: getattr(entry, name) for name in same}
            changed["load_cell"] = laboratory.LoadCell(serial=entry.cell_serial, certificate=entry.number, **facts)
        laboratory.keep_laboratory(registry(), replace(kept, **changed), actor())
        finish("release", say("laboratory.saved"))
