"""The gap between the twin and a rig: choose a case, run the diagnosis, press what it proposes."""

from pathlib import Path

import streamlit as st

from softcal.app.gap.desk import cases, cases_folder, practise, store_upload
from softcal.app.ui.account import permit
from softcal.app.ui.actions import refusals_in_words
from softcal.app.ui.components.gap_report import gap_report
from softcal.app.ui.components.job_panel import begin_job, is_running, job_panel, newest_job
from softcal.app.ui.desk import empty, named, say
from softcal.app.ui.panels import heading

METADATA = (("vref_V", 5.0), ("adc_bits", 16), ("r_series_ohm", 1000.0), ("sample_rate_Hz", 50.0))


def render() -> None:
    wanted, known = str(st.query_params.get("case", "")), [str(case) for case in cases()]
    options = [wanted, *known] if wanted and wanted not in known else known
    case = None
    with heading("gap"):
        if options:
            index = options.index(wanted) if wanted in options else 0
            chosen = str(st.selectbox(say("gap.case"), options, index=index, format_func=_shown, key=f"case-{wanted}"))
            if chosen != wanted:
                st.query_params["case"] = chosen
            case = Path(chosen)
    with st.expander(say("gap.add"), icon=":material/add:", expanded=not known):
        folder, upload, rig = st.tabs([say("gap.add.folder"), say("gap.add.upload"), say("gap.add.rig")])
        with folder, st.form("case-folder", border=False):
            path = str(st.text_input(say("gap.folder"), placeholder="/data/rig-7")).strip()
            st.caption(say("gap.folder.how"))
            if st.form_submit_button(say("gap.folder.do")) and path:
                permit("set_up")
                if Path(path).is_dir():
                    _open(Path(path).resolve())
                st.error(say("gap.folder.none", path=path), icon=":material/error:")
        with upload, st.form("case-upload", border=False):
            left, right = st.columns(2)
            name = str(left.text_input(say("gap.name"), placeholder="rig-7"))
            serial = str(right.text_input(say("column.serial"), placeholder="A17"))
            values: dict[str, object] = {"serial": serial.strip()}
            for column, (key, usual) in zip(st.columns(len(METADATA)), METADATA, strict=True):
                least = 1 if key == "adc_bits" else type(usual)(1e-3)
                values[key] = column.number_input(key, value=usual, min_value=least)
            sensors, said = ("pressure", "strain"), named("gap.sensor")
            values["sensor_type"] = st.selectbox(say("gap.sensor"), sensors, format_func=said)
            files = st.file_uploader(say("gap.files"), type=["csv"], accept_multiple_files=True)
            st.caption(say("gap.files.how"))
            is_sent = st.form_submit_button(say("gap.upload.do"))
        with upload:
            if is_sent:
                permit("set_up")
                with refusals_in_words():
                    _open(store_upload(name.strip(), [file.getvalue() for file in files], values))
        with rig:
            st.caption(say("gap.rig.how"))
            if st.button(say("gap.rig.do"), icon=":material/casino:"):
                permit("set_up")
                with st.spinner(say("gap.rig.wait")):
                    _open(practise())
    if case is None:
        empty("gap.none")
        return
    job = newest_job("diagnose", case=str(case))
    label = say("gap.diagnose" if job is None else "gap.diagnose.again")
    if st.button(label, type="primary" if job is None else "secondary", disabled=is_running(job), key="diagnose"):
        begin_job("diagnose", case=str(case))
        st.rerun()
    if job is not None and job_panel(job):
        gap_report(job, case)


def _shown(path: str) -> str:
    folder = Path(path)
    return str(folder.relative_to(cases_folder())) if folder.is_relative_to(cases_folder()) else path


def _open(case: Path) -> None:
    st.query_params["case"] = str(case)
    st.rerun()
