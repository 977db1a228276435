"""Unit of a numeric time column: stated, by its size, or by the sample rate."""

from pathlib import Path

import numpy as np

from softcal.app.tables.table import Column
from softcal.app.tables.time_column import PER_SECOND, find_declared_unit, is_time_heading
from softcal.core.errors import InputError
from softcal.core.recording import RATE_TOLERANCE, Array

MIN_RATE_HZ, MAX_RATE_HZ = 0.5, 2e5
"""A soft sensor that is read less or more often is none: the column is not in seconds."""

EPOCHS = {"ticks": (1.26e17, 1.6e17), "s": (1e9, 4e9), "ms": (1e12, 4e12), "us": (1e15, 4e15), "ns": (1e18, 4e18)}
"""Numbers of these sizes count from 1970 in that unit: the years 2001 to 2096."""

DIGITS_OF_DATES = ((1.99e13, 2.1e13), (1.99e16, 2.1e16))
"""Numbers of these sizes are dates without marks, without and with ms: 1990 to 2099."""

SAMPLES = "samples"
"""Unit of a column that counts them."""

CURE = "state its unit or pattern with --time-format (s, ms, us, ns, min, iso, excel or a strptime pattern)"


def number_unit(
    path: Path, column: Column, values: Array, time_format: str | None, declared_Hz: float | None
) -> tuple[str, str]:
    """Return the unit of a time column, with a remark if the sample rate decided it.

    Args:
        values: (n,) its numbers.
        time_format: declared unit; None finds it.
        declared_Hz: declared rate, which decides between possible units.

    Raises:
        InputError: nothing tells the unit, or the numbers are dates.
    """
    name = column.name
    if time_format == "iso":
        raise InputError(f"{path}: column {name!r} holds numbers, no ISO dates; correct --time-format")
    if time_format is not None:
        return time_format, ""
    present = values[np.isfinite(values)]
    if len(present) and any(low <= present[0] < high for low, high in DIGITS_OF_DATES):
        raise InputError(
            f"{path}: column {name!r} ({present[0]:.0f}, ...) may be dates without marks between their parts; write "
            "them as 2024-05-14 09:30:00.020, or give --sample-rate without this column"
        )
    steps = np.diff(present)
    step = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
    declared_unit = find_declared_unit(column)
    if declared_unit is not None and not (name == "t_s" and not column.unit):
        return declared_unit, ""
    if step == 0:
        return "s", ""
    if declared_unit is None:
        for unit, (low, high) in EPOCHS.items():
            if low <= present[0] < high:
                return unit, ""
        if declared_Hz is not None and (unit := _unit_by_rate(step, declared_Hz)):
            return unit, "" if unit == "s" else f"column {name!r} is in {unit} by the sample rate of {declared_Hz:g} Hz"
        if declared_Hz is not None and step == 1 and not is_time_heading(name) and not np.any(present % 1):
            return SAMPLES, ""
    _check_seconds(path, name, present, step, declared_Hz)
    return "s", ""


def _unit_by_rate(step: float, rate_Hz: float) -> str:
    """Return the only unit in which the step agrees with a rate; "" for none or several."""
    fitting = [unit for unit, per in PER_SECOND.items() if abs(per / step / rate_Hz - 1) <= RATE_TOLERANCE]
    return fitting[0] if len(fitting) == 1 else ""


def _check_seconds(path: Path, name: str, present: Array, step: float, declared_Hz: float | None) -> None:
    """Refuse numbers that no sensor's seconds can be, unless the declared rate is theirs."""
    agrees = declared_Hz is not None and abs(1 / step / declared_Hz - 1) <= RATE_TOLERANCE
    if not agrees and (problem := find_seconds_problem(present, step)):
        raise InputError(f"{path}: column {name!r} {problem}? {CURE}")


def find_seconds_problem(present: Array, step: float) -> str:
    """Return why numbers are no seconds of a sensor's samples, and what they may be; "" where they can be."""
    rate_Hz, is_integer = 1 / step, bool(np.all(present == np.round(present)))
    if not (rate_Hz < MIN_RATE_HZ or rate_Hz > MAX_RATE_HZ or (is_integer and rate_Hz <= 1)):
        return ""
    likely_units = [unit for unit, per in PER_SECOND.items() if MIN_RATE_HZ <= per / step <= MAX_RATE_HZ]
    guess = "excel" if rate_Hz > MAX_RATE_HZ else " or ".join(likely_units[:2]) or "another unit"
    return f"({present[0]:.12g}, {present[1]:.12g}, ...) shows {rate_Hz:g} Hz if it is in s; is it in {guess}"
