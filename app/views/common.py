"""How screens show numbers: rounding, units, and long series thinned for a chart."""

from collections.abc import Sized

import numpy as np

from softcal.app.texts.reasons import Words, phrase
from softcal.core.messages.figures import decimals_of_limit
from softcal.core.recording import Array
from softcal.core.unit.verdict import Limit

POINTS = 4000
"""So many points of a series are drawn; more cost the browser and show nothing."""


def number(value: float | None, unit: str = "", limit: float | None = None) -> str:
    """Return a number with three significant digits and its unit; a dash where there is none.

    Beside a limit it has the decimals of the limit, so that all errors of a lot have as many.
    """
    if value is None:
        return "–"
    shown = f"{value:.3g}" if limit is None else f"{value:.{decimals_of_limit(limit)}f}"
    return f"{shown} {unit}".strip()


def limit_said(limit: Limit | None, words: Words) -> str:
    """Return a lot's limit with its unit; one that nobody stated says so."""
    if limit is None:
        return words("lot.limit.none")
    said = number(limit.maximum_rmse, limit.unit, limit.maximum_rmse)
    return said if limit.is_stated else words("lot.limit.derived", limit=said)


def percent(share: float | None) -> str:
    """Return a share in per cent. Only all is 100 %, only nothing is 0 %."""
    if share is None:
        return "–"
    shown = f"{share:.1%}" if 0 < share < 1 else f"{share:.0%}"
    return {"100.0%": "> 99.9%", "0.0%": "< 0.1%"}.get(shown, shown).replace("%", " %")


def shortened(name: str, most: int) -> str:
    """Return a long name with its middle left out: serials differ at their ends."""
    if len(name) <= most:
        return name
    head = (most - 1) // 2
    return f"{name[:head]}…{name[head + 1 - most :]}"


def phase_said(phase: str, words: Words) -> str:
    """Return the phase of a run in words; an unknown one stays as the station says it."""
    return phrase("phase", phase, words) if phase else words("phase.queued")


def thinned(values: Sized, most: int = POINTS) -> slice:
    """Return the slice that leaves about so many points of a long series for a chart."""
    return slice(None, None, max(1, len(values) // most))


def far_end(values: Array, limit: float | None) -> float:
    """Return where the bars end: not so far that a few would squeeze all others."""
    end = 1.2 * (limit or 0.0)
    if len(values):
        end = max(end, min(1.02 * float(values.max()), 2.5 * float(np.quantile(values, 0.8))))
    return end or 1.0
