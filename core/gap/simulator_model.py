"""A simulator of somebody else as the model of a diagnosis."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import cast
from weakref import WeakKeyDictionary

import numpy as np

from softcal.core.errors import InputError
from softcal.core.gap.case import Case, DataMistake, MenuEntry, RigScale, Run
from softcal.core.gap.diagnosis import Assessment, Checked, Diagnosis, ReportingModel, check_case, diagnose_with
from softcal.core.gap.evidence import (
    FaultLocation,
    RankedCause,
    Where,
    fault_locations,
    regime_locations,
    with_residual_location,
)
from softcal.core.gap.experiments import NextExperiment, causes_of, propose_experiment, together
from softcal.core.gap.fit import Tangent, fit, leader_of, rows_of_runs, strongest_regimes, structure
from softcal.core.gap.hypothesis import Hypothesis, Prior, Probe, fit_scale, from_fit, to_fit
from softcal.core.gap.linear import COMMON_STEP_s, energy
from softcal.core.gap.method import METHOD, GapMethod
from softcal.core.gap.mistakes import find_repeats
from softcal.core.gap.model import Block, Directions, Fit, Fits, Problem, Sizes
from softcal.core.gap.residual import noise_chance, noise_levels, scatter_of
from softcal.core.gap.search import Progress, Search
from softcal.core.gap.simulator import (
    LINEAR,
    Columns,
    ForeignStep,
    Simulator,
    SimulatorFailed,
    SimulatorRun,
    check_calls,
    planned,
    runs_of,
)
from softcal.core.gap.simulator_reach import (
    SimulatorTerm,
    against_others,
    conditions_of,
    cut_off,
    explanatory_signals,
    find_excess_noise,
    find_strays,
    recording_mistakes,
    shifted,
    states_of,
    terms_of,
)
from softcal.core.messages.reason import Reason, reason
from softcal.core.metrics import finite_or_none
from softcal.core.recording import Array, Mask
from softcal.core.twin.effects import Effect, Parameter
from softcal.core.twin.probes import ExcitationRange

MAX_CACHED = 200
"""Answers of a simulator that are kept."""

MIN_LIFT = 1.5
"""Share of the gap over share of time from which a condition is listed."""

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


def best_start(
    problem: Problem, hypothesis: Hypothesis, scattering: int = 32, max_tries: int = 5, steps: int = 60
) -> Fit:
    """Return the best minimum found from starts all over the bounds.

    Args:
        scattering: places at which the prediction is made once.
        max_tries: of these, those from which a fit takes a few steps, besides the usual values.
        steps: most steps from the best two of them.
    """
    usual, *others = scattered(hypothesis.parameters, scattering)
    starts = [usual, *likeliest(problem, hypothesis, others)[:max_tries]]
    rough = sorted((fit(problem, hypothesis, start, steps=6) for start in starts), key=lambda f: f.chi2)
    fits = [fit(problem, hypothesis, result.coordinates, steps=steps) for result in rough[:2]]
    return min(fits, key=lambda result: result.chi2)


def likeliest(problem: Problem, hypothesis: Hypothesis, points: Sequence[Array]) -> list[Array]:
    """Return places in the order of what a prediction at each leaves; those without one last."""

    def cost_at(point: Array) -> float:
        cost = energy(problem.residual(problem.predict(hypothesis, point), point))
        return cost if np.isfinite(cost) else np.inf

    problem.model.prepare(problem, [(hypothesis, point) for point in points])
    return sorted(points, key=cost_at)


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
    projections, of = np.array([float(row @ base.residual) for row in rows]), np.array(owner)
    gains: dict[tuple[Effect, ...], float] = {}
    for i, j in combinations(range(len(candidates)), 2):
        one, other = np.flatnonzero(of == i), np.flatnonzero(of == j)
        a, b, c = projections[one][:, None], projections[other][None, :], alike[np.ix_(one, other)]
        together = (a**2 + b**2 - 2.0 * a * b * c) / np.maximum(1.0 - c**2, 1e-6)
        gains[candidates[i], candidates[j]] = float(together.max(initial=0.0))
    return sorted(gains, key=lambda pair: -gains[pair])[: base.problem.method.search.max_pairs]


def rows_over_bounds(effect: Effect) -> list[tuple[float, ...]]:
    """Return values of an effect all over its bounds, the usual ones first."""
    points = scattered(effect.parameters, DRAWS)
    return [tuple(from_fit(p, float(x)) for p, x in zip(effect.parameters, point, strict=True)) for point in points]


def try_from_many_starts(base: Fit, effects: tuple[Effect, ...], fits: Fits, store: Callable[[Fit], None]) -> None:
    """Fit effects jointly from several starts, and store what is worth it."""
    problem, hypothesis, starting = base.problem, base.hypothesis.adding(*effects), list[Fit]()
    for effect in effects:
        parent = fits.get(tuple(sorted(e.id for e in effects if e is not effect)))
        if parent is None:
            continue
        space = Tangent(parent)
        candidates = [
            space.score_candidate(Probe(effect, row, effect.is_one_sided)) for row in rows_over_bounds(effect)
        ]
        candidate = max((one for one in candidates if one is not None), key=lambda one: one.gain, default=None)
        if candidate is not None:
            starting.append(fit(problem, parent.hypothesis.adding(effect), candidate.start(parent), steps=FIRST_STEPS))
    samples = scattered([p for effect in hypothesis.effects for p in effect.parameters], DRAWS)
    starts = [np.append(base.coordinates, values) for values in samples]
    likely = likeliest(problem, hypothesis, starts)[0]
    best = min((*starting, fit(problem, hypothesis, likely, steps=FIRST_STEPS)), key=lambda result: result.chi2)
    # What is not better after a few steps than the best with one cause less is left there.
    parts = [f.chi2 for ids, f in fits.items() if set(ids) < set(best.ids)]
    if best.chi2 < min(parts) - problem.method.search.worth * max(base.chi2 - problem.count, 0.0):
        store(fit(problem, best.hypothesis, best.coordinates, steps=60))


@dataclass
class Calls:
    """What a simulator said of a case lately; how often it failed within its bounds, and how first."""

    count: int = 0
    of: int = 0
    first: str = ""
    answers: dict[tuple[tuple[str, float], ...], Array] = field(default_factory=dict)

    def store(self, key: tuple[tuple[str, float], ...], answer: Array) -> None:
        """Store an answer; the oldest goes: every part that is held back begins where the others did."""
        self.answers[key] = answer
        if len(self.answers) > MAX_CACHED:
            del self.answers[next(iter(self.answers))]

    def record(self) -> dict[str, object] | None:
        """Return what a report says of failures; None where it never failed."""
        return {"evaluations": self.count, "of": self.of, "first": self.first} if self.count else None


@dataclass(frozen=True, eq=False)
class SimulatorModel(ReportingModel):
    """A simulator with its candidates, and what it said of every case."""

    simulator: Simulator
    method: GapMethod = METHOD.for_simulators
    _calls: WeakKeyDictionary[Case, Calls] = field(default_factory=WeakKeyDictionary, repr=False)

    smooth_order = 2
    is_partly_unknown = False
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
    def channels(self) -> tuple[str, ...]:
        return self.simulator.channels

    @property
    def priors(self) -> Sequence[Prior]:
        with_prior = [(k, p, self.simulator.prior_of(p)) for k, p in enumerate(self.base)]
        return [
            Prior(k, to_fit(p, one[0]), one[1] / one[0] if p.scale == "log" else one[1])
            for k, p, one in with_prior
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

    # What it predicts.

    def scale_of(self, case: Case) -> RigScale:
        # A simulator states the bounds of its own parameters.
        return RigScale()

    def channels_of(self, run: Run) -> tuple[str, ...]:
        return self.simulator.channels

    def noise_range(self, problem: Problem, channel: str) -> tuple[float, float]:
        min_noise = 1e-9 * max(float(np.ptp(problem.measured[b.rows])) for b in problem.blocks_of(channel))
        return (self.simulator.noise.get(channel, min_noise), self.simulator.noise.get(channel, np.inf))

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
            sizes_by_kind = {kind: float(size) for (channel, kind), size in rows if channel == block.channel}
            t_s = problem.case.runs[block.run].elapsed_s
            values = out[block.rows]
            if sizes_by_kind.get("delay") and np.all(np.isfinite(values)):
                values = shifted(values, t_s, sizes_by_kind["delay"], sizes_by_kind[LINEAR])[0]
            out[block.rows] = (
                values * (1.0 + sizes_by_kind.get("gain", 0.0))
                + sizes_by_kind.get("zero", 0.0)
                + sizes_by_kind.get("drift", 0.0) * t_s
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
            kinds, signal = self.simulator.offsets, raw[block.rows]
            t_s, has = problem.case.runs[block.run].elapsed_s, dict.fromkeys(kinds, 0.0)
            if block.run in sizes:
                has = dict(zip(kinds, sizes[block.run], strict=True))
            late, slope, apart = signal, np.gradient(clean[block.rows], t_s), np.zeros(len(t_s))
            if has.get((block.channel, "delay")) and np.all(np.isfinite(signal)):
                late, slope, apart = shifted(signal, t_s, has[block.channel, "delay"], has[block.channel, LINEAR])
            of_kind = {"zero": np.ones(len(t_s)), "drift": t_s, "gain": late, "delay": -slope, LINEAR: apart}
            out.append(np.array([of_kind[kind] * (channel == block.channel) for channel, kind in kinds]))
        return out

    def _simulated(self, problem: Problem, hypothesis: Hypothesis, coordinates: Array) -> Array:
        """Return (samples,) with the empirical terms, NaN where the simulator fails in a run."""
        parameters = self.simulator.parameter_values(hypothesis, coordinates)
        key, calls = tuple(parameters.items()), self.calls(problem.case)
        if key not in calls.answers:
            answers = (self._predicted(run, parameters) for run in runs_of(problem.case))
            calls.store(key, self._stacked(problem, answers))
        raw = calls.answers[key]
        added = [e for e in hypothesis.effects if e.id not in self.simulator.candidate_ids]
        terms = [(cast(ForeignStep, e.step).of, e.id) for e in added]
        if not terms or not np.all(np.isfinite(raw)):
            return raw
        out, sizes = raw.copy(), {i: coordinates[hypothesis.index_of(i)] for _, i in terms}
        for run in range(len(problem.case.runs)):
            rows_of_channel = {b.channel: b.rows for b in problem.blocks if b.run == run}
            columns = {name: problem.recorded(run, name) for name in self.simulator.inputs}
            columns |= {channel: raw[rows] for channel, rows in rows_of_channel.items()}
            for term, i in terms:
                out[rows_of_channel[term.place]] += sizes[i] * term.values(problem.case.runs[run].t_s, columns)
        return out

    def prepare(self, problem: Problem, points: Sequence[tuple[Hypothesis, Array]]) -> None:
        if self.simulator.run_many is None or problem.case.is_planned:
            return
        calls, runs = self.calls(problem.case), runs_of(problem.case)
        every = (self.simulator.parameter_values(hypothesis, coordinates) for hypothesis, coordinates in points)
        new = {key: values for values in every if (key := tuple(values.items())) not in calls.answers}
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
        for k, channel_answers in enumerate(answers):
            if isinstance(channel_answers, SimulatorFailed):
                calls.count += 1
                calls.first = calls.first or str(channel_answers)
                return np.full(len(out), np.nan)
            for block in (b for b in problem.blocks if b.run == k):
                out[block.rows] = channel_answers[block.channel]
        return out

    # What it leaves.

    def is_clean(self, result: Fit) -> bool:
        return noise_chance(result) > self.method.noise_test.chance

    def is_uneven(self, result: Fit) -> bool:
        return False

    def followed(self, result: Fit, channel: str) -> list[Sequence[Array]]:
        return explanatory_signals(self.simulator, result, channel)

    def halves(self, result: Fit, block: Block) -> tuple[Mask, Mask]:
        """Return where a channel of a run lies above its median, and where it changes faster than usual."""
        level = result.predicted[block.rows]
        rate = np.abs(np.gradient(level, result.problem.case.runs[block.run].t_s))
        return np.asarray(level > np.median(level)), np.asarray(rate > np.median(rate))

    def load_of(self, result: Fit) -> Array:
        return result.predicted

    def states(self, result: Fit) -> list[Array]:
        return states_of(self.simulator, result)

    def laws(self, base: Fit) -> dict[str, list[Array]]:
        space = Tangent(base)
        return {
            effect.id: [space.signature(Probe(effect, row, effect.is_one_sided)) for row in rows_over_bounds(effect)]
            for effect in self.candidates
        }

    def axes_of(self, result: Fit, run: int) -> tuple[str, Array, Array]:
        name, load = next(iter(self.simulator.inputs), "t_s"), self.simulator.channels[0]
        return name, result.problem.recorded(run, name), result.problem.recorded(run, load)

    # How causes are sought.

    def mistakes(self, case: Case) -> tuple[DataMistake, ...]:
        return recording_mistakes(self.simulator, case, self.method.mistake)

    def base_of_mistaken_case(self, case: Case) -> Fit:
        return self.base_fit(case)

    def rough_problem(self, case: Case) -> Problem:
        """Return recordings with a fiftieth of the spread of a channel as its noise."""
        columns = {c: np.concatenate([run.columns[c] for run in runs_of(case)]) for c in self.simulator.channels}
        return Problem(self, case, {c: 0.02 * max(float(np.std(values)), 1e-12) for c, values in columns.items()})

    def rough_fit(self, case: Case) -> Fit:
        """Fit the base quickly, for a question that is put to several cases."""
        return best_start(self.rough_problem(case), Hypothesis(of_all=self.base), scattering=16, max_tries=2, steps=20)

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

    def _shared_by_base(self, result: Fit) -> Problem:
        """Leave to the base what all runs share of an offset, where the base can take its shape."""
        problem = result.problem
        if not len(problem.largest_offsets):
            return problem
        bare = fit(problem.bare, result.hypothesis, result.coordinates, steps=0)
        rows = rows_of_runs(problem, problem.directions(result.hypothesis, result.coordinates, bare.predicted, {}))
        space = Tangent(bare)
        shared = [bare.problem.whitened(row) for row in np.sum(list(rows.values()), axis=0)]
        remaining = np.array([energy(space.visible(row)) for row in shared]) * problem.largest_offsets**2
        is_shared = (remaining < self.method.search.base_sigma**2) & np.any(shared, axis=1)
        return replace(problem, of_base=tuple(map(bool, is_shared)))

    def mistakes_by_base(self, base: Fit) -> tuple[tuple[DataMistake, ...], tuple[DataMistake, ...]]:
        if broken := find_strays(self, base):
            return broken, ()
        cut = cut_off(self.simulator, base.problem.case, self.method.mistake)
        questions = (
            *cut,
            *find_repeats(base),
            *find_excess_noise(self.simulator, scatter_of(base), self.method.mistake),
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
        excitation = ExcitationRange(1.0, 1.0, 0.0, 1.0, longest_s, float(np.median(runs[0].step_s[1:])))
        return tuple(Probe(c, row, c.is_one_sided) for c in effects for row in c.probes(excitation))

    def start_again(self, base: Fit, candidates: Sequence[Effect], fits: Fits, store: Callable[[Fit], None]) -> None:
        """Fit every cause and every pair from several starts where structure is left.

        A level never reached promises nothing to first order; two causes may gain only together.
        """
        for effect in candidates:
            try_from_many_starts(base, (effect,), fits, store)
        for pair in likely_pairs(base, candidates):
            if self.is_clean(leader_of(fits)):
                break
            try_from_many_starts(base, pair, fits, store)

    def departures(self, case: Case) -> tuple[Effect, ...]:
        return ()

    # What is reported.

    def menu(self, base: Fit) -> list[MenuEntry]:
        experiments = self.simulator.experiments
        return [MenuEntry(name, planned(self.simulator, name), one.minutes) for name, one in experiments.items()]

    def terms(self, base: Fit) -> Iterator[SimulatorTerm]:
        return terms_of(self.simulator, base)

    def where(self, search: "Search", assessment: "Assessment", causes: Sequence[RankedCause]) -> Where:
        best, verdict = search.best, assessment.verdict
        if verdict == "no_gap":
            return Where()
        base, regimes = search.base, strongest_regimes(search.base, conditions_of, MIN_LIFT)
        loudest = max(base.problem.scored_channels, key=lambda channel: structure(base, channel).z)
        channel, regime = (
            (regimes[0].channel, regimes[0].name) if regimes else (loudest, Reason("gap.regime.everywhere"))
        )
        if verdict == "unknown":
            part, ids = search.explained_share(best), best.ids
            nearest = Reason("gap.seen.no_candidate")
            if ids:
                nearest = reason("gap.seen.nearest", causes=together(ids, "gap.both"), share=part)
            locations = [FaultLocation("unknown", channel, regime, 1.0, nearest)]
        else:
            explaining = [c for c in causes if c.effect in best.ids]
            locations = fault_locations(
                explaining, channel, regime, lambda effect_id: reason("gap.effect", effect=effect_id)
            )
            if verdict == "explained_in_part":
                locations = with_residual_location(
                    locations, FaultLocation("unknown", channel, regime, 1.0 - search.explained_share(best))
                )
        return Where((*locations, *regime_locations(locations[0].stage, regimes, "gap.seen.energy_of_all")), regimes)

    def next_experiment(
        self, search: "Search", assessment: "Assessment", telling: NextExperiment | None
    ) -> NextExperiment:
        group, verdict = assessment.group, assessment.verdict
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
        return propose_experiment(entries, group)

    def report(self, diagnosis: "Diagnosis[SimulatorModel]") -> dict[str, object]:
        """Return what a report has besides; an effect that is off at infinity is None."""
        result, out = diagnosis.best, dict[str, object]()
        if (described := diagnosis.residual) is not None:
            added = [one.term.record() for one in described.terms]
            out["residual"] = described.record() | {"added": added, "parameters": self._parameters(described.fit)}
        return out | {
            "simulator": self.simulator.name,
            "calls": self.calls(diagnosis.case).of * len(diagnosis.case.runs),
            "failed": self.calls(diagnosis.case).record(),
            "offsets": [
                {"run": result.problem.case.runs[run].name, "channel": channel, kind: float(size)}
                for run, row in result.problem.offset_sizes(result.hypothesis, result.coordinates).items()
                for (channel, kind), size in zip(self.simulator.offsets, row, strict=True)
            ],
            "parameters": self._parameters(result),
            "base": self._parameters(diagnosis.base),
            "priors": self.summarise_priors(result),
        }

    def summarise_priors(self, result: Fit) -> dict[str, dict[str, float]]:
        """Return by parameter of the base with a prior its mean and standard deviation, and what was fitted."""
        values = self.simulator.parameter_values(result.hypothesis, result.coordinates)
        pairs = [(p.name, self.simulator.prior_of(p)) for p in self.base]
        return {n: {"mean": one[0], "sd": one[1], "fitted": values[n]} for n, one in pairs if one is not None}

    def _parameters(self, result: Fit) -> dict[str, float | None]:
        values = self.simulator.parameter_values(result.hypothesis, result.coordinates)
        return {name: finite_or_none(value) for name, value in values.items()}


def diagnose_simulator(
    simulator: Simulator, runs: Sequence[SimulatorRun], serial: str = "", progress: Progress | None = None
) -> Diagnosis[SimulatorModel]:
    """Diagnose the gap between a simulator and recordings of what it simulates.

    Args:
        runs: made by `recorded`.

    Raises:
        InputError: no run, or the simulator gives something else than finite channels.
    """
    on_progress = progress or (lambda _: None)
    on_progress("calling the simulator a few times")
    return diagnose_with(*_called(simulator, runs, serial), on_progress)


def _called(simulator: Simulator, runs: Sequence[SimulatorRun], serial: str = "") -> tuple[SimulatorModel, Case]:
    if not runs:
        raise InputError(f"simulator {simulator.name}: no run was given; a diagnosis needs one")
    names = [run.name for run in runs]
    if len(set(names)) < len(names):
        raise InputError(f"simulator {simulator.name}: two runs have one name: {', '.join(names)}")
    check_calls(simulator, runs)
    return SimulatorModel(simulator.of_runs(names)), Case(serial, tuple(runs))


def check_simulator(simulator: Simulator, runs: Sequence[SimulatorRun]) -> Checked:
    """Return the mistakes in recordings and, without any, what they tell of a simulator; no search.

    Raises:
        InputError: as for `diagnose_simulator`.
    """
    model, case = _called(simulator, runs)
    return check_case(case, model)
