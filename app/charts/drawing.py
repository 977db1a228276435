"""A figure as a drawing that stands by itself: lines, level bars and maps as SVG, without the plotting library.

A page that is mailed is then some hundred kilobytes instead of five megabytes, and prints.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from itertools import groupby
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.colors import sample_colorscale

from softcal.app.charts.palette import LIGHT
from softcal.core.recording import Array

WIDTH = 1000
LETTER = 7.2
"""Mean width of a letter of 13 pixels."""


@dataclass(frozen=True)
class _Axis:
    """Where an axis lies on the drawing: `low` at pixel `start`, `high` at pixel `end`."""

    low: float
    high: float
    start: float
    end: float
    names: tuple[str, ...] = ()

    def at(self, values: Any) -> Array:
        if self.names:
            values = [self.names.index(str(value)) for value in values]
        share = (np.asarray(values, dtype=float) - self.low) / (self.high - self.low)
        return np.asarray(self.start + share * (self.end - self.start))

    def ticks(self) -> list[tuple[float, str]]:
        """Return values worth a mark, with what stands beside them."""
        if self.names:
            return [(float(k), name) for k, name in enumerate(self.names)]
        step = 10.0 ** np.floor(np.log10((self.high - self.low) / 4.0))
        step *= next(k for k in (1.0, 2.0, 5.0, 10.0) if (self.high - self.low) / (k * step) <= 6.0)
        values = np.arange(np.ceil(self.low / step), np.floor(self.high / step) + 1) * step
        # A step that ends on zero from below would be written as -0.
        return [(float(v), f"{round(float(v), 12) + 0.0:.6g}") for v in values]


def drawing(figure: go.Figure) -> str:
    """Return a figure of lines, level bars or maps as SVG, as wide as its page."""
    layout = figure.layout
    margin = {side: getattr(layout.margin, side) or 0 for side in "lrtb"}
    names = [str(name) for trace in figure.data if trace.type != "scattergl" for name in trace.y]
    margin["l"] = max(margin["l"], 12 + LETTER * max(map(len, names), default=0))
    parts: list[str] = []
    for (x_name, y_name), group in groupby(figure.data, key=lambda trace: (trace.xaxis or "x", trace.yaxis or "y")):
        traces = list(group)
        x_layout, y_layout = (layout["xaxis" + x_name[1:]], layout["yaxis" + y_name[1:]])
        left, right = _ends(x_layout, margin["l"], WIDTH - margin["l"] - margin["r"])
        below, above = _ends(y_layout, margin["b"], layout.height - margin["t"] - margin["b"])
        x = _axis([t.x for t in traces], x_layout, left, right)
        y = _axis([t.y for t in traces], y_layout, layout.height - below, layout.height - above)
        parts += _frame(x, y, x_layout, y_layout)
        for trace in traces:
            if trace.type == "heatmap":
                parts += _cells(trace, x, y, layout.coloraxis)
            elif trace.type == "bar":
                parts += _bars(trace, x, y)
            else:
                points = [(a, b) for a, b in zip(x.at(trace.x), y.at(trace.y), strict=True) if np.isfinite(a + b)]
                style = f"stroke='{trace.line.color}' stroke-width='{trace.line.width or 1}'"
                shown = " ".join(f"{a:.1f},{b:.1f}" for a, b in points)
                parts.append(f"<polyline fill='none' {style} points='{shown}'/>")

    # The titles of the parts of a figure, and what its colours mean.
    for note in layout.annotations:
        across = margin["l"] + note.x * (WIDTH - margin["l"] - margin["r"])
        up = layout.height - margin["b"] - note.y * (layout.height - margin["t"] - margin["b"])
        parts.append(_text(across, up - 8, note.text))
    if scale := layout.coloraxis.colorbar.title.text:
        parts.append(_text(WIDTH - margin["r"], layout.height - 10, scale, "end"))

    # The names of lines, on one line at the bottom, from the right.
    named = [t for t in figure.data if t.type.startswith("scatter") and t.showlegend is not False and t.name]
    at, up = WIDTH - 20.0, layout.height - 12
    for trace in reversed(named):
        at -= LETTER * len(trace.name)
        parts.append(_text(at, layout.height - 8, trace.name, "start"))
        place = f"x1='{at - 26}' x2='{at - 6}' y1='{up}' y2='{up}'"
        parts.append(f"<line {place} stroke='{trace.line.color}' stroke-width='2'/>")
        at -= 44
    return (
        f"<svg class='drawing' viewBox='0 0 {WIDTH} {layout.height}' role='img' font-size='13' fill='{LIGHT.text}'>"
        f"{''.join(parts)}</svg>"
    )


def _ends(axis: Any, margin: float, size: float) -> tuple[float, float]:
    low, high = axis.domain or (0.0, 1.0)
    return margin + low * size, margin + high * size


def _axis(values: Sequence[Any], axis: Any, start: float, end: float) -> _Axis:
    first = [v for part in values for v in part]
    if first and isinstance(first[0], str):
        names = tuple(dict.fromkeys(first))
        names = names[::-1] if axis.autorange == "reversed" else names
        return _Axis(-0.5, len(names) - 0.5, start, end, names)
    if axis.range:
        low, high = axis.range
        return _Axis(low, high, start, end)
    known = np.asarray(first, dtype=float)
    known = known[np.isfinite(known)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    room = 0.04 * (high - low) or 0.5 * abs(high) or 1.0
    return _Axis(low - room, high + room, start, end)


def _frame(x: _Axis, y: _Axis, x_layout: Any, y_layout: Any) -> Iterator[str]:
    for axis, other, is_level in ((x, y, False), (y, x, True)):
        is_share = bool((y_layout if is_level else x_layout).tickformat)
        for value, label in axis.ticks():
            at = float(axis.at([axis.names[int(value)]] if axis.names else [value])[0])
            ends = (other.start, other.end)
            place = f"x1='{ends[0]:.1f}' x2='{ends[1]:.1f}' y1='{at:.1f}' y2='{at:.1f}'"
            if not is_level:
                place = f"y1='{ends[0]:.1f}' y2='{ends[1]:.1f}' x1='{at:.1f}' x2='{at:.1f}'"
            yield f"<line {place} stroke='{LIGHT.grid}'/>" if not axis.names else ""
            text = f"{100 * value:.0f} %" if is_share else label
            yield _text(other.start - 6, at + 4, text, "end") if is_level else _text(at, other.start + 16, text)
    if x_layout.title.text:
        yield _text(0.5 * (x.start + x.end), y.start + 34, x_layout.title.text)
    if y_layout.title.text:
        yield _text(x.start - 6, y.end - 6, y_layout.title.text, "end")


def _bars(trace: Any, x: _Axis, y: _Axis) -> Iterator[str]:
    colours = trace.marker.color
    high = 0.7 * abs(y.end - y.start) / max(len(y.names), 1)
    start = float(x.at([0.0])[0])
    for k, (value, middle) in enumerate(zip(x.at(trace.x), y.at(trace.y), strict=True)):
        colour = colours if isinstance(colours, str) else colours[k]
        wide = max(float(value) - start, 0.0)
        place = f"x='{start:.1f}' y='{middle - high / 2:.1f}' width='{wide:.1f}' height='{high:.1f}'"
        yield f"<rect {place} fill='{colour}'/>"
        if trace.text is not None:
            yield _text(start + wide + 6, float(middle) + 4, str(trace.text[k]), "start")


def _cells(trace: Any, x: _Axis, y: _Axis, scale: Any) -> Iterator[str]:
    wide, high = abs(x.end - x.start) / len(x.names), abs(y.end - y.start) / len(y.names)
    for row, middle in zip(np.asarray(trace.z, dtype=float), y.at(trace.y), strict=True):
        for value, centre in zip(row, x.at(trace.x), strict=True):
            if np.isfinite(value):
                share = float(np.clip((value - scale.cmin) / max(scale.cmax - scale.cmin, 1e-12), 0.0, 1.0))
                # The darker half of the scale would hide dark letters.
                colour = sample_colorscale("OrRd", [0.6 * share])[0]
                place = f"x='{centre - wide / 2:.1f}' y='{middle - high / 2:.1f}'"
                yield f"<rect {place} width='{wide:.1f}' height='{high:.1f}' fill='{colour}' stroke='#fff'/>"
                yield _text(float(centre), float(middle) + 4, f"{value:.1f}")


def _text(x: float, y: float, text: str, anchor: str = "middle") -> str:
    label = escape(text.replace("<br>", " "))
    return f"<text x='{x:.1f}' y='{y:.1f}' text-anchor='{anchor}'>{label}</text>"
