"""Lots side by side: the same numbers of each. No Streamlit."""

from collections.abc import Sequence

from softcal.app.texts.reasons import Words, plainly
from softcal.app.views.common import limit_said, number, percent
from softcal.app.views.lot import LotView

MOST_LOTS = 6


def lot_rows(views: Sequence[LotView], words: Words) -> list[dict[str, str]]:
    """Return one row a fact under the lots' names."""
    columns = {view.lot.id: _facts(view, words) for view in views}
    names = list(next(iter(columns.values()))) if columns else []
    return [{words("compare.fact.lot"): name, **{lot: facts[name] for lot, facts in columns.items()}} for name in names]


def _facts(view: LotView, words: Words) -> dict[str, str]:
    unit, found, process = view.lot.reference_unit, view.yields, view.process
    days = f"{view.days[0].name} – {view.days[-1].name}" if view.days else "–"
    measured = [row.after_rmse for row in view.audited if row.after_rmse is not None]
    return {
        words("source.model"): view.lot.sensor_model or "–",
        words("compare.days"): days,
        words("lot.units"): f"{view.judged} / {view.total}",
        **{words(f"verdict.{word}"): str(view.counts[word]) for word in view.counts if word != "none"},
        words("lot.first_pass"): _share(found.first_pass.value, found.first_pass.interval),
        words("lot.yield"): _share(found.last_pass.value, found.last_pass.interval),
        words("lot.limit"): limit_said(view.limit, words),
        words("lot.predicted"): number(view.median_predicted, unit),
        words("lot.audited"): str(len(measured)),
        words("compare.measured"): number(sorted(measured)[len(measured) // 2], unit) if measured else "–",
        words("lot.ratio"): number(view.after_to_own),
        "Cpk": number(process.capability.cpk) if process.capability else "–",
        words("compare.first_reason"): plainly(view.reasons[0][0], words) if view.reasons else "–",
    }


def _share(value: float | None, interval: tuple[float, float]) -> str:
    return "–" if value is None else f"{percent(value)} ({percent(interval[0])} – {percent(interval[1])})"
