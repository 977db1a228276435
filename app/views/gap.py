"""What the gap page says of a diagnosis: places, causes with intervals, the next experiment. No Streamlit."""

from collections.abc import Mapping, Sequence
from typing import Any

from softcal.app.views.common import percent

LIKELY = 0.05
"""Effects below this probability are not listed as causes."""

Report = Mapping[str, Any]


def plain_name(identifier: str) -> str:
    """Return an identifier of the catalogue as words."""
    return identifier.replace("_", " ")


def named_causes(report: Report) -> list[str]:
    """Return the effects that are more likely there than not, the likeliest first, each with its probability."""
    causes = [cause for cause in _ranked(report) if cause["probability"] >= 0.5]
    return [f"{plain_name(cause['effect'])} ({percent(cause['probability'])})" for cause in causes]


def cause_rows(report: Report) -> list[dict[str, str]]:
    """Return one row per likely cause: effect, stage, probability, shrink, and values with their 90 % intervals."""
    return [
        {
            "effect": plain_name(cause["effect"]),
            "stage": plain_name(str(cause.get("stage", ""))),
            "probability": percent(cause["probability"]),
            "shrink": percent(cause["shrink"]),
            "values": "; ".join(_value(name, fitted) for name, fitted in cause["parameters"].items()),
        }
        for cause in _ranked(report)
        if cause["probability"] >= LIKELY
    ]


def place_rows(report: Report) -> list[dict[str, str]]:
    """Return one row per place where the gap shows, the largest share first."""
    places = sorted(report["where"], key=lambda place: -float(place["share"]))
    return [
        {
            "stage": plain_name(place["stage"]),
            "channel": str(place["channel"]),
            "regime": str(place["regime"]),
            "share": percent(float(place["share"])),
            "detail": str(place["detail"]),
        }
        for place in places
    ]


def hidden_effects(report: Report) -> list[str]:
    """Return the effects of which the refitted base would swallow four fifths or more on these runs."""
    hidden = {name: share for name, share in report["hidden_fraction"].items() if share is not None and share >= 0.8}
    return [f"{plain_name(name)} ({percent(hidden[name])})" for name in sorted(hidden, key=lambda n: -hidden[n])]


def ambiguous_groups(report: Report) -> list[str]:
    """Return the groups of effects these recordings cannot tell apart, in words."""
    return [" / ".join(map(plain_name, group)) for group in report["ambiguous_with"]]


def next_experiment(report: Report) -> Mapping[str, Any] | None:
    """Return the proposed experiment, None where none is proposed."""
    found: Mapping[str, Any] | None = report.get("next_experiment")
    return found if found and found.get("profile") not in (None, "", "none") else None


def _ranked(report: Report) -> Sequence[Mapping[str, Any]]:
    return sorted(report["causes"], key=lambda cause: -cause["probability"])


def _value(name: str, fitted: Mapping[str, Any]) -> str:
    if fitted.get("value") is None:
        return f"{name} –"
    known = fitted.get("low") is not None and fitted.get("high") is not None
    interval = f" ({fitted['low']:.3g} … {fitted['high']:.3g})" if known else ""
    return f"{name} = {fitted['value']:.3g}{interval} {fitted.get('unit') or ''}".rstrip()
