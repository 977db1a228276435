"""A unit in use: the course of its drift over each stream, and whether a calibration is due."""

import streamlit as st

from softcal.app.charts.long_term import course_figure
from softcal.app.texts.reasons import phrase
from softcal.app.ui.desk import colours, instant, say
from softcal.app.ui.panels import numbers, rest_may_follow, show_figure
from softcal.app.ui.server_memory import registry
from softcal.app.views.common import number
from softcal.app.views.long_term import course, units_in_use
from softcal.core.lot import UnitKey


def draw_long_use(key: UnitKey) -> None:
    """Draw the state and the course of a unit in use; nothing where it is not followed."""
    use = next((found for found in units_in_use(registry()) if found[0].key == key), None)
    if use is None:
        return
    unit, reference_unit = use
    st.header(say("long_term.course", serial=key.serial))
    state = "alarm" if unit.entry["alarm"] else unit.entry["verdict"]
    numbers(
        (
            (say("column.state"), say(f"event.{state}"), None),
            (say("lot.predicted"), number(unit.entry["predicted_rmse"], reference_unit), None),
            (say("chart.drift_scale"), number(unit.entry["shift"]), None),
            (say("long_term.steps"), str(unit.steps), None),
            (say("column.made"), instant(unit.made_at), None),
        ),
        narrowest_px=185,
    )
    streams = registry().adaptations.streams(key)
    stream = streams[0] if len(streams) == 1 else str(st.selectbox(say("long_term.stream"), streams))
    stream_course = course(registry(), key, stream)
    if stream_course.alarm:
        why = phrase("adapt", stream_course.alarm, say)
        st.warning(why, icon=":material/notification_important:", title=say("long_term.due"))
    if not stream_course.steps:
        st.caption(say("long_term.no_steps"))
        return
    if rest_may_follow():
        show_figure(course_figure(stream_course, colours(), say), f"course-{key}")
