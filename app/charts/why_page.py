"""Write why a unit's verdict is what it is: one page with one figure, readable without a network."""

from functools import partial
from pathlib import Path

from softcal.app.charts.palette import palette
from softcal.app.charts.why import why_figure
from softcal.app.files.atomic import write_text
from softcal.app.texts.catalogue import text
from softcal.app.views.unit import UnitView, unit_view
from softcal.core.errors import InputError
from softcal.db.registry import Registry

SCRIPT = "plotly.min.js"
"""Pages of one folder share this file beside them."""


def explain_unit(
    registry: Registry, serial: str, out: Path, revision: int | None = None, lot_id: str | None = None
) -> UnitView:
    """Write the page of one unit, whole in itself.

    Raises:
        InputError: the registry has no calibration of the serial, or the file is not to end in .html.
    """
    if out.suffix.lower() != ".html":
        raise InputError(f"{out}: the figure is written as a page; name a file that ends in .html")
    view = unit_view(registry, serial, revision, lot_id)
    write_text(out, why_page(view, script=True))
    return view


def explain_units(registry: Registry, serials: list[str], folder: Path, lot_id: str | None = None) -> None:
    """Write one page a unit into a folder, and the drawing script they share."""
    from plotly.offline import get_plotlyjs

    write_text(folder / SCRIPT, get_plotlyjs())
    for serial in serials:
        write_text(folder / f"{serial}.html", why_page(unit_view(registry, serial, None, lot_id), script=SCRIPT))


def why_page(view: UnitView, script: bool | str) -> str:
    """Return the figure as a page; `script` True puts the drawing script into it, a name refers to a file beside it."""
    figure = why_figure(view, palette("light"), partial(text, "en"))
    return str(figure.to_html(include_plotlyjs=script, config={"displaylogo": False}))


def why_json(view: UnitView) -> dict[str, object]:
    """Return the numbers behind the verdict as JSON values: schema `softcal.explain/1`."""
    found, decision, method = view.explanation, view.calibration.decision, view.calibration.method
    return {
        "schema": "softcal.explain/1",
        "serial": view.calibration.serial,
        "revision": view.stored.revision,
        "verdict": str(decision.verdict),
        "predicted": decision.predicted.to_json(),
        "measured": None if decision.measured is None else decision.measured.to_json(),
        "reasons": [str(why) for why in decision.reasons],
        "knowledge": str(view.calibration.knowledge),
        "method": None if method is None else {"id": method.id, "numbers": dict(method.to_json())},
        "predicted_rmse": None if found.forecast is None else found.forecast[1],
        "predicted_interval": None if found.forecast is None else [found.forecast[0], found.forecast[2]],
        "limit_rmse": found.limit,
        "contributions": dict(found.contributions),
        "evidence": dict(view.calibration.evidence),
    }
