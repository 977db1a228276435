"""`softcal explain`: the figure and the numbers behind a verdict, one unit or a whole lot."""

import json
from functools import partial
from pathlib import Path

import pytest

from softcal.app.charts.palette import palette
from softcal.app.charts.why import why_figure
from softcal.app.cli.main import main
from softcal.app.texts.catalogue import text
from softcal.app.views.unit import unit_view
from softcal.core.lot import UnitKey
from softcal.db.connection import open_registry

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


def test_explanation_of_one_unit_is_told_in_words_numbers_and_a_figure(
    url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    page, report = tmp_path / "why.html", tmp_path / "why.json"
    assert main(["explain", "--serial", "A2", "--registry", url, "--out", str(page), "--json", str(report)]) == 0
    facts = json.loads(report.read_text())
    parts = facts["contributions"].values()
    assert facts["predicted_rmse"] == pytest.approx(sum(part**2 for part in parts) ** 0.5, rel=1e-6)
    assert facts["reasons"][0] in " ".join(capsys.readouterr().out.split())
    assert "A2" in page.read_text()


def test_figure_shows_forecast_against_limit_and_all_panels(url: str) -> None:
    with open_registry(url) as registry:
        view = unit_view(registry, UnitKey("small", "A1"))
    figure = why_figure(view, palette("light"), partial(text, "en"))
    diamond = next(trace for trace in figure.data if trace.name == text("en", "column.predicted"))
    assert diamond.x[0] == pytest.approx(view.stored.state.predicted_rmse)
    assert [line.x0 for line in figure.layout.shapes] == [view.explanation.limit]
    assert figure.layout.xaxis.range[1] > max(view.explanation.limit, *diamond.x, *figure.data[0].x)
    drawn = [trace for trace in figure.data if trace.xaxis == "x2" and trace.x[0] is not None]
    edges = view.explanation.density_edges
    assert {(trace.x[0], trace.x[-1]) for trace in drawn} == {(edges[0], edges[-1])}
    assert len({trace.xaxis for trace in figure.data}) == 4
    assert str(view.stored.state.decision.reasons[0])[:40] in figure.layout.title.text


def test_a_figure_file_that_is_no_page_is_refused(url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert main(["explain", "--serial", "A1", "--registry", url, "--out", str(tmp_path / "a.png")]) == 2
    assert ".html" in capsys.readouterr().err and not (tmp_path / "a.png").exists()
