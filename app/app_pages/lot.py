"""The lot at a glance: yield, errors, the units that need a look, the table."""

import pandas as pd
import streamlit as st

from softcal.app import charts
from softcal.app.desk import choose, choose_language, colours, empty, errors_in_words, registry, show_figure, words
from softcal.app.spreadsheet import csv_text
from softcal.app.views import LotView, lot_view, number

LOOKS = 8


def render() -> None:
    """Draw the page."""
    say = words()
    with errors_in_words():
        lots = [lot.id for lot in registry().lots()]
        if not lots:
            empty(say("empty.lots"), say("empty.lots.how"))
            return
        left, right = st.columns([5, 1])
        with right:
            choose_language()
        with left:
            lot_id = choose(say("choose.lot"), lots, "lot")
        view = lot_view(registry(), lot_id or lots[0])
        if not view.judged:
            empty(say("empty.units"), say("empty.units.how"))
            return
        _figures(view)
        _charts(view)
        _looks(view)
        _table(view)


def _figures(view: LotView) -> None:
    say, unit, share = words(), view.lot.reference_unit, view.share_passed
    predicted = float(pd.Series(view.predicted).median()) if len(view.predicted) else None
    limit = number(view.lot.limit_rmse, unit) if view.lot.limit_rmse else say("lot.limit.none")
    cells = (
        (say("lot.units"), f"{len(view.judged)} / {len(view.units)}", None),
        (say("lot.yield"), "–" if share is None else f"{share:.0%}", say("lot.yield.help")),
        (say("lot.predicted"), number(predicted, unit), say("lot.predicted.help")),
        (say("lot.limit"), limit, say("lot.limit.help")),
        (say("lot.audited"), str(len(view.audited)), say("lot.audited.help")),
        (say("lot.ratio"), number(view.after_to_own), say("lot.ratio.help")),
    )
    for column, (label, value, explanation) in zip(st.columns(len(cells)), cells, strict=True):
        column.metric(label, value, help=explanation, border=True)


def _charts(view: LotView) -> None:
    say = words()
    left, right = st.columns(2)
    with left:
        st.subheader(say("lot.distribution"))
        show_figure(charts.predicted_errors(view, colours(), say), "predicted")
    if view.audited:
        with right:
            st.subheader(say("lot.scores"))
            show_figure(charts.audit_scores(view, colours(), say), "scores")


def _looks(view: LotView) -> None:
    say = words()
    st.subheader(say("lot.look"))
    if not view.needing_a_look:
        st.caption(say("lot.look.none"))
    for unit in view.needing_a_look[:LOOKS]:
        word = say(f"verdict.{unit.verdict}")
        st.markdown(
            f"**[{unit.serial}](unit?unit={unit.serial})** · {word} · {unit.reasons[0] if unit.reasons else ''}"
        )


def _table(view: LotView) -> None:
    say = words()
    rows = [
        {
            say("column.serial"): unit.serial,
            say("column.verdict"): say(f"verdict.{unit.verdict or 'none'}"),
            say("column.predicted"): unit.predicted_rmse,
            say("column.before"): unit.before_rmse,
            say("column.after"): unit.after_rmse,
            say("column.own"): unit.own_rmse,
            say("column.family"): unit.family,
            say("column.revision"): unit.revision,
            say("column.reasons"): "; ".join(unit.reasons),
        }
        for unit in view.units
    ]
    table = pd.DataFrame(rows)
    st.subheader(say("lot.table"))
    st.dataframe(table, width="stretch", hide_index=True)
    name = f"{view.lot.id}.csv"
    content = csv_text(list(table.columns), table.itertuples(index=False, name=None))
    st.download_button(say("lot.export"), data=content, file_name=name, mime="text/csv", key="export-table")
