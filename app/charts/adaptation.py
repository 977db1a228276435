"""Drift, map, estimate and predicted error of a unit in use, as one figure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from softcal.app.charts.palette import FONTS, LIGHT
from softcal.core.operation.stream_estimator import MapUpdate
from softcal.core.recording import Array
from softcal.core.unit.estimate import Estimate

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

BLUE, ORANGE, GREY, RED = LIGHT.mapped, LIGHT.raw, LIGHT.source, LIGHT.limit
BANDS = {BLUE: LIGHT.band, ORANGE: "rgba(180, 105, 14, 0.18)"}

KEPT_ROWS = 6000
Course = Sequence[Mapping[str, Any]]


@dataclass
class Trace:
    """Columns of equal length, evenly thinned over the rows of a stream."""

    t_s: list[float] = field(default_factory=list)
    output: list[float] = field(default_factory=list)
    estimate: list[float] = field(default_factory=list)
    lower: list[float] = field(default_factory=list)
    upper: list[float] = field(default_factory=list)
    predicted_rmse: list[float] = field(default_factory=list)
    stride: int = 1
    rows: int = 0

    def add(self, rows: Estimate, output: Array, update: MapUpdate) -> None:
        """Add rows that were estimated up to the given map."""
        places = slice(-self.rows % self.stride, None, self.stride)
        self.rows += len(output)
        self.t_s += rows.t_s[places].tolist()
        self.output += output[places].tolist()
        self.estimate += rows.estimate[places].tolist()
        self.lower += rows.lower[places].tolist()
        self.upper += rows.upper[places].tolist()
        self.predicted_rmse += [update.predicted_rmse] * len(output[places])
        while len(self.t_s) > KEPT_ROWS:
            self.stride *= 2
            for name, values in vars(self).items():
                if isinstance(values, list):
                    setattr(self, name, values[::2])


def adaptation_figure(title: str, trace: Trace, maps: Course, output_unit: str, reference_unit: str) -> "Figure":
    """Return the figure of a unit's stream; `maps` are its steps in the registry, oldest first."""
    from plotly.subplots import make_subplots

    from softcal.app.charts.style import dots

    titles = [f"Output [{output_unit}]", "Drift, in scales of the calibrated use", "Map"]
    titles += [f"Estimate [{reference_unit}]", f"Predicted error [{reference_unit}]"]
    figure = make_subplots(rows=5, cols=1, shared_xaxes=True, vertical_spacing=0.04, subplot_titles=titles)
    _line(figure, 1, trace.t_s, trace.output, "output", GREY)
    seen = [step for step in maps if step["t_s"] is not None]
    times = [step["t_s"] for step in seen]
    for name, shown, colour in (("shift", "shift", BLUE), ("log_gain", "log gain", ORANGE)):
        lower, upper = ([step[name] + sign * step[f"{name}_sd"] for step in seen] for sign in (-1, 1))
        _band(figure, 2, times, lower, upper, f"{shown} ± sd", colour)
        _line(figure, 2, times, [step[name] for step in seen], shown, colour)
    for verdict, symbol in (("held", "x"), ("tried", "triangle-up"), ("jumped", "diamond")):
        if steps := [step for step in seen if step["verdict"] == verdict]:
            x, y, why = ([step[name] for step in steps] for name in ("t_s", "shift", "reason"))
            dots(figure, x, y, RED, verdict, 8, 2, symbol=symbol, text=why)
    _line(figure, 3, times, [step["gain"] for step in seen], "gain", BLUE, step=True)
    _line(figure, 3, times, [step["offset"] for step in seen], f"offset [{output_unit}]", ORANGE, step=True)
    _band(figure, 4, trace.t_s, trace.lower, trace.upper, "90 % interval", BLUE)
    _line(figure, 4, trace.t_s, trace.estimate, "estimate", BLUE)
    _line(figure, 5, trace.t_s, trace.predicted_rmse, "predicted error", BLUE, step=True)
    if alarms := [step for step in seen if step["alarm"]]:
        x, y, why = ([step[name] for step in alarms] for name in ("t_s", "predicted_rmse", "alarm"))
        dots(figure, x, y, RED, "recalibration due", 9, 5, symbol="triangle-up", text=why)
    look = {"template": "plotly_white", "font_family": FONTS, "hovermode": "x unified"}
    figure.update_layout(title=title, height=1150, margin={"t": 90}, **look)
    figure.update_xaxes(title_text="time [s]", row=5, col=1)
    figure.update_yaxes(rangemode="tozero", row=5, col=1)
    return figure


def _line(
    figure: "Figure", row: int, x: list[float], y: list[float], name: str, colour: str, step: bool = False
) -> None:
    line = {"color": colour, "width": 1.4} | ({"shape": "hv"} if step else {})
    figure.add_scatter(x=x, y=y, mode="lines", line=line, name=name, row=row, col=1)


def _band(
    figure: "Figure", row: int, x: list[float], lower: list[float], upper: list[float], name: str, colour: str
) -> None:
    edge = {"mode": "lines", "line": {"width": 0}, "row": row, "col": 1}
    figure.add_scatter(x=x, y=lower, showlegend=False, hoverinfo="skip", **edge)
    figure.add_scatter(x=x, y=upper, fill="tonexty", fillcolor=BANDS[colour], name=name, **edge)
