"""Letters and colours of the screens. Every text has a contrast of 4.5:1 on its ground."""

from dataclasses import dataclass

FONTS = '"Source Sans", "Noto Sans KR", system-ui, sans-serif'
"""Of pages and plots alike. Streamlit brings the first, `app/ui/static` the second, for the Korean letters.
A page that was taken along is written in what its computer has."""


@dataclass(frozen=True)
class Palette:
    """Colours of one theme.

    Args:
        source, raw, mapped: the three window spaces a chart compares.
        limit: lines that decide.
        verdict: ground of a verdict's badge, `VERDICT_INK` on it.
        chosen: words of what is chosen among others, on the page's ground and on a tint of it.
        veil: ground of a legend inside a picture.
        soft, line, good, bad: labels, borders, words of well or not well, on the page's ground.
    """

    text: str
    grid: str
    source: str
    raw: str
    mapped: str
    band: str
    limit: str
    verdict: dict[str, str]
    chosen: str
    veil: str
    soft: str  # noqa: V107
    line: str
    good: str
    bad: str


VERDICT_MARK = {"pass": "✓", "conditional": "!", "fail": "✕", "retest": "↻", "none": "–"}
"""In front of the word of a verdict, so that no colour is needed to tell them apart."""

VERDICT = {"pass": "#009E73", "conditional": "#E69F00", "fail": "#D55E00", "retest": "#56B4E9", "none": "#A6A6A6"}
"""Of Okabe and Ito (2008): told apart by people of every colour vision."""

VERDICT_INK = "#000000"
"""Text on each of them, with a contrast of 4.5:1."""

VERDICT_HATCH = {"pass": "", "conditional": "/", "fail": "x", "retest": ".", "none": "-"}
"""Of bars, so that a print without colour tells them apart."""

LIGHT = Palette("#1B2733", "#DDE3EA", "#3F5B7A", "#B4690E", "#0B5FFF", "rgba(11,95,255,0.16)", "#B3141D", VERDICT,
                "#0B4FD6", "rgba(255,255,255,0.7)", "#4A5B6C", "#C9D2DB", "#0A7D33", "#B3141D")  # fmt: skip
DARK = Palette("#E6EBF0", "#33404D", "#9DB4CC", "#E0A458", "#6FA3FF", "rgba(111,163,255,0.22)", "#FF7A80", VERDICT,
               "#8DB6FF", "rgba(14,20,27,0.7)", "#A9B8C6", "#3A4855", "#4CC38A", "#FF8F94")  # fmt: skip


def palette(theme: str | None) -> Palette:
    """Return the colours of a theme; light unless it is `dark`."""
    return DARK if theme == "dark" else LIGHT
