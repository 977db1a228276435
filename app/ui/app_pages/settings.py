"""Who is here, who may do what, what certificates say, what was done."""

from softcal.app.ui.panels import heading
from softcal.app.ui.tab_bar import draw_tabs


def render() -> None:
    heading("settings")
    draw_tabs("settings")
