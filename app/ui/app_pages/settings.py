"""Who is here, who may do what, what certificates say, what was done."""

from softcal.app.ui.panels import draw_tabs, heading


def render() -> None:
    heading("settings")
    draw_tabs("settings")
