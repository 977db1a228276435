"""The recordings of a unit, the estimate on them, and its map."""

import streamlit as st

from softcal.app.charts import unit as charts_unit
from softcal.app.ui.desk import colours, instant, say
from softcal.app.ui.panels import figures_beside, rest_may_follow, show_figure, table_to_choose
from softcal.app.ui.server_memory import registry
from softcal.app.views.common import percent
from softcal.app.views.unit import unit_view
from softcal.core.lot import UnitKey
from softcal.db.entries import StoredCalibration


def draw(key: UnitKey, stored: StoredCalibration) -> None:
    if not rest_may_follow():
        return
    view = unit_view(registry(), key, stored.revision)
    share = percent(view.flagged / len(view.estimate.flag))
    st.caption(say("unit.flags", flagged=view.flagged, rows=len(view.estimate.flag), share=share))
    figures_beside(
        ("unit.estimate", charts_unit.estimate_band(view, colours(), say), "estimate_band"),
        ("unit.hysteresis", charts_unit.hysteresis(view, colours(), say), "hysteresis"),
    )
    figures_beside(
        ("unit.outputs", charts_unit.output_distributions(view, colours(), say), "output_distributions"),
        ("unit.map", charts_unit.map_curve(view, colours(), say), "map_curve"),
    )
    draw_recordings(key)


def draw_recordings(key: UnitKey) -> None:
    """Draw the unit's recordings and the curve of the one that is chosen, the newest at first."""
    lot = registry().lots.get(key.lot_id)
    entries = registry().recordings.of_lot(lot.id, key.serial)[::-1]
    if not entries:
        st.caption(say("unit.recordings.none"))
        return
    rows = [
        {
            say("column.kind"): say(f"kind.{entry.kind}"),
            say("column.made"): instant(entry.added_at),
            say("column.duration"): f"{entry.samples / entry.sample_rate_Hz:.1f} s",
            say("column.rate"): f"{entry.sample_rate_Hz:g} Hz",
            "SHA-256": entry.sha256[:12],
        }
        for entry in entries
    ]
    chosen = entries[table_to_choose(rows, f"recordings-{key}") or 0]
    show_figure(
        charts_unit.recording(registry().recordings.get(chosen.sha256), lot, colours(), say), f"recordings-{key}-plot"
    )
