"""The units of a lot that need a look: reason and plot side by side, one click to the unit."""

import streamlit as st

from softcal.app.charts import unit as charts_unit
from softcal.app.texts.reasons import said
from softcal.app.ui.desk import colours, errors_in_words, registry, show_figure, words
from softcal.app.ui.panels import go_to, table_to_choose
from softcal.app.views.common import number
from softcal.app.views.lot import LotView
from softcal.app.views.unit import unit_view
from softcal.db.entries import UnitEntry

ARROW = ":material/arrow_forward:"


def looks(view: LotView) -> None:
    """Draw the worst units and the plot of the one that is chosen, the worst at first."""
    say = words()
    st.header(say("lot.look"))
    if not view.looks:
        st.caption(say("lot.look.none"))
        if view.worst and st.button(say("lot.look.worst", serial=view.worst), key="open-worst", icon=ARROW):
            go_to("unit", unit=view.worst)
        return
    if view.needing_a_look > len(view.looks):
        st.caption(say("lot.look.count", shown=len(view.looks), count=view.needing_a_look))
    _chosen(view)


@st.fragment
@errors_in_words()
def _chosen(view: LotView) -> None:
    left, right = st.columns([3, 2])
    with left:
        rows = [_row(unit, view.lot.reference_unit) for unit in view.looks]
        chosen = table_to_choose(rows, f"looks-{view.lot.id}")
    with right:
        _plot(view.looks[chosen or 0])


def _row(unit: UnitEntry, reference_unit: str) -> dict[str, object]:
    say = words()
    return {
        say("column.serial"): unit.serial,
        say("column.verdict"): say(f"verdict.{unit.verdict}"),
        say("column.reasons"): said(unit.reasons[0], say) if unit.reasons else "",
        say("column.predicted"): number(unit.predicted_rmse, reference_unit),
    }


def _plot(unit: UnitEntry) -> None:
    say = words()
    # What does not fit beside the name goes below it; a label is never cut.
    with st.container(horizontal=True, horizontal_alignment="distribute", vertical_alignment="center"):
        st.markdown(f"**{unit.serial}** · {say(f'verdict.{unit.verdict}')}", width="content")
        is_chosen = st.button(say("lot.look.open"), key="open-look", icon=ARROW)
    if is_chosen:
        go_to("unit", unit=unit.serial)
    if unit.reasons:
        # The table has room for its beginning alone.
        st.caption(said(unit.reasons[0], say))
    if unit.revision is None:
        st.caption(say("empty.calibration"))
        return
    view = unit_view(registry(), unit.serial)
    show_figure(charts_unit.output_distributions(view, colours(), say), f"look-{unit.serial}")
