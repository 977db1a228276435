"""The page of a diagnosis."""

import re
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from softcal.app.charts.gap import (
    chain_figure,
    direction,
    gain_figure,
    residual_map,
    trace_figure,
    worst_run_figure,
)
from softcal.app.charts.gap_page import gap_page
from softcal.app.charts.palette import palette
from softcal.app.charts.style import apply_theme
from softcal.app.paper.drawing import svg
from softcal.app.texts.catalogue import text
from softcal.app.views.gap_runs import ChannelView, RunView

ENGLISH = partial(text, "en")

REPORT: dict[str, Any] = {
    "schema": "softcal.gap/1",
    "verdict": "ambiguous",
    "gap": {
        "output": {"rmse_before": 6e-3, "rmse_after": 1.4e-3, "noise_floor": 1.3e-3},
        "force": {"rmse_before": None, "rmse_after": None, "noise_floor": None},
    },
    "shrink": {"predicted": 0.97, "low": 0.93, "high": 0.99, "held_out": None},
    "where": [{"stage": "transduction", "channel": "output", "regime": "rest", "share": 0.8, "detail": "a < b & c"}],
    "causes": [
        {
            "effect": "thermal_drift",
            "probability": 0.6,
            "shrink": 0.97,
            "parameters": {"alpha": {"value": 1e-3, "low": 9e-4, "high": None, "unit": "1/K"}},
        },
        {"effect": "backlash", "probability": 0.0, "shrink": 0.0, "parameters": {}},
    ],
    "ambiguous_with": [["thermal_drift", "ageing_drift"]],
    "hidden_fraction": {"thermal_drift": 0.9, "backlash": None},
    "next_experiment": {"profile": "temperature_step", "why": "10 K and back part the two by 20 σ"},
    "missing_channels": ["stage_mm"],
}


@pytest.fixture
def run(rng: np.random.Generator) -> RunView:
    t_s = np.arange(2000) / 50.0
    load_N = 3.0 * np.abs(np.sin(0.3 * t_s))
    output_V = ChannelView(1.0 + 0.1 * load_N, 1.0 + 0.1 * load_N + 0.003, 1.0 + 0.1 * load_N + 0.001, 0.001)
    return RunView("1", "ramps", "force_N", t_s, load_N, load_N, {"output_V": output_V})


def test_the_page_answers_the_five_questions(run: RunView) -> None:
    page = gap_page(REPORT, [run], "A17", ENGLISH)
    assert [key for key in ("where", "why", "gain", "sure", "next") if ENGLISH(f"gap.{key}") not in page] == []
    assert all(text in page for text in ("thermal drift", "ageing drift", "temperature step", "97.0 %"))


def test_nothing_is_loaded_from_elsewhere(run: RunView) -> None:
    page = gap_page(REPORT, [run], "A17", ENGLISH)
    assert not re.search(r"<(script|img|iframe)[^>]+src=|<link|@import|url\(\s*['\"]?http", page)


def test_text_of_a_report_cannot_become_markup(run: RunView) -> None:
    page = gap_page(REPORT, [run], "<script>alert(1)</script>", ENGLISH)
    assert "<script>alert" not in page
    assert "a &lt; b &amp; c" in page


def test_what_was_taken_off_the_runs_is_reported_unless_it_shows_as_nothing(run: RunView) -> None:
    sizes = {"run": 1, "force_N": 0.03, "resistance": 1e-6, "seat_mm": 1e-5}
    page = gap_page({**REPORT, "offsets": [sizes]}, [run], "A17", ENGLISH)
    assert ENGLISH("gap.own.force_N", size="0.030") in page
    for name in ("resistance", "seat_mm"):
        assert ENGLISH(f"gap.own.{name}", size="#").partition("#")[0] not in page


@pytest.mark.parametrize("verdict", ["no_gap", "explained", "unknown"])
def test_every_verdict_has_its_page(run: RunView, verdict: str) -> None:
    empty = {"causes": [], "where": [], "ambiguous_with": [], "hidden_fraction": {}, "next_experiment": {}}
    nothing = {"predicted": None, "low": None, "high": None, "held_out": None}
    page = gap_page({**REPORT, **empty, "verdict": verdict, "shrink": nothing}, [run], "A17", ENGLISH)
    assert ENGLISH("gap.next.none") in page and ENGLISH("gap.gain.none") in page


def test_a_mistake_in_the_recordings_has_its_page(run: RunView) -> None:
    data = {
        "what": "unit_factor",
        "channel": "force",
        "runs": [2],
        "evidence": "force of this run is <9.8> times too small",
        "repair": "multiply by 9.807",
    }
    page = gap_page({**REPORT, "verdict": "data", "data": [data]}, [run], "A17", ENGLISH)
    assert "unit factor" in page and "&lt;9.8&gt;" in page and "multiply by 9.807" in page
    assert ENGLISH("gap.gain") not in page


def test_the_residual_map_counts_in_units_of_the_noise(run: RunView) -> None:
    before, edges = residual_map([run], "output_V", is_after=False)
    after, _ = residual_map([run], "output_V", is_after=True)
    assert edges[0] == 0.0 and edges[-1] == pytest.approx(3.0, abs=0.01)
    np.testing.assert_allclose(before[np.isfinite(before)], 3.0)
    np.testing.assert_allclose(after[np.isfinite(after)], 1.0)


def test_direction_tells_loading_hold_and_unloading() -> None:
    t_s = np.arange(300) / 50.0
    drive = np.interp(t_s, [0.0, 2.0, 4.0, 6.0], [0.0, 2.0, 2.0, 0.0])
    directions = direction(drive, t_s)
    assert (directions[50], directions[150], directions[250]) == (0.0, 1.0, 2.0)


def test_a_thinned_trace_keeps_its_peak(run: RunView) -> None:
    t_s = np.arange(20_000) / 50.0
    measured = np.zeros(20_000)
    measured[12_345] = 0.5
    flat = ChannelView(measured, np.zeros(20_000), np.zeros(20_000), 1e-3)
    figure = trace_figure([replace(run, t_s=t_s, channels={"output_V": flat})], "output_V", ENGLISH)
    assert figure is not None
    assert len(figure.data[0].y) <= 1500 and max(figure.data[0].y) == 500.0


def test_a_page_with_long_runs_stays_below_a_megabyte(run: RunView, rng: np.random.Generator) -> None:
    t_s = np.arange(50_000) / 50.0
    noisy = [ChannelView(*rng.normal(0.0, 1.0, (3, 50_000)), 1e-3) for _ in range(2)]
    channels = dict(zip(("output_V", "force_N"), noisy, strict=True))
    long = replace(run, t_s=t_s, drive=np.abs(noisy[0].measured), load_N=np.abs(noisy[0].measured), channels=channels)
    page = gap_page(REPORT, [replace(long, name=str(k)) for k in range(6)], "A17", ENGLISH)
    assert len(page.encode()) < 1_000_000


def test_a_channel_that_was_not_recorded_has_no_figure(run: RunView) -> None:
    assert trace_figure([run], "force_N", ENGLISH) is None


@pytest.mark.parametrize("share", [0.05, 0.5, 1.0])
def test_the_chain_shows_the_share_of_each_stage(share: float) -> None:
    location = {"stage": "load_cell", "channel": "force", "regime": "hold", "share": share, "detail": ""}
    report = {"where": [location, {**location, "share": 0.9}], "unseen_stages": ["motion"]}
    (bars,) = chain_figure(report, ENGLISH).data
    assert dict(zip(bars.y, bars.x, strict=True))["load cell"] == pytest.approx(share)
    assert dict(zip(bars.y, bars.text, strict=True))["motion"] == ENGLISH("gap.chain.unjudged")
    assert svg(chain_figure(report, ENGLISH)).count("<rect") == len(bars.y)
    assert chain_figure({**report, "simulator": "own"}, ENGLISH) is None


def test_names_of_bars_stand_beside_them_and_axes_have_units() -> None:
    gap = {"rmse_before": 6e-3, "rmse_after": 1.4e-3, "noise_floor": 1.3e-3}
    figure = gain_figure({"gap": {"output": gap, "force": gap}}, ENGLISH)
    assert [bars.orientation for bars in figure.data] == ["h", "h"]
    assert (figure.layout.xaxis.title.text, figure.layout.xaxis2.title.text) == ("mV", "mN")


def test_the_legend_of_the_traces_stays_in_the_figure_on_the_screen(run: RunView) -> None:
    figure = trace_figure([run], "output_V", ENGLISH)
    assert figure is not None
    legend = figure.layout.legend.to_plotly_json()
    themed = apply_theme(figure, palette("light")).update_layout(legend=legend)
    # A place below the axes is counted from the axes: counted from the figure it lies outside.
    assert themed.layout.legend.y < 0 and themed.layout.legend.yref == "paper"


def test_the_first_figure_is_the_run_that_the_base_is_farthest_from(run: RunView) -> None:
    near = replace(run, name="2", channels={"output_V": replace(run.channels["output_V"], noise=0.01)})
    figure = worst_run_figure([near, run], ENGLISH)
    assert figure is not None
    measured, base, causes, band, before, after = figure.data
    view = run.channels["output_V"]
    for line, values in ((measured, view.measured), (base, view.base), (causes, view.explained)):
        assert line.xaxis == "x" and set(line.x) <= set(run.load_N) and set(line.y) <= set(1e3 * values)
    assert {abs(y) for y in band.y} == {2.0}
    assert before.y == pytest.approx(-3.0) and after.y == pytest.approx(-1.0)
    run_title, rms_title = (note.text for note in figure.layout.annotations)
    assert "run 1" in run_title and re.findall(r"[\d.]+", rms_title) == ["3.00", "1.00", "1.00"]
    assert figure.layout.yaxis.title.text == "mV" and figure.layout.xaxis.title.text == "force, N"
    assert svg(figure).count("<polyline") >= 5 and worst_run_figure([], ENGLISH) is None


def test_the_loop_of_another_channel_is_over_what_drove_it(run: RunView) -> None:
    drive = run.load_N**2
    lever = replace(run, drive_name="push_N", drive=drive, channels={"angle_rad": run.channels["output_V"]})
    figure = worst_run_figure([lever], ENGLISH)
    assert figure is not None and figure.layout.xaxis.title.text == "push, N"
    assert set(figure.data[0].x) <= set(drive)
