"""A simulator of somebody else as the model of a diagnosis."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import TYPE_CHECKING, cast
from weakref import WeakKeyDictionary

import numpy as np

from softcal.core.errors import InputError
from softcal.core.gap.case import Case, DataMistake, Mask, MenuEntry, Run
from softcal.core.gap.evidence import beside_rest, places_of, regime_places
from softcal.core.gap.experiments import NextExperiment, causes_of, most_telling, together
from softcal.core.gap.fit import Fit, Probe, Tangent, fit, structure
from softcal.core.gap.linear import COMMON_STEP_s, Prior, RigScale, energy, fit_scale, from_fit, to_fit
from softcal.core.gap.method import METHOD, GapMethod, PresenceConfig, SearchConfig
from softcal.core.gap.mistakes import find_repeats
from softcal.core.gap.model import Directions, GapPlace, Model, RankedCause, Sizes, Where
from softcal.core.gap.problem import Block, Hypothesis, Problem, rows_of_runs
from softcal.core.gap.residual import noise_chance, noise_levels, scatter_of
from softcal.core.gap.simulator import (
    STRAIGHT,
    Columns,
    Simulator,
    SimulatorFailed,
    SimulatorRun,
    planned,
    runs_of,
)
from softcal.core.gap.simulator_reach import (
    SimulatorTerm,
    TermStep,
    against_others,
    cut_off,
    find_strays,
    known_of_signals,
    louder_than_stated,
    regimes_of,
    shifted,
    shown,
    terms_of,
)
from softcal.core.messages.reason import Reason, reason
from softcal.core.metrics import finite_or_none
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Parameter
from softcal.core.twin.probes import ExcitationRange

if TYPE_CHECKING:
    from softcal.core.gap.diagnosis import Diagnosis, Judgement
    from softcal.core.gap.search import Search

KNOWN = 200
"""Answers of a simulator that are kept."""

DRAWS, FIRST_STEPS = 12, 6
"""Places over the bounds at which causes are tried, and steps from the likeliest of them."""


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
        cost = energy(problem.residual(problem.predict(hypothesis, place), place))
        return cost if np.isfinite(cost) else np.inf

    problem.prepare([(hypothesis, place) for place in places])
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


@dataclass
class Calls:
    """What a simulator said of a case lately; how often it failed within its bounds, and how first."""

    count: int = 0
    of: int = 0
    first: str = ""
    known: dict[tuple[tuple[str, float], ...], Array] = field(default_factory=dict)

    def store(self, key: tuple[tuple[str, float], ...], answer: Array) -> None:
        """Store an answer; the oldest goes: every part that is held back begins where the others did."""
        self.known[key] = answer
        if len(self.known) > KNOWN:
            del self.known[next(iter(self.known))]

    def record(self) -> dict[str, object] | None:
        """Return what a report says of failures; None where it never failed."""
        return {"evaluations": self.count, "of": self.of, "first": self.first} if self.count else None


@dataclass(frozen=True, eq=False)
class SimulatorModel(Model):
    """A simulator with its candidates, and what it said of every case."""

    simulator: Simulator
    method: GapMethod = METHOD
    _calls: WeakKeyDictionary[Case, Calls] = field(default_factory=WeakKeyDictionary, repr=False)

    smooth_order = 2
    hands_on_closest = True

    def calls(self, case: Case) -> Calls:
        """Return what was said of a case, and how often the simulator failed on it."""
        return self._calls.setdefault(case, Calls())

    @property
    def base(self) -> tuple[Parameter, ...]:
        return self.simulator.base

    @property
    def candidates(self) -> tuple[Effect, ...]:
        return self.simulator.candidates

    @property
    def priors(self) -> Sequence[Prior]:
        known = [(k, p, self.simulator.prior_of(p)) for k, p in enumerate(self.base)]
        return [
            Prior(k, to_fit(p, one[0]), one[1] / one[0] if p.scale == "log" else one[1])
            for k, p, one in known
            if one is not None
        ]

    @property
    def offset_names(self) -> tuple[str, ...]:
        return tuple(f"{kind} of {channel}" for channel, kind in self.simulator.offsets)

    @property
    def are_relative(self) -> Mask:
        return np.array([kind == "gain" for _, kind in self.simulator.offsets], dtype=np.bool_)

    @property
    def are_bending(self) -> Mask:
        return np.array([kind == "delay" for _, kind in self.simulator.offsets], dtype=np.bool_)

    @property
    def search_config(self) -> SearchConfig:
        return self.method.simulator_search

    @property
    def presence_config(self) -> PresenceConfig:
        return self.method.simulator_presence

    # What it predicts.

    def scale_of(self, case: Case) -> RigScale:
        # A simulator states the bounds of its own parameters.
        return RigScale()

    def channels_of(self, run: Run) -> tuple[str, ...]:
        return self.simulator.channels

    def recorded(self, run: Run, channel: str) -> Array:
        return cast(SimulatorRun, run).columns[channel]

    def scored_channels(self, problem: Problem) -> list[str]:
        return list(self.simulator.channels)

    def noise_range(self, problem: Problem, channel: str) -> tuple[float, float]:
        least = 1e-9 * max(float(np.ptp(problem.measured[b.place])) for b in problem.blocks_of(channel))
        return (self.simulator.noise.get(channel, least), self.simulator.noise.get(channel, np.inf))

    def times_slower(self, case: Case) -> float:
        return float(np.median(np.concatenate([run.step_s[1:] for run in case.runs]))) / COMMON_STEP_s

    def is_free(self, case: Case) -> Array:
        return np.ones(len(self.base), dtype=np.bool_)

    def largest_offsets(self, case: Case) -> Array:
        return np.array([self.simulator.per_run[channel].get(kind, 1.0) for channel, kind in self.simulator.offsets])

    def clean(self, problem: Problem, hypothesis: Hypothesis, coordinates: Array, sizes: Sizes) -> Array:
        out = self._simulated(problem, hypothesis, coordinates).copy()
        for block in problem.blocks if sizes else ():
            rows = zip(self.simulator.offsets, sizes[block.run], strict=True)
            mine = {kind: float(size) for (channel, kind), size in rows if channel == block.channel}
            t_s = problem.case.runs[block.run].elapsed_s
            values = out[block.place]
            if mine.get("delay") and np.all(np.isfinite(values)):
                values = shifted(values, t_s, mine["delay"], mine[STRAIGHT])[0]
            out[block.place] = (
                values * (1.0 + mine.get("gain", 0.0)) + mine.get("zero", 0.0) + mine.get("drift", 0.0) * t_s
            )
        return out

    def directions(
        self, problem: Problem, hypothesis: Hypothesis, coordinates: Array, clean: Array, sizes: Sizes
    ) -> Directions:
        raw, out = self._simulated(problem, hypothesis, coordinates), Directions()
        for block in problem.blocks:
            if block.channel not in self.simulator.per_run:
                out.append(None)
                continue
            kinds, mine = self.simulator.offsets, raw[block.place]
            t_s, has = problem.case.runs[block.run].elapsed_s, dict.fromkeys(kinds, 0.0)
            if block.run in sizes:
                has = dict(zip(kinds, sizes[block.run], strict=True))
            late, slope, apart = mine, np.gradient(clean[block.place], t_s), np.zeros(len(t_s))
            if has.get((block.channel, "delay")) and np.all(np.isfinite(mine)):
                late, slope, apart = shifted(mine, t_s, has[block.channel, "delay"], has[block.channel, STRAIGHT])
            of_kind = {"zero": np.ones(len(t_s)), "drift": t_s, "gain": late, "delay": -slope, STRAIGHT: apart}
            out.append(np.array([of_kind[kind] * (channel == block.channel) for channel, kind in kinds]))
        return out

    def _simulated(self, problem: Problem, hypothesis: Hypothesis, coordinates: Array) -> Array:
        """Return (samples,) with the empirical terms, NaN where the simulator fails in a run."""
        parameters = self.simulator.named(hypothesis, coordinates)
        key, calls = tuple(parameters.items()), self.calls(problem.case)
        if key not in calls.known:
            answers = (self._predicted(run, parameters) for run in runs_of(problem.case))
            calls.store(key, self._stacked(problem, answers))
        raw = calls.known[key]
        added = [e for e in hypothesis.effects if e.id not in self.simulator.candidate_ids]
        terms = [(cast(TermStep, e.step).term, e.id) for e in added]
        if not terms or not np.all(np.isfinite(raw)):
            return raw
        out, sizes = raw.copy(), {i: coordinates[hypothesis.place_of(i)] for _, i in terms}
        for run in range(len(problem.case.runs)):
            places = {b.channel: b.place for b in problem.blocks if b.run == run}
            columns = {name: problem.recorded(run, name) for name in self.simulator.inputs}
            columns |= {channel: raw[place] for channel, place in places.items()}
            for term, i in terms:
                out[places[term.place]] += sizes[i] * term.values(problem.case.runs[run].t_s, columns)
        return out

    def prepare(self, problem: Problem, places: Sequence[tuple[Hypothesis, Array]]) -> None:
        if self.simulator.run_many is None or problem.case.is_planned:
            return
        calls, runs = self.calls(problem.case), runs_of(problem.case)
        every = (self.simulator.named(hypothesis, coordinates) for hypothesis, coordinates in places)
        new = {key: place for place in every if (key := tuple(place.items())) not in calls.known}
        for key, answers in zip(new, self.simulator.predict_many(runs, list(new.values())), strict=True):
            calls.store(key, self._stacked(problem, answers))

    def _predicted(self, run: SimulatorRun, parameters: Mapping[str, float]) -> Columns | SimulatorFailed:
        try:
            return self.simulator.predict(run, parameters)
        except SimulatorFailed as error:
            return error

    def _stacked(self, problem: Problem, answers: Iterable[Columns | SimulatorFailed]) -> Array:
        """Return (samples,) answers of all runs, NaN where one fails."""
        out, calls = np.empty(len(problem.measured)), self.calls(problem.case)
        calls.of += 1
        for k, found in enumerate(answers):
            if isinstance(found, SimulatorFailed):
                calls.count += 1
                calls.first = calls.first or str(found)
                return np.full(len(out), np.nan)
            for block in (b for b in problem.blocks if b.run == k):
                out[block.place] = found[block.channel]
        return out

    def with_unknown(self, problem: Problem, predicted: Array) -> Array:
        # Where a simulator fails nothing is known: a fit must not go there.
        return predicted

    # What it leaves.

    def is_clean(self, found: Fit) -> bool:
        return noise_chance(found) > self.method.floor.chance

    def is_uneven(self, found: Fit) -> bool:
        return False

    def followed(self, found: Fit, channel: str) -> list[Sequence[Array]]:
        return known_of_signals(self.simulator, found, channel)

    def halves(self, found: Fit, block: Block) -> tuple[Mask, Mask]:
        """Return where a channel of a run lies above its median, and where it changes faster than usual."""
        level = found.predicted[block.place]
        rate = np.abs(np.gradient(level, found.problem.case.runs[block.run].t_s))
        return np.asarray(level > np.median(level)), np.asarray(rate > np.median(rate))

    def load_of(self, found: Fit) -> Array:
        return found.predicted

    def axes_of(self, found: Fit, run: int) -> tuple[Array, Array]:
        first = found.problem.recorded(run, self.simulator.channels[0])
        return first, first

    # How causes are sought.

    def mistakes(self, case: Case) -> tuple[DataMistake, ...]:
        return shown(self.simulator, case, self.method.mistake)

    def base_beside(self, case: Case) -> Fit:
        return self.base_fit(case)

    def rough_problem(self, case: Case) -> Problem:
        """Return recordings with a fiftieth of the spread of a channel as its noise."""
        columns = {c: np.concatenate([run.columns[c] for run in runs_of(case)]) for c in self.simulator.channels}
        return Problem(self, case, {c: 0.02 * max(float(np.std(values)), 1e-12) for c, values in columns.items()})

    def rough_fit(self, case: Case) -> Fit:
        """Fit the base quickly, for a question that is put to several cases."""
        return best_start(self.rough_problem(case), Hypothesis(of_all=self.base), scattering=16, tried=2, steps=20)

    def base_fit(self, case: Case) -> Fit:
        """Fit the base parameters alone from several starts, with noise levels from the residual.

        Raises:
            InputError: the simulator fails wherever it is tried.
        """
        problem, hypothesis = self.rough_problem(case), Hypothesis(of_all=self.base)
        best, calls = best_start(problem, hypothesis), self.calls(case)
        if best.chi2 == np.inf:
            raise InputError(f"{calls.first}; it fails at all {calls.of} places that were tried")
        for _ in range(3):
            under = fit(best.problem.with_noise(noise_levels(best)), hypothesis, best.coordinates)
            best = fit(self._shared_by_base(under), hypothesis, under.coordinates)
        return best

    def _shared_by_base(self, found: Fit) -> Problem:
        """Leave to the base what all runs share of an offset, where the base can take its shape."""
        problem = found.problem
        if not len(problem.largest_offsets):
            return problem
        bare = fit(problem.bare, found.hypothesis, found.coordinates, steps=0)
        rows = rows_of_runs(problem, problem.directions(found.hypothesis, found.coordinates, bare.predicted, {}))
        space = Tangent(bare)
        shared = [bare.problem.whitened(row) for row in np.sum(list(rows.values()), axis=0)]
        left = np.array([energy(space.visible(row)) for row in shared]) * problem.largest_offsets**2
        is_taken = (left < self.method.search.base_sigma**2) & np.any(shared, axis=1)
        return replace(problem, of_base=tuple(map(bool, is_taken)))

    def mistakes_by_base(self, base: Fit) -> tuple[tuple[DataMistake, ...], tuple[DataMistake, ...]]:
        if broken := find_strays(self, base):
            return broken, ()
        cut = cut_off(self.simulator, base.problem.case, self.method.mistake)
        questions = (
            *cut,
            *find_repeats(base),
            *louder_than_stated(self.simulator, scatter_of(base), self.method.mistake),
        )
        if (test := against_others(self, base)) is None:
            return (), questions
        return ((test.mistake,), ()) if test.is_claim else ((), (test.mistake, *questions))

    def mistakes_by_search(self, search: "Search") -> tuple[DataMistake, ...]:
        return ()

    def visible(self, case: Case) -> tuple[Effect, ...]:
        return self.candidates

    def probes(self, base: Fit, effects: Sequence[Effect]) -> tuple[Probe, ...]:
        runs = base.problem.case.runs
        longest_s = max(float(run.elapsed_s[-1]) for run in runs)
        extent = ExcitationRange(1.0, 1.0, 0.0, 1.0, longest_s, float(np.median(runs[0].step_s[1:])))
        return tuple(Probe(c, row, c.is_one_sided) for c in effects for row in c.probes(extent))

    def start_again(self, search: "Search") -> None:
        """Fit every cause and every pair from several starts where structure is left.

        A level never reached promises nothing to first order; two causes may gain only together.
        """
        search.say("trying every cause, and every two, from several starts")
        for effect in search.candidates:
            try_from_many_starts(search, (effect,))
        for pair in likely_pairs(search.base, search.candidates):
            if self.is_clean(search.leader):
                break
            try_from_many_starts(search, pair)

    def departures(self, case: Case) -> tuple[Effect, ...]:
        return ()

    # What is reported.

    def menu(self, base: Fit) -> list[MenuEntry]:
        experiments = self.simulator.experiments
        return [MenuEntry(name, planned(self.simulator, name), one.minutes) for name, one in experiments.items()]

    def terms(self, base: Fit) -> Iterator[SimulatorTerm]:
        return terms_of(self.simulator, base)

    def where(self, search: "Search", judgement: "Judgement", causes: Sequence[RankedCause]) -> Where:
        best, verdict = search.best, judgement.verdict
        if verdict == "no_gap":
            return Where()
        base, seen = search.base, regimes_of(search.base)
        loudest = max(base.problem.scored_channels, key=lambda channel: structure(base, channel).z)
        channel, regime = (seen[0].channel, seen[0].name) if seen else (loudest, Reason("gap.regime.everywhere"))
        if verdict == "unknown":
            part, ids = search.explained_share(best), best.ids
            nearest = Reason("gap.seen.no_candidate")
            if ids:
                nearest = reason("gap.seen.nearest", causes=together(ids, "gap.both"), share=part)
            places = [GapPlace("unknown", channel, regime, 1.0, nearest)]
        else:
            named = [c for c in causes if c.effect in best.ids]
            places = places_of(named, channel, regime, lambda effect_id: reason("gap.effect", effect=effect_id))
            if verdict == "explained_in_part":
                places = beside_rest(places, GapPlace("unknown", channel, regime, 1.0 - search.explained_share(best)))
        return Where((*places, *regime_places(places[0].stage, seen, "gap.seen.energy_of_all")), tuple(seen))

    def next_experiment(
        self, search: "Search", judgement: "Judgement", telling: NextExperiment | None
    ) -> NextExperiment:
        group, verdict = judgement.group, judgement.verdict
        if verdict == "unknown":
            return telling or NextExperiment("none", Reason("gap.next.add_candidate"))
        if verdict == "explained_in_part" and len(group) < 2:
            return telling or NextExperiment("none", Reason("gap.next.name_rest"))
        if len(group) < 2:
            no_gap, separated = Reason("gap.next.no_gap"), Reason("gap.next.separated_here")
            return NextExperiment("none", no_gap if verdict == "no_gap" else separated)
        entries = self.menu(search.start)
        if not entries:
            return NextExperiment("none", reason("gap.next.no_experiments", causes=causes_of(group)))
        return most_telling(entries, group)

    def report(self, diagnosis: "Diagnosis[SimulatorModel]") -> dict[str, object]:
        """Return what a report has besides; an effect that is off at infinity is None."""
        found, out = diagnosis.best, dict[str, object]()
        if (described := diagnosis.residual) is not None:
            added = [one.term.record() for one in described.terms]
            out["residual"] = described.record() | {"added": added, "parameters": self._parameters(described.fit)}
        return out | {
            "simulator": self.simulator.name,
            "calls": self.calls(diagnosis.case).of * len(diagnosis.case.runs),
            "failed": self.calls(diagnosis.case).record(),
            "offsets": [
                {"run": found.problem.case.runs[run].name, "channel": channel, kind: float(size)}
                for run, row in found.problem.offset_sizes(found.hypothesis, found.coordinates).items()
                for (channel, kind), size in zip(self.simulator.offsets, row, strict=True)
            ],
            "parameters": self._parameters(found),
            "base": self._parameters(diagnosis.base),
            "priors": self.stated_and_fitted(found),
        }

    def stated_and_fitted(self, found: Fit) -> dict[str, dict[str, float]]:
        """Return by parameter of the base with a prior its mean and standard deviation, and what was fitted."""
        values = self.simulator.named(found.hypothesis, found.coordinates)
        pairs = [(p.name, self.simulator.prior_of(p)) for p in self.base]
        return {n: {"mean": one[0], "sd": one[1], "fitted": values[n]} for n, one in pairs if one is not None}

    def _parameters(self, found: Fit) -> dict[str, float | None]:
        values = self.simulator.named(found.hypothesis, found.coordinates)
        return {name: finite_or_none(value) for name, value in values.items()}
