"""The gap between the twin and a rig: the diagnoses, one of them, or two side by side."""

from pathlib import Path
from typing import Literal

import plotly.graph_objects as go
import streamlit as st

from softcal.app.charts import gap as gap_figures
from softcal.app.charts.gap_page import gap_page
from softcal.app.charts.style import apply_theme
from softcal.app.gap.page_cases import cases, cases_folder, has_sealed_rig, practise, run_views_of, store_upload, truth
from softcal.app.ui.account import allows, permit
from softcal.app.ui.actions import download, show_refusals
from softcal.app.ui.components.job_panel import begin_job, is_running, job_panel, newest_job
from softcal.app.ui.components.sign_in import ask_sign_in
from softcal.app.ui.panels import Link, heading, numbers, rest_may_follow, show_figure, table
from softcal.app.ui.presentation import colours, current_translator, empty, format_instant, label_formatter, translate
from softcal.app.ui.server_cache import registry
from softcal.app.views import gap
from softcal.app.views.common import percent
from softcal.app.views.gap import Report
from softcal.core.orders import RunState
from softcal.db.queues.job_board import Job

METADATA_DEFAULTS = (("vref_V", 5.0), ("adc_bits", 16), ("r_series_ohm", 1000.0), ("sample_rate_Hz", 50.0))
ICONS = {
    "no_gap": "check_circle",
    "explained": "lightbulb",
    "explained_in_part": "lightbulb",
    "ambiguous": "call_split",
    "unknown": "help",
    "data": "report",
}
MAX_CAUSES, MAX_LISTED = 8, 20


def render() -> None:
    if not allows("set_up"):
        heading("gap")
        ask_sign_in(("set_up",))
        return
    case, jobs = str(st.query_params.get("case", "")), _diagnoses()
    with heading("gap"):
        if case and st.button(translate("gap.list"), icon=":material/list:", key="gap-list"):
            st.query_params.clear()
            st.rerun()
    if case:
        _case(Path(case), jobs)
        return
    _list(jobs)
    paths = [str(paths) for paths in cases()]
    if undone := [paths for paths in paths if paths not in {job.request["case"] for job in jobs}]:
        table({translate("gap.case"): _case_link(case)} for case in undone)
    _add(is_first=not paths)


def _diagnoses() -> list[Job]:
    """Return the newest diagnoses, without their results."""
    return [job for job in registry().job_board.jobs("diagnose", count=MAX_LISTED) if job.state is RunState.DONE]


def _case_link(case: str, job_id: str = "", text: str = "") -> Link:
    return Link(text or _short_path(case), "gap", (("case", case), *((("job", job_id),) if job_id else ())))


def _list(jobs: list[Job]) -> None:
    """Draw the diagnoses, newest first: what each found, and how far it explains the gap."""
    rows = []
    for brief in jobs:
        report = registry().job_board.job(brief.job_id).result
        rows.append(
            {
                translate("column.made"): format_instant(brief.created),
                translate("gap.case"): _case_link(brief.request["case"], brief.job_id),
                translate("gap.says"): translate(f"gap.verdict.{report['verdict']}"),
                translate("gap.column.effect"): ", ".join(gap.cause_names(report, translate)),
                translate("gap.held_out"): percent(gap.explained_fractions(report).get("held_out")),
                translate("column.actor"): brief.actor,
            }
        )
    if rows:
        table(rows)
    else:
        empty("gap.none")


def _case(case: Path, jobs: list[Job]) -> None:
    """Draw the diagnosis of a case that the address names, else its newest, and another one beside it."""
    st.caption(_short_path(str(case)))
    job, requested_id = newest_job("diagnose", case=str(case)), str(st.query_params.get("job", ""))
    if requested_id and (job is None or not is_running(job)):
        job = registry().job_board.job(requested_id)
    label = translate("gap.diagnose" if job is None else "gap.diagnose.again")
    with st.container(horizontal=True, vertical_alignment="center"):
        kind: Literal["primary", "secondary"] = "primary" if job is None else "secondary"
        is_asked = st.button(label, type=kind, disabled=is_running(job), key="diagnose")
        is_calibrating = st.checkbox(translate("gap.diagnose.calibration"), key="gap-calibration")
    if is_asked:
        st.query_params.pop("job", None)
        begin_job("diagnose", case=str(case), calibration=is_calibrating)
        st.rerun()
    if job is None or not job_panel(job):
        return
    if (other := _other(job, jobs)) is None:
        gap_report(job, case)
        return
    for column, one in zip(st.columns(2), (job, other), strict=True):
        with column:
            st.caption(f"{_short_path(one.request['case'])} · {format_instant(one.created)}")
            _verdict(one.result)
            runs = run_views_of(one.result, registry().job_board.arrays(one))
            if (figure := gap_figures.worst_run_figure(runs, translate, colours())) is not None:
                _figure(figure, f"worst-{one.job_id}")
            _rows(gap.cause_rows(one.result, translate), gap.no_cause_text(one.result, translate))


def _other(job: Job, jobs: list[Job]) -> Job | None:
    """Let a person choose a diagnosis to show beside one; the choice stays in the address."""
    others = {other.job_id: other for other in jobs if other.job_id != job.job_id}
    if not others:
        return None
    names = {key: f"{_short_path(one.request['case'])} · {format_instant(one.created)}" for key, one in others.items()}
    requested_id, ids = str(st.query_params.get("with", "")), list(names)
    index = ids.index(requested_id) if requested_id in ids else None
    label, unset = translate("gap.beside"), translate("choose.some")
    chosen_id = st.selectbox(label, ids, index, names.__getitem__, key="gap-beside", placeholder=unset)
    if chosen_id is None:
        st.query_params.pop("with", None)
        return None
    st.query_params["with"] = chosen_id
    return registry().job_board.job(chosen_id)


def _add(is_first: bool) -> None:
    """Draw the ways to a new case."""
    with st.expander(translate("gap.add"), icon=":material/add:", expanded=is_first):
        folder, upload, rig = st.tabs(
            [translate("gap.add.folder"), translate("gap.add.upload"), translate("gap.add.rig")]
        )
        with folder, st.form("case-folder", border=False):
            path = str(st.text_input(translate("gap.folder"), placeholder="/data/rig-7")).strip()
            st.caption(translate("gap.folder.how"))
            if st.form_submit_button(translate("gap.folder.do")) and path:
                permit("set_up")
                if Path(path).is_dir():
                    _open(Path(path).resolve())
                st.error(translate("gap.folder.none", path=path), icon=":material/error:")
        with upload, st.form("case-upload", border=False):
            left, right = st.columns(2)
            name = str(left.text_input(translate("gap.name"), placeholder="rig-7"))
            serial = str(right.text_input(translate("column.serial"), placeholder="A17"))
            values: dict[str, object] = {"serial": serial.strip()}
            for column, (key, default) in zip(st.columns(len(METADATA_DEFAULTS)), METADATA_DEFAULTS, strict=True):
                min_value = 1 if key == "adc_bits" else type(default)(1e-3)
                values[key] = column.number_input(key, value=default, min_value=min_value)
            sensors, sensor_label = ("pressure", "strain"), label_formatter("gap.sensor")
            values["sensor_type"] = st.selectbox(translate("gap.sensor"), sensors, format_func=sensor_label)
            files = st.file_uploader(translate("gap.files"), type=["csv"], accept_multiple_files=True)
            st.caption(translate("gap.files.how"))
            is_sent = st.form_submit_button(translate("gap.upload.do"))
        with upload:
            if is_sent:
                permit("set_up")
                with show_refusals():
                    _open(store_upload(name.strip(), [file.getvalue() for file in files], values))
        with rig:
            st.caption(translate("gap.rig.how"))
            if st.button(translate("gap.rig.do"), icon=":material/casino:"):
                permit("set_up")
                with st.spinner(translate("gap.rig.wait")):
                    _open(practise())


def _short_path(path: str) -> str:
    folder = Path(path)
    return str(folder.relative_to(cases_folder())) if folder.is_relative_to(cases_folder()) else path


def _open(case: Path) -> None:
    st.query_params.clear()
    st.query_params["case"] = str(case)
    st.rerun()


def gap_report(job: Job, case: Path) -> None:
    """Draw the diagnosis a job has left."""
    report, board, texts = job.result, registry().job_board, current_translator()
    is_data = report["verdict"] == "data"
    _verdict(report)
    runs = run_views_of(report, board.arrays(job))
    if not is_data and (figure := gap_figures.worst_run_figure(runs, translate, colours())) is not None:
        _figure(figure, "worst")

    def page() -> str:
        return gap_page(report, runs, report["serial"], texts)

    # The standalone page in the language of the screen.
    download(translate("gap.page.save"), f"{case.name}-gap.html", page, "gap-page")
    # The figures of recordings with a mistake would show the mistake as a gap.
    if is_data and has_sealed_rig(case):
        _truth(case)
    if is_data or not rest_may_follow():
        return
    st.header(translate("gap.where"))
    if (figure := gap_figures.chain_figure(report, translate, colours())) is not None:
        _figure(figure, "chain")
    _rows(gap.location_rows(report, translate), translate("gap.where.none"))
    for channel in gap_figures.CHANNELS:
        figure = gap_figures.map_figure(runs, channel, translate)
        if figure is not None:
            _figure(figure, f"map-{channel}")
    st.header(translate("gap.why"))
    _figure(gap_figures.ranking_figure(report, MAX_CAUSES, translate, colours()), "ranking")
    _rows(gap.cause_rows(report, translate), gap.no_cause_text(report, translate))
    for group in gap.ambiguous_groups(report, translate):
        st.warning(translate("gap.ambiguous", group=group), icon=":material/call_split:")
    left, right = st.columns(2)
    with left:
        st.header(translate("gap.gain"))
        _figure(gap_figures.gain_figure(report, translate, colours()), "gain")
    with right:
        if (figure := gap_figures.hidden_figure(report, translate, colours())) is not None:
            st.header(translate("gap.sure"))
            if hidden := gap.hidden_effects(report, translate):
                st.caption(translate("gap.hidden", effects=", ".join(hidden)))
            _figure(figure, "hidden")
    if lines := gap.unidentifiable_lines(report, translate):
        st.header(translate("gap.told"))
        st.markdown("\n".join(f"- {gap.capitalize(line)}" for line in lines))
    if residual := report.get("residual"):
        st.header(translate("gap.left"))
        shares = {name: percent(residual["shrink"][name]) for name in ("held_out", "low", "high")}
        st.markdown(translate("gap.left.is", **shares))
        _rows(gap.residual_rows(report, translate), translate("gap.left"))
        if residual["beside"]:
            other_effects = gap.join_names(
                [gap.effect_name(effect, translate) for effect in residual["beside"]], "gap.and", translate
            )
            st.caption(translate("gap.left.beside", causes=other_effects, without=percent(residual["without"])))
        st.caption(translate("gap.left.span", **{name: f"{residual[name]:.3g}" for name in ("load_N", "depth_mm")}))
    _next(report, case)
    with st.expander(translate("gap.runs"), icon=":material/show_chart:"):
        for channel, name in gap_figures.CHANNELS.items():
            if figure := gap_figures.trace_figure(runs, channel, translate, colours()):
                st.subheader(gap.capitalize(translate("gap.figure.trace", channel=gap.channel_name(name, translate))))
                _figure(figure, f"trace-{channel}")


def _verdict(report: Report) -> None:
    """Draw verdict, mistakes, causes, and how far they explain the gap."""
    is_data = report["verdict"] == "data"
    st.header(f":material/{ICONS[report['verdict']]}: {translate('gap.verdict.' + report['verdict'])}")
    for row in gap.mistake_rows(report, translate):
        announce = st.error if is_data else st.warning
        announce(translate("gap.data.found", **row), icon=":material/report:")
    if is_data:
        return
    left, right = st.columns([3, 2])
    with left:
        if causes := gap.cause_names(report, translate):
            st.markdown(translate("gap.causes", causes=", ".join(causes)))
        if partial := report.get("partial"):
            names = [gap.effect_name(effect, translate) for effect in partial["effects"]]
            effects = gap.join_names(names, "gap.and", translate)
            st.markdown(translate("gap.partial", causes=effects, share=percent(partial["share"])))
        if errors := report.get("calibration"):
            newtons = {name: f"{errors[name]:.3g}" for name in ("base", "repaired", "rig")}
            st.markdown(translate("gap.gain.calibration", run=errors["run"], **newtons))
        if report["missing_channels"]:
            st.caption(translate("gap.missing", channels=", ".join(report["missing_channels"])))
    fractions = gap.explained_fractions(report)
    cells = [
        (translate(f"gap.{name}"), percent(fractions.get(key)), translate(f"gap.{name}.help"))
        for name, key in (("forecast", "predicted"), ("held_out", "held_out"))
        if fractions.get(key) is not None
    ]
    with right:
        if cells:
            numbers(cells)
        if fractions.get("low") is not None:
            st.caption(translate("gap.interval", low=percent(fractions["low"]), high=percent(fractions["high"])))


def _next(report: Report, case: Path) -> None:
    proposed = gap.next_experiment(report)
    st.header(translate("gap.next"))
    with st.container(border=True):
        if proposed is None:
            st.markdown(translate("gap.next.none"))
        else:
            minutes = f" · {proposed['minutes']:.0f} min" if proposed.get("minutes") else ""
            name = gap.profile_name(str(proposed["profile"]), translate)
            st.markdown(f"**{name}**{minutes}  \n{gap.next_run_reason(proposed, translate)}")
            if not has_sealed_rig(case):
                st.caption(translate("gap.next.by_hand", experiment=name))
            elif allows("set_up") and st.button(translate("gap.next.do"), type="primary", icon=":material/play_arrow:"):
                begin_job("diagnose", case=str(case), experiment=str(proposed["profile"]))
                st.rerun()
        if has_sealed_rig(case):
            _truth(case)


def _truth(case: Path) -> None:
    if st.toggle(translate("gap.truth"), key=f"truth-{case}"):
        effects, mistake = truth(case)
        hidden = [gap.effect_name(effect, translate) for effect in effects]
        if mistake is not None:
            values = {"mistake": gap.mistake_name(mistake.what, translate), "runs": ", ".join(map(str, mistake.runs))}
            values |= {"channel": gap.channel_name(mistake.channel, translate) if mistake.channel else "–"}
            key = "gap.truth.mistake" if mistake.runs else "gap.truth.mistake.all"
            hidden.append(translate(key, **values))
        st.markdown(translate("gap.truth.is", causes=", ".join(hidden) or translate("trail.nothing")))


def _rows(rows: list[dict[str, str]], otherwise: str) -> None:
    table([{translate(f"gap.column.{name}"): value for name, value in row.items()} for row in rows], otherwise)


def _figure(figure: go.Figure, key: str) -> None:
    """Draw a figure made for paper in the colours of the theme."""
    layout = {name: figure.layout[name].to_plotly_json() for name in ("margin", "legend")}
    themed_figure = apply_theme(figure, colours(), figure.layout.height).update_layout(**layout)
    show_figure(themed_figure.update_xaxes(automargin=True).update_yaxes(automargin=True), key)
