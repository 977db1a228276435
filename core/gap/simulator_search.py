"""The search over the candidates of a simulator, from a base that was fitted from many starts."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from types import MappingProxyType

import numpy as np

from softcal.core.errors import InputError
from softcal.core.gap.case import Case
from softcal.core.gap.coordinates import from_fit
from softcal.core.gap.fit import Fit, fit
from softcal.core.gap.floor import noise_chance
from softcal.core.gap.linear import energy
from softcal.core.gap.method import METHOD
from softcal.core.gap.offsets import rows_of_runs
from softcal.core.gap.problem import Hypothesis, Problem
from softcal.core.gap.screen import Probe, Tangent
from softcal.core.gap.search import EffectSearch, Progress
from softcal.core.gap.shrink import held_out_error
from softcal.core.gap.simulator import Simulator
from softcal.core.gap.simulator_problem import SimulatorProblem, followed, rough_problem
from softcal.core.gap.start import best_start, likeliest, noise_levels, scattered
from softcal.core.twin.effects import Effect, Form
from softcal.core.twin.probes import Extent

DRAWS, FIRST_STEPS = 12, 6
"""Places over the bounds at which causes are tried, and steps from the likeliest of them."""


class SimulatorSearch(EffectSearch):
    """The search over a simulator's candidates: none is placed first, each has one realisation."""

    forms: Mapping[str, Sequence[Form]] = MappingProxyType({})

    def __init__(self, candidates: Sequence[Effect], base: Fit, say: Progress) -> None:
        runs = base.problem.case.runs
        duration_s = max(float(run.elapsed_s[-1]) for run in runs)
        extent = Extent(1.0, 1.0, 0.0, 1.0, duration_s, float(np.median(runs[0].step_s[1:])))
        self._candidates = candidates
        probes = tuple(Probe(c, row, c.is_one_sided) for c in candidates for row in c.probes(extent))
        super().__init__(base, probes, (), extent, METHOD.simulator_search, say)

    def noise_chance(self, found: Fit) -> float:
        return noise_chance(found, follows=followed)

    def is_clean(self, found: Fit) -> bool:
        return self.noise_chance(found) > METHOD.floor.chance

    def closest_set(self) -> Fit:
        """Return the smallest set whose error on samples held back is near the least: a few sets are tried."""
        every = list(self.fits.values())
        tried = {f.ids: f for f in (self.best, *sorted(every, key=lambda f: f.chi2)[: METHOD.verdict.most_tried])}
        for size in {len(f.ids) for f in every}:
            one = min((f for f in every if len(f.ids) == size), key=lambda f: f.chi2)
            tried[one.ids] = one
        errors = {ids: held_out_error(self.base, found) for ids, found in tried.items()}
        near = min(errors.values()) * (1.0 + METHOD.verdict.near_error)
        return tried[min((ids for ids, error in errors.items() if error <= near), key=lambda i: (len(i), errors[i]))]

    def _start_again(self) -> None:
        """Fit every cause and every pair from several starts where structure is left.

        A level never reached promises nothing to first order; two causes may gain only together.
        """
        if self.is_clean(self._leader):
            return
        self._say("trying every cause, and every two, from several starts")
        for effect in self._candidates:
            self._try((effect,))
        for pair in self._likely_pairs():
            if self.is_clean(self._leader):
                break
            self._try(pair)
        self._settle_noise()

    def _likely_pairs(self) -> list[tuple[Effect, ...]]:
        """Return the pairs that promise most to first order, over many places of each."""
        space, rows, owner = Tangent(self.base), [], []
        for k, effect in enumerate(self._candidates):
            for row in _rows(effect):
                signature = space.visible(space.signature(Probe(effect, row, effect.is_one_sided)))
                size = float(np.sqrt(energy(signature)))
                rows += [signature / size] if size > 0.0 else []
                owner += [k] if size > 0.0 else []
        alike = np.array(rows) @ np.array(rows).T if rows else np.zeros((0, 0))
        promised, of = np.array([float(row @ self.base.residual) for row in rows]), np.array(owner)
        gains: dict[tuple[Effect, ...], float] = {}
        for i, j in combinations(range(len(self._candidates)), 2):
            one, other = np.flatnonzero(of == i), np.flatnonzero(of == j)
            a, b, c = promised[one][:, None], promised[other][None, :], alike[np.ix_(one, other)]
            together = (a**2 + b**2 - 2.0 * a * b * c) / np.maximum(1.0 - c**2, 1e-6)
            gains[self._candidates[i], self._candidates[j]] = float(together.max(initial=0.0))
        return sorted(gains, key=lambda pair: -gains[pair])[: METHOD.search.most_pairs]

    def _try(self, effects: tuple[Effect, ...]) -> None:
        problem, hypothesis, fits = self.base.problem, self.base.hypothesis.adding(*effects), []
        for effect in effects:
            parent = self.fits.get(tuple(sorted(e.id for e in effects if e is not effect)))
            if parent is None:
                continue
            space = Tangent(parent)
            leads = [space.lead(Probe(effect, row, effect.is_one_sided)) for row in _rows(effect)]
            lead = max((one for one in leads if one is not None), key=lambda one: one.gain, default=None)
            if lead is not None:
                fits.append(fit(problem, parent.hypothesis.adding(effect), lead.start(parent), steps=FIRST_STEPS))
        drawn = scattered([p for effect in hypothesis.effects for p in effect.parameters], DRAWS)
        places = [np.append(self.base.coordinates, place) for place in drawn]
        likely = likeliest(problem, hypothesis, places)[0]
        best = min((*fits, fit(problem, hypothesis, likely, steps=FIRST_STEPS)), key=lambda found: found.chi2)
        # What is not better after a few steps than the best with one cause less is left there.
        parts = [f.chi2 for ids, f in self.fits.items() if set(ids) < set(best.ids)]
        if best.chi2 < min(parts) - METHOD.search.worth * max(self.base.chi2 - problem.count, 0.0):
            self.keep(fit(problem, best.hypothesis, best.coordinates, steps=60))


def _rows(effect: Effect) -> list[tuple[float, ...]]:
    places = scattered(effect.parameters, DRAWS)
    return [tuple(from_fit(p, float(x)) for p, x in zip(effect.parameters, place, strict=True)) for place in places]


def base_fit(simulator: Simulator, case: Case) -> Fit:
    """Fit the base parameters alone from several starts, with noise levels from the residual.

    Raises:
        InputError: the simulator fails wherever it is tried.
    """
    problem, hypothesis = rough_problem(simulator, case), Hypothesis(of_all=simulator.base)
    best = best_start(problem, hypothesis)
    if best.chi2 == np.inf:
        raise InputError(f"{problem.failures.first}; it fails at all {problem.failures.of} places that were tried")
    for _ in range(3):
        under = fit(best.problem.with_noise(noise_levels(best)), hypothesis, best.coordinates)
        best = fit(_shared_by_base(under), hypothesis, under.coordinates)
    return best


def _shared_by_base(found: Fit) -> Problem:
    """Leave to the base what all runs share of an offset, where the base can take its shape."""
    problem = found.problem
    if not isinstance(problem, SimulatorProblem) or not len(problem.largest_offsets):
        return problem
    bare = fit(problem.bare, found.hypothesis, found.coordinates, steps=0)
    rows = rows_of_runs(problem, problem.directions(found.hypothesis, found.coordinates, bare.predicted, {}))
    space = Tangent(bare)
    shared = [bare.problem.whitened(row) for row in np.sum(list(rows.values()), axis=0)]
    left = np.array([energy(space.visible(row)) for row in shared]) * problem.largest_offsets**2
    return replace(problem, of_base=tuple((left < METHOD.search.base_sigma**2) & np.any(shared, axis=1)))
