"""Score of diagnoses against the opened labels of a challenge: named causes and their probabilities."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softcal.core.challenge.answers import CaseScore, read_answer
from softcal.core.challenge.seal import Label
from softcal.core.errors import InputError
from softcal.core.metrics import finite_or_none, wilson

POOR = ("one_run", "one_speed", "no_load_cell", "no_stage", "ten_bit")
MIN_PROBABILITY = 1e-3
"""Nearest a probability counts to 0 or 1."""

PROBABILITY_EDGES = (0.05, 0.2, 0.5, 0.8, 0.95, 1.0)
DISTANCE_EDGES = (0.0, 3.0, 5.0, 10.0, 30.0, 100.0, np.inf)
"""Bins of the detection curve, in units of the noise over all samples."""


@dataclass(frozen=True)
class Row:
    """A counted measure of one line with its Wilson interval."""

    line: str
    measure: str
    hits: int
    count: int

    @property
    def share(self) -> float:
        return self.hits / self.count if self.count else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        return wilson(self.hits, self.count)

    def to_record(self) -> dict[str, Any]:
        low, high = self.interval
        return {**asdict(self), "share": finite_or_none(self.share), "low": low, "high": high}


@dataclass(frozen=True)
class Detection:
    """Share of cases in which one effect was named, by its visibility."""

    effect: str
    from_sigma: float  # noqa: V107
    to_sigma: float
    named: int
    honest: int
    count: int


@dataclass(frozen=True)
class Probabilities:
    """Calibration of the stated probabilities.

    Args:
        ece: expected calibration error over all effects of all cases, ten bins of equal width.
        ece_first: the same for the probability of the first cause alone.
        brier: mean squared error of all stated probabilities.
        on_truth: mean probability on the true cause (FIA), singles.
        log_score: mean of −ln of the probability of the truth, over causes stated at 0.05 or more, or true.
    """

    ece: float
    ece_first: float
    brier: float
    on_truth: float
    log_score: float
    by_bin: "tuple[Bin, ...]" = ()


@dataclass(frozen=True)
class Bin:
    """Causes with a stated probability in one interval, and how many of them are true.

    An effect that nobody names is right at 0 whatever the diagnosis does, 24 times out of 25. So
    only stated probabilities from the first of `PROBABILITY_EDGES` on are counted.
    """

    low: float
    high: float
    stated: float
    right: int
    count: int


@dataclass(frozen=True)
class FractionScore:
    """Forecast against realised shrink on a run that was in no fit, of every report that has one, right or wrong."""

    count: int
    median_realised: float
    rows: tuple[Row, ...]


@dataclass(frozen=True)
class ScoreSheet:
    """All scores of a challenge."""

    case_scores: tuple[CaseScore, ...]
    rows: tuple[Row, ...]
    detection: tuple[Detection, ...]
    probabilities: Probabilities
    fractions: FractionScore

    def to_record(self) -> dict[str, Any]:
        """Return plain JSON values; what could not be computed is null."""
        numbers = {name: finite_or_none(value) for name, value in vars(self.probabilities).items() if name != "by_bin"}
        return {
            "schema": "softcal.score/1",
            "rows": [row.to_record() for row in self.rows],
            "detection": [{**asdict(bin_), "to_sigma": finite_or_none(bin_.to_sigma)} for bin_ in self.detection],
            "probabilities": {**numbers, "by_bin": [asdict(bin_) for bin_ in self.probabilities.by_bin]},
            "shrink": {
                "count": self.fractions.count,
                "median_realised": finite_or_none(self.fractions.median_realised),
                "rows": [row.to_record() for row in self.fractions.rows],
            },
            "cases": [_case_record(score) for score in self.case_scores],
        }


def _case_record(score: CaseScore) -> dict[str, Any]:
    label, answer = score.label, score.answer
    return {
        "case": label.case.name,
        "line": label.case.line,
        "truth": [cause.effect for cause in label.case.causes],
        "distance_sigma": label.distance_sigma,
        "outcome": score.outcome,
        "verdict": answer.verdict if answer else None,
        "first": answer.first if answer else None,
        "realised_shrink": finite_or_none(score.explained_fraction),
        "unread": score.unread or None,
    }


def score_reports(
    labels: Sequence[Label],
    reports: Mapping[str, Mapping[str, Any]],
    realised: Callable[[Label, Mapping[str, Any]], float] = lambda label, report: float("nan"),
) -> ScoreSheet:
    """Score the reports of a challenge; without a readable report a case counts as wrong.

    Args:
        reports: per case name, a report of schema `softcal.gap/1`.
        realised: shrink of a report's twin on the run that was kept back, NaN where it has none.
    """
    case_scores = []
    for label in labels:
        answer, unread, report = None, "", reports.get(label.case.name)
        if report is not None:
            try:
                answer = read_answer(label.case.name, report)
            except InputError as error:
                unread = str(error)
        fraction = float("nan")
        if (
            report is not None
            and answer is not None
            and answer.verdict in ("explained", "explained_in_part", "ambiguous")
        ):
            fraction = realised(label, report)
        case_scores.append(CaseScore(label, answer, fraction, unread))
    answers = [(j, j.answer) for j in case_scores if j.answer is not None]
    predicted = np.array([p for _, a in answers for p in a.probabilities.values()])
    present = np.array([effect in j.truth for j, a in answers for effect in a.probabilities], dtype=np.float64)
    first = [(a.probabilities[a.first], j.is_first_right) for j, a in answers if a.first and a.verdict != "no_gap"]
    singles = [a.probabilities.get(next(iter(j.truth)), 0.0) for j, a in answers if len(j.truth) == 1]
    probabilities = Probabilities(
        ece=calibration_error(predicted, present),
        ece_first=calibration_error(np.array([p for p, _ in first]), np.array([float(y) for _, y in first])),
        brier=float(np.mean((predicted - present) ** 2)) if len(predicted) else float("nan"),
        on_truth=float(np.mean(singles)) if singles else float("nan"),
        log_score=log_score(predicted, present),
        by_bin=tuple(
            Bin(low, high, float(predicted[in_bin].mean()), int(present[in_bin].sum()), int(in_bin.sum()))
            for low, high in pairwise(PROBABILITY_EDGES)
            if (in_bin := (predicted >= low) & (predicted < high if high < 1.0 else predicted <= high)).any()
        ),
    )
    return ScoreSheet(
        tuple(case_scores),
        tuple(_rows(case_scores)),
        tuple(_detection(case_scores)),
        probabilities,
        _score_fractions(case_scores),
    )


HONEST = ("right", "set", "below noise")


def _rows(case_scores: Sequence[CaseScore]) -> Iterable[Row]:
    for line in dict.fromkeys(j.label.case.line for j in case_scores):
        cases = [j for j in case_scores if j.label.case.line == line]
        with_cause = [j for j in cases if j.label.case.causes]
        yield _row(line, "right", cases, lambda j: j.outcome == "right")
        yield _row(line, "right or honest set or below noise", cases, lambda j: j.outcome in HONEST)
        if line in POOR:
            yield _row(line, "right or abstaining", cases, lambda j: j.outcome in (*HONEST, "abstained"))
        if line == "none":
            yield _row(line, "false alarm", cases, lambda j: j.outcome == "alarm")
        visible = [j for j in with_cause if j.is_visible]
        if any(len(j.truth) == 1 for j in with_cause):
            yield _row(line, "cause first", [j for j in with_cause if j.truth], lambda j: j.is_first_right)
            yield _row(line, "cause first where visible", [j for j in visible if j.truth], lambda j: j.is_first_right)
        if with_cause:
            yield _row(line, "stage", visible, lambda j: j.is_stage_right)
            if line in ("outside", "published_outside"):
                name = "stage right or held open between two"
                yield _row(line, name, visible, lambda j: j.is_stage_right or j.is_stage_open)


def _row(line: str, measure: str, cases: Sequence[CaseScore], is_hit: Callable[[CaseScore], bool]) -> Row:
    return Row(line, measure, sum(map(is_hit, cases)), len(cases))


def _detection(case_scores: Sequence[CaseScore]) -> Iterable[Detection]:
    singles = [j for j in case_scores if len(j.truth) == 1 and len(j.label.case.causes) == 1]
    for effect in sorted({next(iter(j.truth)) for j in singles}):
        for low, high in pairwise(DISTANCE_EDGES):
            scores = [j for j in singles if effect in j.truth and low <= j.label.distance_sigma < high]
            if scores:
                named, honest = sum(j.is_first_right for j in scores), sum(j.outcome in HONEST for j in scores)
                yield Detection(effect, low, high, named, honest, len(scores))


def calibration_error(predicted: NDArray[np.float64], happened: NDArray[np.float64]) -> float:
    """Return Σ (nᵦ/n)·|mean stated − mean happened| over ten bins of equal width."""
    if len(predicted) == 0:
        return float("nan")
    bin_of = np.minimum((predicted * 10).astype(int), 9)
    return float(np.sum(np.abs(np.bincount(bin_of, predicted - happened)))) / len(predicted)


def log_score(predicted: NDArray[np.float64], present: NDArray[np.float64]) -> float:
    """Return the mean of −ln of the probability of the truth, in nats, over causes that are stated or true.

    What nobody states and nobody hid costs nothing, so that it would only hide what is wrong. A probability of 0 or 1
    counts as one in a thousand short of it.
    """
    counts = (predicted >= PROBABILITY_EDGES[0]) | (present > 0.0)
    if not counts.any():
        return float("nan")
    p = np.clip(predicted[counts], MIN_PROBABILITY, 1.0 - MIN_PROBABILITY)
    return float(np.mean(-np.log(np.where(present[counts] > 0.0, p, 1.0 - p))))


def _score_fractions(case_scores: Sequence[CaseScore]) -> FractionScore:
    forecasts = [
        (j.answer, j.explained_fraction)
        for j in case_scores
        if j.answer and np.isfinite(j.explained_fraction) and np.isfinite(j.answer.predicted)
    ]
    measures = {
        "realised ≥ 0.95": [fraction >= 0.95 for _, fraction in forecasts],
        "|forecast − realised| ≤ 0.10": [abs(a.predicted - fraction) <= 0.10 for a, fraction in forecasts],
        "realised inside [low, high]": [a.low <= fraction <= a.high for a, fraction in forecasts],
    }
    return FractionScore(
        count=len(forecasts),
        median_realised=float(np.median([fraction for _, fraction in forecasts])) if forecasts else float("nan"),
        rows=tuple(Row("explained", name, sum(hits), len(hits)) for name, hits in measures.items()),
    )


MIN_SHARES: Mapping[str, float] = MappingProxyType(
    {
        "usual": 0.7,
        "none": 0.7,
        "pair": 0.5,
        "form": 0.5,
        "outside": 0.5,
        "mistakes": 0.7,
        "untared": 0.6,
        "reseated": 0.6,
        "published_form": 0.15,
        "published_outside": 0.15,
    }
)
"""Least share of a line's cases that are right: the true causes, `no_gap`, `unknown` or `data`.

They lie far below what is measured on many cases, and above what an answer reaches that does not
look at the recording. With a handful of cases a line, a sound diagnosis fails once in hundreds of
times, and silence never passes.
"""

MIN_CASES = 4
"""Cases that a large draw has of each of these lines: fewer could miss a floor by chance."""

MIN_SHARE_OF_ALL = 0.6
"""Least share over all these lines together."""


def shortfalls(sheet: ScoreSheet) -> list[str]:
    """Return one sentence for every floor that is not reached; empty where all are.

    All drawn cases count: a case without a report is wrong.
    """
    sentences, hits, total = [], 0, 0
    for line, min_share in MIN_SHARES.items():
        cases = [score for score in sheet.case_scores if score.label.case.line == line]
        right = sum(score.outcome == "right" for score in cases)
        hits, total = hits + right, total + len(cases)
        if right < min_share * len(cases):
            sentences.append(f"{line}: {right} of {len(cases)} right; at least {min_share:.0%} were expected")
    if total and hits < MIN_SHARE_OF_ALL * total:
        sentences.append(f"all lines: {hits} of {total} right; at least {MIN_SHARE_OF_ALL:.0%} were expected")
    return sentences
