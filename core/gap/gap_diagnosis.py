"""What the diagnosis of the twin and that of another simulator judge, hold and report alike."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Generic, Literal, Self, TypeVar

import numpy as np

from softcal.core.gap.case import Case
from softcal.core.gap.coordinates import from_fit
from softcal.core.gap.data_mistake import DataMistake
from softcal.core.gap.empirical import LearnedResidual, T
from softcal.core.gap.explained import form_of
from softcal.core.gap.fit import Fit
from softcal.core.gap.floor import coloured
from softcal.core.gap.identifiability import Identifiability
from softcal.core.gap.method import METHOD
from softcal.core.gap.next_experiment import NextExperiment
from softcal.core.gap.posterior import (
    confused_pairs,
    exact_log_evidence,
    hidden_fraction,
    log_evidences,
    probabilities,
    rivals,
)
from softcal.core.gap.presence import consistency_of, list_completeness, rest_energy
from softcal.core.gap.problem import Problem
from softcal.core.gap.residual import Regime
from softcal.core.gap.search import EffectSearch
from softcal.core.gap.shrink import ChannelGap, Quantified, Shrink, gap_of_base, quantify, unsupported
from softcal.core.twin.effects import Effect
from softcal.core.unit.uncertainty import NORMAL_90
from softcal.core.words.reason import Reason, in_words, reason, several

CONFIG = METHOD.verdict

DiagnosisVerdict = Literal["no_gap", "explained", "explained_in_part", "ambiguous", "unknown", "data"]


@dataclass(frozen=True)
class ParameterEstimate:
    """A fitted parameter of an effect with its 90 % interval."""

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class RankedCause:
    """One effect of the catalogue and how it stands.

    Args:
        shrink: share of the gap that goes with it, of what the set takes; None where it is not in the set.
        parameters: by the catalogue's equation; empty where no hypothesis has it.
        form: the other equation that fits better, empty where the catalogue's does.
        alone, added: share of the gap that goes with it alone, and that comes back without it; None where not fitted.
    """

    effect: str
    stage: str
    probability: float
    shrink: float | None
    parameters: dict[str, ParameterEstimate]
    form: str = ""
    alone: float | None = None
    added: float | None = None


@dataclass(frozen=True)
class GapPlace:
    """One line of where the gap lies."""

    stage: str
    channel: str
    regime: Reason
    share: float
    detail: Reason = Reason("gap.map.none")

    def record(self) -> dict[str, object]:
        return in_words(vars(self), "regime", "detail")


@dataclass(frozen=True)
class Partial:
    """The causes that come nearest where nothing explains the gap, and their share of it."""

    effects: tuple[str, ...]
    share: float


def on_unseen(group: tuple[Fit, ...], gone: set[str]) -> tuple[tuple[Fit, ...], set[str]]:
    """Return rivals but those that add a cause that lowers nothing on unseen samples; and these causes."""
    best, in_play, idle = group[0], [group[0]], set()
    for other in group[1:]:
        added = set(other.ids) - set(best.ids)
        # Another form of a cause may hold what a second one is: nothing is left for that to lower.
        is_larger = set(best.ids) < set(other.ids) and not any(map(form_of, best.effects))
        if is_larger and (added & gone or (len(added) == 1 and unsupported(other, dict.fromkeys(added, best)))):
            idle |= added
        else:
            in_play.append(other)
    return tuple(in_play), idle


@dataclass(frozen=True)
class Judgement:
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


def judged(
    search: EffectSearch,
    effects: Iterable[str],
    say: Callable[[str], None],
    as_told: Callable[[Fit], Fit] = lambda found: found,
    is_uneven: Callable[[Fit], bool] = lambda _: False,
) -> Judgement:
    """Return the set of causes of a search, the shrink held out, verdict, and chances of effects.

    Args:
        as_told: the best hypothesis as it is handed on.
        is_uneven: whether noise that a hypothesis leaves is not the same everywhere.
    """
    say("holding back samples from every cause")
    # Causes that lower nothing on unseen samples are taken out of the best hypothesis.
    gone: set[str] = set()
    while len(search.best.ids) > 1:
        rest = search.one_less(search.best)
        idle = unsupported(search.best, rest)
        if not idle:
            break
        gone.add(idle[0])
        search.best = rest[idle[0]]
    logs, best = log_evidences(search.fits), search.best
    group, added = on_unseen(rivals(search.fits, best, logs, tuple(search.held_open.values())), gone)
    doubted = gone | added | set(search.held_open)
    say("measuring the shrink on samples no fit has seen")
    quantified = quantify(search.base, as_told(best), search.fits.values())
    verdict = _verdict(search, group, quantified, is_uneven)
    every = _presence(search, logs, effects, is_uneven)
    # Of a cause held open beside the best hypothesis the mean counts of two readings: every equation may be a little
    # wrong, or they hold exactly.
    larger = [f for f in group if set(f.ids) > set(best.ids)]
    exact = probabilities({f.ids: exact_log_evidence(f) for f in (best, *larger)}, effects)
    open_ = {i for f in larger for i in f.ids}.difference(best.ids)
    every = {i: 0.5 * (p + exact[i]) if i in open_ else p for i, p in every.items()}
    trust = dict.fromkeys(effects if best.ids and not quantified.stands else doubted, CONFIG.imitated_trust)
    chances = {i: p * trust.get(i, 1.0) for i, p in every.items()}
    if verdict == "unknown" and search.stranger is None:
        if quantified.stands and any(chances[i] >= METHOD.presence.certain for i in best.ids):
            verdict = "explained_in_part"
        elif (best := search.closest_set()) is not search.best:
            group, quantified = (best,), quantify(search.base, as_told(best), is_given=True)
    if best.ids and not quantified.stands:
        best, group, quantified = search.base, (search.base,), quantify(search.base, search.base)
    search.best = best
    return Judgement(best, group, quantified, verdict, chances, _completeness(search, best, is_uneven))


def _completeness(search: EffectSearch, found: Fit, is_uneven: Callable[[Fit], bool]) -> float:
    has_unlisted = search.stranger is not None or is_uneven(found)
    gap, chance = max(search.base.chi2 - search.base.problem.count, 1.0), search.noise_chance(found)
    rest = min(rest_energy(found, chance) / gap, 1.0) if found.ids else 1.0
    return list_completeness(chance, rest, has_unlisted)


def _presence(
    search: EffectSearch,
    logs: Mapping[tuple[str, ...], float],
    effects: Iterable[str],
    is_uneven: Callable[[Fit], bool],
) -> dict[str, float]:
    """Return for every effect the probability that it is there, an unmodelled rest or not.

    Every hypothesis counts by its evidence. In one that leaves a rest a cause may be what imitates a part of it.
    """
    top = max(logs.values())
    weights = {ids: float(np.exp(value - top)) for ids, value in logs.items()}
    total, chances = sum(weights.values()), dict.fromkeys(effects, 0.0)
    for ids, weight in weights.items():
        if ids and weight > METHOD.presence.negligible * total:
            found = search.fits[ids]
            complete, rest = _completeness(search, found, is_uneven), rest_energy(found, search.noise_chance(found))
            for i in ids:
                genuine = consistency_of(found, i, rest).genuine_chance
                chances[i] += weight / total * (complete + (1.0 - complete) * genuine)
    return chances


S = TypeVar("S", bound=EffectSearch)


def under_its_floor(
    search: S, searched: Callable[[Problem], S], is_floor: Callable[[Fit], bool], say: Callable[[str], None]
) -> S:
    """Search once more under noise that fades; keep that only where what is left is shown to be noise."""
    problem = coloured(search.closest)
    if problem is None:
        return search
    say("searching once more under noise that fades")
    again = searched(problem)
    again.run()
    return again if again.stranger is None and again.is_clean(again.best) and is_floor(again.best) else search


def _verdict(
    search: EffectSearch, group: tuple[Fit, ...], quantified: Quantified, is_uneven: Callable[[Fit], bool]
) -> DiagnosisVerdict:
    best, base = search.best, search.base
    if search.stranger is not None:
        return "unknown"
    if not best.ids or not quantified.stands:
        is_sound = search.is_clean(base) and search.noise_chance(base) > METHOD.floor.chance and not is_uneven(base)
        return "no_gap" if is_sound else "unknown"
    is_small = min(search.share(best), quantified.shrink.held_out) >= CONFIG.down_to_noise and search.is_explained(best)
    if is_uneven(best) or not (is_small or search.noise_chance(best) >= CONFIG.doubted_chance):
        return "unknown"
    return "ambiguous" if len(group) > 1 else "explained"


def estimates_of(found: Fit, effect_id: str) -> dict[str, ParameterEstimate]:
    """Return value and 90 % interval of an effect's parameters; none where the fit lacks it."""
    effect = next((e for e in found.effects if e.id == effect_id), None)
    if effect is None:
        return {}
    at, out = found.hypothesis.slices[effect_id], {}
    margins = NORMAL_90 * np.sqrt(np.maximum(np.diag(found.covariance), 0.0))[at]
    for parameter, x, margin in zip(effect.parameters, found.coordinates[at], margins, strict=True):
        p = found.problem.scale.sized(parameter)
        ends = sorted(from_fit(p, float(x + side * margin)) for side in (-1.0, 1.0))
        three = (from_fit(p, float(x)), *ends)
        value, low, high = (float(np.nan_to_num(v, posinf=p.high, neginf=p.low)) for v in three)
        out[p.name] = ParameterEstimate(value, low, high, p.unit)
    return out


def bounds_reached(found: Fit) -> dict[str, float]:
    """Return the parameters that a fit left on a bound, with values; a cause's as `cause.parameter`.

    A bound that switches a cause off is none.
    """
    base, rows = found.hypothesis.split(found.coordinates)
    free = [p for p, is_free in zip(found.hypothesis.of_all, found.problem.is_free, strict=True) if is_free]
    pairs = [(p.name, p, v) for p, v in zip(found.hypothesis.of_all, base, strict=True) if p in free]
    for effect, values in zip(found.effects, rows, strict=True):
        pairs += [(f"{effect.id}.{p.name}", p, v) for p, v in zip(effect.parameters, values, strict=True)]
    reached = {}
    for name, parameter, value in pairs:
        own = found.problem.scale.sized(parameter)
        ends = [end for end in (own.low, own.high) if np.isfinite(end) and end != own.neutral and not own.is_fixed]
        if any(math.isclose(value, end, rel_tol=1e-6, abs_tol=1e-9 * abs(own.usual)) for end in ends):
            reached[name] = value
    return reached


SCHEMA = "softcal.gap/1"

NOT_MEASURED = "not measured: the recordings hold a mistake"


@dataclass(frozen=True, eq=False, kw_only=True)
class GapDiagnosis(Generic[T]):
    """Everything a report or a page needs; with the verdict `data` only what has no default.

    Args:
        chosen: causes that are chosen where each part of the samples in turn is held back.
        explained_share: of the structured gap energy, 1 when nothing but noise is left.
        mistakes: in the recordings; with another verdict than `data` they are questions.
        residual: empirical terms for what no named cause explains, if they hold on runs held back.
        told: what the runs tell of the base and of every effect; None where there is a mistake.
        list_complete: probability that nothing unmodelled is left.
    """

    verdict: DiagnosisVerdict
    base: Fit
    best: Fit
    causes: tuple[RankedCause, ...]
    gap: dict[str, ChannelGap]
    next_experiment: NextExperiment
    places: tuple[GapPlace, ...] = ()
    shrink: Shrink = Shrink(0.0, 0.0, 0.0, 0.0)
    protocol: str = NOT_MEASURED
    chosen: tuple[tuple[str, ...], ...] = ()
    ambiguous_with: list[list[str]] = field(default_factory=list)
    hidden_fraction: dict[str, float] = field(default_factory=dict)
    explained_share: float = 0.0
    mistakes: tuple[DataMistake, ...] = ()
    partial: Partial | None = None
    residual: LearnedResidual[T] | None = None
    told: Identifiability | None = None
    list_complete: float = 0.0

    @classmethod
    def stopped(cls, base: Fit, effects: Iterable[Effect], mistakes: tuple[DataMistake, ...], **own: Any) -> Self:
        """Return the diagnosis of mistaken recordings: nothing is named and nothing forecast."""
        return cls(
            verdict="data",
            base=base,
            best=base,
            causes=tuple(RankedCause(effect.id, effect.stage, 0.0, None, {}) for effect in effects),
            gap=gap_of_base(base),
            next_experiment=NextExperiment("none", several([one.repair for one in mistakes])),
            mistakes=mistakes,
            **own,
        )

    @classmethod
    def of(cls, base: Fit, judgement: Judgement, **own: Any) -> Self:
        """Return the diagnosis of a base and its judgement, with what follows from them alone."""
        found, quantified = judgement.group[0], judgement.quantified
        return cls(
            base=base,
            verdict=judgement.verdict,
            gap=quantified.gap,
            shrink=quantified.shrink,
            protocol=quantified.protocol,
            chosen=quantified.chosen,
            ambiguous_with=confused_pairs(judgement.group),
            hidden_fraction={i: hidden_fraction(found, i) for i in found.ids},
            list_complete=judgement.list_complete,
            **own,
        )

    @property
    def on_bound(self) -> dict[str, float]:
        """Parameters of base and causes left on a bound, with values: often the recordings are to blame."""
        return bounds_reached(self.best)

    @property
    def case(self) -> Case:
        """The recordings."""
        return self.base.problem.case

    def report(self) -> dict[str, object]:
        """Return what every report has, ready for JSON."""
        return {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "serial": self.case.serial,
            "data": [found.record() for found in self.mistakes],
            "gap": {channel: vars(gap) for channel, gap in self.gap.items()},
            "shrink": vars(self.shrink) | {"protocol": self.protocol, "chosen": [list(ids) for ids in self.chosen]},
            "where": [place.record() for place in self.places],
            "causes": [
                vars(c) | {"form": c.form or None, "parameters": {name: vars(p) for name, p in c.parameters.items()}}
                for c in self.causes
            ],
            "ambiguous_with": self.ambiguous_with,
            "hidden_fraction": self.hidden_fraction,
            "identifiability": None if self.told is None else self.told.record(),
            "next_experiment": self.next_experiment.record(),
            "explained_share": self.explained_share,
            "partial": None if self.partial is None else vars(self.partial) | {"effects": list(self.partial.effects)},
            "residual": None if self.residual is None else self.residual.record(),
            "list_complete": self.list_complete,
            "on_bound": self.on_bound,
        }


def places_of(
    causes: Sequence[RankedCause], channel: str, regime: Reason, detail: Callable[[str], Reason]
) -> list[GapPlace]:
    """Return the places of named causes, each with its part of what all of them take."""
    total = sum(c.shrink or 0.0 for c in causes) or 1.0
    return [GapPlace(c.stage, channel, regime, (c.shrink or 0.0) / total, detail(c.effect)) for c in causes]


def beside_rest(places: Sequence[GapPlace], rest: GapPlace) -> list[GapPlace]:
    """Return the places of causes, scaled by what they take, with the place of a rest."""
    rest = replace(rest, detail=reason("gap.seen.rest", share=rest.share))
    return [*(replace(place, share=(1.0 - rest.share) * place.share) for place in places), rest]


def regime_places(stage: str, seen: Sequence[Regime], code: str) -> list[GapPlace]:
    """Return the first four regimes in which the gap stands out as places at a stage."""
    return [GapPlace(stage, r.channel, r.name, r.share, reason(code, share=r.share, lift=r.lift)) for r in seen[:4]]


def partial_of(search: EffectSearch, judgement: Judgement) -> Partial | None:
    """Return the set and its share of the gap where a rest is left; what comes nearest where no set stands."""
    if judgement.verdict not in ("unknown", "explained_in_part"):
        return None
    closest = judgement.best if judgement.best.ids else nearest(search)
    share = search.explained_share(closest)
    return Partial(closest.ids, share) if closest.ids and share > 0.0 else None


def nearest(search: EffectSearch) -> Fit:
    """Return the simplest hypothesis that takes nearly the most of the gap away."""
    most = max(search.share(found) for found in search.fits.values())
    near = [found for found in search.fits.values() if search.share(found) >= most - CONFIG.near_share]
    return min(near, key=lambda found: (len(found.ids), found.chi2))


def ranked_causes(
    search: EffectSearch,
    best: Fit,
    effects: Iterable[Effect],
    fits: tuple[Fit, ...],
    chances: dict[str, float],
    held_out: float,
) -> tuple[RankedCause, ...]:
    """Return every effect with how it stands, the likeliest first.

    Args:
        fits: where parameters are taken from, the first that has them; else from the effect alone.
        held_out: share of the gap that goes on samples held back, split among the best causes.
    """
    ids = best.ids
    excess = max(search.base.chi2 - search.base.problem.count, 0.0)
    one_less = {i: search.fits.get(tuple(j for j in ids if j != i)) for i in ids}
    # The explained χ² is split among several causes: the mean of adding each first and last.
    worth = dict.fromkeys(ids, 1.0)
    for effect_id in ids if len(ids) > 1 else ():
        alone, rest = search.fits.get((effect_id,)), one_less[effect_id]
        first = search.base.chi2 - alone.chi2 if alone else 0.0
        last = rest.chi2 - best.chi2 if rest else 0.0
        worth[effect_id] = max(0.5 * (first + last), 0.0)
    total = sum(worth.values()) or 1.0
    forms = {e.id: form_of(e) for e in best.effects}

    def share_of(better: Fit | None, worse: Fit | None) -> float | None:
        if better is None or worse is None or excess <= 0.0:
            return None
        return float(np.clip((worse.chi2 - better.chi2) / excess, 0.0, 1.0))

    def cause(effect: Effect) -> RankedCause:
        found = next((f for f in fits if effect.id in f.ids), search.fits.get((effect.id,)))
        return RankedCause(
            effect.id,
            effect.stage,
            chances[effect.id],
            worth[effect.id] / total * held_out if effect.id in worth else None,
            estimates_of(found, effect.id) if found is not None else {},
            forms.get(effect.id, ""),
            alone=share_of(search.fits.get((effect.id,)), search.base),
            added=share_of(best, one_less.get(effect.id)),
        )

    return tuple(sorted(map(cause, effects), key=lambda c: (-c.probability, -(c.shrink or 0.0))))
