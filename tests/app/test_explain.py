"""`softcal explain`: the figure and the numbers behind a verdict, one unit or a whole lot."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
import pytest

from softcal.app.charts.explanation import explanation_figure
from softcal.app.charts.palette import palette
from softcal.app.cli.main import main
from softcal.app.texts.catalogue import catalogue, text
from softcal.app.views.unit import UnitView, unit_view
from softcal.core.lot import UnitKey
from softcal.db.connection import open_registry
from tests.unit_states import sample_release

SMALL = ("--hidden", "16,8", "--no-own")


@pytest.fixture
def url(lot_folder: Path, registry_url: str) -> str:
    """The URL of a registry in which the small lot is calibrated."""
    main(["batch", str(lot_folder), "--registry", registry_url, *SMALL])
    return registry_url


def test_every_unit_of_a_batch_gets_its_figure(lot_folder: Path, registry_url: str, tmp_path: Path) -> None:
    main(["batch", str(lot_folder), "--registry", registry_url, *SMALL, "--plots", str(tmp_path / "why")])
    pages = sorted(path.name for path in (tmp_path / "why").iterdir())
    assert pages == ["A1.html", "A2.html", "A3.html", "plotly.min.js"]
    page = (tmp_path / "why" / "A1.html").read_text()
    assert "plotly.min.js" in page and "https://" not in page.split("<body>")[1][:2000]


def test_explanation_of_one_unit_is_rendered_in_words_numbers_and_a_figure(
    url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    page, report = tmp_path / "why.html", tmp_path / "why.json"
    assert main(["explain", "--serial", "A2", "--registry", url, "--out", str(page), "--json", str(report)]) == 0
    content = json.loads(report.read_text())
    parts = content["contributions"].values()
    assert content["predicted_rmse"] == pytest.approx(sum(part**2 for part in parts) ** 0.5, rel=1e-6)
    assert content["reasons"][0] in " ".join(capsys.readouterr().out.split())
    assert "A2" in page.read_text()


def figure_of(url: str, has_audit: bool) -> tuple[UnitView, go.Figure]:
    with open_registry(url) as registry:
        view = unit_view(registry, UnitKey("small", "A1"))
    view = view if has_audit else replace(view, audit=None)
    return view, explanation_figure(view, palette("light"), partial(text, "en"))


def test_what_was_measured_is_shown_where_it_decided(url: str) -> None:
    view, figure = figure_of(url, has_audit=True)
    assert view.audit is not None
    titles = {note.text for note in figure.layout.annotations}
    assert titles == {text("en", f"why.{name}") for name in ("estimate", "error", "course", "loop")}
    error = view.audit.estimate - view.audit.reference
    assert float(np.sqrt(np.mean(error**2))) == pytest.approx(view.stored.state.errors["after_rmse"], rel=1e-6)
    limit = view.stored.state.limit.maximum_rmse
    assert sorted({line.y0 for line in figure.layout.shapes}) == [-limit, limit]
    assert all("[N]" in figure.layout[axis].title.text for axis in ("xaxis", "yaxis", "yaxis2", "yaxis3", "xaxis4"))


def test_the_parts_of_a_forecast_add_in_quadrature_and_each_is_explained(url: str) -> None:
    view, figure = figure_of(url, has_audit=False)
    bars = figure.data[0]
    ends = np.asarray(bars.base) + np.asarray(bars.x)
    assert ends[-1] == pytest.approx(view.stored.state.forecast.rmse, rel=1e-2)
    assert np.asarray(bars.base)[1:] == pytest.approx(ends[:-1])
    assert min(np.diff(np.concatenate([[0.0], ends**2]))) > 0
    assert all(sentence.endswith(".") for _, sentence in bars.customdata)


def test_what_audits_of_other_units_make_of_a_forecast_is_a_part_of_it(url: str) -> None:
    view, _ = figure_of(url, has_audit=False)
    state = view.stored.state
    release = sample_release(limit_rmse=state.limit.maximum_rmse, scale=0.75)
    view = replace(view, stored=replace(view.stored, state=replace(state, audit=None, release=release)))
    assert view.stored.state.predicted_rmse == pytest.approx(0.75 * state.fit.forecast.rmse)
    bars = explanation_figure(view, palette("light"), partial(text, "en")).data[0]
    assert bars.base[-1] + bars.x[-1] == pytest.approx(view.stored.state.predicted_rmse)
    assert bars.y[-1] == text("en", "part.audits")


def test_every_part_of_a_forecast_has_a_sentence() -> None:
    parts = {key.removeprefix("part.") for key in catalogue()["en"] if key.startswith("part.")}
    assert {f"why.part.{part}" for part in parts} <= set(catalogue()["en"])


@pytest.mark.parametrize("has_audit", [True, False])
def test_each_panel_has_its_legend_inside(url: str, has_audit: bool) -> None:
    _, figure = figure_of(url, has_audit)
    legends = {trace.legend or "legend" for trace in figure.data}
    assert len(legends) == (4 if has_audit else 1)
    assert all(0 <= figure.layout[name].x <= 1 and 0 <= figure.layout[name].y <= 1 for name in legends)


def test_the_figure_shows_the_forecast_against_the_limit(url: str) -> None:
    view, figure = figure_of(url, has_audit=False)
    limit = view.stored.state.limit.maximum_rmse
    diamond = next(trace for trace in figure.data if trace.name == text("en", "column.predicted"))
    assert diamond.x[0] == pytest.approx(view.stored.state.predicted_rmse)
    assert [line.x0 for line in figure.layout.shapes] == [limit]
    assert figure.layout.xaxis.range[1] > max(limit, *diamond.x)
    assert str(view.stored.state.decision.reasons[0])[:40] in figure.layout.title.text


def test_a_figure_file_that_is_no_page_is_refused(url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert main(["explain", "--serial", "A1", "--registry", url, "--out", str(tmp_path / "a.png")]) == 2
    assert ".html" in capsys.readouterr().err and not (tmp_path / "a.png").exists()
