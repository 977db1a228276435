"""How papers write numbers: an uncertainty with two significant digits, a value with as many decimals (GUM 7.2.6)."""

from collections.abc import Mapping, Sequence
from decimal import Decimal
from math import floor, isfinite, log10

MAX_DECIMALS = 9
"""No paper needs more; where this many do not tell two numbers apart, they are equal."""


def decimals_of(uncertainty: float) -> int:
    """Return the decimal place of the second significant digit of an uncertainty; below 0 left of the point."""
    if not (isfinite(uncertainty) and uncertainty > 0):
        return 3
    decimals = 1 - floor(log10(uncertainty))
    # 0.0996 is 0.10: rounding may take it into the next decade.
    return 1 - floor(log10(round(uncertainty, decimals)))


def decimals_of_limit(limit: float) -> int:
    """Return how many decimals errors have beside a limit: those of its third digit or, if more, of all stated."""
    if not (isfinite(limit) and limit > 0):
        return 3
    return max(0, 2 - floor(log10(limit)), len(format_limit(limit).partition(".")[2]))


def format_limit(limit: float) -> str:
    """Return a limit in the digits it was stated with; one of more than ten was computed, and has three."""
    text = f"{limit:.10g}"
    return f"{Decimal(text if float(text) == limit else f'{limit:.3g}'):f}"


def format_error(error: float, limit: float) -> str:
    """Return an error beside a limit: all errors of a lot have as many decimals."""
    return f"{error:.{decimals_of_limit(limit)}f}"


def with_decimals(value: float, decimals: int) -> str:
    """Return a number rounded to a decimal place; below 0 to tens, hundreds ..."""
    return f"{round(value, decimals):.{max(decimals, 0)}f}"


def format_uncertainty(uncertainty: float) -> str:
    """Return an uncertainty with two significant digits."""
    return with_decimals(uncertainty, decimals_of(uncertainty) if uncertainty else 0)


def format_value(value: float, uncertainty: float) -> str:
    """Return a value with as many decimals as its uncertainty, given with two significant digits."""
    return with_decimals(value, decimals_of(uncertainty))


def find_decimals(values: Mapping[str, float], decimals: int, pairs: Sequence[tuple[str, str]]) -> int:
    """Return the least decimals from these on with which every pair of numbers compares as the exact ones do."""

    def keeps_order(digits: int) -> bool:
        rounded = {name: float(with_decimals(value, digits)) for name, value in values.items()}
        return all((rounded[a] <= rounded[b]) == (values[a] <= values[b]) for a, b in pairs)

    return next((digits for digits in range(decimals, MAX_DECIMALS) if keeps_order(digits)), MAX_DECIMALS)
