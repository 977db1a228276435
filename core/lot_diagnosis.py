"""Units of one lot diagnosed together: one cause for all of them, a size of its own for each."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from softcal.core.errors import InputError
from softcal.core.gap.case import Case
from softcal.core.gap.diagnosis import Diagnosis, DiagnosisVerdict
from softcal.core.gap.evidence import ParameterEstimate, estimates_of, probabilities
from softcal.core.gap.fit import Yardstick, fit, log_evidences, misfit, penalty
from softcal.core.gap.hypothesis import Hypothesis
from softcal.core.gap.method import CompetingHypothesesConfig
from softcal.core.gap.model import Fit, Fits, Problem
from softcal.core.gap.twin import TWIN, TwinModel, diagnose
from softcal.core.recording import Array

Ids = tuple[str, ...]
SCHEMA = "softcal.gap_lot/1"

MIN_UNITS = 2


@dataclass(eq=False)
class UnitSearch:
    """What one unit's search leaves for the lot; the fits themselves are too large to keep."""

    problem: Problem
    yardstick: Yardstick
    logs: dict[Ids, float]
    fits: dict[Ids, tuple[Hypothesis, Array]]
    misfit_and_penalty: dict[Ids, tuple[float, float]] = field(default_factory=dict)
    """χ² of every fit, and what its parameters cost."""

    @classmethod
    def from_fits(cls, fits: Fits) -> "UnitSearch":
        """Take what is needed from fits under one noise level."""
        fits_by_ids = {ids: (one.hypothesis, one.coordinates) for ids, one in fits.items()}
        costs = {ids: (one.chi2, penalty(one)) for ids, one in fits.items()}
        return cls(fits[()].problem, Yardstick.from_fits(fits.values()), dict(log_evidences(fits)), fits_by_ids, costs)

    @property
    def top(self) -> float:
        """Log evidence of the unit's own best hypothesis."""
        return max(self.logs.values())

    def shared(self, ids: Ids) -> float:
        """Return the log evidence without the prior odds of the causes, which a lot pays once.

        A hypothesis that was not fitted gets its bound: what the unit's own best one has.
        """
        return self.logs.get(ids, self.top) - len(ids) * float(np.log(self.problem.method.evidence.prior_odds))

    @property
    def stray(self) -> float:
        """Log evidence of a unit with causes of its own."""
        return float(np.log(self.problem.method.evidence.stray_odds)) + self.top

    def log_term(self, ids: Ids) -> float:
        """Return what the unit adds to the lot's log evidence: it shares causes, or strays."""
        return float(np.logaddexp(np.log1p(-self.problem.method.evidence.stray_odds) + self.shared(ids), self.stray))

    def add(self, ids: Ids, donor: tuple[Hypothesis, Array]) -> None:
        """Fit causes that this unit's search did not try, from another unit's sizes, also reversed."""
        hypothesis = donor[0].without_episodes()
        base = self.fits[max(self.logs, key=lambda i: self.logs[i])][1][hypothesis.of_base]
        sizes = donor[1][hypothesis.of_base.stop :]
        signs = [-1.0 if p.low < 0.0 and p.scale == "linear" else 1.0 for p in hypothesis.parameters]
        turned = sizes * np.array(signs[hypothesis.of_base.stop :])
        starts = [sizes] if np.array_equal(turned, sizes) else [sizes, turned]
        attempts = [fit(self.problem, hypothesis, np.append(base, start), steps=40) for start in starts]
        best = min(attempts, key=lambda one: one.chi2)
        self.logs[ids] = self.yardstick.log_evidence(best)
        self.fits[ids], self.misfit_and_penalty[ids] = (best.hypothesis, best.coordinates), (best.chi2, penalty(best))

    def fitted(self, ids: Ids) -> Fit:
        """Return the fit of a hypothesis, made again from its coordinates."""
        return fit(self.problem, *self.fits[ids], steps=5)


@dataclass(frozen=True, eq=False)
class LotMember:
    """One unit of a lot; with a mistake in its recordings it follows nothing and has no odds and no fit.

    Args:
        follows: whether it shares the lot's causes.
        log_odds: of sharing them against causes of its own.
        sizes: of the lot's causes in this unit, with 90 % intervals; empty where it does not follow.
        fit: of the lot's causes to this unit.
    """

    name: str
    diagnosis: Diagnosis[TwinModel]
    follows: bool
    log_odds: float | None
    sizes: Mapping[str, Mapping[str, ParameterEstimate]]
    fit: Fit | None = field(default=None, repr=False)

    @property
    def is_excluded(self) -> bool:
        """Whether nothing was judged, for the recordings hold a mistake."""
        return self.diagnosis.verdict == "data"

    def record(self) -> dict[str, object]:
        return {
            "unit": self.name,
            "serial": self.diagnosis.case.serial,
            "verdict": self.diagnosis.verdict,
            "own": list(self.diagnosis.best.ids),
            "follows": self.follows,
            "log_odds": self.log_odds,
            "sizes": {i: {name: vars(p) for name, p in rows.items()} for i, rows in self.sizes.items()},
            "data": [mistake.record() for mistake in self.diagnosis.mistakes],
        }


@dataclass(frozen=True, eq=False)
class LotDiagnosis:
    """What the units of a lot share.

    Args:
        causes: of the best shared hypothesis, empty for none.
        competing_hypotheses: sets of causes that the lot cannot tell apart, the best first.
        probability: of every cause that any unit's search considered.
        logs: log of prior times evidence over the units that follow, by hypothesis.
        ruled_out: hypotheses too far behind at their bound to be fitted to the units that lack them.
    """

    verdict: DiagnosisVerdict
    causes: Ids
    competing_hypotheses: tuple[Ids, ...]
    probability: Mapping[str, float]
    logs: Mapping[Ids, float]
    ruled_out: int
    members: tuple[LotMember, ...]
    stray_odds: float

    @property
    def outliers(self) -> list[str]:
        """Units with causes of their own."""
        return [m.name for m in self.members if not m.follows and not m.is_excluded]

    @property
    def excluded(self) -> list[str]:
        """Units whose recordings hold a mistake."""
        return [m.name for m in self.members if m.is_excluded]

    def report(self) -> dict[str, object]:
        """Return JSON values, schema `softcal.gap_lot/1`."""
        return {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "causes": [
                {"effect": i, "probability": p, "shared": i in self.causes}
                for i, p in sorted(self.probability.items(), key=lambda item: -item[1])
                if p > 0.0
            ],
            "rivals": [list(ids) for ids in self.competing_hypotheses],
            "outliers": self.outliers,
            "left_out": self.excluded,
            "stray_odds": self.stray_odds,
            "ruled_out_by_bound": self.ruled_out,
            "units": [m.record() for m in self.members],
        }


def diagnose_lot(cases: Mapping[str, Case], progress: Callable[[str], None] | None = None) -> LotDiagnosis:
    """Diagnose every unit, then what they share.

    Raises:
        InputError: fewer than two units.
    """
    if len(cases) < MIN_UNITS:
        raise InputError(f"{len(cases)} unit in the lot; at least {MIN_UNITS} are needed to be diagnosed together")
    report = progress or (lambda _: None)
    alone: dict[str, Diagnosis[TwinModel]] = {}
    searches: dict[str, UnitSearch] = {}
    every: list[UnitSearch] = []
    for number, (name, case) in enumerate(cases.items(), start=1):
        alone[name] = diagnosis = diagnose(case, on_fits=lambda fits: every.append(UnitSearch.from_fits(fits)))
        if diagnosis.verdict != "data":
            searches[name] = every[-1]
        causes = " + ".join(diagnosis.best.ids) or "no cause"
        report(f"unit {number} of {len(cases)}, {name}: {diagnosis.verdict}, {causes}")
    if not searches:
        members = tuple(_member(n, d, None, ()) for n, d in alone.items())
        return LotDiagnosis("data", (), (), {}, {}, 0, members, TWIN.method.evidence.stray_odds)
    report("adding up the evidence of the units")
    votes, ruled_out = lot_logs(list(searches.values()))
    leader = max(votes, key=lambda ids: votes[ids])
    following = [one for one in searches.values() if one.shared(leader) > one.stray]
    logs = joint_logs(following, votes) if following else votes
    method = next(iter(searches.values())).problem.method
    open_causes = [_find_surrogates(alone[name], one) for name, one in searches.items()]
    best, competing_hypotheses, surrogates = _best(logs, open_causes, method.competing)
    members = tuple(_member(name, one, searches.get(name), best) for name, one in alone.items())
    verdict = _verdict(best, competing_hypotheses, members)
    # Where nothing explains the units, the truth is most likely none of the causes compared.
    trust = method.verdict.unknown_trust if verdict == "unknown" else 1.0
    chances = probabilities(logs, sorted({i for ids in logs for i in ids}))
    probability = {
        i: p * trust * (method.verdict.surrogate_trust if i in surrogates else 1.0) for i, p in chances.items()
    }
    return LotDiagnosis(
        verdict, best, competing_hypotheses, probability, logs, ruled_out, members, method.evidence.stray_odds
    )


def joint_logs(following: Sequence[UnitSearch], hypotheses: Iterable[Ids]) -> dict[Ids, float]:
    """Return the log evidence of every hypothesis over units that share their causes, up to a constant.

    What a hypothesis leaves is summed over the units, and only then judged as of one unit: an equation
    that is a little wrong does not become more so by being repeated. Within the noise every unit counts
    in full.
    """
    noise_floor = sum(one.yardstick.noise_floor for one in following)
    # The first unit's parameters are paid for apart. Paid for in every unit, what one cause is a little cheaper than
    # another would count as often as there are units.
    size = sum(float(np.log(one.problem.count)) for one in following[1:])
    totals = {ids: sum(one.misfit_and_penalty[ids][0] for one in following) + len(ids) * size for ids in hypotheses}
    min_total = min(totals.values())
    cost = {ids: float(np.mean([one.misfit_and_penalty[ids][1] for one in following])) for ids in totals}
    modes = following[0].problem.method.evidence.modes
    return {ids: -0.5 * (misfit(noise_floor + total - min_total, modes) + cost[ids]) for ids, total in totals.items()}


def lot_logs(searches: Sequence[UnitSearch]) -> tuple[dict[Ids, float], int]:
    """Return the votes of the units for every hypothesis, and how many a bound has ruled out.

    A vote is a unit's own log evidence. One that strays cannot outvote the others.
    A hypothesis that a unit did not fit is fitted to it, unless even at its bound it is far behind.
    """
    every = {ids for one in searches for ids in one.logs}
    bounds = {ids: _pooled(searches, ids) for ids in every}
    logs: dict[Ids, float] = {}
    for ids in sorted(every, key=lambda i: (-bounds[i], i)):
        if logs and bounds[ids] < max(logs.values()) - searches[0].problem.method.competing.negligible:
            continue
        donor = max((one for one in searches if ids in one.logs), key=lambda one: one.shared(ids) - one.top)
        for one in searches:
            if ids not in one.logs:
                one.add(ids, donor.fits[ids])
        logs[ids] = _pooled(searches, ids)
    return logs, len(every) - len(logs)


def _pooled(searches: Sequence[UnitSearch], ids: Ids) -> float:
    prior_odds = searches[0].problem.method.evidence.prior_odds
    return len(ids) * float(np.log(prior_odds)) + sum(one.log_term(ids) for one in searches)


def _best(
    logs: Mapping[Ids, float], open_causes: Sequence[set[str]], config: CompetingHypothesesConfig
) -> tuple[Ids, tuple[Ids, ...], set[str]]:
    top = max(logs, key=lambda ids: logs[ids])
    near = sorted((ids for ids in logs if logs[ids] > logs[top] - config.odds), key=lambda ids: -logs[ids])
    in_play: list[Ids] = [top]
    for ids in near:
        is_larger = any(set(ids) > set(other) for other in in_play)
        if ids and ids not in in_play and (not is_larger or logs[ids] > logs[top] - config.added):
            in_play.append(ids)
    surrogates = {i for i in top if 2 * sum(i in causes for causes in open_causes) >= len(open_causes)}
    smaller = tuple(i for i in top if i not in surrogates)
    if surrogates and smaller in logs:
        return smaller, (smaller, *in_play)[: config.max_hypotheses], surrogates
    return top, tuple(in_play[: config.max_hypotheses]) if top else (top,), set()


def _find_surrogates(one: Diagnosis[TwinModel], searches: UnitSearch) -> set[str]:
    """Return the causes that a free form of the others imitates in a unit, though likelier."""
    ids = one.best.ids
    every = [competitor.ids for competitor in one.competing_hypotheses[1:] if set(competitor.ids) > set(ids)]
    larger = [other for other in every if searches.logs[other] > searches.logs[ids]]
    return {i for other in larger for i in other if i not in ids}


def _member(name: str, alone: Diagnosis[TwinModel], searches: UnitSearch | None, best: Ids) -> LotMember:
    if searches is None:
        return LotMember(name, alone, follows=False, log_odds=None, sizes={})
    odds = searches.shared(best) - searches.stray
    shared_fit = searches.fitted(best)
    sizes = {i: estimates_of(shared_fit, i) for i in best} if odds > 0.0 else {}
    return LotMember(name, alone, odds > 0.0, odds, sizes, shared_fit)


def _verdict(best: Ids, competing_hypotheses: tuple[Ids, ...], members: tuple[LotMember, ...]) -> DiagnosisVerdict:
    included = [m for m in members if not m.is_excluded]
    # The lot explains no more than most of its units: what they leave is there in each of them.
    is_unexplained = 2 * sum(m.diagnosis.verdict == "unknown" for m in included) > len(included)
    if is_unexplained or 2 * sum(m.follows for m in included) <= len(included):
        return "unknown"
    if not best:
        return "no_gap"
    return "ambiguous" if len(competing_hypotheses) > 1 else "explained"
