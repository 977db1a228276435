"""How screens show numbers: rounding, units, and long series thinned for a chart."""

from collections.abc import Sized

import numpy as np

from softcal.app.texts.reasons import Translator, translate_phrase
from softcal.core.messages.figures import format_error, format_limit
from softcal.core.recording import Array
from softcal.core.unit.verdict import Limit

POINTS = 4000
"""So many points of a series are drawn; more cost the browser and show nothing."""


def number(value: float | None, unit: str = "", limit: float | None = None) -> str:
    """Return a number with three significant digits, beside a limit as an error, and its unit; a dash for none."""
    if value is None:
        return "–"
    text = f"{value:.3g}" if limit is None else format_error(value, limit)
    return f"{text} {unit}".strip()


def limit_number(limit: float | None, unit: str) -> str:
    """Return a limit as it was stated and its unit; a dash for none."""
    return "–" if limit is None else f"{format_limit(limit)} {unit}"


def render_limit(limit: Limit | None, translate: Translator) -> str:
    """Return a lot's limit with its unit; one that nobody stated says so."""
    if limit is None:
        return translate("lot.limit.none")
    text = limit_number(limit.maximum_rmse, limit.unit)
    return text if limit.is_stated else translate("lot.limit.derived", limit=text)


def percent(share: float | None) -> str:
    """Return a share in per cent. Only all is 100 %, only nothing is 0 %."""
    if share is None:
        return "–"
    text = f"{share:.1%}" if 0 < share < 1 else f"{share:.0%}"
    return {"100.0%": "> 99.9%", "0.0%": "< 0.1%"}.get(text, text).replace("%", " %")


def shorten(name: str, max_length: int) -> str:
    """Return a long name with its middle left out: serials differ at their ends."""
    if len(name) <= max_length:
        return name
    head = (max_length - 1) // 2
    return f"{name[:head]}…{name[head + 1 - max_length :]}"


def render_phase(phase: str, translate: Translator) -> str:
    """Return the phase of a run in words; an unknown one stays as the station says it."""
    return translate_phrase("phase", phase, translate) if phase else translate("phase.queued")


def thinning_slice(values: Sized, max_points: int = POINTS) -> slice:
    """Return the slice that leaves about so many points of a long series for a chart."""
    return slice(None, None, max(1, len(values) // max_points))


def axis_end(values: Array, limit: float | None) -> float:
    """Return where the bars end: not so far that a few would squeeze all others."""
    end = 1.2 * (limit or 0.0)
    if len(values):
        end = max(end, min(1.02 * float(values.max()), 2.5 * float(np.quantile(values, 0.8))))
    return end or 1.0
