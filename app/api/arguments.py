"""Arguments as Python users give them, typed once: plain numbers, columns of float64, times in s. Text is no number."""

import os
from collections.abc import Hashable
from datetime import UTC, datetime, timedelta
from decimal import Decimal
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import numpy as np

from softcal.core.errors import InputError
from softcal.core.recording import Array

NS_PER_S = 1e9


def number(name: str, value: Any, expected: str) -> float:
    """Return a real number as a float: int, Fraction, Decimal, a NumPy scalar or an array without dimensions.

    Raises:
        InputError: it is text, a bool, complex, not finite, or has more than one value.
    """
    result = _float(value)
    if result is None or not np.isfinite(result):
        raise InputError(f"{name} is {show_value(value)}; {expected} was expected")
    return result


def whole_number(name: str, value: Any, minimum: int) -> int:
    """Return a whole number as an int, `InputError` where it is none or below the minimum."""
    scalar = _scalar(value)
    if not isinstance(scalar, Integral) or isinstance(scalar, bool) or not minimum <= int(scalar) < 2**63:
        raise InputError(f"{name} is {show_value(value)}; a whole number of at least {minimum} was expected")
    return int(scalar)


def text(name: str, value: Any) -> str:
    """Return a text as a plain str, `InputError` where it is something else."""
    expect(name, value, str, "text")
    return str(value)


def file_path(name: str, value: Any) -> Path:
    """Return a path given as text or as a path object.

    Raises:
        InputError: it is neither, or empty.
    """
    path = os.fspath(value) if isinstance(value, str | os.PathLike) else None
    if not isinstance(path, str) or not path or "\0" in path:
        raise InputError(f"{name} is {show_value(value)}; a path: text or a pathlib.Path was expected")
    return Path(path)


def expect(name: str, value: Any, kind: Any, expected: str) -> None:
    """Refuse an argument of another type with `InputError`."""
    if not isinstance(value, kind):
        raise InputError(f"{name} is {show_value(value)}; {expected} was expected")


def show_value(value: Any) -> str:
    """Return a value with its type, in few letters on one line."""
    line = " ".join(repr(value).split())
    return f"{line if len(line) <= 60 else line[:57] + '...'} ({type(value).__name__})"


def column(name: str, values: Any) -> Array:
    """Return a copy of a column as (n,) float64, NaN where a value is missing.

    Args:
        values: list, tuple, array or Series of real numbers; None, NaN, NA and masked values are missing.

    Raises:
        InputError: text, bools, times or complex numbers; not one column.
    """
    array = _array(name, values)
    if array.dtype.kind == "O":
        array = np.array([_element(name, k, value) for k, value in enumerate(array)], dtype=np.float64)
    if array.dtype.kind not in "iuf":
        first = array[:1].tolist()
        content = show_value(first[0]) if first else array.dtype.name
        raise InputError(f"{name} holds {content}; real numbers were expected")
    # A copy in any case; and -0.0 becomes 0.0, so that equal columns have one hash.
    copied: Array = array.astype(np.float64, order="C") + 0.0
    return copied


def times(name: str, values: Any) -> Array:
    """Return time stamps in s as (n,) float64: numbers as they are, dates since the first, durations in full.

    Dates are differences of whole nanoseconds, so that no digit is lost; a zone is taken to UTC first.

    Args:
        values: numbers in s, or datetime, Timestamp, datetime64, Timedelta, timedelta64; list, array, Series or Index.

    Raises:
        InputError: one is missing or text, or dates with and without a zone are mixed.
    """
    import pandas as pd

    index = _time_index(name, values)
    if index is None:
        _refuse_text(name, values)
        return column(name, values)
    missing = np.flatnonzero(index.isna())
    if len(missing):
        raise InputError(
            f"{name} is missing at sample {missing[0]}; every sample needs its time: leave such rows out, as with "
            f"table.dropna(subset=[{name!r}])"
        )
    try:
        ticks = index.as_unit("ns").asi8
    except (ValueError, OverflowError) as error:
        raise InputError(f"{name} is too far from today to be counted in nanoseconds ({error})") from error
    start = ticks[0] if len(ticks) and isinstance(index, pd.DatetimeIndex) else 0
    return np.asarray((ticks - start) / NS_PER_S, dtype=np.float64)


def has_dates(name: str, values: Any) -> bool:
    """Whether time stamps are dates or durations, whose unit is certain, and no plain numbers."""
    return _time_index(name, values) is not None


def first_instant(name: str, values: Any) -> datetime | None:
    """Return the first of time stamps that are dates, UTC; without a zone they are local time. None of other stamps."""
    import pandas as pd

    index = _time_index(name, values)
    if not isinstance(index, pd.DatetimeIndex) or not len(index):
        return None
    try:
        return index[0].to_pydatetime(warn=False).astimezone(UTC)
    except (ValueError, OverflowError):
        return None


def is_times(values: Any) -> bool:
    """Whether a Series or an index is one of dates or of durations by its type."""
    import pandas as pd

    dtype = values.dtype
    is_arrow = isinstance(dtype, pd.ArrowDtype) and dtype.kind in "mM"
    return bool(is_arrow or pd.api.types.is_datetime64_any_dtype(dtype) or pd.api.types.is_timedelta64_dtype(dtype))


def times_of_index(values: Any) -> Any:
    """Return the index of a pandas Series or DataFrame where it is one of dates or durations, else None.

    Raises:
        InputError: it is one of periods, or of a mixture of times.
    """
    import pandas as pd

    index = getattr(values, "index", None)
    is_index = isinstance(index, pd.Index) and index.nlevels == 1
    return index if is_index and _time_index("t_s", index) is not None else None


def check_indexes(columns: dict[str, Any]) -> None:
    """Refuse Series whose rows stand under other labels: sample by sample they would be paired wrongly."""
    indexes = {
        name: values.index for name, values in columns.items() if hasattr(getattr(values, "index", None), "equals")
    }
    for name in list(indexes)[1:]:
        first = next(iter(indexes))
        if len(indexes[name]) == len(indexes[first]) and not indexes[name].equals(indexes[first]):
            raise InputError(
                f"{first} and {name} have the same length and another index; take both from one table, or give "
                "arrays where they belong together row by row: .to_numpy()"
            )


def frame_column(frame: Any, option: str, name: Hashable) -> Any:
    """Return the column of a table by its name; `option` is the argument that names another."""
    count = list(frame.columns).count(name)
    if count != 1:
        names = ", ".join(map(str, list(frame.columns)[:12]))
        problem = "there is no column" if count == 0 else f"{count} columns are named"
        raise InputError(f"{problem} {name!r}; the table has {names}; name the one that is meant: {option}=")
    return frame[name]


def _scalar(value: Any) -> Any:
    """Return the one value of a NumPy scalar or of an array without dimensions; anything else as it is."""
    if isinstance(value, np.generic) or getattr(value, "ndim", None) == 0:
        return value.item()
    return value


def _check_sequence(name: str, values: Any) -> None:
    if hasattr(values, "columns"):
        raise InputError(f"{name} is a table; one column was expected: Recording.from_frame takes a table")
    if isinstance(values, str | bytes | dict | set | frozenset) or not hasattr(values, "__len__"):
        raise InputError(f"{name} is {show_value(values)}; one column of numbers was expected")


def _array(name: str, values: Any) -> Any:
    """Return (n,) values as a NumPy array, of objects where they are a mixture."""
    import pandas as pd

    _check_sequence(name, values)
    if isinstance(values, pd.Series | pd.Index | pd.api.extensions.ExtensionArray):
        dtype = values.dtype
        is_plain = pd.api.types.is_float_dtype(dtype) or pd.api.types.is_integer_dtype(dtype)
        return values.to_numpy(dtype=np.float64, na_value=np.nan) if is_plain else np.asarray(values)
    if isinstance(values, np.ma.MaskedArray):
        values = values.tolist()
    try:
        array = np.asarray(values)
    except (TypeError, ValueError, RuntimeError) as error:
        raise InputError(f"{name} is no column of numbers ({' '.join(str(error).split())[:120]})") from error
    # NumPy makes text of numbers and text, and numbers of numbers and bools: elements are looked at as they were given.
    if isinstance(values, list | tuple) and array.ndim == 1:
        array = np.fromiter(values, dtype=object, count=len(values))
    if array.ndim != 1:
        raise InputError(f"{name} has {array.ndim} dimensions; one column of numbers was expected")
    return array


def _time_index(name: str, values: Any) -> Any:
    """Return dates or durations as an index of pandas, None where the values are numbers."""
    import pandas as pd

    _check_sequence(name, values)
    if getattr(values, "ndim", 1) != 1:
        return None
    if isinstance(values, np.ma.MaskedArray):
        values = values.tolist()
    is_indexed = isinstance(values, pd.Series | pd.Index | pd.api.extensions.ExtensionArray | list | tuple)
    index: Any = pd.Index(values if is_indexed else np.asarray(values))
    if is_times(index):
        is_arrow = isinstance(index.dtype, pd.ArrowDtype)
        return pd.Index(index.to_numpy(dtype=object, na_value=pd.NaT)) if is_arrow else index
    kind = pd.api.types.infer_dtype(index)
    if kind == "period":
        raise InputError(f"{name} holds periods such as {index[0]}, no instants; .to_timestamp() gives their start")
    is_mixture = kind.startswith("mixed") and any(isinstance(value, datetime | timedelta) for value in index)
    if not is_mixture and not kind.startswith(("date", "timedelta")):
        return None
    has_zone = [getattr(value, "tzinfo", None) is not None for value in index if not pd.isna(value)]
    # Offsets that differ, as around the end of summer time, are one scale in UTC.
    if kind.startswith("datetime") and (all(has_zone) or not any(has_zone)):
        return pd.to_datetime(list(index), utc=any(has_zone))
    if kind.startswith("timedelta"):
        return pd.to_timedelta(list(index))
    cure = "times with and without a zone are mixed" if any(has_zone) else f"its values are of the kind {kind}"
    raise InputError(f"{name} is no column of times: {cure}; one kind was expected")


def _refuse_text(name: str, values: Any) -> None:
    import pandas as pd

    if getattr(values, "ndim", 1) == 1 and pd.api.types.infer_dtype(values) in ("string", "bytes"):
        first = pd.Index(values)[0]
        raise InputError(
            f"{name} holds the text {show_value(first)}; seconds or times were expected: pandas.to_datetime or "
            "pandas.to_timedelta makes times of text"
        )


def _element(name: str, sample: int, value: Any) -> float:
    import pandas as pd

    if value is None or value is pd.NA or value is np.ma.masked:
        return float("nan")
    result = _float(value)
    if result is None:
        raise InputError(f"{name} holds {show_value(value)} at sample {sample}; real numbers were expected")
    return result


def _float(value: Any) -> float | None:
    """Return a real number as a float, None where the value is none."""
    scalar = _scalar(value)
    if not isinstance(scalar, Real | Decimal) or isinstance(scalar, bool):
        return None
    try:
        return float(scalar)
    except (OverflowError, ValueError):
        return None
