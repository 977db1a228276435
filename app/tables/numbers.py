"""Conversion of cells to numbers: notations of numbers and of missing samples."""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from datetime import date, datetime, time, timedelta
from enum import Enum, auto
from numbers import Real
from typing import Any
from unicodedata import normalize

import numpy as np
from numpy.typing import NDArray

from softcal.app.tables.stamp_text import is_stamp
from softcal.core.recording import Array

NOT_A_NUMBER = frozenset({"nan", "-nan", "+nan", "nan(ind)", "-nan(ind)", "1.#qnan", "-1.#qnan", "1.#ind", "-1.#ind"})
"""What printf of C and its descendants write for NaN, in small letters."""

INFINITE = frozenset({"inf", "-inf", "+inf", "infinity", "-infinity", "+infinity", "1.#inf", "-1.#inf", "∞", "-∞"})
"""No sample either: a number beyond the range of its type."""

MISSING_CODES = frozenset(
    "na n/a n.a. #n/a #na <na> null none nil nodata ol +ol -ol o.l. ovl ovld ovrld overload overflow overrange "
    "underrange #value! #div/0! #ref! #num! #null! #name? #wert! #nv #bezug! -- --- ---- ----- nan()".split()
) | {"no data", "over range", "under range"}
"""What spreadsheets, statistics programs and meters write where they have no number, in small letters."""

NUMBER = {
    ".": re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+|[dD][+-]\d+)?"),
    ",": re.compile(r"[+-]?(?:\d+(?:,\d+)?|,\d+)(?:[eE][+-]?\d+|[dD][+-]\d+)?"),
}
"""Fortran writes `1.5D+03` for numbers of double precision."""

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
    r"(?P<number>[^\sA-Za-zµμ°Ω%][^\sA-Za-zµμ°Ω%]*(?:[eE][+-]?\d+)?)\s*"
    r"(?P<unit>[A-Za-zµμ°Ω%][A-Za-zµμ°Ω%/]*?)(?: ?[AD]C)?"
)
"""A number with its unit behind it, such as `0.52 V` or `0.52 V DC`."""

HEXADECIMAL = re.compile(r"0[xX][0-9A-Fa-f]{1,8}")
MAX_SUMMARY_ROWS = 12
SUMMARY_LABELS = frozenset(
    "mean average avg median std stdev sd min minimum max maximum sum total count range variance "
    "peak sd rms mittelwert mittel moyenne media promedio 평균 최대 최소".split()
)
"""How rows of a summary below a table begin, in small letters."""


def is_summary(cells: Sequence[Any]) -> bool:
    """Return whether a row below the samples is a summary, such as a mean, by its first filled cell."""
    first = next((cell for cell in cells if cell is not None and str(cell).strip()), None)
    label = re.match(r"[^\W\d_]*", first.strip().lower()) if isinstance(first, str) else None
    return label is not None and label[0] in SUMMARY_LABELS


class Kind(Enum):
    """Kind of one cell."""

    EMPTY = auto()
    NUMBER = auto()
    STAMP = auto()
    TEXT = auto()


def cell_kind(cell: Any, decimal: str = ".", missing: Sequence[str] = ()) -> Kind:
    """Return the kind of a cell of a text file or a sheet."""
    if cell is None:
        return Kind.EMPTY
    if isinstance(cell, str):
        text = cell.strip()
        if not text:
            return Kind.EMPTY
        if NUMBER[decimal].fullmatch(text) or is_missing(text, missing):
            return Kind.NUMBER
        return Kind.STAMP if is_stamp(text) else Kind.TEXT
    if isinstance(cell, (bool, np.bool_)):
        return Kind.TEXT
    if isinstance(cell, Real):
        return Kind.NUMBER
    return Kind.STAMP if isinstance(cell, (datetime, date, time, timedelta)) else Kind.TEXT


def is_missing(text: str, missing: Sequence[str] = ()) -> bool:
    """Return whether a text is a missing sample: empty, NaN, out of range, or declared."""
    bare = text.strip()
    return not bare or bare in missing or (small := bare.lower()) in NOT_A_NUMBER or small in INFINITE


def is_no_sample(text: str, missing: Sequence[str] = ()) -> bool:
    """Return whether a text among numbers is a missing sample: as in `is_missing`, or one of `MISSING_CODES`."""
    return is_missing(text, missing) or text.strip().lower() in MISSING_CODES


def missing_codes_remark(column: str, cells: Any, missing: Sequence[str]) -> list[str]:
    """Return a remark on undeclared cells of a column with a word of `MISSING_CODES`: word and count.

    Args:
        cells: (n,) array of objects, or an arrow array of texts.
    """
    counts: Counter[str] = Counter()
    if isinstance(cells, np.ndarray):
        counts.update(cell.strip() for cell in cells if isinstance(cell, str))
    else:
        import pyarrow.compute as pc

        texts = pc.utf8_trim_whitespace(cells)
        is_code = pc.is_in(pc.utf8_lower(texts), value_set=_arrow_texts(MISSING_CODES))
        counts.update(pc.filter(texts, is_code).to_pylist())
    codes = [text for text in counts if text.lower() in MISSING_CODES and text not in missing]
    listed_codes = ", ".join(f"{text!r} (rows: {counts[text]})" for text in codes)
    return [f"column {column!r}: {listed_codes} read as missing samples"] if codes else []


def unit_number(cell: Any, decimal: str) -> tuple[str, str] | None:
    """Return number and unit of a text such as `0.52 V`, or None."""
    match = UNIT_NUMBER.fullmatch(cell.strip()) if isinstance(cell, str) else None
    if match is None or match["unit"].lower() not in UNITS or not NUMBER[decimal].fullmatch(match["number"]):
        return None
    return match["number"], match["unit"]


def parse_formatted_numbers(cells: NDArray[Any], decimal: str, missing: Sequence[str]) -> tuple[Array, str, str] | None:
    """Return texts that are numbers in another notation, their unit, and the removed characters.

    A minus of a text editor, digits of full width, `="0.52"`; `0x1F` in every cell; one unit behind every
    number; marks between thousands where they can be nothing else. None where a cell is none of these, or two readings
    are possible.
    """
    texts = [None if cell is None or is_no_sample(str(cell), missing) else _normalize_text(str(cell)) for cell in cells]
    present = [text for text in texts if text is not None]
    if not present:
        return None
    with_unit = [unit_number(text, decimal) for text in present]
    units = {one[1] for one in with_unit if one}
    unit, remark = "", ""
    if len(units) == 1 and None not in with_unit:
        (unit,) = units
        texts = [text if text is None else str(unit_number(text, decimal)[0]) for text in texts]  # type: ignore[index]
        remark = f"{unit!r} stands behind every number and was taken off"
    elif all(HEXADECIMAL.fullmatch(text) for text in present):
        texts = [text if text is None else str(int(text, 16)) for text in texts]
        remark = "its numbers are hexadecimal"
    elif mark := _thousands_mark(present, decimal):
        texts = [text if text is None else text.replace(mark, "") for text in texts]
        remark = f"{mark!r} stands between thousands and was taken off"
    elif _has_other_mark(present, decimal):
        texts = [text if text is None else text.replace(_other_mark(decimal), decimal) for text in texts]
        remark = f"its decimal mark is {_other_mark(decimal)!r}, unlike that of other columns"
    values = to_numbers(np.array(texts, dtype=object), decimal, missing)
    return None if values is None else (values, unit, remark)


def _normalize_text(text: str) -> str:
    match = re.fullmatch(r'="(.*)"', text.strip())
    return normalize("NFKC", match[1] if match else text).strip().replace("\u2212", "-")


def _thousands_mark(texts: Sequence[str], decimal: str) -> str:
    """Return the thousands separator; "" without one, or if it may be a decimal mark."""
    marked = [text for text in texts if not NUMBER[decimal].fullmatch(text)]
    marks = {match["mark"] for text in marked if (match := THOUSANDS.fullmatch(text))}
    if len(marks) != 1 or not all(THOUSANDS.fullmatch(text) for text in marked):
        return ""
    (mark,) = marks
    is_certain = mark not in ",." or any(text.count(mark) > 1 or decimal in text for text in marked)
    return mark if mark != decimal and is_certain else ""


def _other_mark(decimal: str) -> str:
    return "," if decimal == "." else "."


def _has_other_mark(texts: Sequence[str], decimal: str) -> bool:
    """Return whether a whole column has the other decimal mark, which cannot be a thousands separator."""
    is_other = all(NUMBER[_other_mark(decimal)].fullmatch(text) for text in texts)
    return is_other and not all(THOUSANDS.fullmatch(text) for text in texts if _other_mark(decimal) in text)


def to_numbers(cells: NDArray[Any], decimal: str = ".", missing: Sequence[str] = ()) -> Array | None:
    """Return cells as float64 with NaN for missing samples; None where one of them is no number.

    Args:
        cells: (n,) of any type: numbers, or texts with None for empty ones.
    """
    if cells.dtype.kind in "iuf":
        values = cells.astype(np.float64)
        declared = [_parse_float(text) for text in missing if NUMBER["."].fullmatch(text)]
        return np.where(np.isfinite(values) & ~np.isin(values, declared), values, np.nan)
    if cells.dtype.kind in "bmM":
        return None
    values = np.empty(len(cells))
    for row, cell in enumerate(cells):
        number = _parse_number(cell, decimal, missing)
        if number is None:
            return None
        values[row] = number
    return values


def _parse_number(cell: Any, decimal: str, missing: Sequence[str]) -> float | None:
    if cell is None:
        return np.nan
    if isinstance(cell, str):
        text = cell.strip()
        if is_no_sample(text, missing):
            return np.nan
        return _parse_float(text) if NUMBER[decimal].fullmatch(text) else None
    if isinstance(cell, (bool, np.bool_)) or not isinstance(cell, Real):
        return None
    value = float(cell)
    return value if np.isfinite(value) and str(cell) not in missing else np.nan


def _parse_float(text: str) -> float:
    return float(text.upper().replace("D", "E").replace(",", "."))


def texts_to_numbers(texts: Any, decimal: str = ".", missing: Sequence[str] = ()) -> Array | None:
    """Return an arrow array of texts as `to_numbers` does, fast: a column of a large file."""
    import pyarrow as pa
    import pyarrow.compute as pc

    texts = pc.utf8_trim_whitespace(texts)
    small = ("nan", "", *NOT_A_NUMBER, *INFINITE, *MISSING_CODES)
    codes = _arrow_texts(small)
    is_missing = pc.is_in(pc.utf8_lower(texts), value_set=codes)
    if missing:
        is_missing = pc.or_(is_missing, pc.is_in(texts, value_set=_arrow_texts(missing)))
    pattern = f"^{NUMBER[decimal].pattern}$".replace("?:", "")
    if not pc.all(pc.or_(is_missing, pc.match_substring_regex(texts, pattern)), min_count=0).as_py():
        return None
    texts = pc.fill_null(pc.if_else(is_missing, codes[0], texts), codes[0])
    for mark, plain in ((",", "."), ("D", "E"), ("d", "e")):
        texts = pc.replace_substring(texts, mark, plain)
    numbers = pc.cast(pc.utf8_ltrim(texts, characters="+"), pa.float64())
    values = np.frombuffer(numbers.buffers()[1], np.float64, len(numbers), 8 * numbers.offset)
    return np.where(np.isfinite(values), values, np.nan)


def _arrow_texts(texts: Iterable[str]) -> Any:
    """Return texts as an arrow array, without pyarrow's search for pandas, which takes half a second."""
    import pyarrow as pa

    builder = pa.lib.StringBuilder()
    builder.append_values(list(texts))
    return builder.finish()


def show_cell(cell: object) -> str:
    """Return a cell as text for an error message."""
    text = str(cell)
    return "nothing or nan" if text in ("nan", "None", "<NA>", "NaT") else repr(text[:40])


def number_cure(cell: object, decimal: str = ".") -> str:
    """Return what to do about a cell that is no number."""
    text = str(cell).strip()
    other = _other_mark(decimal)
    if THOUSANDS.fullmatch(text) and NUMBER[other].fullmatch(text):
        return (
            f"write numbers without marks between thousands; only if {other!r} is the decimal mark, give --decimal "
            f"'{other}'"
        )
    if NUMBER[other].fullmatch(text) and not isinstance(cell, bool):
        return f"write it with a decimal {'point' if decimal == '.' else 'comma'} as the other numbers of its column"
    if unit_number(text, decimal):
        return "write all numbers of its column in one unit, which its heading may state"
    if THOUSANDS.fullmatch(text):
        return "write numbers without marks between thousands, or state the decimal mark with --decimal"
    return f"correct it, leave it empty, or give --missing {text[:40]!r} if it stands for a missing sample"
