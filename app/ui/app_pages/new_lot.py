"""A new lot out of files: drop them, map the columns, name the source, see what would be refused, calibrate."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path

import pandas as pd
import streamlit as st

from softcal.app.batch.front_door import Expected, expect, store_lot
from softcal.app.charts.new_lot import columns_over_time, reference_over_output
from softcal.app.files.importing import Columns, ImportPlan, median_rate_Hz
from softcal.app.jobs.process import start_job
from softcal.app.texts.reasons import all_said
from softcal.app.ui.account import actor, permit
from softcal.app.ui.components.job_panel import job_panel, newest_job
from softcal.app.ui.components.lot_upload import choose_columns, dropped_files, first_readable, forget_files
from softcal.app.ui.desk import colours, in_words, registry, show_figure, words
from softcal.app.ui.panels import go_to, heading, table
from softcal.core.errors import InputError
from softcal.core.lot import Lot

ROWS = 5
ASKED = "new-lot-asked"


@dataclass(frozen=True)
class _Facts:
    """What the form of the lot says."""

    name: str
    source: str
    model: str
    quantity: str
    reference_unit: str
    output_unit: str
    limit: float | None
    audit: bool


def render() -> None:
    say = words()
    heading("new_lot")
    if asked := st.session_state.get(ASKED):
        _calibrating(asked)
        return
    with _step(1):
        st.caption(say("new_lot.files.how"))
        files = dropped_files()
        found = first_readable(files) if files else None
    if found is None:
        return
    with _step(2):
        columns, rate_Hz = _columns(*found)
    with _step(3):
        facts = _facts(files, found[1], columns)
    if not rate_Hz or not facts.name:
        st.info(say("new_lot.missing"), icon=":material/edit:")
        return
    try:
        plan = _plan(files, columns, rate_Hz, facts)
    except InputError as error:
        st.error(in_words(error), icon=":material/error:")
        return
    with _step(4):
        usable = _expected(plan)
    if usable is not None and st.button(say("new_lot.do"), type="primary", icon=":material/play_arrow:"):
        permit("set_up")
        store_lot(registry(), usable, actor())
        start_job(registry(), "calibrate", {"lot": usable.lot.id}, actor())
        forget_files()
        st.session_state[ASKED] = usable.lot.id
        st.rerun()


def _step(number: int) -> st.delta_generator.DeltaGenerator:
    box = st.container(border=True)
    box.markdown(f"## {number} · {words()(f'new_lot.step.{number}')}")
    return box


def _columns(path: Path, content: pd.DataFrame) -> tuple[Columns, float]:
    """Draw preview, choice and plots; return the columns and the sample rate in Hz, 0 while nobody knows it."""
    say = words()
    st.caption(say("new_lot.preview", file=path.name, rows=len(content), columns=len(content.columns)))
    st.dataframe(content.head(ROWS), width="stretch", hide_index=True)
    shapes = {"files": say("new_lot.shape.files"), "wide": say("new_lot.shape.wide")}
    shape = st.radio(say("new_lot.shape"), list(shapes), format_func=shapes.__getitem__, horizontal=True)
    columns = choose_columns(content, shape == "wide")
    rate_Hz = _rate_Hz(path, columns.time)
    left, right = st.columns(2)
    with left:
        show_figure(columns_over_time(content, columns, colours(), words()), "new-lot-figure")
    with right:
        if columns.reference is not None and (figure := reference_over_output(content, columns, colours(), words())):
            show_figure(figure, "new-lot-figure-reference")
    return columns, rate_Hz


def _rate_Hz(path: Path, time_column: str | None) -> float:
    say = words()
    if time_column is None:
        return float(st.number_input(f"{say('column.rate')} [Hz]", 0.1, 100_000.0, 50.0, key="new-lot-rate"))
    try:
        rate_Hz = median_rate_Hz(path, time_column)
    except InputError as error:
        told = str(error).replace(f"{path}: ", "").split(";")[0]
        st.error(say("new_lot.time.refused", why=told), icon=":material/error:")
        return 0.0
    st.caption(say("new_lot.rate", rate=f"{rate_Hz:g}"))
    return rate_Hz


def _facts(files: Sequence[Path], content: pd.DataFrame, columns: Columns) -> _Facts:
    say = words()
    if columns.is_wide:
        others = {columns.reference, columns.time, columns.stage}
        names = (str(name) for name in content.columns if name not in others)
        serials = [name for name in names if fnmatchcase(name, columns.output)]
    else:
        serials = [file.stem for file in files]
    first, second, third, fourth = st.columns(4)
    name = str(first.text_input(say("source.lot_id"), placeholder="2026-48", key="new-lot-name")).strip()
    source = str(second.selectbox(say("new_lot.source"), serials, key="new-lot-source") or "")
    model = str(third.text_input(say("source.model"), placeholder="eGaIn pad, 3 mm", key="new-lot-model")).strip()
    limit = fourth.number_input(say("lot.limit"), 0.0, value=None, format="%.4g", help=say("lot.limit.help"))
    first, second, third, fourth = st.columns(4, vertical_alignment="bottom")
    quantity = str(first.text_input(say("source.quantity"), "force", key="new-lot-quantity")).strip()
    reference = str(second.text_input(say("source.reference_unit"), "N", key="new-lot-unit")).strip()
    output = str(third.text_input(say("source.output_unit"), "V", key="new-lot-output-unit")).strip()
    audit = fourth.toggle(say("new_lot.audit"), True, help=say("new_lot.audit.help"), key="new-lot-audit")
    return _Facts(name, source, model, quantity, reference, output, limit or None, audit)


def _plan(files: Sequence[Path], columns: Columns, rate_Hz: float, facts: _Facts) -> ImportPlan:
    units = (facts.quantity, facts.reference_unit, facts.output_unit)
    lot = Lot(facts.name, facts.source, rate_Hz, facts.model, *units, facts.limit)
    return ImportPlan(files, columns, lot, facts.audit)


def _expected(plan: ImportPlan) -> ImportPlan | None:
    """Draw what would become of every unit; return the plan without what is refused, None where no lot is left."""
    say = words()
    expected = expect(plan)
    refused = [one for one in expected if one.problem]
    doubtful = [one for one in expected if one.findings]
    good = len(expected) - len(refused) - len(doubtful)
    st.markdown(say("new_lot.expected", good=good, doubtful=len(doubtful), refused=len(refused)))
    worst_first = sorted(expected, key=lambda one: (not one.problem, not one.findings))
    table([_row(one, plan.lot.source) for one in worst_first])
    source = next((one for one in expected if one.serial == plan.lot.source), None)
    if source is None or source.problem or plan.columns.reference is None:
        st.error(say("new_lot.no_source", source=plan.lot.source), icon=":material/error:")
        return None
    if len(expected) - len(refused) < 2:
        st.error(say("new_lot.no_units"), icon=":material/error:")
        return None
    unreadable = {one.file for one in refused if not one.serial}
    files = tuple(file for file in plan.files if file.name not in unreadable)
    return replace(plan, files=files, without=frozenset(one.serial for one in refused if one.serial))


def _row(one: Expected, source: str) -> dict[str, object]:
    say = words()
    will = "refused" if one.problem else "source" if one.serial == source else "doubtful" if one.findings else "good"
    return {
        say("new_lot.column.file"): one.file,
        say("column.serial"): one.serial or None,
        say("new_lot.column.rows"): one.rows or None,
        say("column.duration"): f"{one.seconds:.0f} s" if one.rows else None,
        say("new_lot.column.will"): say(f"new_lot.will.{will}"),
        say("column.reasons"): in_words(one.problem) if one.problem else all_said(one.findings, say),
    }


def _calibrating(lot_id: str) -> None:
    """Draw how far the calibration is, and lead to the lot once it is done."""
    say = words()
    st.markdown(say("new_lot.calibrating", lot=lot_id))
    job = newest_job("calibrate", lot=lot_id)
    if job is None or job_panel(job):
        del st.session_state[ASKED]
        go_to("lot", lot=lot_id)
    elif not job.state.is_active and st.button(say("new_lot.to_lot"), icon=":material/arrow_forward:"):
        del st.session_state[ASKED]
        go_to("lot", lot=lot_id)
