"""Units in use: which need a calibration, and the course of one over time."""

import streamlit as st

from softcal.app.charts.long_term import course_figure
from softcal.app.texts.reasons import phrase
from softcal.app.ui.desk import choose, colours, empty, instant, say
from softcal.app.ui.panels import heading, rest_may_follow, show_figure, table
from softcal.app.ui.server_memory import registry
from softcal.app.views.common import number
from softcal.app.views.long_term import course, units_in_use
from softcal.core.lot import UnitKey


def render() -> None:
    beside = heading("long_term")
    units = units_in_use(registry())
    if not units:
        empty("long_term.none")
        return
    with beside:
        key = UnitKey.parse(choose(say("choose.unit"), [str(unit.key) for unit, _ in units], "unit") or "")
    table(
        {
            say("choose.lot"): unit.lot_id,
            say("column.serial"): unit.serial,
            say("column.state"): say("event.alarm" if unit.entry["alarm"] else f"event.{unit.entry['verdict']}"),
            say("lot.predicted"): number(unit.entry["predicted_rmse"], reference_unit),
            say("chart.drift_scale"): number(unit.entry["shift"]),
            say("long_term.steps"): unit.steps,
            say("column.made"): instant(unit.made_at),
            say("column.remark"): phrase("adapt", unit.entry["alarm"], say),
        }
        for unit, reference_unit in units
    )
    streams = registry().adaptations.streams(key)
    stream = streams[0] if len(streams) == 1 else str(st.selectbox(say("long_term.stream"), streams))
    stream_course = course(registry(), key, stream)
    st.header(say("long_term.course", serial=key.serial))
    if stream_course.alarm:
        why = phrase("adapt", stream_course.alarm, say)
        st.warning(why, icon=":material/notification_important:", title=say("long_term.due"))
    if not stream_course.steps:
        st.caption(say("long_term.no_steps"))
        return
    if rest_may_follow():
        show_figure(course_figure(stream_course, colours(), say), f"course-{key}")
