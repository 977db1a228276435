"""Embedded fonts: ReportLab's own for Latin letters, one of the computer's for all else."""

import html
import itertools
import os
import sys
from functools import cache
from pathlib import Path

from reportlab.graphics.shapes import STATE_DEFAULTS
from reportlab.pdfbase import pdfmetrics
from reportlab.pdfbase.ttfonts import TTFError, TTFont

from softcal.core.errors import InputError

PLAIN, BOLD = "Vera", "VeraBd"
OTHER = "other letters"
VARIABLE = "SOFTCAL_FONT"

CANDIDATES = {
    "linux": ("/usr/share/fonts/truetype/nanum/NanumGothic.ttf", "/usr/share/fonts/truetype/dejavu/DejaVuSans.ttf"),
    "win32": (r"C:\Windows\Fonts\malgun.ttf", r"C:\Windows\Fonts\arial.ttf"),
    "darwin": ("/System/Library/Fonts/Supplemental/AppleGothic.ttf", "/Library/Fonts/Arial Unicode.ttf"),
}
"""TrueType fonts with Korean first; ReportLab cannot embed the outlines of most others (CFF)."""


@cache
def register() -> None:
    """Make the two built-in fonts known to ReportLab, and the one every drawing begins with."""
    for name in (PLAIN, BOLD):
        pdfmetrics.registerFont(TTFont(name, f"{name}.ttf"))
    STATE_DEFAULTS["fontName"] = PLAIN


def has_all(font: str, text: str) -> bool:
    """Return whether a registered font has a glyph for every character."""
    glyphs = pdfmetrics.getFont(font).face.charToGlyph
    return all(ord(character) in glyphs for character in text)


def font_for(text: str) -> str:
    """Return the font to draw a text with (`InputError`: no font at hand has all its characters)."""
    register()
    if has_all(PLAIN, text):
        return PLAIN
    wanted = os.environ.get(VARIABLE)
    for place in (wanted,) if wanted else CANDIDATES.get(sys.platform, ()):
        if _registered(place) and has_all(f"{OTHER} {place}", text):
            return f"{OTHER} {place}"
    raise InputError(
        f"the certificate's fonts cannot write {text!r}; install a TrueType font that can (fonts-nanum for Korean) or "
        f"name one: {VARIABLE}=/path/to/font.ttf; no certificate was written"
    )


@cache
def _registered(place: str) -> bool:
    if not Path(place).is_file():
        return False
    try:
        pdfmetrics.registerFont(TTFont(f"{OTHER} {place}", place))
    except (TTFError, OSError) as error:
        raise InputError(f"{place} is no TrueType font that can be embedded: {error}") from error
    return True


def marked_up(text: str) -> str:
    """Return a text as ReportLab's markup, every run of letters in a font that has them."""
    register()
    marked = ""
    for is_plain, characters in itertools.groupby(text, key=lambda character: has_all(PLAIN, character)):
        run = "".join(characters)
        escaped = html.escape(run)
        marked += escaped if is_plain else f'<font name="{html.escape(font_for(run))}">{escaped}</font>'
    return marked
