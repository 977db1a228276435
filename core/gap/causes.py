"""How every cause stands in a report: size, share, place; and what is said where none explains the gap."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from softcal.core.gap.coordinates import from_fit
from softcal.core.gap.fit import Fit, Map, Regime, form_of
from softcal.core.twin.effects import Effect
from softcal.core.unit.uncertainty import NORMAL_90
from softcal.core.words.reason import Reason, in_words, reason

if TYPE_CHECKING:
    from softcal.core.gap.diagnosis import Judgement
    from softcal.core.gap.search import Search

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
class Where:
    """Where the gap lies: places, the regimes in which it stands out, and what relations fitted alone leave."""

    places: tuple[GapPlace, ...] = ()
    regimes: tuple[Regime, ...] = ()
    maps: tuple[Map, ...] = ()


@dataclass(frozen=True)
class Partial:
    """The causes that come nearest where nothing explains the gap, and their share of it."""

    effects: tuple[str, ...]
    share: float


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


def partial_of(search: "Search", judgement: "Judgement") -> Partial | None:
    """Return the set and its share of the gap where a rest is left; what comes nearest where no set stands."""
    if judgement.verdict not in ("unknown", "explained_in_part"):
        return None
    closest = judgement.best if judgement.best.ids else nearest(search)
    share = search.explained_share(closest)
    return Partial(closest.ids, share) if closest.ids and share > 0.0 else None


def nearest(search: "Search") -> Fit:
    """Return the simplest hypothesis that takes nearly the most of the gap away."""
    most = max(search.share(found) for found in search.fits.values())
    fits = list(search.fits.values())
    enough = most - fits[0].problem.method.verdict.near_share
    near = [found for found in fits if search.share(found) >= enough]
    return min(near, key=lambda found: (len(found.ids), found.chi2))


def ranked_causes(
    search: "Search",
    best: Fit,
    effects: Sequence[Effect],
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
    forms = {e.id: form_of(best, e) for e in best.effects}

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
