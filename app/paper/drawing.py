"""The one back end of pictures that leave as files: a figure of lines, bars or a map as a drawing for PDF and SVG."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.colors import sample_colorscale
from reportlab.graphics.renderSVG import drawToString
from reportlab.graphics.shapes import Circle, Drawing, Line, Polygon, PolyLine, Rect, String
from reportlab.lib.colors import toColor

from softcal.app.paper.fonts import PLAIN, runs_of, width_of
from softcal.core.errors import InputError
from softcal.core.recording import Array

WIDTH, SIZE = 1000.0, 13.0
"""Of a page's drawing and of its letters, in pixels of the figure."""

PAPER_SIZE = 7.0
"""Letters on paper, in points."""

INK, GRID = "#1b2733", "#dde3ea"
DASHES = {"dash": [8, 5], "dot": [2, 4]}
UNUSED = re.compile(
    r"""^.*?(?=<svg)|<title>.*?</desc>|<clipPath.*?</clipPath>|font-family: [^;]*; |\s*\n\s*"""
    r"""| id="group"| style="clip-path[^"]*.""",
    re.DOTALL,
)
"""What the SVG of a part of a page has no use for; its letters are those of the page."""


@dataclass(frozen=True)
class _Axis:
    """Where an axis lies on the drawing: `low` at `start`, `high` at `end`."""

    low: float
    high: float
    start: float
    end: float
    names: tuple[str, ...] = ()
    is_log: bool = False

    @classmethod
    def from_values(cls, values: Sequence[Any], look: Any, margin: tuple[float, float], size: float) -> "_Axis":
        first, last = look.domain or (0.0, 1.0)
        span = size - sum(margin)
        ends, is_log = (margin[0] + first * span, margin[0] + last * span), look.type == "log"
        if len(values) and isinstance(values[0], str):
            names = tuple(dict.fromkeys(map(str, values)))
            return cls(-0.5, len(names) - 0.5, *ends, names[::-1] if look.autorange == "reversed" else names)
        if look.range:
            low, high = look.range
            return cls(low, high, *ends, is_log=is_log)
        numbers = np.asarray(values, dtype=float)
        numbers = np.log10(numbers) if is_log else numbers
        numbers = numbers[np.isfinite(numbers)]
        low, high = (float(numbers.min()), float(numbers.max())) if len(numbers) else (0.0, 1.0)
        low = min(low, 0.0) if look.rangemode == "tozero" else low
        beyond = 0.04 * (high - low) or 0.5 * abs(high) or 1.0
        return cls(low - beyond * (look.rangemode != "tozero"), high + beyond, *ends, is_log=is_log)

    def at(self, values: Any) -> Array:
        if self.names:
            values = [self.names.index(str(value)) for value in values]
        numbers = np.asarray(values, dtype=float)
        share = ((np.log10(numbers) if self.is_log else numbers) - self.low) / (self.high - self.low)
        return np.round(self.start + share * (self.end - self.start), 2)

    def ticks(self, look: Any) -> list[tuple[Any, str]]:
        """Return values worth a mark, with what stands beside them."""
        if self.names:
            return [(name, name) for name in self.names]
        if look.tickvals is not None:
            ticks = zip(look.tickvals, look.ticktext, strict=True)
            return [(v, text) for v, text in ticks if self.start <= self.at(v) <= self.end]
        step = 10.0 ** np.floor(np.log10((self.high - self.low) / 4.0))
        step *= next(k for k in (1.0, 2.0, 5.0, 10.0) if (self.high - self.low) / (k * step) <= 6.0)
        step = max(step, 1.0) if look.tickformat == "d" else step
        # A step that ends on zero from below would be written as -0.
        values = (np.arange(np.ceil(self.low / step), np.floor(self.high / step) + 1) * step).round(12) + 0.0
        return [(v, f"{100 * v:.0f} %" if "%" in (look.tickformat or "") else f"{v:.6g}") for v in values.tolist()]


def _runs(text: str) -> list[tuple[str, str]]:
    """Return a text without markup by fonts; what none at hand can write is left to who reads the SVG."""
    plain = re.sub(r"<[^>]*>", " ", text)
    try:
        return runs_of(plain)
    except InputError:
        return [(PLAIN, plain)]


class _Pen:
    """Draws on paper: every text in fonts that have its letters."""

    def __init__(self, width: float, height: float) -> None:
        self.drawing, self.width = Drawing(width, height), width

    def text(self, x: float, y: float, text: str, anchor: float = 0.5, colour: str = INK) -> float:
        """Write a text of which the share `anchor` lies before x; return its width."""
        runs = _runs(text)
        wide = width_of(runs, SIZE)
        x -= anchor * wide
        for font, letters in runs:
            self.drawing.add(String(x, y, letters, fontName=font, fontSize=SIZE, fillColor=toColor(colour)))
            x += width_of([(font, letters)], SIZE)
        return wide

    def line(self, points: Sequence[float], colour: str, width: float = 1.0, dash: str | None = None) -> None:
        look = {"strokeColor": toColor(colour), "strokeWidth": width, "strokeDashArray": DASHES.get(dash or "")}
        self.drawing.add(Line(*points, **look) if len(points) == 4 else PolyLine(list(points), **look))

    def box(self, left: float, below: float, right: float, above: float, colour: str, edge: str | None = None) -> None:
        look = {"fillColor": toColor(colour), "strokeColor": toColor(edge) if edge else None, "strokeWidth": 0.5}
        self.drawing.add(Rect(left, below, right - left, above - below, **look))


def draw(figure: go.Figure, width: float = WIDTH) -> Drawing:
    """Return a figure of lines, points, bars or maps as a drawing so many pixels wide, and as high as the figure."""
    layout = figure.layout
    pen, margin = _Pen(width, layout.height), {side: getattr(layout.margin, side) or 0 for side in "lrtb"}
    names = {name for trace in figure.data if trace.type in ("bar", "heatmap") for name in trace.y}
    wide = (width_of(_runs(name), SIZE) for name in names if isinstance(name, str))
    margin["l"] = max(margin["l"], 12 + max(wide, default=0.0))
    axes: dict[str, _Axis] = {}
    for (x_name, y_name), group in groupby(figure.data, key=lambda trace: (trace.xaxis or "x", trace.yaxis or "y")):
        traces = list(group)
        looks = x_look, y_look = layout["xaxis" + x_name[1:]], layout["yaxis" + y_name[1:]]
        x = _Axis.from_values([v for t in traces for v in t.x], x_look, (margin["l"], margin["r"]), width)
        levels = [shape.y0 for shape in layout.shapes if shape.yref == y_name]
        y = _Axis.from_values([*_heights(traces), *levels], y_look, (margin["b"], margin["t"]), layout.height)
        axes |= {x_name: x, y_name: y}
        _draw_frame(pen, x, y, *looks)
        below = np.zeros(len(traces[0].x))
        for trace in traces:
            if trace.type == "heatmap":
                _draw_map(pen, trace, x, y, layout.coloraxis)
            elif trace.type == "bar" and trace.orientation == "h":
                _draw_level_bars(pen, trace, x, y)
            elif trace.type == "bar":
                below = _draw_bars(pen, trace, x, y, below)
            else:
                _draw_points(pen, trace, x, y)

    def to_position(name: str, value: float, is_level: bool) -> float:
        """Return where a place of an axis, or of all (`paper`), lies."""
        if axis := axes.get(name):
            return float(axis.at([value])[0])
        first, last = ("b", "t") if is_level else ("l", "r")
        start, end = margin[first], (layout.height if is_level else width) - margin[last]
        return float(start + value * (end - start))

    for shape in layout.shapes:
        ends = [to_position(*one) for one in ((shape.xref, shape.x0, False), (shape.yref, shape.y0, True))]
        ends += [to_position(*one) for one in ((shape.xref, shape.x1, False), (shape.yref, shape.y1, True))]
        pen.line(ends, shape.line.color, shape.line.width, shape.line.dash)
    for note in layout.annotations:
        anchor = {"left": 0.0, "right": 1.0}.get(note.xanchor, 0.5)
        y_name = note.yref or "y"
        # As a shape does not, a note stands on such an axis by its logarithm.
        is_log = y_name in axes and axes[y_name].is_log
        at = (
            to_position(note.xref or "x", note.x, False),
            to_position(y_name, 10**note.y if is_log else note.y, True) + 8,
        )
        pen.text(*at, note.text, anchor, note.font.color or INK)
    if scale := layout.coloraxis.colorbar.title.text:
        pen.text(width - margin["r"], 10, scale, 1.0)
    _draw_legend(pen, figure)
    return pen.drawing


def svg(figure: go.Figure) -> str:
    """Return a figure as SVG, as wide as its page."""
    picture = UNUSED.sub("", drawToString(draw(figure)))
    return re.sub(r"<svg [^>]*?(viewBox=\"[^\"]*\")[^>]*>", r"<svg class='drawing' \1 role='img'>", picture, count=1)


def fit_drawing(figure: go.Figure, width: float) -> Drawing:
    """Return a figure as a drawing for paper, `width` points wide."""
    scale = PAPER_SIZE / SIZE
    drawing = draw(figure, width / scale)
    drawing.scale(scale, scale)
    drawing.width, drawing.height = width, drawing.height * scale
    return drawing


def _heights(traces: Sequence[Any]) -> list[Any]:
    if traces[0].type == "bar" and traces[0].orientation != "h":
        return [0.0, *np.sum([trace.y for trace in traces], axis=0)]
    return [value for trace in traces for value in trace.y]


def _draw_frame(pen: _Pen, x: _Axis, y: _Axis, x_look: Any, y_look: Any) -> None:
    for value, label in x.ticks(x_look):
        at = float(x.at([value])[0])
        if not x.names:
            pen.line((at, y.start, at, y.end), GRID)
        pen.text(at, y.start - 16, label)
    for value, label in y.ticks(y_look):
        at = float(y.at([value])[0])
        if not y.names:
            pen.line((x.start, at, x.end, at), GRID)
        pen.text(x.start - 6, at - 4, label, 1.0)
    if x_look.title.text:
        pen.text(0.5 * (x.start + x.end), y.start - 34, x_look.title.text)
    if y_look.title.text:
        # It begins left of its axis, where a long one has room too.
        pen.text(max(x.start - 60, 4), y.end + 6, y_look.title.text, 0.0)


def _draw_level_bars(pen: _Pen, trace: Any, x: _Axis, y: _Axis) -> None:
    colours, high = trace.marker.color, 0.7 * abs(y.end - y.start) / max(len(y.names), 1)
    start = float(x.at([0.0])[0])
    for k, (end, middle) in enumerate(zip(x.at(trace.x), y.at(trace.y), strict=True)):
        colour = colours if isinstance(colours, str) else colours[k]
        pen.box(start, middle - high / 2, max(end, start), middle + high / 2, colour)
        if trace.text is not None:
            pen.text(max(end, start) + 6, middle - 4, str(trace.text[k]), 0.0)


def _draw_bars(pen: _Pen, trace: Any, x: _Axis, y: _Axis, below: Array) -> Array:
    """Draw upright bars on those below; return where they end."""
    tops: Array = below + np.asarray(trace.y, dtype=float)
    sides = x.at(trace.x), x.at(np.asarray(trace.x, dtype=float) + trace.width)
    for left, right, low, high, count in zip(*sides, y.at(below), y.at(tops), trace.y, strict=True):
        if count:
            pen.box(left, low, right, high, trace.marker.color, "#ffffff")
    return tops


def _draw_map(pen: _Pen, trace: Any, x: _Axis, y: _Axis, scale: Any) -> None:
    wide, high = abs(x.end - x.start) / len(x.names) / 2, abs(y.end - y.start) / len(y.names) / 2
    for row, middle in zip(np.asarray(trace.z, dtype=float), y.at(trace.y), strict=True):
        for value, centre in zip(row, x.at(trace.x), strict=True):
            if np.isfinite(value):
                share = float(np.clip((value - scale.cmin) / max(scale.cmax - scale.cmin, 1e-12), 0.0, 1.0))
                # The darker half of the scale would hide dark letters.
                colour = sample_colorscale("OrRd", [0.6 * share])[0]
                pen.box(centre - wide, middle - high, centre + wide, middle + high, colour, "#ffffff")
                pen.text(centre, middle - 4, f"{value:.1f}")


def _draw_points(pen: _Pen, trace: Any, x: _Axis, y: _Axis) -> None:
    points = np.column_stack([x.at(trace.x), y.at(trace.y)])
    points = points[np.isfinite(points).all(axis=1)]
    flat, mode = points.ravel().tolist(), trace.mode or "lines"
    if trace.fill == "toself":
        pen.drawing.add(Polygon(flat, fillColor=toColor(trace.fillcolor), strokeColor=None))
    elif "lines" in mode and len(points) > 1:
        pen.line(flat, trace.line.color, trace.line.width or 1, trace.line.dash)
    if "markers" in mode:
        for at in points:
            look = {"fillColor": toColor(trace.marker.color), "strokeColor": None}
            pen.drawing.add(Circle(*at, (trace.marker.size or 4) / 2, **look))


def _draw_legend(pen: _Pen, figure: go.Figure) -> None:
    """Write the names on one line at the bottom, from the right."""
    at = pen.width - 20.0
    for trace in reversed(figure.data):
        is_upright = trace.type == "bar" and trace.orientation != "h"
        if not trace.name or trace.showlegend is False or not (is_upright or trace.type.startswith("scatter")):
            continue
        colour = trace.marker.color if is_upright or trace.line.color is None else trace.line.color
        at -= pen.text(at, 8, trace.name, 1.0)
        pen.line((at - 26, 12, at - 6, 12), colour, 2 + 6 * is_upright)
        at -= 44
