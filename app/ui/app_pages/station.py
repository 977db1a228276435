"""The stations: what each does, its references, its profiles."""

from softcal.app.ui.panels import heading
from softcal.app.ui.tab_bar import draw_tabs


def render() -> None:
    heading("station")
    draw_tabs("station")
