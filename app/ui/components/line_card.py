"""The operator's state as HTML. Everything from outside is escaped."""

from collections.abc import Sequence
from html import escape
from pathlib import Path
from urllib.parse import quote

from softcal.app.charts.palette import VERDICT_INK, Palette
from softcal.app.views.common import shorten
from softcal.app.views.line import Chip, LineView

MARKS = {
    "pass": '<circle cx="32" cy="32" r="29"/><path d="M18 33l10 10 19-21"/>',
    "fail": '<path d="M20 4h24l16 16v24L44 60H20L4 44V20z"/><path d="M21 21l22 22M43 21L21 43"/>',
    "check": '<path d="M32 4l28 28-28 28L4 32z"/><path d="M32 18v17M32 44v1"/>',
    "repeat": '<path d="M53 32a21 21 0 1 1-6-15"/><path d="M48 5v13H35"/>',
    "stopped": '<path d="M32 5l28 51H4z"/><path d="M32 23v15M32 46v1"/>',
    "closed": '<rect x="12" y="28" width="40" height="30" rx="4"/><path d="M20 28v-8a12 12 0 0 1 24 0v8"/>',
    "golden": '<path d="M32 4l8 17 19 2-14 13 4 19-17-9-17 9 4-19L5 23l19-2z"/>',
    "load": '<circle cx="32" cy="14" r="8"/><path d="M20 26h24l10 30H10z"/>',
    "running": '<path d="M4 34h12l7-20 11 38 8-26 5 8h13"/>',
    "yes": '<path d="M8 34l16 16 32-36"/>',
    "no": '<path d="M12 12l40 40M52 12L12 52"/>',
    "ready": '<path d="M6 20V6h14M44 6h14v14M58 44v14H44M20 58H6V44"/><path d="M18 20v24M27 20v24M37 20v24M46 20v24"/>',
}
"""Tone → paths on 64 × 64; each has its own shape, since colour says nothing to many."""


LONGEST_VALUE, LONGEST_CHIP = 36, 17
"""Characters of a value in the bar and of a serial among the last units; the tip has all."""


def style() -> str:
    """Return the style of the screen; once per page."""
    css = Path(__file__).with_suffix(".css").read_text(encoding="utf-8")
    drawing = (
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 64 64" fill="none" stroke="#000" stroke-width="5" '
        'stroke-linecap="round" stroke-linejoin="round">'
    )
    drawings = {tone: quote(f"{drawing}{paths}</svg>") for tone, paths in MARKS.items()}
    marks = "".join(
        f'.sc-mark-{tone}{{--sc-mark:url("data:image/svg+xml,{quoted}")}}' for tone, quoted in drawings.items()
    )
    return f"<style>{css}{marks}</style>"


def theme(colours: Palette) -> str:
    """Return the colours that follow the browser's theme."""
    css_colours = {name: getattr(colours, name) for name in ("soft", "line", "good", "bad")}
    css_colours |= {f"verdict-{verdict}": ground for verdict, ground in colours.verdict.items()} | {"ink": VERDICT_INK}
    return f"<style>:root{{{''.join(f'--sc-{name}:{colour};' for name, colour in css_colours.items())}}}</style>"


def note_html(text: str, is_refusal: bool) -> str:
    """Return the sentence about the last scan."""
    return f'<div class="sc-note {"sc-no" if is_refusal else "sc-yes"}">{escape(text)}</div>'


def cells_html(view: LineView) -> str:
    """Return the bar of what is always visible."""
    cells = "".join(
        f'<div><span>{escape(label)}</span><b title="{escape(value)}">{escape(shorten(value, LONGEST_VALUE))}</b></div>'
        for label, value in view.cells
    )
    return f'<div class="sc-cells">{cells}</div>'


def card_html(view: LineView, reason_label: str) -> str:
    """Return the state; the numbers behind it open under the word `reason_label`."""
    serial = f'<div class="sc-serial">{escape(view.serial)}</div>' if view.serial else ""
    details = "".join(f"<li>{escape(line)}</li>" for line in view.details)
    numbers = "".join(f"<li>{escape(line)}</li>" for line in view.reason_details)
    numbers_html = (
        f'<details class="sc-why"><summary>{escape(reason_label)}</summary><ul>{numbers}</ul></details>'
        if numbers
        else ""
    )
    progress = ""
    if view.is_busy:
        percent, phase = round(100 * min(max(view.fraction, 0.0), 1.0)), escape(view.phase)
        progress = (
            f'<div class="sc-phase"><span>{phase}</span><span>{escape(view.remaining)}</span></div>'
            f'<div class="sc-bar" role="progressbar" aria-valuemin="0" aria-valuemax="100" aria-valuenow="{percent}" '
            f'aria-label="{phase}"><i style="width:{percent}%"></i></div>'
        )
    look = f"sc-{view.tone} sc-short" if view.conditions else f"sc-{view.tone}"
    return (
        f'<section class="sc-card {look}" data-state="{view.state}">{_mark(view.tone)}'
        f'<div class="sc-body"><div class="sc-word">{escape(view.word)}</div>{serial}'
        f'<p class="sc-do">{escape(view.instruction)}</p>'
        f"{f'<ul>{details}</ul>' if details else ''}{numbers_html}{progress}</div></section>"
    )


def conditions_html(view: LineView, title: str) -> str:
    """Return what the gate looked at, good and bad, in words."""
    worst_first = sorted(view.conditions, key=lambda condition: condition.is_good)
    rows = "".join(
        f'<li class="{"sc-good" if c.is_good else "sc-bad"}">{_mark("yes" if c.is_good else "no")}'
        f"<b>{escape(str(c.name))}</b> <span>{escape(str(c.says))}</span></li>"
        for c in worst_first
    )
    return f'<div class="sc-gate"><h3>{escape(title)}</h3><ul>{rows}</ul></div>'


def chips_html(view: LineView, title: str, empty: str) -> str:
    """Return the last units, newest first."""
    body = chips_row(view.chips) if view.chips else f"<p>{escape(empty)}</p>"
    return f'<div class="sc-chips"><h3>{escape(title)}</h3>{body}</div>'


def chips_row(chips: Sequence[Chip]) -> str:
    """Return units with their results side by side."""
    items = "".join(
        f'<li class="sc-chip sc-{c.tone}" title="{escape(c.serial)}: {escape(c.word)}">{_mark(c.tone)}'
        f"<b>{escape(shorten(c.serial, LONGEST_CHIP))}</b><span>{escape(c.word)}</span></li>"
        for c in chips
    )
    return f"<ul>{items}</ul>"


def _mark(name: str) -> str:
    # Streamlit takes SVG out of HTML: the mark is a mask over the colour of the text.
    return f'<i class="sc-mark sc-mark-{name}" aria-hidden="true"></i>'
