"""Comparison of a diagnosis with the true causes of its case: one outcome per case."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from softcal.core.challenge.equations import ALIASES, CATALOGUE
from softcal.core.challenge.recording_mistakes import Mistake
from softcal.core.challenge.seal import Label
from softcal.core.errors import InputError

VERDICTS = ("no_gap", "explained", "explained_in_part", "ambiguous", "unknown", "data")

VISIBLE_SIGMA = 5.0
"""A cause that stands out by less after the base is refitted counts as below the noise."""

MIN_REPORTED_PROBABILITY = 0.5
"""A cause is named when its stated probability is at least this."""


@dataclass(frozen=True)
class Answer:
    """The answer of a report.

    Args:
        probabilities: stated probability of every effect of the catalogue.
        first: the effect with the highest probability, empty where none is above zero.
        reported_effects: effects with a probability of at least one half.
        groups: sets of effects the report cannot tell apart.
        stages: stages under `where`, the largest share first.
        predicted, low, high: forecast of the shrink and its interval; NaN for none.
        data: mistakes that the report names, as (kind, channel, runs), no runs for all.
    """

    verdict: str
    probabilities: Mapping[str, float]
    first: str
    reported_effects: frozenset[str]
    groups: tuple[frozenset[str], ...]
    stages: tuple[str, ...]
    predicted: float
    low: float
    high: float
    data: tuple[tuple[str, str, tuple[int, ...]], ...] = ()

    @property
    def candidates(self) -> frozenset[str]:
        """Effects that the report holds possible: the named, the first, and the ambiguous ones."""
        first = {self.first} if self.first and self.verdict == "ambiguous" else set()
        candidates = self.reported_effects | first
        return candidates.union(*(group for group in self.groups if group & candidates or not candidates))


def read_answer(name: str, report: Mapping[str, Any]) -> Answer:
    """Read the parts of a report that are scored.

    Raises:
        InputError: a key of `softcal.gap/1` is missing or has another shape.
    """
    try:
        if report["verdict"] not in VERDICTS:
            raise ValueError(f"verdict is {report['verdict']!r}")
        probabilities = {str(cause["effect"]): float(cause["probability"]) for cause in report["causes"]}
        if not all(0.0 <= p <= 1.0 for p in probabilities.values()):
            raise ValueError(f"a probability is none: {probabilities}")
        shares = sorted(report["where"], key=lambda entry: -float(entry["share"]))
        fraction = report["shrink"]
        first = max(probabilities, key=probabilities.__getitem__) if any(probabilities.values()) else ""
        return Answer(
            verdict=str(report["verdict"]),
            probabilities=probabilities,
            first=first,
            reported_effects=frozenset(effect for effect, p in probabilities.items() if p >= MIN_REPORTED_PROBABILITY),
            groups=tuple(frozenset(map(str, group)) for group in report["ambiguous_with"]),
            stages=tuple(str(entry["stage"]) for entry in shares),
            predicted=_number(fraction["predicted"]),
            low=_number(fraction["low"]),
            high=_number(fraction["high"]),
            data=tuple(
                (str(d["what"]), str(d["channel"]), () if d["runs"] == "all" else tuple(map(int, d["runs"])))
                for d in report.get("data", ())
            ),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"report of {name}: {error!r}; a report of schema softcal.gap/1 was expected") from error


def _number(value: object) -> float:
    return float("nan") if value is None else float(value)  # type: ignore[arg-type]


@dataclass(frozen=True)
class CaseScore:
    """The answer for one case with its true causes.

    Args:
        answer: answer of the report, None without a readable report.
        explained_fraction: shrink on the run that was kept back, NaN where it was not computed.
        unread: reason why a report cannot be read; empty for a readable or missing report.
    """

    label: Label
    answer: Answer | None
    explained_fraction: float = float("nan")
    unread: str = ""

    @property
    def truth(self) -> frozenset[str]:
        """True causes within the catalogue; an effect outside the catalogue cannot be named."""
        return frozenset(c.effect for c in self.label.case.causes if c.effect in CATALOGUE)

    @property
    def is_visible(self) -> bool:
        """Whether the signature of the causes exceeds the noise after a refit of the base."""
        return self.label.distance_sigma >= VISIBLE_SIGMA

    @property
    def outcome(self) -> str:
        """right, set (honestly ambiguous), below noise, missed, abstained, alarm or wrong."""
        answer, case, truth = self.answer, self.label.case, self.truth
        if answer is None:
            return "wrong" if self.unread else "no report"
        if case.mistake:
            mistake = Mistake.from_text(case.mistake)
            # A unit of the whole case contradicts nothing in it: it is asked beside any verdict.
            is_unit_question = mistake.what == "unit_factor" and not mistake.runs and bool(answer.data)
            if answer.verdict != "data" and not is_unit_question:
                return "wrong"
            channels = set(mistake.channel.split("+")) - {""}
            is_right_mistake = any(
                (kind, runs) == (mistake.what, mistake.runs) and channels <= set(channel.split("+"))
                for kind, channel, runs in answer.data
            )
            return "right" if is_right_mistake else "abstained"
        if answer.verdict == "no_gap":
            return "right" if not case.causes else "missed" if self.is_visible else "below noise"
        if not case.causes:
            # Noise may leave something that has no cause: only a name, or a mistake, is an alarm.
            return "abstained" if answer.verdict == "unknown" and not answer.reported_effects else "alarm"
        # Beside a rest a name counts like anywhere: one that is not there is wrong.
        is_false = answer.verdict in ("unknown", "explained_in_part") and bool(answer.reported_effects - truth)
        if any(cause.effect not in CATALOGUE for cause in case.causes):
            if answer.verdict in ("unknown", "explained_in_part") and not is_false:
                return "right"
            alias = ALIASES.get(case.causes[0].effect)
            return "set" if alias and alias in answer.candidates | {answer.first} else "wrong"
        if is_false:
            return "wrong"
        if answer.verdict in ("explained", "explained_in_part") and answer.reported_effects == truth:
            return "right"
        if answer.verdict == "ambiguous":
            if answer.reported_effects == truth or (len(truth) == 1 and answer.first in truth):
                return "right"
            if truth <= answer.candidates and len(answer.candidates) <= max(3, len(truth) + 1):
                return "set"
        return "abstained" if answer.verdict in ("unknown", "explained_in_part") else "wrong"

    @property
    def is_first_right(self) -> bool:
        return self.answer is not None and self.answer.verdict != "no_gap" and self.answer.first in self.truth

    @property
    def is_stage_right(self) -> bool:
        return bool(self.answer and self.answer.stages and self.answer.stages[0] in self.label.case.stages)

    @property
    def is_stage_open(self) -> bool:
        """Whether the report leaves two stages possible, one of them of a true cause."""
        stages = set(self.answer.stages) if self.answer else set()
        return len(stages) == 2 and not stages.isdisjoint(self.label.case.stages)
