"""The limit of a new lot on a terminal: given, or asked for with a number to confirm."""

import sys
from pathlib import Path
from typing import Any

from softcal.app.cli.options import converted
from softcal.app.output import echo
from softcal.core.errors import InputError
from softcal.core.limit_text import LimitText, proposed_limit

LIMIT: dict[str, Any] = {
    "type": converted(LimitText.parse, "{!r}: a number above 0 was expected, or a share of the range as in 5%"),
    "metavar": "RMSE",
    "help": "largest acceptable error, in the reference unit or as a share of its range: 0.3 or 5%%; "
    "without one no unit passes",
}
UNSTATED = "no limit is stated, so no unit can pass; state it as rmse under [limit] in {toml}"


def limit_rmse(
    limit: LimitText | None, unit: str, full_range: float | None, toml: Path, *, may_ask: bool | None = None
) -> float | None:
    """Return the limit in the reference's unit; None without a stated limit, with a remark.

    Args:
        limit: as an option.
        full_range: of the source's reference, in its unit; None if unknown.
        may_ask: whether a person can be asked; by default on a terminal.

    Raises:
        InputError: a share of an unknown range.
    """
    if limit is not None:
        return limit.rmse(full_range)
    may_ask = sys.stdin.isatty() if may_ask is None else may_ask
    rmse = _ask_limit(unit, full_range) if may_ask else None
    if rmse is None:
        echo(f"note: {UNSTATED.format(toml=toml)}")
    return rmse


def _ask_limit(unit: str, full_range: float | None) -> float | None:
    question, proposed = f"largest acceptable RMSE, in {unit} or in % of the range", None
    if full_range is not None:
        proposed = proposed_limit(full_range)
        question += f" (proposed: {proposed:g} {unit}, {proposed / full_range:.0%} of the range; y takes it)"
    while True:
        print(f"{question}; Enter states none: ", end="", file=sys.stderr, flush=True)
        text = sys.stdin.readline().strip()
        if not text:
            return None
        if text.lower() in ("y", "yes") and proposed is not None:
            return proposed
        try:
            return LimitText.parse(text).rmse(full_range)
        except InputError as error:
            echo(str(error))
        except ValueError:
            echo(f"{text!r}: a number above 0 was expected, or a share of the range as in 5%")
