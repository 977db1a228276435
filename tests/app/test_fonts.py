"""Pages and plots are written in the same letters, Korean ones too, and none is fetched from elsewhere."""

import tomllib
from collections.abc import Callable
from pathlib import Path

import plotly.graph_objects as go
import pytest
from playwright.sync_api import Page

from softcal.app.charts.gap import FONTS as OF_GAP
from softcal.app.charts.palette import FONTS, LIGHT
from softcal.app.charts.style import apply_theme
from softcal.app.ui import account

UI = Path(account.__file__).parent
THEME = tomllib.loads((UI / ".streamlit" / "config.toml").read_text(encoding="utf-8"))["theme"]
MAX_BYTES = 1_000_000


def test_plots_are_written_like_the_page() -> None:
    assert apply_theme(go.Figure(), LIGHT).layout.font.family == THEME["font"] == FONTS == OF_GAP


def test_the_fonts_of_the_page_lie_in_the_package_with_their_licence() -> None:
    weights = {int(face["weight"]): UI / str(face["url"]).removeprefix("app/") for face in THEME["fontFaces"]}
    assert weights.keys() == {400, 700} and all(face["family"] in FONTS for face in THEME["fontFaces"])
    for file in weights.values():
        assert file.read_bytes()[:4] == b"wOF2" and file.stat().st_size < MAX_BYTES
    assert (UI / "static" / "OFL.txt").is_file()


@pytest.mark.long
def test_a_browser_writes_page_and_plot_in_the_bundled_letters(small_calibrated, serve: Callable, page: Page) -> None:
    with serve(f"sqlite:///{small_calibrated}") as screen:
        page.goto(f"{screen.address}/lot?lot=small&lang=ko")
        page.locator(".js-plotly-plot text").first.wait_for()
        families = "found => found.map(one => getComputedStyle(one).fontFamily)"
        plot = set(page.locator(".js-plotly-plot text").evaluate_all(families))
        font_families = set(page.locator("h1, p, [data-testid=stTable] td").evaluate_all(families))
        assert len(plot) == 1 and all(
            family.startswith('"Source Sans", "Noto Sans KR"') for family in plot | font_families
        )
        page.evaluate("document.fonts.ready.then(() => true)")
        loaded = page.evaluate("[...document.fonts].filter(f => f.status == 'loaded').map(f => [f.family, f.weight])")
        assert {("Noto Sans KR", "400"), ("Noto Sans KR", "700")} <= {(f.strip('"'), w) for f, w in loaded}
