"""The decision on one unit: a limit agreed before measuring, guard bands after ILAC-G8:09/2019, reasons in words."""

from dataclasses import dataclass

import numpy as np

from softcal.core.errors import InputError
from softcal.core.unit.uncertainty import ErrorForecast
from softcal.core.windows import TAPS

VERDICTS = ("pass", "conditional", "fail", "retest")
"""From best to worst; a retest outranks a fail because nothing can be said about the unit yet."""

FOUR_WORDS = ("pass", "conditional pass", "conditional fail", "fail")
"""The non-binary statement of ILAC-G8:09/2019, section 4.2.3."""

DEFAULT_FACTOR = 3.0
"""A lot that states no limit gets this factor times the source's own held-out RMSE."""

CONTRACT_WORD = {"pass": "pass", "conditional pass": "conditional", "conditional fail": "conditional", "fail": "fail"}


@dataclass(frozen=True)
class Limit:
    """The largest error a unit may have: the tolerance limit TL of ILAC-G8.

    Args:
        unit: physical unit of the reference.
        maximum_rmse: tolerance limit for the RMSE against the reference, in `unit`.
        origin: where the number comes from, printed with every verdict.

    Raises:
        InputError: the limit is not a positive number.
    """

    unit: str
    maximum_rmse: float
    origin: str = "stated for the lot"

    def __post_init__(self) -> None:
        if not 0 < self.maximum_rmse < float("inf"):
            raise InputError(f"limit maximum_rmse = {self.maximum_rmse} {self.unit}; a positive number was expected")


def default_limit(unit: str, source_rmse: float) -> Limit:
    """Return the limit of a lot that states none: `DEFAULT_FACTOR` times the source's held-out RMSE."""
    origin = f"no limit was stated: {DEFAULT_FACTOR:g} x the source's own held-out RMSE of {source_rmse:.3g} {unit}"
    return Limit(unit, DEFAULT_FACTOR * source_rmse, origin)


@dataclass(frozen=True)
class Finding:
    """Something seen on a recording or a map that bears on the verdict.

    Args:
        kind: short name, for example `saturated`.
        text: the same in a sentence a line operator can act on.
        worst_word: the best verdict word a unit with this finding can still get.
    """

    kind: str
    text: str
    worst_word: str = "conditional"


@dataclass(frozen=True)
class Verdict:
    """What is decided on one unit.

    Args:
        word: pass, conditional, fail or retest.
        four_word: pass, conditional pass, conditional fail or fail (ILAC-G8); empty where no error could be forecast.
        reasons: why, in words, most important first.
    """

    word: str
    four_word: str
    reasons: tuple[str, ...]


def four_word(forecast: ErrorForecast, limit: Limit) -> str:
    """Place a forecast error against the limit with guard band w = U (95 %, k = 2), ILAC-G8:09/2019 section 4.2.3.

    Pass: upper <= TL, so the probability of a false accept is below 2.5 %. Conditional pass: the forecast itself is
    within TL. Conditional fail: lower <= TL. Fail: even the lower end is above TL.
    """
    if forecast.upper <= limit.maximum_rmse:
        return "pass"
    if forecast.rmse <= limit.maximum_rmse:
        return "conditional pass"
    return "conditional fail" if forecast.lower <= limit.maximum_rmse else "fail"


def decide(
    forecast: ErrorForecast, limit: Limit, findings: tuple[Finding, ...] = (), source: str = "predicted"
) -> Verdict:
    """Combine an error, forecast or measured, with what was found; the worse of the two words stands."""
    statement = four_word(forecast, limit)
    words = [CONTRACT_WORD[statement], *(f.worst_word for f in findings)]
    word = max(words, key=VERDICTS.index)
    ordered = sorted(findings, key=lambda f: -VERDICTS.index(f.worst_word))
    return Verdict(word, statement, (*(f.text for f in ordered), _statement_text(forecast, limit, statement, source)))


def refuse(finding: Finding) -> Verdict:
    """Return the verdict on a unit for which no map can be made at all."""
    return Verdict(finding.worst_word, "", (finding.text,))


def decide_audited(before: float, after: float, windows: int, limit: Limit) -> Verdict:
    """Decide on a unit whose error was measured against the reference.

    Args:
        before, after: RMSE of f on raw and on mapped windows of the audit, in the limit's unit.
        windows: number of windows behind them.
        limit: tolerance limit.

    The standard deviation of an RMSE from n independent errors is RMSE / sqrt(2 n); errors of neighbouring windows are
    alike, so n is the number of windows that do not overlap.
    """
    uncertainty = after / np.sqrt(2 * max(windows / TAPS, 1.0))
    measured = ErrorForecast(after, after - 2 * uncertainty, after + 2 * uncertainty)
    harm = f"worse than doing nothing: RMSE {after:.3g} {limit.unit} with the map, {before:.3g} without it"
    findings = (Finding("harmful", harm, "fail"),) if after > before else ()
    return decide(measured, limit, findings, source="measured")


def _statement_text(forecast: ErrorForecast, limit: Limit, statement: str, source: str) -> str:
    relation = {
        "pass": "within",
        "conditional pass": "within, but closer than its uncertainty to",
        "conditional fail": "above, but closer than its uncertainty to",
        "fail": "above",
    }[statement]
    return (
        f"{source} RMSE {forecast.rmse:.3g} {limit.unit} (95 %: {forecast.lower:.3g} to {forecast.upper:.3g}) is "
        f"{relation} the limit {limit.maximum_rmse:.3g} {limit.unit} ({limit.origin})"
    )
