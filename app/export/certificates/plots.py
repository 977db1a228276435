"""The plots of certificates and reports as vector drawings."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from reportlab.graphics.charts.axes import XValueAxis, YValueAxis
from reportlab.graphics.shapes import Drawing, Group, Line, Polygon, PolyLine, String
from reportlab.lib import colors

from softcal.app.export.certificates.content import Certificate
from softcal.app.export.certificates.fonts import PLAIN, runs_of, width_of
from softcal.core.recording import Array

SIZE = 7
AXIS, CURVE, BAND = colors.HexColor("#5a6472"), colors.HexColor("#0b5cad"), colors.HexColor("#bcd6f2")
DECIDES = colors.HexColor("#b3261e")
LEFT, RIGHT, BOTTOM, TOP = 46.0, 8.0, 26.0, 8.0
HEIGHT = 112.0
SHOWN_S = 20.0
"""So much of a recording is shown: several presses, and the interval can be seen."""

MAX_TICKS = 7
MAX_POINTS = 1200
"""A curve is thinned to this many points: more cannot be told apart on paper."""


class Level(NamedTuple):
    """A line that decides: where it lies, and its name."""

    at: float
    name: str


def estimate_plot(certificate: Certificate, width: float) -> Drawing:
    """Draw the estimates of the unit's own recording over time, with U_est around them."""
    estimated = certificate.estimated
    rows = np.flatnonzero(np.isfinite(estimated.estimate))
    rows = rows[estimated.t_s[rows] <= estimated.t_s[rows[0]] + SHOWN_S]
    rows = rows[:: max(1, math.ceil(len(rows) / MAX_POINTS))]
    t_s, lower, upper = estimated.t_s[rows], estimated.lower[rows], estimated.upper[rows]
    labels = "t, s", f"{certificate.lot.reference_quantity}, {certificate.lot.reference_unit}"
    axes = _Axes.around(t_s, np.concatenate([lower, upper]), width, labels)
    drawing = axes.drawing
    edge = axes.points(np.concatenate([t_s, t_s[::-1]]), np.concatenate([lower, upper[::-1]]))
    drawing.add(Polygon(edge, fillColor=BAND, strokeColor=None))
    drawing.add(PolyLine(axes.points(t_s, estimated.estimate[rows]), strokeColor=CURVE, strokeWidth=0.7))
    return drawing


def map_plot(certificate: Certificate, width: float) -> Drawing:
    """Draw which source output each steady output of the unit stands for."""
    labels = (
        f"output of unit {certificate.serial}, {certificate.lot.output_unit}",
        f"source output, {certificate.lot.output_unit}",
    )
    axes = _Axes.around(certificate.output, certificate.mapped, width / 2, labels)
    drawing = axes.drawing
    drawing.add(PolyLine(axes.points(certificate.output, certificate.mapped), strokeColor=CURVE, strokeWidth=1.2))
    return drawing


def bars_plot(edges: Array, counts: Array, limit: Level | None, labels: tuple[str, str], width: float) -> Drawing:
    """Draw a histogram with the limit that its values are held to.

    Args:
        edges: (n + 1,) of the bars.
        counts: (n,) of each bar.
        limit: value and name; None draws none.
        width: on paper, in points.
    """
    most = max(float(counts.max(initial=0.0)), 1.0)
    across = edges if limit is None else np.append(edges, 1.05 * limit.at)
    axes = _Axes.around(across, np.array([0.0, most]), width, labels, room=0.15, is_count=True)
    drawing = axes.drawing
    for left, right, count in zip(edges[:-1], edges[1:], counts, strict=True):
        if count:
            corners = axes.points(np.array([left, left, right, right]), np.array([0.0, count, count, 0.0]))
            drawing.add(Polygon(corners, fillColor=CURVE, strokeColor=colors.white, strokeWidth=0.3))
    if limit is not None:
        ends = axes.points(np.full(2, limit.at), np.array([axes.up.valueMin, axes.up.valueMax]))
        drawing.add(Line(*ends, strokeColor=DECIDES, strokeWidth=1))
        drawing.add(_label(ends[2] - 3, ends[3] - 6, limit.name, "end", DECIDES))
    return drawing


def course_plot(values: Array, levels: Sequence[Level], labels: tuple[str, str], width: float) -> Drawing:
    """Draw values (n,) in their order, `width` points wide, with the lines they are held to, each with its name."""
    at = np.arange(1, len(values) + 1, dtype=float)
    heights = np.append(values, [level.at for level in levels])
    axes = _Axes.around(at, heights, width, labels)
    drawing = axes.drawing
    for level in levels:
        ends = axes.points(at[[0, -1]], np.full(2, level.at))
        drawing.add(Line(*ends, strokeColor=DECIDES, strokeWidth=0.7, strokeDashArray=[3, 2]))
        drawing.add(_label(ends[2], ends[3] + 2, level.name, "end", DECIDES))
    drawing.add(PolyLine(axes.points(at, values), strokeColor=CURVE, strokeWidth=0.8))
    return drawing


@dataclass(frozen=True)
class _Axes:
    """A rectangle of data on a rectangle of paper; ReportLab's axes find the ticks."""

    across: XValueAxis
    up: YValueAxis
    drawing: Drawing

    @classmethod
    def around(
        cls, x: Array, y: Array, width: float, labels: tuple[str, str], *, room: float = 0.04, is_count: bool = False
    ) -> "_Axes":
        """Return axes that hold all values, `room` of the upright span beyond, with their names."""
        drawing = Drawing(width, HEIGHT)
        across, up = XValueAxis(), YValueAxis()
        across.tickDown = up.tickLeft = 2
        for axis, values, length, share in (
            (across, x, width - LEFT - RIGHT, 0.0),
            (up, y, HEIGHT - BOTTOM - TOP, room),
        ):
            low, high = float(values.min()), float(values.max())
            margin = share * (high - low) or (abs(high) * 1e-3 or 1.0) * (high == low)
            axis.valueMin, axis.valueMax = (0.0 if is_count and axis is up else low - margin), high + margin
            axis.maximumTicks, axis.labelTextFormat = MAX_TICKS, "%g"
            axis.strokeColor, axis.strokeWidth = AXIS, 0.5
            axis.labels.fontName, axis.labels.fontSize, axis.labels.fillColor = PLAIN, SIZE, AXIS
            if is_count and axis is up:
                axis.valueStep = max(1, math.ceil(axis.valueMax / MAX_TICKS))
            axis.setPosition(LEFT, BOTTOM, length)
            axis.configure([(axis.valueMin, axis.valueMax)])
            drawing.add(axis)
        drawing.add(_label((LEFT + width - RIGHT) / 2, 4, labels[0], "middle"))
        drawing.add(_label(LEFT + 4, HEIGHT - TOP - 6, labels[1], "start"))
        return cls(across, up, drawing)

    def points(self, x: Array, y: Array) -> list[float]:
        """Return paper coordinates x, y, x, y, ..., rounded alike on every machine."""
        pairs = zip(x.tolist(), y.tolist(), strict=True)
        return [round(at, 2) for one, other in pairs for at in (self.across.scale(one), self.up.scale(other))]


def _label(x: float, y: float, text: str, anchor: str, colour: colors.Color = AXIS) -> Group:
    """A text that begins, ends or has its middle (`anchor`) at x, every run of letters in a font that has them."""
    runs, label = runs_of(text), Group()
    x -= {"start": 0.0, "middle": 0.5, "end": 1.0}[anchor] * width_of(runs, SIZE)
    for font, letters in runs:
        label.add(String(x, y, letters, fontName=font, fontSize=SIZE, fillColor=colour))
        x += width_of([(font, letters)], SIZE)
    return label
