"""What the gap page says of a diagnosis: places, causes with intervals, the next experiment. No Streamlit.

Every function takes the words of the screen. A name that has none, as of a plug-in's own effect, is shown as it is.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from softcal.app.texts.reasons import Words, phrase, said
from softcal.app.views.common import percent
from softcal.core.messages.reason import Reason
from softcal.core.profiles import pressed

LIKELY = 0.05
"""Effects below this probability are not listed as causes."""

Report = Mapping[str, Any]


def words_for(report: Report, say: Words) -> Words:
    """Return the words for a report: those on a simulator of one's own do not speak of the twin."""
    if not report.get("simulator"):
        return say

    def of_simulator(key: str, **values: object) -> str:
        try:
            return say(f"{key}.simulator", **values)
        except KeyError:
            return say(key, **values)

    return of_simulator


def untold_lines(report: Report, say: Words) -> list[str]:
    """Return one line for everything the runs of a report do not tell."""
    identifiability = report.get("identifiability") or {"untold": ()}
    return [said(Reason.parse(one), say) for one in identifiability["untold"]]


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
    """Return a sentence with a capital at its beginning; other letters may be units."""
    return sentence[:1].upper() + sentence[1:]


def listed(names: Sequence[str], key: str, say: Words) -> str:
    """Return names in a row, joined by a text with a `first` one and the `rest`."""
    first, *rest = names
    return say(key, first=first, rest=listed(rest, key, say)) if rest else first


def named_causes(report: Report, say: Words) -> list[str]:
    """Return the effects that are more likely there than not, each with its probability."""
    causes = [cause for cause in ranked(report) if cause["probability"] >= 0.5]
    return [f"{effect_name(cause['effect'], say)} ({percent(cause['probability'])})" for cause in causes]


def cause_rows(report: Report, say: Words) -> list[dict[str, str]]:
    """Return one row per likely cause, with its values and their 90 % intervals."""
    rows = []
    for cause in ranked(report):
        if cause["probability"] < LIKELY:
            continue
        values = []
        for name, fitted in cause["parameters"].items():
            low, high = (fitted.get(end) for end in ("low", "high"))
            unit = phrase("gap.unit", str(fitted["unit"]), say) if fitted.get("unit") else ""
            value = "–" if fitted.get("value") is None else f"{fitted['value']:.4g}"
            interval = "" if None in (low, high) else f" ({say('gap.range', low=f'{low:.3g}', high=f'{high:.3g}')})"
            values.append(f"{phrase('gap.parameter', name, say)} = {value}{interval} {unit}".rstrip())
        if cause.get("form"):
            values.append(say("gap.form", form=phrase("gap.form", cause["form"], say)))
        rows.append(
            {
                "effect": effect_name(cause["effect"], say),
                "stage": stage_name(str(cause.get("stage", "")), say),
                "probability": percent(cause["probability"]),
                "shrink": percent(cause["shrink"]),
                "values": "; ".join(values),
            }
        )
    return rows


def no_cause_words(report: Report, say: Words) -> str:
    """Return why no cause is likely: none is needed, or none explains what is there."""
    return say("gap.why.unknown" if report["verdict"] == "unknown" else "gap.why.none")


def residual_rows(report: Report, say: Words) -> list[dict[str, str]]:
    """Return one row per empirical term: its standard error, and how often it was chosen."""
    residual = report.get("residual") or {"formula": (), "terms": ()}
    return [
        {
            "term": formula.removesuffix(term["variable"]) + phrase("gap.variable", term["variable"], say),
            "error": f"{term['standard_error']:.1g} {term['unit']}",
            "chosen": percent(term["chosen"]),
        }
        for formula, term in zip(residual["formula"], residual["terms"], strict=True)
    ]


def place_rows(report: Report, say: Words) -> list[dict[str, str]]:
    """Return one row per place where the gap shows, the largest share first."""
    rows = []
    for place in sorted(report["where"], key=lambda place: -float(place["share"])):
        regime, detail = _sentences(place, ("regime", "detail"), say)
        names = stage_name(place["stage"], say), channel_name(str(place["channel"]), say), regime
        row = (*names, percent(float(place["share"])), detail)
        rows.append(dict(zip(("stage", "channel", "regime", "share", "detail"), row, strict=True)))
    return rows


def mistake_rows(report: Report, say: Words) -> list[dict[str, str]]:
    """Return one row per mistake in the recordings, with what shows and what repairs it."""
    rows = []
    for mistake in report.get("data", ()):
        evidence, repair = _sentences(mistake, ("evidence", "repair"), say)
        runs = say("gap.data.all") if mistake["runs"] == "all" else ", ".join(map(str, mistake["runs"]))
        rows.append(
            {
                "mistake": mistake_name(mistake["what"], say),
                "channel": channel_name(mistake["channel"], say),
                "runs": runs,
                "evidence": evidence,
                "repair": repair,
            }
        )
    return rows


def hidden_effects(report: Report, say: Words) -> list[str]:
    """Return the effects of which the refitted base would swallow four fifths or more."""
    hidden = {name: share for name, share in report["hidden_fraction"].items() if share is not None and share >= 0.8}
    return [f"{effect_name(name, say)} ({percent(hidden[name])})" for name in sorted(hidden, key=lambda n: -hidden[n])]


def ambiguous_groups(report: Report, say: Words) -> list[str]:
    """Return the groups of effects these recordings cannot tell apart, in words."""
    return [" / ".join(effect_name(effect, say) for effect in group) for group in report["ambiguous_with"]]


def next_experiment(report: Report) -> Mapping[str, Any] | None:
    """Return the proposed experiment, None where none is proposed."""
    experiment: Mapping[str, Any] | None = report.get("next_experiment")
    return experiment if experiment and experiment.get("profile") not in (None, "", "none") else None


def why_next(experiment: Mapping[str, Any], say: Words) -> str:
    """Return why a run is proposed, or none."""
    (why,) = _sentences(experiment, ("why",), say)
    return why


def ranked(report: Report) -> Sequence[Mapping[str, Any]]:
    """Return the causes, the likeliest first."""
    return sorted(report["causes"], key=lambda cause: -cause["probability"])


def _sentences(entry: Mapping[str, Any], names: Sequence[str], say: Words) -> list[str]:
    """Return what an entry says under some names: its reasons, else its plain sentences."""
    return [said(Reason.parse(one), say) for one in entry.get("reasons") or [entry.get(name) or "" for name in names]]
