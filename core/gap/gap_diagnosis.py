"""What the diagnosis of the twin and that of another simulator judge, hold and report alike."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
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
from softcal.core.gap.problem import Problem
from softcal.core.gap.residual import Regime
from softcal.core.gap.search import EffectSearch
from softcal.core.gap.shrink import ChannelGap, Quantified, Shrink, gap_of_base, quantify, unsupported
from softcal.core.twin.effects import Effect
from softcal.core.unit.uncertainty import NORMAL_90
from softcal.core.words.reason import Reason, in_words, reason, several

CONFIG = METHOD.verdict

DiagnosisVerdict = Literal["no_gap", "explained", "ambiguous", "unknown", "data"]


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
        shrink: share of the gap that goes when it is added, of the explained whole.
        parameters: by the catalogue's equation; empty where it is not in the best hypothesis.
        form: the other equation that fits better, empty where the catalogue's does.
    """

    effect: str
    stage: str
    probability: float
    shrink: float
    parameters: dict[str, ParameterEstimate]
    form: str = ""


@dataclass(frozen=True)
class GapPlace:
    """One line of where the gap lies."""

    stage: str
    channel: str
    regime: Reason
    share: float
    detail: Reason

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


def judged(
    search: EffectSearch,
    effects: Iterable[str],
    say: Callable[[str], None],
    as_told: Callable[[Fit], Fit] = lambda found: found,
    is_uneven: Callable[[Fit], bool] = lambda _: False,
) -> tuple[tuple[Fit, ...], Quantified, DiagnosisVerdict, dict[str, float]]:
    """Return a search's best and rival hypotheses, the shrink held out, verdict, chances of effects.

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
    # Where nothing explains the gap the truth is most likely none of the effects.
    trust = 1.0 if quantified.stands or not best.ids else CONFIG.imitated_trust
    trust = CONFIG.unknown_trust * search.explained_share(best) if verdict == "unknown" else trust
    # Of a cause held open beside the best hypothesis the mean counts of two readings: every equation may be a little
    # wrong, or they hold exactly.
    larger = [f for f in group if set(f.ids) > set(best.ids)]
    exact = probabilities({f.ids: exact_log_evidence(f) for f in (best, *larger)}, effects)
    open_ = {i for f in larger for i in f.ids}.difference(best.ids)
    every = {i: 0.5 * (p + exact[i]) if i in open_ else p for i, p in probabilities(logs, effects).items()}
    chances = {i: p * trust * (CONFIG.imitated_trust if i in doubted else 1.0) for i, p in every.items()}
    return group, quantified, verdict, chances


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


def nearest(search: EffectSearch) -> Fit:
    """Return the simplest hypothesis that takes nearly the most of the gap away."""
    most = max(search.share(found) for found in search.fits.values())
    near = [found for found in search.fits.values() if search.share(found) >= most - CONFIG.near_share]
    return min(near, key=lambda found: (len(found.ids), found.chi2))


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

    @classmethod
    def stopped(cls, base: Fit, effects: Iterable[Effect], mistakes: tuple[DataMistake, ...], **own: Any) -> Self:
        """Return the diagnosis of mistaken recordings: nothing is named and nothing forecast."""
        return cls(
            verdict="data",
            base=base,
            best=base,
            causes=tuple(RankedCause(effect.id, effect.stage, 0.0, 0.0, {}) for effect in effects),
            gap=gap_of_base(base),
            next_experiment=NextExperiment("none", several([one.repair for one in mistakes])),
            mistakes=mistakes,
            **own,
        )

    @classmethod
    def of(cls, base: Fit, found: Fit, group: tuple[Fit, ...], quantified: Quantified, **own: Any) -> Self:
        """Return the diagnosis of a base and its rivals, with what follows from them alone."""
        return cls(
            base=base,
            gap=quantified.gap,
            shrink=quantified.shrink,
            protocol=quantified.protocol,
            chosen=quantified.chosen,
            ambiguous_with=confused_pairs(group),
            hidden_fraction={i: hidden_fraction(found, i) for i in found.ids},
            **own,
        )

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
        }


def places_of(
    causes: Sequence[RankedCause], channel: str, regime: Reason, detail: Callable[[str], Reason]
) -> list[GapPlace]:
    """Return the places of named causes, each with its part of what all of them take."""
    total = sum(c.shrink for c in causes) or 1.0
    return [GapPlace(c.stage, channel, regime, c.shrink / total, detail(c.effect)) for c in causes]


def regime_places(stage: str, seen: Sequence[Regime], code: str) -> list[GapPlace]:
    """Return the first four regimes in which the gap stands out as places at a stage."""
    return [GapPlace(stage, r.channel, r.name, r.share, reason(code, share=r.share, lift=r.lift)) for r in seen[:4]]


def partial_of(search: EffectSearch) -> Partial | None:
    """Return the causes that come nearest, and their share; None where none takes anything."""
    closest = nearest(search)
    share = search.explained_share(closest)
    return Partial(closest.ids, share) if closest.ids and share > 0.0 else None


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
    # The explained χ² is split among several causes: the mean of adding each first and last.
    worth = dict.fromkeys(ids, 1.0)
    for effect_id in ids if len(ids) > 1 else ():
        alone, rest = search.fits.get((effect_id,)), search.fits.get(tuple(i for i in ids if i != effect_id))
        first = search.base.chi2 - alone.chi2 if alone else 0.0
        last = rest.chi2 - best.chi2 if rest else 0.0
        worth[effect_id] = max(0.5 * (first + last), 0.0)
    total = sum(worth.values()) or 1.0
    forms = {e.id: form_of(e) for e in best.effects}

    def cause(effect: Effect) -> RankedCause:
        found = next((f for f in fits if effect.id in f.ids), search.fits.get((effect.id,)))
        parameters = estimates_of(found, effect.id) if found is not None else {}
        share = worth.get(effect.id, 0.0) / total * held_out
        return RankedCause(effect.id, effect.stage, chances[effect.id], share, parameters, forms.get(effect.id, ""))

    return tuple(sorted(map(cause, effects), key=lambda c: (-c.probability, -c.shrink)))
