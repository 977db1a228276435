"""Which hypotheses are fitted: forward from the base, a few of the best at every size.

Score tests say which effects are worth a full fit; fits begin all over the bounds. Departures of another kind
are fitted beside them: where one wins, nothing in the list explains the gap.

What the equation of one cause leaves on a rig often looks like a second cause. So every further one
is held against a free form of those beside it: other sizes and shapes, all mixed, and a size that
changes with load and time. Where that explains nearly as much, these runs do not tell the two.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from softcal.core.gap.episodes import PLACERS, relocate_episodes
from softcal.core.gap.fit import Candidate, Tangent, Yardstick, fit, leader_of, log_evidences, one_less, share_of_gap
from softcal.core.gap.hypothesis import Probe, from_fit, start_coordinates, to_fit
from softcal.core.gap.linear import energy, projected
from softcal.core.gap.model import Fit
from softcal.core.gap.residual import is_noise, noise_of, with_correlated_noise, with_driving_noise
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Form, SearchTarget

GENTLER = (0.1, 0.003)
"""Shares of a promised size from which a fit begins once more."""

MIN_GAIN_SHARE = 0.1
"""Share of the promised drop of χ² that a fit must bring, or it begins once more."""


def fit_jointly(parent: Fit, candidate: Candidate, steps: int = 20) -> Fit:
    """Fit an effect jointly with its parent, from other starts too where the first leads nowhere.

    A step along the slopes ends far off where the surface bends; an effect nearly off can only gain.
    """
    hypothesis = parent.hypothesis.adding(candidate.effect)
    best = fit(parent.problem, hypothesis, candidate.start(parent), steps=steps)
    for share in GENTLER:
        if best.chi2 < parent.chi2 - MIN_GAIN_SHARE * candidate.gain:
            break
        again = fit(parent.problem, hypothesis, candidate.start(parent, share), steps=2 * steps)
        best = min(best, again, key=lambda result: result.chi2)
    return best


def screen(result: Fit, candidates: Sequence[Probe]) -> list[Candidate]:
    """Return the best lead of every effect that is not in the fit yet, best first.

    Of the change that a probe makes only what the fitted parameters cannot imitate counts (Rao's score
    test).
    """
    space = Tangent(result)
    best: dict[str, Candidate] = {}
    candidates = [probe for probe in candidates if probe.effect.id not in result.ids]
    result.problem.model.prepare(result.problem, [space.extended_start(probe) for probe in candidates])
    for probe in candidates:
        candidate = space.score_candidate(probe)
        if candidate is not None and (probe.effect.id not in best or candidate.gain > best[probe.effect.id].gain):
            best[probe.effect.id] = candidate
    return sorted(best.values(), key=lambda candidate: -candidate.gain)


def find_hidden_probes(result: Fit, candidates: Sequence[Probe], share: float) -> list[Probe]:
    """Return the last probe of every effect that the fitted parameters imitate to this share."""
    space = Tangent(result)
    last: dict[str, Probe] = {}
    for probe in candidates:
        if probe.effect.id in result.ids:
            continue
        signature = space.signature(probe)
        size = energy(signature)
        if size > 0.0 and energy(space.visible(signature)) < (1.0 - share) * size:
            last[probe.effect.id] = probe
    return list(last.values())


Progress = Callable[[str], None]


class Search:
    """All hypotheses fitted to one case, under one noise level."""

    def __init__(self, base: Fit, candidates: Sequence[Effect], on_progress: Progress = lambda _: None) -> None:
        self.model, self.candidates, self.on_progress = base.problem.model, candidates, on_progress
        self._config = self.model.method.search
        self._probes = self.model.probes(base, candidates)
        self._episodic = [effect for effect in candidates if effect.signs.search_target is not None]
        self.start = self.base = self.best = base
        self.fits: dict[tuple[str, ...], Fit] = {(): base}
        self.unmodelled: Fit | None = None
        self.not_excluded: dict[str, Fit] = {}
        """Causes that another equation of those beside them explains as well, with fits."""

    @cached_property
    def laws(self) -> Mapping[str, Sequence[Array]]:
        """By candidate, (samples,) what it does to the base under every shape that was tried."""
        return self.model.laws(self.base) if self.model.method.presence.of_bent else {}

    def run(self) -> None:
        """Grow the hypotheses until no effect promises anything more."""
        parents = [self.base]
        for size, max_candidates in enumerate(self._config.candidates, start=1):
            self.on_progress(f"fitting {size} effect{'s' if size > 1 else ''} jointly with the base")
            grown = [child for parent in parents for child in self._grow(parent, max_candidates)]
            if not grown:
                break
            if size > 1:
                # Episodes of the best hypotheses are placed anew, with all their causes in.
                for result in sorted(self.fits.values(), key=lambda f: f.bic)[:4]:
                    if result.hypothesis.episode_count and not self.model.is_clean(result):
                        self.store(relocate_episodes(result))
            self.settle_noise()
            if size == len(self._config.candidates):
                break
            leader = leader_of(self.fits)
            is_promising = any(candidate.gain > self._config.gain for candidate in screen(leader, self._probes)[:1])
            # What promises nothing to first order must be placed to know.
            if not is_promising and not any(child.bic < leader.bic for child in self._grow_episodic(leader)):
                break
            ranked = sorted((f for f in self.fits.values() if len(f.ids) == size), key=lambda f: f.bic)
            # Several are grown on: the right pair often begins with the second-best single cause.
            parents = ranked[: self._config.beam[size - 1]]
        if not self.model.is_clean(leader_of(self.fits)):
            self.on_progress("fitting the likeliest causes from other starts")
            self.model.start_again(self.base, self.candidates, self.fits, self.store)
            self.settle_noise()
        # Smaller hypotheses get the episodes that the closest one has: places are no cause.
        donor = self.closest
        episodic_ids = {e.id for e in donor.effects if e.is_episodic}
        for ids, result in list(self.fits.items()) if donor.hypothesis.episode_count else ():
            if set(ids) < set(donor.ids) and episodic_ids <= set(ids):
                hypothesis = replace(result.hypothesis, episodes=donor.hypothesis.episodes)
                self.store(fit(result.problem, hypothesis, result.coordinates))
        self._conclude()

    def _conclude(self) -> None:
        """Choose among the catalogue's equations and other realisations of the likely causes."""
        self.on_progress("fitting other realisations of the likely causes")
        self.best = self._max_likelihood_fit
        is_settled = len(self.best.ids) < 2 and self.model.is_clean(self.best)
        share = self._config.likely_clean if is_settled else self._config.likely
        singles = sorted((f for ids, f in self.fits.items() if len(ids) == 1), key=lambda f: f.bic)
        likely = [f for f in singles if self.share(f) > share * self.share(singles[0])] if singles else []
        for result in likely[: self._config.with_forms]:
            for form in self.model.forms_of(result.ids[0]):
                self.store(self._in_form(result, form))
        self.settle_noise()
        self.best = self._max_likelihood_fit
        for _ in range(2):
            before = self.best
            # One cause in another form, another left out: that may be what the equation leaves.
            for smaller in one_less(self.fits, before).values():
                for cause in smaller.ids if len(smaller.ids) > 1 else ():
                    for form in self.model.forms_of(cause):
                        self.store(self._in_form(smaller, form))
            if self._max_likelihood_fit.ids == before.ids:
                break
            self.best = self._max_likelihood_fit
        self._test_further_effects()
        # A departure outside the list stands alone or in the place of a cause.
        parents = one_less(self.fits, self.best).values() if len(self.best.ids) > 1 else ()
        self.unmodelled = best_unmodelled(self.best, [self.base, *parents], list(self.fits.values()))

    def store_not_excluded(self) -> None:
        """Take causes that a free form of the others imitates out of the best; they stay in play."""
        while len(self.best.ids) > 1:
            smaller = {i: result for i, result in one_less(self.fits, self.best).items() if self.is_explained(result)}
            with_surrogate = causes_with_surrogate(self.best, smaller)
            if not with_surrogate:
                break
            self.not_excluded[with_surrogate[0]] = self.best
            self.best = smaller[with_surrogate[0]]
        # Beside what is left, not beside one another.
        for effect_id, larger in self.not_excluded.items():
            alone = tuple(sorted({*self.best.ids, effect_id}))
            self.not_excluded[effect_id] = self.fits.get(alone, larger)

    def _test_further_effects(self) -> None:
        """Fit what may stand beside the best hypothesis: small or hidden effects."""
        for _ in range(3):
            parent = self.best
            if not parent.ids:
                return
            larger = [
                fit_jointly(parent, candidate, steps=40)
                for candidate in screen(parent, self._probes)
                if candidate.gain > self._config.added_gain or candidate.hidden > self._config.hiding
            ]
            for result in larger:
                self.store(result)
            if larger:
                # What a larger fit gains may be a better minimum of the smaller one.
                # A better base found beside a larger hypothesis serves the smaller one as well.
                closest = min(larger, key=lambda result: result.chi2)
                self.store(fit(parent.problem, parent.hypothesis, closest.coordinates[: len(parent.coordinates)]))
            # Effects that hide promise little: they are fitted in the place of each cause.
            for rest in one_less(self.fits, parent).values():
                for probe in find_hidden_probes(rest, self._probes, self._config.hiding) if rest.ids else ():
                    if tuple(sorted({*rest.ids, probe.effect.id})) not in self.fits:
                        start = np.append(rest.coordinates, start_coordinates([probe.effect], [probe.values]))
                        self.store(fit(rest.problem, rest.hypothesis.adding(probe.effect), start, steps=40))
            self.best = self._max_likelihood_fit
            if self.best.ids == parent.ids and self.best.chi2 > parent.chi2 - 1.0:
                return

    @property
    def _max_likelihood_fit(self) -> Fit:
        logs = log_evidences(self.fits)
        return self.fits[max(logs, key=lambda ids: logs[ids])]

    def share(self, result: Fit) -> float:
        """Return which share of the excess of the base over the noise a hypothesis takes away."""
        return share_of_gap(self.base, result)

    def explained_share(self, result: Fit) -> float:
        """Return the share within [0, 1], as reports give it."""
        return float(np.clip(self.share(result), 0.0, 1.0))

    @property
    def closest(self) -> Fit:
        """The fit that leaves least, however many causes it takes."""
        return min(self.fits.values(), key=lambda result: result.chi2)

    def is_explained(self, result: Fit) -> bool:
        """Whether nothing is left, or as little as another equation of the causes leaves."""
        if self.model.is_clean(result):
            return True
        enough = self._config.enough
        return self.share(result) >= enough[min(len(result.ids), len(enough)) - 1]

    def _in_form(self, result: Fit, form: Form) -> Fit:
        at = [e.id for e in result.effects].index(form.effect.id)
        rows = [list(values) for values in result.effect_values]
        others = [e for e in result.effects if e.id != form.effect.id]
        first = form.start(rows[at], result.problem.scale.factor)
        start = start_coordinates([*others, form.effect], [*rows[:at], *rows[at + 1 :], first])
        hypothesis = replace(result.hypothesis, effects=(*others, form.effect))
        base = result.coordinates[hypothesis.of_base]
        return fit(result.problem, hypothesis, np.concatenate([base, start]), steps=30)

    def store(self, result: Fit) -> None:
        """Keep the best fit of its causes; one where a simulator fails is none."""
        if result.chi2 == np.inf:
            return
        if (before := self.fits.get(result.ids)) is not None:
            # The same causes may end in several minima; one noise level judges them all.
            result = max(before, result, key=Yardstick.from_fits((*self.fits.values(), result)).log_evidence)
        self.fits[result.ids] = result

    def grown_from(self, parent: Fit) -> list[Fit]:
        """Return fits of another start with each of its likeliest effects; none is kept."""
        candidates = screen(parent, self._probes)[: self._config.candidates[-1]]
        return [fit_jointly(parent, candidate) for candidate in candidates] + self._grow_episodic(parent)

    def _grow(self, parent: Fit, count: int) -> list[Fit]:
        candidates = screen(parent, self._probes)
        strongest = candidates[0].gain if candidates else 0.0
        # A promise is first order: the refitted base gives more, so that less is asked at first.
        need = max(self._config.gain / 3, self._config.relative_gain * strongest)
        ids_with = {candidate.effect.id: tuple(sorted({*parent.ids, candidate.effect.id})) for candidate in candidates}
        new = [
            candidate
            for candidate in candidates[:count]
            if candidate.gain >= need and ids_with[candidate.effect.id] not in self.fits
        ]
        children = [fit_jointly(parent, candidate) for candidate in new] + self._grow_episodic(parent)
        for child in children:
            self.store(child)
        return children

    def _grow_episodic(self, parent: Fit) -> list[Fit]:
        """Return the parent with each effect that must be placed first and could be."""
        missing = [e for e in self._episodic if e.id not in parent.ids]
        result = []
        for side in (side for e in missing for side in (e, *e.sides)):
            if (search_target := side.signs.search_target) is None:
                size = side.parameters[0].name
                raise ValueError(f"{side.id} ({size}) has a side that is placed and must be placed too")
            result.append((search_target, PLACERS[search_target](parent, side)))
        # Steps placed freely in time take a little off any structure; they must take a visible part.
        min_gain = self._config.patch * max(self.base.chi2 - self.base.problem.count, 0.0)
        return [
            child
            for search_target, child in result
            if child is not None and (search_target != SearchTarget.INTERVALS or parent.chi2 - child.chi2 > min_gain)
        ]

    def settle_noise(self) -> None:
        """Score all hypotheses under the noise that the best one leaves: their χ² compare."""
        best = leader_of(self.fits)
        problem = with_driving_noise(best.problem.with_noise(*noise_of(best)), best)
        self.fits = {ids: result.under(problem) for ids, result in self.fits.items()}
        if problem.correlation:
            # Under another colour the least squares lie elsewhere: the likeliest are fitted on.
            likely = sorted(self.fits.values(), key=lambda f: f.bic)[: self._config.again]
            for result in {id(f): f for f in (self.fits[()], *likely)}.values():
                self.fits[result.ids] = fit(problem, result.hypothesis, result.coordinates, steps=6)
        self.base = self.fits[()]


def best_unmodelled(best: Fit, parents: Sequence[Fit], fits: Sequence[Fit]) -> Fit | None:
    """Return the best fit with an unmodelled effect beside a parent; None where none beats the catalogue."""
    if best.problem.is_driven_by_force:
        return None
    problem = best.problem
    probes = [
        Probe(e, (problem.scale.sized(e.parameters[0]).usual,), e.is_one_sided)
        for e in problem.model.departures(problem.case)
    ]
    joint_fits = [fit_jointly(parent, candidate) for parent in parents for candidate in screen(parent, probes)[:1]]
    if not joint_fits:
        return None
    yardstick = Yardstick.from_fits((*fits, *joint_fits))
    closest = max(joint_fits, key=yardstick.log_evidence)
    ahead = yardstick.log_evidence(closest) - yardstick.log_evidence(best)
    is_decisive = ahead > (
        problem.method.unmodelled.clean_odds if problem.model.is_clean(closest) else problem.method.competing.odds
    )
    is_simpler = len(closest.ids) <= len(best.ids) - 2
    is_better = is_simpler or closest.chi2 < best.chi2 - problem.method.unmodelled.min_gain
    return closest if is_decisive and is_better else None


def causes_with_surrogate(best: Fit, smaller: Mapping[str, Fit]) -> list[str]:
    """Return the causes that a free form of the others, `smaller`, imitates, the weakest first."""
    order, min_share = (
        sorted(smaller, key=lambda one: smaller[one].chi2),
        best.problem.method.unmodelled.surrogate_share,
    )
    return [effect_id for effect_id in order if surrogate_share(smaller[effect_id], best) >= min_share]


def surrogate_share(rest: Fit, best: Fit) -> float:
    """Return which share of a larger hypothesis's gain a free form of a smaller one has as well."""
    gain = rest.chi2 - best.chi2
    if gain <= 0.0 or not rest.ids:
        return 0.0
    rows = [rest.problem.whitened(row) for effect in rest.effects for row in _directions(rest, effect)]
    visible = projected(rows, rest.jacobian)
    if not len(visible):
        return 0.0
    # Each direction takes 1 off χ² by chance.
    explained = float(np.sum((visible @ rest.residual) ** 2)) - len(visible)
    return explained / gain


def _directions(result: Fit, effect: Effect) -> Iterator[Array]:
    """Yield (samples,) changes of the prediction that another equation of one cause may bring."""
    problem, at = result.problem, result.hypothesis.slices[effect.id]
    indices = range(at.start, at.stop)
    parameters = [problem.scale.sized(p) for p in effect.parameters]
    # A size without a shape is its own shape: a toe, a play, a delay.
    shapes = list(zip(indices, parameters, strict=True))[1:] or list(zip(indices, parameters, strict=True))
    # A hum at another pitch, or with other phases, is another hum.
    for k, parameter in () if effect.belongs_to_run else shapes:
        for ratio in problem.method.unmodelled.ratios:
            moved = result.coordinates.copy()
            value = from_fit(parameter, moved[k])
            if np.isfinite(value) and value != 0.0:
                moved[k] = to_fit(parameter, float(np.clip(ratio * value, parameter.low, parameter.high)))
            if moved[k] != result.coordinates[k]:
                yield problem.predict(result.hypothesis, moved) - result.predicted
    without, is_retained = result.hypothesis.without(effect.id)
    signature = result.predicted - problem.predict(without, result.coordinates[is_retained])
    # Load and time relative to the largest, each with its square.
    load, time = problem.model.load_of(result), np.zeros(len(problem.measured))
    for block in problem.blocks:
        time[block.rows] = problem.case.runs[block.run].elapsed_s
    load, time = load / (np.max(np.abs(load)) or 1.0), time / (np.max(time) or 1.0)
    of_load, of_time = [load, load**2], [time, time**2]
    # A delay that grows with time is a rate, a cause of its own.
    for course in of_load if effect.signs.clock is not None else of_load + of_time:
        yield signature * course


def search_under_correlated_noise(search: Search) -> Search:
    """Search once more under noise that fades; keep that only where what is left is shown to be noise."""
    model, closest = search.model, search.closest
    if model.is_clean(search.best) and not model.is_uneven(search.best):
        return search
    problem = with_correlated_noise(closest)
    # What the most flexible hypothesis leaves is noise, or what a smaller one leaves is not either.
    if problem is None or not is_noise(fit(problem, closest.hypothesis, closest.coordinates)):
        return search
    search.on_progress("searching once more under noise that fades")
    # Another noise moves the minimum a little: it is near the base's, or that of the closest.
    hypothesis, of_base = search.start.hypothesis, search.start.hypothesis.of_base
    starts = (search.start.coordinates, closest.coordinates[of_base])
    fits = [fit(problem, hypothesis, start, steps=60) for start in starts]
    again = Search(min(fits, key=lambda result: result.chi2), search.candidates, search.on_progress)
    again.run()
    return again if again.unmodelled is None and model.is_clean(again.best) and is_noise(again.best) else search
