"""The figures of docs/method.md: a simulated lot whose units rest longer than their source. Run by screenshots.py."""

from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from playwright.sync_api import Browser, ViewportSize
from plotly.subplots import make_subplots

from softcal.core.maps.catalogue import family
from softcal.core.maps.interface import FitProblem, UnitMap
from softcal.core.maps.paired import paired_by_stage
from softcal.core.network.config import NetworkConfig
from softcal.core.network.training import fit_network
from softcal.core.recording import Array, LabelledRecording
from softcal.core.simulated_lot import LotDesign, SimulatedUnit, simulate_lot
from softcal.core.windows import resting

SEED = 3
SHOWN_S = 25.0
FAMILIES = {
    "monotone": "whole distribution (monotone)",
    "two_point": "rest and peak (two_point)",
    "stage_matched": "pairs (stage_matched)",
}
SIZE = ViewportSize(width=1100, height=430)


def take_all(browser: Browser, out: Path) -> None:
    """Draw both figures."""
    lot = simulate_lot(SEED, LotDesign(good=1, shift="other dwell", has_stage=True))
    network = fit_network(lot.source, NetworkConfig(hidden=(40, 20), max_epochs=60, batch=128)).network
    unit = lot.units[0]
    problem = FitProblem(lot.source, network, unit.recording)
    page = browser.new_page(viewport=SIZE, device_scale_factor=1.5)
    for name, figure in {"method-families": families(problem, unit), "method-pairs": pairs(problem)}.items():
        page.set_content(figure.to_html(include_plotlyjs=True, config={"displayModeBar": False}))
        page.locator(".main-svg").first.wait_for()
        page.screenshot(path=out / f"{name}.png")


def families(problem: FitProblem, unit: SimulatedUnit) -> go.Figure:
    """Both outputs over time, and what each family makes of them beside the truth."""
    figure = panels(
        ("Output: the unit is held for longer", "Curve from the unit's output to the source's"),
        (("time, s", "output, V"), ("output of the unit, V", "output of the source, V")),
    )
    for recording, name in ((problem.source.unlabelled, "source"), (unit.recording, "unit")):
        rows = recording.t_s - recording.t_s[0] < SHOWN_S
        figure.add_scatter(x=recording.t_s[rows] - recording.t_s[0], y=recording.output[rows], name=name, row=1, col=1)
    lowest, highest = np.quantile(unit.audit.unlabelled.output, (0.002, 0.998))
    levels = np.linspace(lowest, highest, 60)
    for name, label in FAMILIES.items():
        figure.add_scatter(x=levels, y=at_rest(family(name).fit(problem), levels), name=label, row=1, col=2)
    ours, theirs = truth(unit.audit, problem.source)
    figure.add_scatter(
        x=ours,
        y=theirs,
        name="outputs at equal load",
        mode="markers",
        marker={"color": "black", "size": 5},
        row=1,
        col=2,
    )
    return figure


def pairs(problem: FitProblem) -> go.Figure:
    """The pairs with the curve through them, and what f makes of the curve."""
    figure = panels(
        ("Windows at equal stage position and history", "What f says of the mapped unit"),
        (
            ("mean output of the unit's window, V", "mean output of the source's, V"),
            ("output of the unit, V", "load, N"),
        ),
    )
    source_rows, target_rows = paired_by_stage(problem.source.unlabelled, problem.target, problem.config)
    thin = slice(None, None, max(1, len(target_rows) // 1500))
    of_unit = problem.target.windows[target_rows[thin]].mean(axis=1)
    of_source = problem.source.windows[source_rows[thin]].mean(axis=1)
    load_N = problem.source.window_reference[source_rows[thin]]
    fitted = family("stage_matched").fit(problem)
    levels = np.linspace(float(of_unit.min()), float(of_unit.max()), 100)
    dots = {"mode": "markers", "marker": {"size": 3, "opacity": 0.4}}
    figure.add_scatter(x=of_unit, y=of_source, name="a pair", row=1, col=1, **dots)
    figure.add_scatter(x=levels, y=at_rest(fitted, levels), name="γ at rest", row=1, col=1)
    figure.add_scatter(x=of_unit, y=load_N, name="load of the pair's source", row=1, col=2, **dots)
    answer_N = problem.network.evaluate(fitted.apply(resting(levels)))
    figure.add_scatter(x=levels, y=answer_N, name="f(γ) at rest", row=1, col=2)
    return figure


def panels(titles: tuple[str, str], axes: tuple[tuple[str, str], tuple[str, str]]) -> go.Figure:
    """Two empty panels with named axes."""
    figure = make_subplots(cols=2, subplot_titles=titles)
    for column, (x, y) in enumerate(axes, start=1):
        figure.update_xaxes(title=x, row=1, col=column)
        figure.update_yaxes(title=y, row=1, col=column)
    figure.update_layout(template="plotly_white", margin={"l": 60, "r": 20, "t": 40, "b": 50}, **SIZE)
    return figure


def at_rest(unit_map: UnitMap, levels: Array) -> Array:
    """Mean of the mapped window of a unit that stands still at each level."""
    return np.asarray(unit_map.apply(resting(levels)).mean(axis=1))


def truth(unit: LabelledRecording, source: LabelledRecording) -> tuple[Array, Array]:
    """Mean outputs of both in the same steps of the load, from the unit's audit: no map has seen it."""
    edges_N = np.linspace(0.0, float(np.quantile(unit.reference, 0.995)), 16)
    means = []
    for recording in (unit, source):
        step = np.digitize(recording.reference, edges_N)
        means.append([float(recording.unlabelled.output[step == k].mean()) for k in range(1, len(edges_N))])
    return np.array(means[0]), np.array(means[1])
