"""What the gap page says of a diagnosis: places, causes with intervals, the next experiment. No Streamlit.

Every function takes the words of the screen. A name that has none, as of a plug-in's own effect, is shown as it is.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from softcal.app.texts.reasons import Words, phrase, said
from softcal.app.views.common import percent
from softcal.core.profiles import pressed
from softcal.core.words.reason import Reason

LIKELY = 0.05
"""Effects below this probability are not listed as causes."""

Report = Mapping[str, Any]


def plain_name(identifier: str) -> str:
    """Return an identifier of the catalogue as words."""
    return identifier.replace("_", " ")


def effect_name(effect: str, say: Words) -> str:
    """Return how an effect is called."""
    return plain_name(phrase("gap.effect", effect, say))


def stage_name(stage: str, say: Words) -> str:
    """Return how a stage of the chain is called."""
    return plain_name(phrase("gap.stage", stage, say))


def channel_name(channel: str, say: Words) -> str:
    """Return how a channel is called; two that were exchanged stand with a plus between them."""
    return "+".join(phrase("gap.channel", part, say) for part in channel.split("+"))


def mistake_name(what: str, say: Words) -> str:
    """Return the kind of a mistake in the recordings."""
    return plain_name(phrase("gap.mistake", what, say))


def pressed_name(profile: str, say: Words) -> str:
    """Return what was pressed, or is to be."""
    return said(pressed(plain_name(profile)), say)


def begun(sentence: str) -> str:
    """Return a sentence with a capital letter at its beginning; the others stay, for they may be units."""
    return sentence[:1].upper() + sentence[1:]


def listed(names: Sequence[str], key: str, say: Words) -> str:
    """Return names in a row, joined by a text with a `first` one and the `rest`."""
    first, *rest = names
    return say(key, first=first, rest=listed(rest, key, say)) if rest else first


def named_causes(report: Report, say: Words) -> list[str]:
    """Return the effects that are more likely there than not, the likeliest first, each with its probability."""
    causes = [cause for cause in ranked(report) if cause["probability"] >= 0.5]
    return [f"{effect_name(cause['effect'], say)} ({percent(cause['probability'])})" for cause in causes]


def cause_rows(report: Report, say: Words) -> list[dict[str, str]]:
    """Return one row per likely cause: effect, stage, probability, shrink, and values with their 90 % intervals."""
    return [
        {
            "effect": effect_name(cause["effect"], say),
            "stage": stage_name(str(cause.get("stage", "")), say),
            "probability": percent(cause["probability"]),
            "shrink": percent(cause["shrink"]),
            "values": "; ".join(_value(name, fitted, say) for name, fitted in cause["parameters"].items()),
        }
        for cause in ranked(report)
        if cause["probability"] >= LIKELY
    ]


def no_cause_words(report: Report, say: Words) -> str:
    """Return what is said where no cause is likely: none is needed, or none explains what is there."""
    return say("gap.why.unknown" if report["verdict"] == "unknown" else "gap.why.none")


def residual_rows(report: Report, say: Words) -> list[dict[str, str]]:
    """Return one row per empirical term: the term, its standard error, and how often it was chosen without a run."""
    found = report.get("residual") or {"formula": (), "terms": ()}
    return [
        {
            "term": formula.removesuffix(term["variable"]) + phrase("gap.variable", term["variable"], say),
            "error": f"{term['standard_error']:.1g} {term['unit']}",
            "chosen": percent(term["chosen"]),
        }
        for formula, term in zip(found["formula"], found["terms"], strict=True)
    ]


def place_rows(report: Report, say: Words) -> list[dict[str, str]]:
    """Return one row per place where the gap shows, the largest share first."""
    places = sorted(report["where"], key=lambda place: -float(place["share"]))
    columns = ("stage", "channel", "regime", "share", "detail")
    rows = [place_words(place, say) | {"share": percent(float(place["share"]))} for place in places]
    return [{column: row[column] for column in columns} for row in rows]


def place_words(place: Mapping[str, Any], say: Words) -> dict[str, str]:
    """Return one place where the gap shows in words: stage, channel, regime and what is seen."""
    regime, detail = _kept(place, ("regime", "detail"), say)
    return {
        "stage": stage_name(place["stage"], say),
        "channel": channel_name(str(place["channel"]), say),
        "regime": regime,
        "detail": detail,
    }


def mistake_rows(report: Report, say: Words) -> list[dict[str, str]]:
    """Return one row per mistake in the recordings: what, where, what shows it and what repairs it."""
    rows = []
    for found in report.get("data", ()):
        evidence, repair = _kept(found, ("evidence", "repair"), say)
        runs = say("gap.data.all") if found["runs"] == "all" else ", ".join(map(str, found["runs"]))
        rows.append(
            {
                "mistake": mistake_name(found["what"], say),
                "channel": channel_name(found["channel"], say),
                "runs": runs,
                "evidence": evidence,
                "repair": repair,
            }
        )
    return rows


def hidden_effects(report: Report, say: Words) -> list[str]:
    """Return the effects of which the refitted base would swallow four fifths or more on these runs."""
    hidden = {name: share for name, share in report["hidden_fraction"].items() if share is not None and share >= 0.8}
    return [f"{effect_name(name, say)} ({percent(hidden[name])})" for name in sorted(hidden, key=lambda n: -hidden[n])]


def ambiguous_groups(report: Report, say: Words) -> list[str]:
    """Return the groups of effects these recordings cannot tell apart, in words."""
    return [" / ".join(effect_name(effect, say) for effect in group) for group in report["ambiguous_with"]]


def next_experiment(report: Report) -> Mapping[str, Any] | None:
    """Return the proposed experiment, None where none is proposed."""
    found: Mapping[str, Any] | None = report.get("next_experiment")
    return found if found and found.get("profile") not in (None, "", "none") else None


def why_next(experiment: Mapping[str, Any], say: Words) -> str:
    """Return why a run is proposed, or none."""
    (why,) = _kept(experiment, ("why",), say)
    return why


def parameter_name(name: str, say: Words) -> str:
    """Return how a parameter of an effect is written."""
    return phrase("gap.parameter", name, say)


def unit_name(fitted: Mapping[str, Any], say: Words) -> str:
    """Return the unit of a fitted parameter, empty where it has none."""
    return phrase("gap.unit", str(fitted["unit"]), say) if fitted.get("unit") else ""


def ranked(report: Report) -> Sequence[Mapping[str, Any]]:
    """Return the causes, the likeliest first."""
    return sorted(report["causes"], key=lambda cause: -cause["probability"])


def _kept(entry: Mapping[str, Any], names: Sequence[str], say: Words) -> list[str]:
    """Return what an entry of a report says under some names; an older version kept English sentences alone."""
    return [said(Reason.of(one), say) for one in entry.get("reasons") or [entry.get(name) or "" for name in names]]


def _value(name: str, fitted: Mapping[str, Any], say: Words) -> str:
    name = parameter_name(name, say)
    if fitted.get("value") is None:
        return f"{name} –"
    known = fitted.get("low") is not None and fitted.get("high") is not None
    interval = f" ({fitted['low']:.3g} … {fitted['high']:.3g})" if known else ""
    return f"{name} = {fitted['value']:.3g}{interval} {unit_name(fitted, say)}".rstrip()
