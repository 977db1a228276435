"""The stations: what each does, its references, its profiles."""

from softcal.app.ui.panels import draw_tabs, heading


def render() -> None:
    heading("station")
    draw_tabs("station")
