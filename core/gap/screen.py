"""Which effects are worth a full fit, and where fits begin: score tests of every probe, and starts over the bounds."""

from collections.abc import Sequence
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from softcal.core.gap.coordinates import fit_scale, from_fit, to_fit
from softcal.core.gap.fit import Fit, Lead, Probe, Tangent, fit
from softcal.core.gap.linear import energy
from softcal.core.gap.problem import Hypothesis, Problem
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Parameter

if TYPE_CHECKING:
    from softcal.core.gap.search import Search

DRAWS, FIRST_STEPS = 12, 6
"""Places over the bounds at which causes are tried, and steps from the likeliest of them."""

GENTLER = (0.1, 0.003)
"""Shares of a promised size from which a fit begins once more."""

KEPT_PART = 0.1
"""Share of the promised drop of χ² that a fit must bring, or it begins once more."""


def joined(parent: Fit, lead: Lead, steps: int = 20) -> Fit:
    """Fit an effect jointly with its parent, from other starts too where the first leads nowhere.

    A step along the slopes ends far off where the surface bends; an effect nearly off can only gain.
    """
    hypothesis = parent.hypothesis.adding(lead.effect)
    best = fit(parent.problem, hypothesis, lead.start(parent), steps=steps)
    for share in GENTLER:
        if best.chi2 < parent.chi2 - KEPT_PART * lead.gain:
            break
        again = fit(parent.problem, hypothesis, lead.start(parent, share), steps=2 * steps)
        best = min(best, again, key=lambda found: found.chi2)
    return best


def screen(found: Fit, candidates: Sequence[Probe]) -> list[Lead]:
    """Return the best lead of every effect that is not in the fit yet, best first.

    Of the change that a probe makes only what the fitted parameters cannot imitate counts (Rao's score
    test).
    """
    space = Tangent(found)
    best: dict[str, Lead] = {}
    for probe in candidates:
        if probe.effect.id in found.ids:
            continue
        lead = space.lead(probe)
        if lead is not None and (probe.effect.id not in best or lead.gain > best[probe.effect.id].gain):
            best[probe.effect.id] = lead
    return sorted(best.values(), key=lambda lead: -lead.gain)


def hiding(found: Fit, candidates: Sequence[Probe], share: float) -> list[Probe]:
    """Return the last probe of every effect that the fitted parameters imitate to this share."""
    space = Tangent(found)
    last: dict[str, Probe] = {}
    for probe in candidates:
        if probe.effect.id in found.ids:
            continue
        signature = space.signature(probe)
        size = energy(signature)
        if size > 0.0 and energy(space.visible(signature)) < (1.0 - share) * size:
            last[probe.effect.id] = probe
    return list(last.values())


def scattered(parameters: Sequence[Parameter], count: int) -> Array:
    """Return (count, parameters) coordinates within bounds: the usual values, then near and far.

    A value that may be far off in either direction is drawn by its order of magnitude.
    """
    rng = np.random.default_rng(1)
    out = np.empty((count, len(parameters)))
    for k, p in enumerate(parameters):
        usual, scale = to_fit(p, p.usual), fit_scale(p)
        low, high = sorted((to_fit(p, p.low), to_fit(p, p.high)))
        near = usual + 0.5 * scale * rng.normal(size=count)
        if p.scale == "log":
            far = rng.uniform(max(low, usual - 4.0), min(high, usual + 4.0), count)
        elif high - low > 30.0 * scale:
            side = np.where(rng.random(count) < 0.5, -1.0, 1.0) if low < 0.0 < high else np.sign(usual or 1.0)
            far = side * scale * 10.0 ** rng.uniform(-1.5, 1.5, count)
        else:
            far = rng.uniform(low, high, count)
        out[:, k] = np.clip(np.where(rng.random(count) < 0.5, near, far), low, high)
        out[0, k] = usual
    return out


def best_start(problem: Problem, hypothesis: Hypothesis, scattering: int = 32, tried: int = 5, steps: int = 60) -> Fit:
    """Return the best minimum found from starts all over the bounds.

    Args:
        scattering: places at which the prediction is made once.
        tried: of these, those from which a fit takes a few steps, besides the usual values.
        steps: most steps from the best two of them.
    """
    usual, *others = scattered(hypothesis.parameters, scattering)
    places = [usual, *likeliest(problem, hypothesis, others)[:tried]]
    rough = sorted((fit(problem, hypothesis, place, steps=6) for place in places), key=lambda f: f.chi2)
    fits = [fit(problem, hypothesis, found.coordinates, steps=steps) for found in rough[:2]]
    return min(fits, key=lambda found: found.chi2)


def likeliest(problem: Problem, hypothesis: Hypothesis, places: Sequence[Array]) -> list[Array]:
    """Return places in the order of what a prediction at each leaves; those without one last."""

    def left(place: Array) -> float:
        cost = energy(problem.whitened(problem.measured - problem.predict(hypothesis, place)))
        return cost if np.isfinite(cost) else np.inf

    return sorted(places, key=left)


def likely_pairs(base: Fit, candidates: Sequence[Effect]) -> list[tuple[Effect, ...]]:
    """Return the pairs that promise most to first order, over many places of each."""
    space, rows, owner = Tangent(base), [], []
    for k, effect in enumerate(candidates):
        for row in rows_over_bounds(effect):
            signature = space.visible(space.signature(Probe(effect, row, effect.is_one_sided)))
            size = float(np.sqrt(energy(signature)))
            rows += [signature / size] if size > 0.0 else []
            owner += [k] if size > 0.0 else []
    alike = np.array(rows) @ np.array(rows).T if rows else np.zeros((0, 0))
    promised, of = np.array([float(row @ base.residual) for row in rows]), np.array(owner)
    gains: dict[tuple[Effect, ...], float] = {}
    for i, j in combinations(range(len(candidates)), 2):
        one, other = np.flatnonzero(of == i), np.flatnonzero(of == j)
        a, b, c = promised[one][:, None], promised[other][None, :], alike[np.ix_(one, other)]
        together = (a**2 + b**2 - 2.0 * a * b * c) / np.maximum(1.0 - c**2, 1e-6)
        gains[candidates[i], candidates[j]] = float(together.max(initial=0.0))
    return sorted(gains, key=lambda pair: -gains[pair])[: base.problem.method.search.most_pairs]


def rows_over_bounds(effect: Effect) -> list[tuple[float, ...]]:
    """Return values of an effect all over its bounds, the usual ones first."""
    places = scattered(effect.parameters, DRAWS)
    return [tuple(from_fit(p, float(x)) for p, x in zip(effect.parameters, place, strict=True)) for place in places]


def try_from_many_starts(search: "Search", effects: tuple[Effect, ...]) -> None:
    """Fit effects jointly from several starts, and keep what is worth it."""
    problem, hypothesis, fits = search.base.problem, search.base.hypothesis.adding(*effects), []
    for effect in effects:
        parent = search.fits.get(tuple(sorted(e.id for e in effects if e is not effect)))
        if parent is None:
            continue
        space = Tangent(parent)
        leads = [space.lead(Probe(effect, row, effect.is_one_sided)) for row in rows_over_bounds(effect)]
        lead = max((one for one in leads if one is not None), key=lambda one: one.gain, default=None)
        if lead is not None:
            fits.append(fit(problem, parent.hypothesis.adding(effect), lead.start(parent), steps=FIRST_STEPS))
    drawn = scattered([p for effect in hypothesis.effects for p in effect.parameters], DRAWS)
    places = [np.append(search.base.coordinates, place) for place in drawn]
    likely = likeliest(problem, hypothesis, places)[0]
    best = min((*fits, fit(problem, hypothesis, likely, steps=FIRST_STEPS)), key=lambda found: found.chi2)
    # What is not better after a few steps than the best with one cause less is left there.
    parts = [f.chi2 for ids, f in search.fits.items() if set(ids) < set(best.ids)]
    if best.chi2 < min(parts) - problem.method.search.worth * max(search.base.chi2 - problem.count, 0.0):
        search.keep(fit(problem, best.hypothesis, best.coordinates, steps=60))
