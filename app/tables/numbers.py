"""Cells into numbers: which text is a number, and what stands for a missing sample."""

import re
from collections.abc import Sequence
from datetime import date, datetime, time, timedelta
from enum import Enum, auto
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softcal.core.recording import Array

NOT_A_NUMBER = frozenset({"nan", "-nan", "+nan", "nan(ind)", "-nan(ind)", "1.#qnan", "-1.#qnan", "1.#ind", "-1.#ind"})
"""What printf of C and its descendants write for NaN, in small letters."""

INFINITE = frozenset({"inf", "-inf", "+inf", "infinity", "-infinity", "+infinity", "1.#inf", "-1.#inf", "∞", "-∞"})
"""No sample either: a number beyond the range of its type."""

NUMBER = {
    ".": re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"),
    ",": re.compile(r"[+-]?(?:\d+(?:,\d+)?|,\d+)(?:[eE][+-]?\d+)?"),
}
CLOCK = r"\d{1,3}:\d{2}(?::\d{2}(?:[.,:]\d+)?)?(?: ?[AaPp][Mm])?"
STAMP = re.compile(
    rf"(?:\d{{4}}|\d{{1,2}})[-/.]\d{{1,2}}[-/.]\d{{1,4}}\.?(?:[ T]+{CLOCK}(?: ?(?:Z|UTC|[+-]\d{{2}}:?\d{{2}}))?)?"
    rf"|\d{{8}}T\d{{4,6}}(?:[.,]\d+)?(?:Z|[+-]\d{{2}}:?\d{{2}})?|{CLOCK}|\d+ days? {CLOCK}"
)
"""Dates, times of day and both, as loggers write them."""

THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(?:(?P<mark>[,. '’\u00a0\u202f])\d{3})(?:(?P=mark)\d{3})*(?:[.,]\d+)?")
"""Digits in groups of three."""


class Kind(Enum):
    """What one cell is."""

    EMPTY = auto()
    NUMBER = auto()
    STAMP = auto()
    TEXT = auto()


def cell_kind(cell: Any, decimal: str = ".", missing: Sequence[str] = ()) -> Kind:
    """Return what a cell of a text file or a sheet is."""
    if cell is None:
        return Kind.EMPTY
    if isinstance(cell, str):
        text = cell.strip()
        if not text:
            return Kind.EMPTY
        if NUMBER[decimal].fullmatch(text) or is_missing(text, missing):
            return Kind.NUMBER
        return Kind.STAMP if STAMP.fullmatch(text) else Kind.TEXT
    if isinstance(cell, (bool, np.bool_)):
        return Kind.TEXT
    if isinstance(cell, Real):
        return Kind.NUMBER
    return Kind.STAMP if isinstance(cell, (datetime, date, time, timedelta)) else Kind.TEXT


def is_missing(text: str, missing: Sequence[str] = ()) -> bool:
    """Whether a text stands for a missing sample: nothing, NaN, beyond all numbers, or declared."""
    bare = text.strip()
    return not bare or bare in missing or (small := bare.lower()) in NOT_A_NUMBER or small in INFINITE


def to_numbers(cells: NDArray[Any], decimal: str = ".", missing: Sequence[str] = ()) -> Array | None:
    """Return cells as float64 with NaN for missing samples; None where one of them is no number.

    Args:
        cells: (n,) of any type: numbers, or texts with None for empty ones.
    """
    if cells.dtype.kind in "iuf":
        values = cells.astype(np.float64)
        declared = [float(text) for text in missing if NUMBER["."].fullmatch(text)]
        return np.where(np.isfinite(values) & ~np.isin(values, declared), values, np.nan)
    if cells.dtype.kind in "bmM":
        return None
    values = np.empty(len(cells))
    for row, cell in enumerate(cells):
        number = _number(cell, decimal, missing)
        if number is None:
            return None
        values[row] = number
    return values


def _number(cell: Any, decimal: str, missing: Sequence[str]) -> float | None:
    if cell is None:
        return np.nan
    if isinstance(cell, str):
        text = cell.strip()
        if is_missing(text, missing):
            return np.nan
        return float(text.replace(",", ".")) if NUMBER[decimal].fullmatch(text) else None
    if isinstance(cell, (bool, np.bool_)) or not isinstance(cell, Real):
        return None
    value = float(cell)
    return value if np.isfinite(value) and str(cell) not in missing else np.nan


def texts_to_numbers(texts: Any, decimal: str = ".", missing: Sequence[str] = ()) -> Array | None:
    """Return an arrow array of texts as `to_numbers` does, fast: a column of a large file."""
    import pyarrow as pa
    import pyarrow.compute as pc

    texts = pc.utf8_trim_whitespace(texts)
    special = pa.array(["", *missing, *(form for word in (*NOT_A_NUMBER, *INFINITE) for form in {word, word.upper()}),
                        "NaN", "-NaN", "+NaN", "Inf", "-Inf", "+Inf", "Infinity", "-Infinity"])  # fmt: skip
    texts = pc.if_else(pc.is_in(texts, value_set=special), pa.scalar(None, texts.type), texts)
    pattern = f"^{NUMBER[decimal].pattern}$".replace("?:", "")
    if not pc.all(pc.match_substring_regex(texts, pattern), min_count=0).as_py():
        return None
    if decimal == ",":
        texts = pc.replace_substring(texts, ",", ".")
    texts = pc.utf8_ltrim(texts, characters="+")
    values: Array = pc.cast(texts, pa.float64()).to_numpy(zero_copy_only=False)
    return np.where(np.isfinite(values), values, np.nan)


def shown(cell: object) -> str:
    """Return a cell as an error message shows it."""
    text = str(cell)
    return "nothing or nan" if text in ("nan", "None", "<NA>", "NaT") else repr(text[:40])


def number_cure(cell: object, decimal: str = ".") -> str:
    """Return what to do about a cell that is no number."""
    text = str(cell).strip()
    if NUMBER["," if decimal == "." else "."].fullmatch(text) and not isinstance(cell, bool):
        return (
            f"state the decimal mark with --decimal '{',' if decimal == '.' else '.'}', or write all numbers with one"
        )
    if THOUSANDS.fullmatch(text):
        return "write numbers without marks between thousands, or state the decimal mark with --decimal"
    return f"correct it, leave it empty, or give --missing {shown(text)} if it stands for a missing sample"
