"""What the gap page says of a diagnosis: places, causes with intervals, the next experiment. No Streamlit.

Every function takes the words of the screen. A name that has none, as of a plug-in's own effect, is shown as it is.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from softcal.app.texts.reasons import Translator, render_reason, translate_phrase
from softcal.app.views.common import percent
from softcal.core.messages.reason import Reason
from softcal.core.profiles import describe_profile

LIKELY = 0.05
"""Effects below this probability are not listed as causes."""

Report = Mapping[str, Any]


def report_translator(report: Report, translate: Translator) -> Translator:
    """Return the words for a report: those on a simulator of one's own do not speak of the twin."""
    if not report.get("simulator"):
        return translate

    def of_simulator(key: str, **values: object) -> str:
        try:
            return translate(f"{key}.simulator", **values)
        except KeyError:
            return translate(key, **values)

    return of_simulator


def unidentifiable_lines(report: Report, translate: Translator) -> list[str]:
    """Return one line for everything the runs of a report do not tell."""
    identifiability = report.get("identifiability") or {"untold": ()}
    return [render_reason(Reason.parse(one), translate) for one in identifiability["untold"]]


def explained_fractions(report: Report) -> Mapping[str, Any]:
    """Return how far the causes explain the gap; nothing where there is no gap, or no diagnosis of one."""
    return {} if report["verdict"] == "no_gap" else report.get("shrink", {})


def plain_name(identifier: str) -> str:
    """Return an identifier of the catalogue as words."""
    return identifier.replace("_", " ")


def effect_name(effect: str, translate: Translator) -> str:
    """Return how an effect is called."""
    return plain_name(translate_phrase("gap.effect", effect, translate))


def stage_name(stage: str, translate: Translator) -> str:
    """Return how a stage of the chain is called."""
    return plain_name(translate_phrase("gap.stage", stage, translate))


def channel_name(channel: str, translate: Translator) -> str:
    """Return how a channel is called; two that were exchanged stand with a plus between them."""
    return "+".join(translate_phrase("gap.channel", part, translate) for part in channel.split("+"))


def mistake_name(kind: str, translate: Translator) -> str:
    """Return the kind of a mistake in the recordings."""
    return plain_name(translate_phrase("gap.mistake", kind, translate))


def profile_name(profile: str, translate: Translator) -> str:
    """Return what was pressed, or is to be."""
    return render_reason(describe_profile(plain_name(profile)), translate)


def capitalize(sentence: str) -> str:
    """Return a sentence with a capital at its beginning; other letters may be units."""
    return sentence[:1].upper() + sentence[1:]


def join_names(names: Sequence[str], key: str, translate: Translator) -> str:
    """Return names in a row, joined by a text with a `first` one and the `rest`."""
    first, *rest = names
    return translate(key, first=first, rest=join_names(rest, key, translate)) if rest else first


def cause_names(report: Report, translate: Translator) -> list[str]:
    """Return the effects that are more likely there than not, each with its probability."""
    causes = [cause for cause in rank_causes(report) if cause["probability"] >= 0.5]
    return [f"{effect_name(cause['effect'], translate)} ({percent(cause['probability'])})" for cause in causes]


def cause_rows(report: Report, translate: Translator) -> list[dict[str, str]]:
    """Return one row per likely cause, with its values and their 90 % intervals."""
    rows = []
    for cause in rank_causes(report):
        if cause["probability"] < LIKELY:
            continue
        values = []
        for name, fitted in cause["parameters"].items():
            low, high = (fitted.get(end) for end in ("low", "high"))
            unit = translate_phrase("gap.unit", str(fitted["unit"]), translate) if fitted.get("unit") else ""
            value = "–" if fitted.get("value") is None else f"{fitted['value']:.4g}"
            interval = (
                "" if None in (low, high) else f" ({translate('gap.range', low=f'{low:.3g}', high=f'{high:.3g}')})"
            )
            values.append(f"{translate_phrase('gap.parameter', name, translate)} = {value}{interval} {unit}".rstrip())
        if cause.get("form"):
            values.append(translate("gap.form", form=translate_phrase("gap.form", cause["form"], translate)))
        rows.append(
            {
                "effect": effect_name(cause["effect"], translate),
                "stage": stage_name(str(cause.get("stage", "")), translate),
                "probability": percent(cause["probability"]),
                "shrink": percent(cause["shrink"]),
                "values": "; ".join(values),
            }
        )
    return rows


def no_cause_text(report: Report, translate: Translator) -> str:
    """Return why no cause is likely: none is needed, or none explains what is there."""
    return translate("gap.why.unknown" if report["verdict"] == "unknown" else "gap.why.none")


def residual_rows(report: Report, translate: Translator) -> list[dict[str, str]]:
    """Return one row per empirical term: its standard error, and how often it was chosen."""
    residual = report.get("residual") or {"formula": (), "terms": ()}
    return [
        {
            "term": formula.removesuffix(term["variable"])
            + translate_phrase("gap.variable", term["variable"], translate),
            "error": f"{term['standard_error']:.1g} {term['unit']}",
            "chosen": percent(term["chosen"]),
        }
        for formula, term in zip(residual["formula"], residual["terms"], strict=True)
    ]


def location_rows(report: Report, translate: Translator) -> list[dict[str, str]]:
    """Return one row per place where the gap shows, the largest share first."""
    rows = []
    for location in sorted(report["where"], key=lambda location: -float(location["share"])):
        regime, detail = _sentences(location, ("regime", "detail"), translate)
        names = stage_name(location["stage"], translate), channel_name(str(location["channel"]), translate), regime
        row = (*names, percent(float(location["share"])), detail)
        rows.append(dict(zip(("stage", "channel", "regime", "share", "detail"), row, strict=True)))
    return rows


def mistake_rows(report: Report, translate: Translator) -> list[dict[str, str]]:
    """Return one row per mistake in the recordings, with what shows and what repairs it."""
    rows = []
    for mistake in report.get("data", ()):
        evidence, repair = _sentences(mistake, ("evidence", "repair"), translate)
        runs = translate("gap.data.all") if mistake["runs"] == "all" else ", ".join(map(str, mistake["runs"]))
        rows.append(
            {
                "mistake": mistake_name(mistake["what"], translate),
                "channel": channel_name(mistake["channel"], translate),
                "runs": runs,
                "evidence": evidence,
                "repair": repair,
            }
        )
    return rows


def hidden_effects(report: Report, translate: Translator) -> list[str]:
    """Return the effects of which the refitted base would swallow four fifths or more."""
    hidden = {name: share for name, share in report["hidden_fraction"].items() if share is not None and share >= 0.8}
    return [
        f"{effect_name(name, translate)} ({percent(hidden[name])})" for name in sorted(hidden, key=lambda n: -hidden[n])
    ]


def ambiguous_groups(report: Report, translate: Translator) -> list[str]:
    """Return the groups of effects these recordings cannot tell apart, in words."""
    return [" / ".join(effect_name(effect, translate) for effect in group) for group in report["ambiguous_with"]]


def next_experiment(report: Report) -> Mapping[str, Any] | None:
    """Return the proposed experiment, None where none is proposed."""
    experiment: Mapping[str, Any] | None = report.get("next_experiment")
    return experiment if experiment and experiment.get("profile") not in (None, "", "none") else None


def next_run_reason(experiment: Mapping[str, Any], translate: Translator) -> str:
    """Return why a run is proposed, or none."""
    (text,) = _sentences(experiment, ("why",), translate)
    return text


def rank_causes(report: Report) -> Sequence[Mapping[str, Any]]:
    """Return the causes, the likeliest first."""
    return sorted(report["causes"], key=lambda cause: -cause["probability"])


def _sentences(entry: Mapping[str, Any], names: Sequence[str], translate: Translator) -> list[str]:
    """Return what an entry says under some names: its reasons, else its plain sentences."""
    return [
        render_reason(Reason.parse(one), translate)
        for one in entry.get("reasons") or [entry.get(name) or "" for name in names]
    ]
