"""Cells into numbers: which text is a number, and what stands for a missing sample."""

import re
from collections.abc import Sequence
from datetime import date, datetime, time, timedelta
from enum import Enum, auto
from numbers import Real
from typing import Any
from unicodedata import normalize

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


UNITS = frozenset(
    "s sec secs second seconds ms msec us usec µs μs ns min mins minute minutes h hr v mv uv µv μv volt volts "
    "n mn kn newton newtons kgf gf g kg lbf lb lbs ozf mm cm m um µm μm in inch pa kpa mpa hpa bar mbar psi hz khz "
    "°c c °f k % %fs count counts lsb raw digit digits ohm ohms ω kω mω kohm mohm a ma ua µa f pf nf uf v/v mv/v "
    "mm/s mm/min n/mm 1 - – — n/a none a.u. au ts rn smp avg max std tot no. hh:mm:ss hh:mm:ss.fff hh:mm:ss.ms "
    "yyyy-mm-dd date time text".split()
)
"""Texts that a row of units is made of, in small letters."""

UNIT_NUMBER = re.compile(
    r"(?P<number>[^\sA-Za-zµμ°Ω%][^\sA-Za-zµμ°Ω%]*(?:[eE][+-]?\d+)?)\s*(?P<unit>[A-Za-zµμ°Ω%][A-Za-zµμ°Ω%/]*)"
)
"""A number with its unit behind it."""

MAX_SUMMARY_ROWS = 12
SUMMARY_WORDS = frozenset(
    "mean average avg median std stdev sd min minimum max maximum sum total count range variance "
    "mittelwert mittel moyenne media promedio 평균 최대 최소".split()
)
"""How rows of a summary below a table begin, in small letters."""


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


def unit_number(cell: Any, decimal: str) -> tuple[str, str] | None:
    """Return number and unit of a text such as `0.52 V`; None where it is none."""
    match = UNIT_NUMBER.fullmatch(cell.strip()) if isinstance(cell, str) else None
    if match is None or match["unit"].lower() not in UNITS or not NUMBER[decimal].fullmatch(match["number"]):
        return None
    return match["number"], match["unit"]


def written_numbers(cells: NDArray[Any], decimal: str, missing: Sequence[str]) -> tuple[Array, str, str] | None:
    """Return texts that are numbers in another way of writing, their unit, and what was taken off.

    A minus of a text editor, digits of full width, `1.5D-3`, `="0.52"`; one unit behind every number; marks between
    thousands where they can be nothing else. None where a cell is none of these, or two readings are possible.
    """
    texts = [None if cell is None or is_missing(str(cell), missing) else _plain(str(cell)) for cell in cells]
    present = [text for text in texts if text is not None]
    if not present:
        return None
    with_unit = [unit_number(text, decimal) for text in present]
    units = {one[1] for one in with_unit if one}
    unit, how = "", ""
    if len(units) == 1 and None not in with_unit:
        (unit,) = units
        texts = [text if text is None else str(unit_number(text, decimal)[0]) for text in texts]  # type: ignore[index]
        how = f"{unit!r} stands behind every number and was taken off"
    elif mark := _thousands_mark(present, decimal):
        texts = [text if text is None else text.replace(mark, "") for text in texts]
        how = f"{mark!r} stands between thousands and was taken off"
    elif _has_other_mark(present, decimal):
        texts = [text if text is None else text.replace(_other(decimal), decimal) for text in texts]
        how = f"its decimal mark is {_other(decimal)!r}, unlike that of other columns"
    values = to_numbers(np.array(texts, dtype=object), decimal, missing)
    return None if values is None else (values, unit, how)


def _plain(text: str) -> str:
    match = re.fullmatch(r'="(.*)"', text.strip())
    text = normalize("NFKC", match[1] if match else text).strip().replace("\u2212", "-")
    return re.sub(r"(?<=\d)[dD](?=[+-]\d+$)", "E", text)


def _thousands_mark(texts: Sequence[str], decimal: str) -> str:
    """Return the mark between thousands; "" where there is none, or where it may be a decimal mark."""
    marked = [text for text in texts if not NUMBER[decimal].fullmatch(text)]
    marks = {match["mark"] for text in marked if (match := THOUSANDS.fullmatch(text))}
    if len(marks) != 1 or not all(THOUSANDS.fullmatch(text) for text in marked):
        return ""
    (mark,) = marks
    is_certain = mark not in ",." or any(text.count(mark) > 1 or decimal in text for text in marked)
    return mark if mark != decimal and is_certain else ""


def _other(decimal: str) -> str:
    return "," if decimal == "." else "."


def _has_other_mark(texts: Sequence[str], decimal: str) -> bool:
    """Whether all of a column has the other decimal mark, and none of it can be a mark between thousands alone."""
    is_other = all(NUMBER[_other(decimal)].fullmatch(text) for text in texts)
    return is_other and not all(THOUSANDS.fullmatch(text) for text in texts if _other(decimal) in text)


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
    # Whatever converts Python's values into arrow's, or back, looks for pandas, which takes half a second to load.
    builder = pa.lib.StringBuilder()
    written = [form for word in (*NOT_A_NUMBER, *INFINITE) for form in {word, word.upper()}]
    written += [sign + word for word in ("NaN", "Inf", "Infinity") for sign in ("", "-", "+")]
    builder.append_values(["nan", "", *missing, *written])
    words = builder.finish()
    is_missing = pc.is_in(texts, value_set=words)
    pattern = f"^{NUMBER[decimal].pattern}$".replace("?:", "")
    if not pc.all(pc.or_(is_missing, pc.match_substring_regex(texts, pattern)), min_count=0).as_py():
        return None
    texts = pc.fill_null(pc.if_else(is_missing, words[0], texts), words[0])
    if decimal == ",":
        texts = pc.replace_substring(texts, ",", ".")
    numbers = pc.cast(pc.utf8_ltrim(texts, characters="+"), pa.float64())
    values = np.frombuffer(numbers.buffers()[1], np.float64, len(numbers), 8 * numbers.offset)
    return np.where(np.isfinite(values), values, np.nan)


def shown(cell: object) -> str:
    """Return a cell as an error message shows it."""
    text = str(cell)
    return "nothing or nan" if text in ("nan", "None", "<NA>", "NaT") else repr(text[:40])


def number_cure(cell: object, decimal: str = ".") -> str:
    """Return what to do about a cell that is no number."""
    text = str(cell).strip()
    other = _other(decimal)
    if THOUSANDS.fullmatch(text) and NUMBER[other].fullmatch(text):
        return (
            f"write numbers without marks between thousands; only if {other!r} is the decimal mark, give --decimal "
            f"'{other}'"
        )
    if NUMBER[other].fullmatch(text) and not isinstance(cell, bool):
        return f"write it with a decimal {'point' if decimal == '.' else 'comma'} as the other numbers of its column"
    if THOUSANDS.fullmatch(text):
        return "write numbers without marks between thousands, or state the decimal mark with --decimal"
    return f"correct it, leave it empty, or give --missing {shown(text)} if it stands for a missing sample"
