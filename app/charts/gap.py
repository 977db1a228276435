"""Figures of a diagnosis: arrays, report values and words in, Plotly figures out."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from softcal.app.charts.palette import FONTS, LIGHT, Palette
from softcal.app.charts.style import LEVEL_BARS
from softcal.app.texts.reasons import Translator, render_reason
from softcal.app.views.common import percent
from softcal.app.views.gap import channel_name, effect_name, profile_name, rank_causes, stage_name
from softcal.app.views.gap_runs import ChannelView, RunView
from softcal.core.messages.figures import decimals_of, with_decimals
from softcal.core.messages.reason import Reason
from softcal.core.recording import Array, Indices

CHANNELS = {"output_V": "output", "force_N": "force"}
"""Columns that are drawn, with the name a report has for them."""

CHAIN = ("motion", "mechanics", "transduction", "electronics", "acquisition", "load_cell")
CHANNEL_UNITS = {"output_V": "mV", "force_N": "mN"}


def report_name(column: str) -> str:
    """Return a report's name for a column; a simulator's are the same."""
    return CHANNELS.get(column, column)


def unit_of(column: str) -> tuple[float, str]:
    """Return the factor of a column's values where they are shown, and their unit then."""
    column = next((c for c, name in CHANNELS.items() if name == column), column)
    if column in CHANNEL_UNITS:
        return 1e3, CHANNEL_UNITS[column]
    return 1.0, column.rpartition("_")[2] if "_" in column else ""


def channels_of(runs: "Sequence[RunView]") -> list[str]:
    """Return the columns that runs show, those of the twin in their order first."""
    every = dict.fromkeys(name for run in runs for name in run.channels)
    return [*(name for name in CHANNELS if name in every), *(name for name in every if name not in CHANNELS)]


DIRECTIONS = tuple(Reason(f"gap.regime.{name}") for name in ("loading", "hold", "unloading"))
BANDS = 6
PREDICTIONS = ("base", "causes", "floor")
RESIDUALS = ("rmse_before", "rmse_after", "noise_floor")
MAX_POINTS = 1500
"""Most points of a trace that are drawn: the largest of each stretch."""

COMPARED_POINTS = 500
""" ... and of each of three that lie on one another."""


_Line = tuple[str, Array, str, Indices]
"""What a line is of, its values, its colour, and which of the values are drawn."""


def _apply_style(figure: go.Figure, height: int, left: int = 60, **layout: Any) -> go.Figure:
    figure.update_layout(
        template="plotly_white",
        height=height,
        margin={"l": left, "r": 20, "t": 44, "b": 44},
        font={"family": FONTS, "size": 13, "color": LIGHT.text},
        **layout,
    )
    return figure


def direction(drive: Array, t_s: Array) -> Array:
    """Return per sample 0 loading, 1 hold, 2 unloading, from the drive's slope."""
    if len(drive) < 5:
        return np.ones(len(drive))
    slope = np.gradient(np.convolve(np.pad(drive, 2, mode="edge"), np.full(5, 0.2), mode="valid"), t_s)
    still = 0.02 * max(float(np.max(np.abs(slope))), 1e-12)
    return np.where(slope > still, 0.0, np.where(slope < -still, 2.0, 1.0))


def residual_map(runs: Sequence[RunView], channel: str, is_after: bool) -> tuple[Array, Array]:
    """Return the RMS residual in units of the noise by force band and direction, and the bands.

    (BANDS, 3) with NaN where fewer than five samples fall, and (BANDS + 1,) edges in N.
    """
    runs_of_channel = [run for run in runs if channel in run.channels]
    edges = np.linspace(0.0, max(float(np.max(run.load_N)) for run in runs_of_channel), BANDS + 1)
    total, count = np.zeros((BANDS, 3)), np.zeros((BANDS, 3))
    for run in runs_of_channel:
        view = run.channels[channel]
        residual = (view.measured - (view.explained if is_after else view.base)) / view.noise
        band = np.clip(np.searchsorted(edges, run.load_N, side="right") - 1, 0, BANDS - 1)
        cells = (band, direction(run.drive, run.t_s).astype(int))
        np.add.at(total, cells, residual**2)
        np.add.at(count, cells, 1.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(count >= 5, np.sqrt(total / count), np.nan), edges


def worst_channel(runs: Sequence[RunView]) -> tuple[RunView, str] | None:
    """Return the run and the column that the base is farthest from, in units of the noise; None without runs."""
    pairs = [(run, column) for run in runs for column in run.channels]
    return max(pairs, key=lambda pair: rms_of(pair[0].channels[pair[1]], "base", noise=True), default=None)


def rms_of(view: ChannelView, prediction: str, *, noise: bool = False) -> float:
    """Return the RMS of what a prediction leaves, in the channel's unit or in units of its noise."""
    residual = view.measured - getattr(view, prediction)
    return float(np.sqrt(np.mean(residual**2))) / (view.noise if noise else 1.0)


def worst_run_figure(runs: Sequence[RunView], translate: Translator, colours: Palette = LIGHT) -> go.Figure | None:
    """Draw the run that the base is farthest from: its loop, and the residual over time beside the band of the noise.

    Measured, by the refitted base and with the causes; RMS of both residuals and of the noise in the title.
    """
    if (worst := worst_channel(runs)) is None:
        return None
    run, column = worst
    view, (times, unit) = run.channels[column], unit_of(column)
    is_output = column == "output_V"
    x, x_name = (run.load_N, "force_N") if is_output else (run.drive, run.drive_name)
    sizes = [times * size for size in (rms_of(view, "base"), rms_of(view, "explained"), view.noise)]
    decimals = decimals_of(min(sizes)) + 1
    before, after, floor = (with_decimals(size, decimals) for size in sizes)
    channel = channel_name(report_name(column), translate)
    titles = [
        translate("gap.figure.worst", run=run.name, channel=channel),
        translate("gap.figure.worst.rms", before=before, after=after, floor=floor, unit=unit),
    ]
    figure = make_subplots(cols=2, subplot_titles=titles, column_widths=[0.42, 0.58], horizontal_spacing=0.1)
    at = _thinning_indices(view.measured - view.base, COMPARED_POINTS)
    predictions = (("base", view.base, colours.source), ("causes", view.explained, colours.mapped))

    def look(of: str, colour: str) -> dict[str, Any]:
        # What was measured lies below the predictions and shows on both sides of them.
        line = {"color": colour, "width": 4 if of == "measured" else 1.4}
        return {"mode": "lines", "line": line, "name": translate(f"gap.figure.{of}")}

    for of, values, colour in (("measured", view.measured, colours.raw), *predictions):
        figure.add_scatter(x=x[at], y=times * values[at], **look(of, colour), row=1, col=1)
    low, high, band = run.t_s[0], run.t_s[-1], 2 * times * view.noise
    corners = {"x": [low, high, high, low], "y": [band, band, -band, -band]}
    filled = {"fill": "toself", "fillcolor": colours.line}
    figure.add_scatter(**corners, **filled, **look("noise_band", colours.line), row=1, col=2)
    for of, values, colour in predictions:
        residual = view.measured - values
        at = _thinning_indices(residual, COMPARED_POINTS)
        figure.add_scatter(x=run.t_s[at], y=times * residual[at], showlegend=False, **look(of, colour), row=1, col=2)
    name, _, x_unit = x_name.rpartition("_")
    label = f"{channel_name(name, translate)}, {x_unit}" if name else x_name
    figure.update_xaxes(title=label, title_standoff=8, row=1, col=1)
    figure.update_xaxes(title=translate("gap.figure.time"), title_standoff=8, row=1, col=2)
    figure.update_yaxes(title=unit)
    legend = {"orientation": "h", "x": 1.0, "xanchor": "right", "y": -0.2, "yanchor": "top", "yref": "paper"}
    return _apply_style(figure, 360, legend=legend)


def map_figure(runs: Sequence[RunView], channel: str, translate: Translator) -> go.Figure | None:
    """Draw the residual of a channel by force band and direction, before and after."""
    if channel not in CHANNELS or not any(channel in run.channels for run in runs):
        return None
    before, edges = residual_map(runs, channel, is_after=False)
    after, _ = residual_map(runs, channel, is_after=True)
    top = float(np.nanmax([np.nanmax(before), np.nanmax(after), 3.0]))
    bands = [f"{low:.1f}–{high:.1f} N" for low, high in zip(edges[:-1], edges[1:], strict=True)]
    titles = [
        f"{channel_name(CHANNELS[channel], translate)}, {translate(f'gap.figure.{of}')}" for of in ("base", "causes")
    ]
    figure = make_subplots(cols=2, shared_yaxes=True, subplot_titles=titles)
    for column, values in enumerate((before, after), start=1):
        heat = go.Heatmap(
            z=values,
            x=[render_reason(direction, translate) for direction in DIRECTIONS],
            y=bands,
            coloraxis="coloraxis",
            texttemplate="%{z:.1f}",
            hovertemplate="%{y}, %{x}: %{z:.2f} σ<extra></extra>",
            hoverongaps=False,
        )
        figure.add_trace(heat, row=1, col=column)
    scale = {
        "colorscale": "OrRd",
        "cmin": 1.0,
        "cmax": top,
        "colorbar": {"title": {"text": translate("gap.figure.scale"), "side": "right"}},
    }
    return _apply_style(figure, 320, coloraxis=scale)


def chain_figure(report: Mapping[str, Any], translate: Translator, colours: Palette = LIGHT) -> go.Figure | None:
    """Draw the share of the gap by stage of the twin's chain; None for another simulator, whose chain is its own."""
    if report.get("simulator"):
        return None
    shares: dict[str, float] = {}
    for location in report["where"]:
        # Stages come first; the rows after them tell the regime, whose share is one of energy.
        shares.setdefault(location["stage"], min(1.0, max(0.0, float(location["share"]))))
    hidden_stages, labels = report.get("unseen_stages", ()), []
    for stage in CHAIN:
        share = shares.get(stage, 0.0)
        labels.append(
            percent(share) if share else translate("gap.chain.unjudged" if stage in hidden_stages else "gap.chain.none")
        )
    names, x = [stage_name(stage, translate) for stage in CHAIN], [shares.get(stage, 0.0) for stage in CHAIN]
    figure = go.Figure(go.Bar(x=x, y=names, text=labels, marker_color=colours.raw, hoverinfo="skip", **LEVEL_BARS))
    figure.update_xaxes(range=[0.0, 1.12], tickformat=".0%", title=translate("gap.chain.label"))
    figure.update_yaxes(autorange="reversed")
    return _apply_style(figure, 90 + 28 * len(CHAIN), left=150, showlegend=False)


def ranking_figure(
    report: Mapping[str, Any], max_causes: int, translate: Translator, colours: Palette = LIGHT
) -> go.Figure:
    """Draw the effects by probability, the likeliest on top; at least three."""
    every = rank_causes(report)
    likely = sum(cause["probability"] >= 0.005 for cause in every)
    causes = every[: min(max_causes, max(3, likely))][::-1]
    names = [effect_name(cause["effect"], translate) for cause in causes]
    chances = [cause["probability"] for cause in causes]
    shades = [colours.mapped if chance >= 0.5 else colours.source for chance in chances]
    labels = [percent(chance) for chance in chances]
    look = {"marker_color": shades, "hovertemplate": "%{y}: %{x:.3f}<extra></extra>"} | LEVEL_BARS
    figure = go.Figure(go.Bar(x=chances, y=names, text=labels, **look))
    figure.update_xaxes(range=[0.0, 1.08], tickformat=".0%", title=translate("gap.figure.probability"))
    return _apply_style(figure, 120 + 26 * max(1, len(causes)), left=190, showlegend=False)


def gain_figure(report: Mapping[str, Any], translate: Translator, colours: Palette = LIGHT) -> go.Figure:
    """Draw the residual of each channel before and after, with its noise floor."""
    every = report["gap"]
    # JSON keeps no order.
    names = [*(name for name in CHANNELS.values() if name in every), *(n for n in every if n not in CHANNELS.values())]
    channels = [name for name in names if every[name] and None not in map(every[name].get, RESIDUALS)]
    # One above the other, with level bars: side by side, or below upright ones, names meet on half of a narrow page.
    titles = [translate("gap.figure.residual", channel=channel_name(name, translate)) for name in channels]
    figure = make_subplots(rows=max(1, len(channels)), subplot_titles=titles, vertical_spacing=0.24)
    for row, name in enumerate(channels, start=1):
        gap, (times, unit) = report["gap"][name], unit_of(name)
        values = [times * gap[key] for key in RESIDUALS]
        decimals = decimals_of(min(values)) + 1
        names, value_texts = (
            [translate(f"gap.figure.{of}") for of in PREDICTIONS],
            [f"{with_decimals(value, decimals)} {unit}" for value in values],
        )
        shades = [colours.source, colours.mapped, colours.line]
        figure.add_bar(x=values, y=names, text=value_texts, marker_color=shades, **LEVEL_BARS, row=row, col=1)
        figure.update_xaxes(title=unit, title_standoff=4, range=[0.0, 1.3 * max(values)], row=row, col=1)
        figure.update_yaxes(autorange="reversed", automargin=True, row=row, col=1)
    return _apply_style(figure, 90 + 190 * max(1, len(channels)), showlegend=False)


def hidden_figure(report: Mapping[str, Any], translate: Translator, colours: Palette = LIGHT) -> go.Figure | None:
    """Draw how much of each effect the refitted base would swallow on these runs."""
    hidden = {name: share for name, share in report["hidden_fraction"].items() if share is not None}
    if not hidden:
        return None
    names = sorted(hidden, key=lambda name: hidden[name])
    shares = [hidden[name] for name in names]
    shades = [colours.limit if share >= 0.8 else colours.source for share in shares]
    hover = f"%{{y}}: {translate('gap.figure.hidden.one', share='%{x:.0%}')}<extra></extra>"
    effects = [effect_name(name, translate) for name in names]
    figure = go.Figure(go.Bar(x=shares, y=effects, orientation="h", marker_color=shades, hovertemplate=hover))
    title = translate("gap.figure.hidden")
    figure.update_xaxes(range=[0.0, 1.0], tickformat=".0%", title=title, title_standoff=12, automargin=True)
    return _apply_style(figure, 140 + 18 * len(names), left=150, showlegend=False)


def trace_figure(
    runs: Sequence[RunView], channel: str, translate: Translator, colours: Palette = LIGHT
) -> go.Figure | None:
    """Draw the residual of a channel over time, one row per run, before and after."""

    def lines(view: ChannelView) -> Iterator[_Line]:
        for of, predicted, colour in (("base", view.base, colours.source), ("causes", view.explained, colours.mapped)):
            residual = view.measured - predicted
            yield of, residual, colour, _thinning_indices(residual)

    return _over_time(runs, channel, lines, translate)


def compared_figure(runs: Sequence[RunView], channel: str, translate: Translator) -> go.Figure | None:
    """Draw what was measured and predicted over time, one row per run, before and after."""

    def lines(view: ChannelView) -> Iterator[_Line]:
        # The same instants for all three: those at which the base is farthest off.
        at = _thinning_indices(view.measured - view.base, COMPARED_POINTS)
        yield "measured", view.measured, LIGHT.raw, at
        yield "base", view.base, LIGHT.source, at
        yield "causes", view.explained, LIGHT.mapped, at

    return _over_time(runs, channel, lines, translate)


def _over_time(
    runs: Sequence[RunView], channel: str, lines: Callable[[ChannelView], Iterator[_Line]], translate: Translator
) -> go.Figure | None:
    runs_of_channel = [run for run in runs if channel in run.channels]
    if not runs_of_channel:
        return None
    times, unit = unit_of(channel)
    titles = [
        f"{run.name}: {profile_name(run.profile, translate)}" if run.profile else run.name for run in runs_of_channel
    ]
    figure = make_subplots(
        rows=len(runs_of_channel), subplot_titles=titles, vertical_spacing=min(0.1, 0.3 / len(runs_of_channel))
    )
    for row, run in enumerate(runs_of_channel, start=1):
        for of, values, colour, at in lines(run.channels[channel]):
            look = {"legendgroup": of, "showlegend": row == 1, "line": {"color": colour, "width": 1}}
            name = translate(f"gap.figure.{of}")
            figure.add_scattergl(x=run.t_s[at], y=times * values[at], name=name, **look, row=row, col=1)
        figure.update_yaxes(title=unit, row=row, col=1)
    # The legend stands below: far from its axis, as the desk would draw it, the title would lie on it.
    figure.update_xaxes(title=translate("gap.figure.time"), title_standoff=8, row=len(runs_of_channel), col=1)
    position = {"x": 1.0, "xanchor": "right", "y": -0.35 / len(runs_of_channel), "yanchor": "top", "yref": "paper"}
    return _apply_style(figure, 110 + 150 * len(runs_of_channel), legend={"orientation": "h", **position})


def _thinning_indices(values: Array, max_points: int = MAX_POINTS) -> Indices:
    """Return indices that keep the largest absolute value of each of at most so many stretches."""
    if len(values) <= max_points:
        return np.arange(len(values))
    starts = np.linspace(0, len(values), max_points + 1).astype(int)
    picks = [a + int(np.argmax(np.abs(values[a:b]))) for a, b in zip(starts[:-1], starts[1:], strict=True) if b > a]
    return np.array(picks)
