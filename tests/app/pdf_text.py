"""What a PDF says, read by pypdf: no test of paper needs a program of the computer."""

from io import BytesIO
from pathlib import Path

from pypdf import PdfReader
from pypdf.generic import DictionaryObject


def read_pages(pdf: bytes | Path) -> list[str]:
    """Return the text of every page, with the spaces of its layout."""
    return [page.extract_text(extraction_mode="layout", layout_mode_strip_rotated=False) for page in _reader(pdf).pages]


def read_text(pdf: bytes | Path) -> str:
    """Return all that a PDF says, with one space between two words."""
    return " ".join(" ".join(read_pages(pdf)).split())


def read_fonts(pdf: bytes | Path) -> dict[str, bool]:
    """Return the names of all fonts that its pages use, and whether the file of each is inside."""
    fonts = {}
    for page in _reader(pdf).pages:
        for entry in page["/Resources"]["/Font"].values():
            font: DictionaryObject = entry.get_object()
            fonts[str(font["/BaseFont"])] = "/FontFile2" in font["/FontDescriptor"].get_object()
    return fonts


def _reader(pdf: bytes | Path) -> PdfReader:
    return PdfReader(BytesIO(pdf) if isinstance(pdf, bytes) else pdf)
