"""The diagnosis: where a model is wrong, why, how sure that is, how far the gap shrinks, what to record next."""

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Literal, Self, TypeAlias, TypeVar

from softcal.core.gap.case import Case, DataMistake
from softcal.core.gap.empirical import LearnedResidual, learn_residual
from softcal.core.gap.evidence import (
    FaultLocation,
    Partial,
    RankedCause,
    Where,
    bounds_reached,
    competing_hypotheses,
    confused_pairs,
    consistency_of,
    hidden_fraction,
    in_catalogue_form,
    list_completeness,
    partial_of,
    probabilities,
    ranked_causes,
    rest_energy,
    weights_of,
    with_constants,
)
from softcal.core.gap.experiments import (
    Identifiability,
    NextExperiment,
    identifiability,
    propose_for_unmodelled,
    reasons,
)
from softcal.core.gap.fit import exact_log_evidence, log_evidences, one_less
from softcal.core.gap.model import Fit, Model
from softcal.core.gap.residual import (
    ChannelGap,
    ExplainedFraction,
    Quantified,
    gap_of_base,
    held_out_error,
    noise_chance,
    on_unseen,
    quantify,
    unsupported,
)
from softcal.core.gap.search import Progress, Search, search_under_correlated_noise
from softcal.core.messages.reason import several

Checked: TypeAlias = tuple[tuple[DataMistake, ...], Identifiability | None]
"""Mistakes or questions, and what runs tell."""


SCHEMA = "softcal.gap/1"

NOT_MEASURED = "not measured: the recordings hold a mistake"


DiagnosisVerdict = Literal["no_gap", "explained", "explained_in_part", "ambiguous", "unknown", "data"]


@dataclass(frozen=True)
class CalibrationGap:
    """Errors of f on a run that neither twin nor f has seen, RMS in N, by what f was trained on.

    Args:
        run: the run that was held back.
        base, repaired: f trained on the refitted base twin, and on the twin with the causes.
        rig: f trained on the rig's other runs.
    """

    run: str
    base: float
    repaired: float
    rig: float


class ReportingModel(Model):
    """A model that can say where a gap lies, and what to record next."""

    @abstractmethod
    def mistakes_by_search(self, search: Search) -> tuple[DataMistake, ...]:
        """Return mistakes of recordings that explain more than the causes of a search do."""

    @abstractmethod
    def where(self, search: Search, assessment: "Assessment", causes: Sequence[RankedCause]) -> Where:
        """Return where the gap lies."""

    @abstractmethod
    def next_experiment(
        self, search: Search, assessment: "Assessment", telling: NextExperiment | None
    ) -> NextExperiment:
        """Return what to record next.

        Args:
            telling: the run that tells a rest from the causes nearest to it; None where none does.
        """

    @abstractmethod
    def report(self, diagnosis: "Diagnosis[Any]") -> dict[str, object]:
        """Return what the report of this model has besides, ready for JSON."""


M = TypeVar("M", bound=ReportingModel)


@dataclass(frozen=True, eq=False, kw_only=True)
class Diagnosis(Generic[M]):
    """Everything a report or a page needs; with the verdict `data` only what has no default.

    Args:
        chosen: causes that are chosen where each part of the samples in turn is held back.
        explained_share: of the structured gap energy, 1 when nothing but noise is left.
        best: each cause by the equation that fits best, as it is handed on.
        catalogue_fit: the best hypothesis with every cause by the equation that is reported.
        competing_hypotheses: hypotheses that cannot be told apart, the best first.
        mistakes: in the recordings; with another verdict than `data` they are questions.
        residual: empirical terms for what no named cause explains, if they hold on runs held back.
        identifiability: what the runs tell of the base and of every effect; None where there is a mistake.
        list_complete: probability that nothing unmodelled is left.
        calibration: what the gap costs a calibration; None where it was not asked for.
        provenance: what made it and from what, as JSON values; None of what was read from no file.
    """

    model: M
    verdict: DiagnosisVerdict
    base: Fit
    best: Fit
    catalogue_fit: Fit
    competing_hypotheses: tuple[Fit, ...]
    causes: tuple[RankedCause, ...]
    gap: dict[str, ChannelGap]
    next_experiment: NextExperiment
    where: Where = Where()
    explained_fraction: ExplainedFraction = ExplainedFraction(0.0, 0.0, 0.0, 0.0)
    protocol: str = NOT_MEASURED
    chosen: tuple[tuple[str, ...], ...] = ()
    ambiguous_with: list[list[str]] = field(default_factory=list)
    hidden_fraction: dict[str, float] = field(default_factory=dict)
    explained_share: float = 0.0
    mistakes: tuple[DataMistake, ...] = ()
    partial: Partial | None = None
    residual: LearnedResidual[Any] | None = None
    identifiability: Identifiability | None = None
    list_complete: float = 0.0
    calibration: CalibrationGap | None = None
    provenance: Mapping[str, object] | None = None

    @classmethod
    def stopped(cls, model: M, base: Fit, mistakes: tuple[DataMistake, ...]) -> Self:
        """Return the diagnosis of mistaken recordings: nothing is named and nothing forecast."""
        return cls(
            model=model,
            verdict="data",
            base=base,
            best=base,
            catalogue_fit=base,
            competing_hypotheses=(base,),
            causes=tuple(RankedCause(effect.id, effect.stage, 0.0, None, {}) for effect in model.candidates),
            gap=gap_of_base(base),
            next_experiment=NextExperiment("none", several([one.repair for one in mistakes])),
            mistakes=mistakes,
        )

    @property
    def locations(self) -> tuple[FaultLocation, ...]:
        """Where the gap lies."""
        return self.where.locations

    @property
    def on_bound(self) -> dict[str, float]:
        """Parameters of base and causes left on a bound, with values: often the recordings are to blame."""
        return bounds_reached(self.best)

    @property
    def case(self) -> Case:
        """The recordings."""
        return self.base.problem.case

    def report(self) -> dict[str, object]:
        """Return the report of the contract, ready for JSON."""
        report: dict[str, object] = {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "serial": self.case.serial,
            "data": [result.record() for result in self.mistakes],
            "gap": {channel: vars(gap) for channel, gap in self.gap.items()},
            "shrink": vars(self.explained_fraction)
            | {"protocol": self.protocol, "chosen": [list(ids) for ids in self.chosen]},
            "where": [location.record() for location in self.locations],
            "causes": [
                vars(c) | {"form": c.form or None, "parameters": {name: vars(p) for name, p in c.parameters.items()}}
                for c in self.causes
            ],
            "ambiguous_with": self.ambiguous_with,
            "hidden_fraction": self.hidden_fraction,
            "identifiability": None if self.identifiability is None else self.identifiability.record(),
            "next_experiment": self.next_experiment.record(),
            "explained_share": self.explained_share,
            "partial": None if self.partial is None else vars(self.partial) | {"effects": list(self.partial.effects)},
            "residual": None if self.residual is None else self.residual.record(),
            "list_complete": self.list_complete,
            "on_bound": self.on_bound,
            "calibration": None if self.calibration is None else vars(self.calibration),
        }
        return report | self.model.report(self) | ({"provenance": self.provenance} if self.provenance else {})


def check_case(case: Case, model: Model) -> Checked:
    """Return the mistakes in the recordings and, where there is none, what the runs tell of a model."""
    if recording_mistakes := model.mistakes(case):
        return recording_mistakes, None
    base = model.base_fit(case)
    recording_mistakes, questions = model.mistakes_by_base(base)
    return (recording_mistakes, None) if recording_mistakes else (questions, distinguished_by(base))


def distinguished_by(base: Fit) -> Identifiability:
    """Return what the runs of a base fit tell, and which experiments tell the rest."""
    model = base.problem.model
    return identifiability(base, model.visible(base.problem.case), model.menu(base))


def diagnose_with(
    model: M,
    case: Case,
    progress: Progress | None = None,
    on_fits: Callable[[Mapping[tuple[str, ...], Fit]], None] | None = None,
) -> Diagnosis[M]:
    """Diagnose the gap between a model and recordings."""
    on_progress = progress or (lambda _: None)
    on_progress("looking for mistakes in the recordings")
    if recording_mistakes := model.mistakes(case):
        return Diagnosis.stopped(model, model.base_of_mistaken_case(case), recording_mistakes)
    on_progress("fitting the base to all runs")
    base = model.base_fit(case)
    recording_mistakes, questions = model.mistakes_by_base(base)
    if recording_mistakes:
        return Diagnosis.stopped(model, base, recording_mistakes)
    identifiability = distinguished_by(base)
    for cause in reasons(identifiability):
        on_progress(str(cause))
    # What every run may have of its own needs no cause: its equation's error would be named as one.
    search = Search(
        base,
        [e for e in model.visible(case) if e.is_episodic or not identifiability[e.id].is_run_nuisance],
        on_progress,
    )
    search.run()
    search = search_under_correlated_noise(search)
    if recording_mistakes := model.mistakes_by_search(search):
        return Diagnosis.stopped(model, search.base, recording_mistakes)
    if search.unmodelled is None:
        search.store_not_excluded()
    assessment = assess_search(search)
    if on_fits is not None:
        on_fits(search.fits)
    best, best_with_constants = assessment.best, with_constants(assessment.best)
    catalogue_fits, quantified = tuple(map(in_catalogue_form, assessment.group)), assessment.quantified
    causes = ranked_causes(
        search.fits, best, model.candidates, catalogue_fits, assessment.chances, quantified.explained_fraction.held_out
    )
    where = model.where(search, assessment, causes)
    on_progress("describing what is left")
    terms = list(model.terms(search.base))
    parents = {"unknown": (search.base, best_with_constants), "no_gap": ()}.get(
        assessment.verdict, (best_with_constants,)
    )
    residual = learn_residual(search.base, parents, terms)
    return Diagnosis(
        model=model,
        verdict=assessment.verdict,
        base=search.base,
        best=best_with_constants,
        catalogue_fit=catalogue_fits[0],
        competing_hypotheses=assessment.group,
        causes=causes,
        gap=quantified.gap,
        next_experiment=model.next_experiment(search, assessment, _propose_for_residual(search, assessment, residual)),
        where=where,
        explained_fraction=quantified.explained_fraction,
        protocol=quantified.protocol,
        chosen=quantified.chosen,
        ambiguous_with=confused_pairs(assessment.group),
        hidden_fraction={i: hidden_fraction(assessment.group[0], i) for i in assessment.group[0].ids},
        explained_share=search.explained_share(best),
        mistakes=questions,
        partial=partial_of(search.fits, assessment.best) if assessment.is_partial else None,
        residual=residual,
        identifiability=identifiability.naming(best.ids),
        list_complete=assessment.list_complete,
    )


def _propose_for_residual(
    search: Search, assessment: "Assessment", residual: LearnedResidual[Any] | None
) -> NextExperiment | None:
    """Return the run that tells what is left from every cause near to it; None where nothing describes it."""
    rest, other_causes = (residual.fit, residual.other_causes) if residual is not None else (search.unmodelled, ())
    if rest is None or not assessment.is_partial:
        return None
    other_causes = other_causes or tuple(i for i in rest.ids if i in {effect.id for effect in search.candidates})
    return propose_for_unmodelled(search.model.menu(search.start), search.fits, rest, other_causes)


@dataclass(frozen=True)
class Assessment:
    """What a search comes to: the one set of causes that every section of a report is of.

    Args:
        best: the set of causes, the base alone where none lowers the gap on samples held back.
        group: the set and what cannot be told apart from it.
        chances: probability of every effect that it is there, whatever else is left.
        list_complete: probability that nothing unmodelled is left.
    """

    best: Fit
    group: tuple[Fit, ...]
    quantified: Quantified
    verdict: DiagnosisVerdict
    chances: dict[str, float]
    list_complete: float

    @property
    def is_partial(self) -> bool:
        """Whether a rest of the gap has no name."""
        return self.verdict in ("unknown", "explained_in_part")


def assess_search(search: Search) -> Assessment:
    """Return the set of causes of a search, the shrink held out, verdict, and chances of effects."""
    model, config = search.model, search.model.method
    effects = [effect.id for effect in model.candidates]
    search.on_progress("holding back samples from every cause")
    # Causes that lower nothing on unseen samples are taken out of the best hypothesis.
    rejected: set[str] = set()
    while len(search.best.ids) > 1:
        rest = one_less(search.fits, search.best)
        idle = unsupported(search.best, rest)
        if not idle:
            break
        rejected.add(idle[0])
        search.best = rest[idle[0]]
    logs, best = log_evidences(search.fits), search.best
    group, added = on_unseen(
        competing_hypotheses(search.fits, best, logs, tuple(search.not_excluded.values())), rejected
    )
    doubted = rejected | added | set(search.not_excluded)
    search.on_progress("measuring the shrink on samples no fit has seen")
    quantified = quantify(search.base, with_constants(best), search.fits.values())
    verdict = _verdict(search, group, quantified)
    every = _presence(search, logs, effects)
    # Of a cause held open beside the best hypothesis the mean counts of two readings: every equation may be a little
    # wrong, or they hold exactly.
    larger = [f for f in group if set(f.ids) > set(best.ids)]
    exact = probabilities({f.ids: exact_log_evidence(f) for f in (best, *larger)}, effects)
    open_ = {i for f in larger for i in f.ids}.difference(best.ids)
    every = {i: 0.5 * (p + exact[i]) if i in open_ else p for i, p in every.items()}
    trust = dict.fromkeys(
        effects if best.ids and not quantified.is_supported else doubted, config.verdict.surrogate_trust
    )
    chances = {i: p * trust.get(i, 1.0) for i, p in every.items()}
    if verdict == "unknown" and search.unmodelled is None:
        if quantified.is_supported and any(chances[i] >= model.method.presence.certain for i in best.ids):
            verdict = "explained_in_part"
        elif model.hands_on_closest and (best := closest_set(search)) is not search.best:
            group, quantified = (best,), quantify(search.base, with_constants(best), is_chosen=True)
    if best.ids and not quantified.is_supported:
        best, group, quantified = search.base, (search.base,), quantify(search.base, search.base)
    search.best = best
    return Assessment(best, group, quantified, verdict, chances, _completeness(search, best))


def closest_set(search: Search) -> Fit:
    """Return the smallest set whose error on samples held back is near the least.

    A few sets are tried, and of the nearest one with a cause more.
    """
    config, every = search.model.method, list(search.fits.values())
    fits = {f.ids: f for f in (search.best, *sorted(every, key=lambda f: f.chi2)[: config.verdict.max_tried])}
    for size in {len(f.ids) for f in every}:
        one = min((f for f in every if len(f.ids) == size), key=lambda f: f.chi2)
        fits[one.ids] = one
    errors = {ids: held_out_error(search.base, result) for ids, result in fits.items()}
    nearest = fits[min(errors, key=lambda ids: errors[ids])]
    if len(nearest.ids) < config.competing.max_causes:
        for grown in search.grown_from(nearest):
            search.store(grown)
            if (stored := search.fits.get(grown.ids)) is not None:
                fits[stored.ids], errors[stored.ids] = stored, held_out_error(search.base, stored)
    near = min(errors.values()) * (1.0 + config.verdict.near_error)
    return fits[min((ids for ids, error in errors.items() if error <= near), key=lambda i: (len(i), errors[i]))]


def _completeness(search: Search, result: Fit) -> float:
    has_unlisted = search.unmodelled is not None or search.model.is_uneven(result)
    gap, chance = max(search.base.chi2 - search.base.problem.count, 1.0), noise_chance(result)
    rest = min(rest_energy(result, chance) / gap, 1.0) if result.ids else 1.0
    return list_completeness(chance, rest, has_unlisted, search.model.method.presence)


def _presence(search: Search, logs: Mapping[tuple[str, ...], float], effects: Iterable[str]) -> dict[str, float]:
    """Return for every effect the probability that it is there, an unmodelled rest or not.

    Every hypothesis counts by its evidence. In one that leaves a rest a cause may be what imitates a part of it.
    """
    config, chances, rest = search.model.method.presence, dict.fromkeys(effects, 0.0), 0.0
    memo: dict[tuple[str, ...], dict[str, float]] = {(): {}}
    for ids, weight in weights_of(logs).items():
        if weight > config.negligible:
            rest += weight * (1.0 - _completeness(search, search.fits[ids]))
            for i, chance in genuine_probabilities(search, ids, memo).items():
                chances[i] += weight * chance
    # What no hypothesis has may hide beside a rest.
    return {i: p + (1.0 - p) * config.hides * rest for i, p in chances.items()}


def genuine_probabilities(
    search: Search, ids: tuple[str, ...], memo: dict[tuple[str, ...], dict[str, float]]
) -> dict[str, float]:
    """Return how likely each cause of a hypothesis is there and imitates nothing; `memo` by hypothesis."""
    if ids not in memo:
        config, result = search.model.method.presence, search.fits[ids]
        complete, rest = _completeness(search, result), rest_energy(result, noise_chance(result))
        fits, laws = search.fits, search.laws
        each = {
            i: consistency_of(
                result,
                i,
                rest,
                [row for j, rows in laws.items() if j != i for row in rows],
                fits.get(tuple(j for j in ids if j != i)),
            )
            for i in ids
        }
        # A law that goes to its bound takes the shape of another one, and leaves no more than that one would.
        if config.of_bound and any(one.is_on_bound for one in each.values()):
            complete = 0.0
        genuine = {i: complete + (1.0 - complete) * one.genuine_chance(config) for i, one in each.items()}
        memo[ids] = dict(genuine)
        # Beside one that imitates, the others stand as they do without it, so far as the two cancel. A smaller set that
        # was not worth a fit says nothing for them.
        for j in ids:
            smaller, imitates = tuple(i for i in ids if i != j), 1.0 - genuine[j]
            without = genuine_probabilities(search, smaller, memo) if smaller in search.fits else {}
            for i in smaller:
                with_it, alone = memo[ids][i], without.get(i, 0.0)
                lost = imitates * each[i].cancelled * max(with_it - alone, 0.0)
                memo[ids][i] = max(with_it - lost, imitates * alone)
    return memo[ids]


def _verdict(search: Search, group: tuple[Fit, ...], quantified: Quantified) -> DiagnosisVerdict:
    best, base, model = search.best, search.base, search.model
    if search.unmodelled is not None:
        return "unknown"
    if not best.ids or not quantified.is_supported:
        is_sound = (
            model.is_clean(base) and noise_chance(base) > model.method.noise_test.chance and not model.is_uneven(base)
        )
        return "no_gap" if is_sound else "unknown"
    is_small = min(
        search.share(best), quantified.explained_fraction.held_out
    ) >= model.method.verdict.down_to_noise and search.is_explained(best)
    if model.is_uneven(best) or not (is_small or noise_chance(best) >= model.method.verdict.doubted_chance):
        return "unknown"
    return "ambiguous" if len(group) > 1 else "explained"
