"""Embedded fonts: ReportLab's own for Latin letters, the package's for Korean, one of the computer's for all else."""

import html
import itertools
import os
import sys
import unicodedata
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from reportlab.graphics.shapes import STATE_DEFAULTS
from reportlab.pdfbase import pdfmetrics
from reportlab.pdfbase.ttfonts import TTFError, TTFont

from softcal.core.errors import InputError, printable
from softcal.core.lot import escape_serial

PLAIN, BOLD = "Vera", "VeraBd"
OTHER = "other letters"
FONT_VARIABLE = "SOFTCAL_FONT"

KOREAN = str(Path(__file__).with_name("static") / "KoreanSans.ttf")
"""All Korean syllables, Greek, Cyrillic, kana and signs: papers in Korean need no font of the computer."""

SYSTEM_FONTS = {
    "linux": ("/usr/share/fonts/truetype/nanum/NanumGothic.ttf", "/usr/share/fonts/truetype/dejavu/DejaVuSans.ttf"),
    "win32": (r"C:\Windows\Fonts\malgun.ttf", r"C:\Windows\Fonts\arial.ttf"),
    "darwin": ("/System/Library/Fonts/Supplemental/AppleGothic.ttf", "/Library/Fonts/Arial Unicode.ttf"),
}
"""TrueType fonts of other letters; ReportLab cannot embed the outlines of most others (CFF)."""


@cache
def register() -> None:
    """Make the two built-in fonts known to ReportLab, and the one every drawing begins with."""
    for name in (PLAIN, BOLD):
        pdfmetrics.registerFont(TTFont(name, f"{name}.ttf"))
    STATE_DEFAULTS["fontName"] = PLAIN


def has_all(font: str, text: str) -> bool:
    """Return whether a registered font has a glyph for every character."""
    register()
    glyphs = pdfmetrics.getFont(font).face.charToGlyph
    return all(ord(character) in glyphs for character in text)


def runs_of(text: str) -> list[tuple[str, str]]:
    """Return a text as paper can show it, as pairs of a font and letters (`InputError`: no font has a letter)."""
    grouped = itertools.groupby(writable(text), key=_font_for)
    return [(font, "".join(letters)) for font, letters in grouped]


def width_of(runs: list[tuple[str, str]], size: float) -> float:
    """Return how wide runs of letters are, in points."""
    return sum(float(pdfmetrics.stringWidth(letters, font, size)) for font, letters in runs)


def _font_for(letter: str) -> str:
    if has_all(PLAIN, letter):
        return PLAIN
    for path in _font_files():
        name = register_file(path)
        if has_all(name, letter):
            return name
    raise InputError(
        f"no font at hand can write {letter!r}; name a TrueType font that can: {FONT_VARIABLE}=/path/to/font.ttf; "
        "no certificate was written"
    )


def _font_files() -> Iterator[str]:
    if configured := os.environ.get(FONT_VARIABLE):
        yield configured
    yield KOREAN
    yield from filter(os.path.isfile, SYSTEM_FONTS.get(sys.platform, ()))


def printable_serial(serial: str) -> str:
    """Return a serial as a page can write it: escaped to ASCII where no font at hand has its letters."""
    try:
        runs_of(serial)
    except InputError:
        return escape_serial(serial)
    return serial


@cache
def register_file(path: str) -> str:
    """Make a font file known to ReportLab and return its name."""
    try:
        pdfmetrics.registerFont(TTFont(f"{OTHER} {path}", path))
    except (TTFError, OSError) as error:
        raise InputError(f"{FONT_VARIABLE}={path} is no TrueType font that can be embedded: {error}") from error
    return f"{OTHER} {path}"


def writable(text: str) -> str:
    """Return a text as paper can show it.

    Letters are composed (macOS takes Korean in file names apart), white space is a space, what has no width is left
    out, and other control characters show as codes.
    """
    composed = (" " if letter.isspace() else letter for letter in unicodedata.normalize("NFC", text))
    return printable("".join(letter for letter in composed if unicodedata.category(letter) != "Cf"))


def marked_up(text: str) -> str:
    """Return a text as ReportLab's markup, every run of letters in a font that has them."""
    markup = ""
    for font, letters in runs_of(text):
        escaped = html.escape(letters)
        markup += escaped if font == PLAIN else f'<font name="{html.escape(font)}">{escaped}</font>'
    return markup
