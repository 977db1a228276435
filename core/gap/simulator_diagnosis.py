"""The diagnosis of a simulator of somebody else: where, which, how far, how sure, what to run next.

Hypotheses, evidence, rivals, hidden fractions and held-out shrink are those of the soft sensor's twin; only what
predicts the channels is another.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from softcal.core.errors import InputError
from softcal.core.gap import next_experiment
from softcal.core.gap.ambiguity import confused_pairs, hidden_fraction, rivals
from softcal.core.gap.candidates import Probe
from softcal.core.gap.case import Case
from softcal.core.gap.coordinates import from_fit
from softcal.core.gap.diagnosis import (
    IMITATED_TRUST,
    NOT_MEASURED,
    SCHEMA,
    UNKNOWN_TRUST,
    DiagnosisVerdict,
    GapPlace,
    Partial,
    RankedCause,
    chances_of,
    estimates_of,
    gap_of_base,
    let_go,
    on_unseen,
    shares_of,
    under_its_floor,
)
from softcal.core.gap.empirical import LearnedResidual, learned
from softcal.core.gap.fit import Block, Fit, Hypothesis, Problem, fit
from softcal.core.gap.floor import coloured, is_noise
from softcal.core.gap.identifiability import Identifiability, identifiability, sentences
from softcal.core.gap.linear import energy
from softcal.core.gap.next_experiment import MenuEntry, NextExperiment
from softcal.core.gap.offsets import rows_of_runs
from softcal.core.gap.plausibility import DataMistake
from softcal.core.gap.posterior import log_evidences
from softcal.core.gap.residual import Regime, structure
from softcal.core.gap.screen import Lead, Tangent
from softcal.core.gap.search import EffectSearch, Progress, SearchConfig
from softcal.core.gap.shrink import ChannelGap, Quantified, Shrink, quantify
from softcal.core.gap.simulator import (
    Failures,
    Simulator,
    SimulatorProblem,
    SimulatorRun,
    followed,
    is_high,
    is_quick,
    planned,
)
from softcal.core.gap.simulator_plausibility import against_others, cut_off, shown
from softcal.core.gap.simulator_terms import SimulatorTerm, terms_of
from softcal.core.gap.start import best_start, likeliest, noise_levels, scattered
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect
from softcal.core.twin.probes import Extent
from softcal.core.words.reason import Reason, reason, several

CONFIG = SearchConfig(leads=(8, 5), beam=(3,))
"""As for the twin, up to two causes at once."""

DRAWS, FIRST_STEPS, WORTH = 12, 6, 0.01
"""Places over the bounds at which causes are tried, steps from the likeliest of them, and the share of the gap that
these must gain to go on."""

MOST_PAIRS = 8
"""Pairs of causes that are tried from several starts: all of four or fewer candidates."""

NEAR_share = 0.02
"""Share of the gap that one cause more must take to be told as what comes nearest."""

LEAST_GAIN, LEAST_SHRINK = 10.0, 0.3
"""By how much χ² and the gap must fall on samples held back: what falls by less is no cause, whatever its evidence."""

ENOUGH_SHRINK = 0.85
"""Share of the gap, held out, from which causes explain it although structure is left: another equation of them."""

IMITATED = 1e-3
"""Share of the energy of an offset common to all runs up to which the base has it as its own."""

STANDS_OUT = 1.5
"""Share of the gap over share of time from which a condition is listed."""


@dataclass(frozen=True, eq=False)
class SimulatorDiagnosis:
    """What is found of a simulator; parts as in `Diagnosis`."""

    simulator: Simulator
    serial: str
    verdict: DiagnosisVerdict
    base: Fit
    best: Fit
    causes: tuple[RankedCause, ...]
    places: tuple[GapPlace, ...]
    gap: dict[str, ChannelGap]
    shrink: Shrink
    protocol: str
    chosen: tuple[tuple[str, ...], ...]
    ambiguous_with: list[list[str]]
    hidden_fraction: dict[str, float]
    next_experiment: NextExperiment
    explained_share: float
    told: Identifiability
    mistakes: tuple[DataMistake, ...] = ()
    residual: LearnedResidual[SimulatorTerm] | None = None

    def report(self) -> dict[str, object]:
        """Return the report of schema `softcal.gap/1`; `parameters` are those of the simulator that explains most."""
        return {
            "schema": SCHEMA,
            "simulator": self.simulator.name,
            "verdict": self.verdict,
            "serial": self.serial,
            "data": [found.record() for found in self.mistakes],
            "gap": {name: vars(gap) for name, gap in self.gap.items()},
            "shrink": vars(self.shrink) | {"protocol": self.protocol, "chosen": [list(ids) for ids in self.chosen]},
            "where": [place.record() for place in self.places],
            "causes": [
                vars(c) | {"parameters": {name: vars(p) for name, p in c.parameters.items()}} for c in self.causes
            ],
            "ambiguous_with": self.ambiguous_with,
            "hidden_fraction": self.hidden_fraction,
            "next_experiment": self.next_experiment.record(),
            "explained_share": self.explained_share,
            "partial": None if self.partial is None else vars(self.partial) | {"effects": list(self.partial.effects)},
            "identifiability": self.told.record(),
            "residual": self._residual_record(),
            "failed": self.failures.record(),
            "offsets": self.offsets,
            "parameters": self.simulator.named(self.best.hypothesis, self.best.coordinates),
            "base": self.simulator.named(self.base.hypothesis, self.base.coordinates),
        }

    def _residual_record(self) -> dict[str, object] | None:
        if self.residual is None:
            return None
        found = self.residual.fit
        return self.residual.record() | {
            "added": [one.term.record() for one in self.residual.terms],
            "parameters": self.simulator.named(found.hypothesis, found.coordinates),
        }

    @property
    def partial(self) -> Partial | None:
        """The causes that come nearest where nothing explains the gap."""
        ids = self.best.hypothesis.ids
        return Partial(ids, self.explained_share) if self.verdict == "unknown" and ids else None

    @property
    def failures(self) -> Failures:
        """How often the simulator failed on the way."""
        problem = self.base.problem
        return problem.failures if isinstance(problem, SimulatorProblem) else Failures()

    @property
    def offsets(self) -> list[dict[str, object]]:
        """What every run has of its own and no cause has to explain, by run and channel."""
        problem, kinds = self.best.problem, self.simulator.offsets
        sizes = problem.offset_sizes(self.best.hypothesis, self.best.coordinates)
        return [
            {"run": problem.case.runs[run].name, "channel": channel, kind: float(size)}
            for run, row in sizes.items()
            for (channel, kind), size in zip(kinds, row, strict=True)
        ]


def diagnose_simulator(
    simulator: Simulator, runs: Sequence[SimulatorRun], serial: str = "", progress: Progress | None = None
) -> SimulatorDiagnosis:
    """Diagnose the gap between a simulator and recordings of what it simulates.

    Args:
        runs: made by `recorded`.
        serial: of the unit, for the report.
        progress: called with one line at every step.

    Raises:
        InputError: no run, or the simulator gives something else than finite channels.
    """
    if not runs:
        raise InputError(f"simulator {simulator.name}: no run was given; a diagnosis needs one")
    say = progress or (lambda _: None)
    case = Case(serial, tuple(runs))
    base, spoilt = _base_or_mistakes(simulator, case, say)
    if spoilt:
        return _stopped(simulator, base, spoilt)
    told = told_by(simulator, base)
    for line in sentences(told):
        say(line)
    search = _searched(simulator, base, told, say)
    doubted = let_go(search)
    best, ids = search.best, [c.id for c in simulator.candidates]
    logs = log_evidences(search.fits)
    group, idle = on_unseen(rivals(search.fits, best, logs), doubted)
    doubted |= idle
    say("measuring the shrink on samples no fit has seen")
    quantified = quantify(search.base, best, search.fits.values())
    verdict = _verdict(search, group, quantified)
    if verdict == "unknown":
        best = _nearest(search)
        quantified = quantify(search.base, best, is_given=True)
        if not _stands(quantified):
            best = search.base
            quantified = quantify(search.base, best)
    elif verdict == "no_gap" and best.hypothesis.ids:
        best, group = search.base, (search.base,)
        quantified = quantify(search.base, best)
    share = float(np.clip(search.share(best), 0.0, 1.0))
    doubt = _trust(quantified, best) if verdict in ("unknown", "no_gap") else 1.0
    every = chances_of(logs, group, ids)
    chances = {i: p * doubt * (IMITATED_TRUST if i in doubted else 1.0) for i, p in every.items()}
    causes = _causes(search, best, simulator, group, chances, quantified.shrink.held_out)
    return SimulatorDiagnosis(
        simulator=simulator,
        serial=serial,
        verdict=verdict,
        base=search.base,
        best=best,
        causes=causes,
        places=_places(search, best, causes, verdict),
        gap=quantified.gap,
        shrink=quantified.shrink,
        protocol=quantified.protocol,
        chosen=quantified.chosen,
        ambiguous_with=confused_pairs(group),
        hidden_fraction={i: hidden_fraction(best, i) for i in best.hypothesis.ids},
        next_experiment=_next(simulator, group, verdict),
        explained_share=share,
        told=told,
        mistakes=cut_off(simulator, case),
        residual=_described(search.base, best, verdict, say),
    )


def _described(base: Fit, best: Fit, verdict: DiagnosisVerdict, say: Progress) -> LearnedResidual[SimulatorTerm] | None:
    """Return the empirical terms that describe what the named causes leave; none where nothing is left."""
    if verdict == "no_gap":
        return None
    say("describing what is left")

    def known(found: Fit) -> Iterable[SimulatorTerm]:
        problem = found.problem
        return terms_of(problem, found.predicted) if isinstance(problem, SimulatorProblem) else ()

    return learned(base, (base, best) if verdict == "unknown" else (best,), known)


def check_simulator(
    simulator: Simulator, runs: Sequence[SimulatorRun]
) -> tuple[tuple[DataMistake, ...], Identifiability | None]:
    """Return the mistakes in recordings and, where there is none, what they tell of a simulator: nothing is searched.

    Raises:
        InputError: as for `diagnose_simulator`.
    """
    if not runs:
        raise InputError(f"simulator {simulator.name}: no run was given; a check needs one")
    case = Case("", tuple(runs))
    base, spoilt = _base_or_mistakes(simulator, case, lambda _: None)
    return (spoilt, None) if spoilt else (cut_off(simulator, case), told_by(simulator, base))


def _base_or_mistakes(simulator: Simulator, case: Case, say: Progress) -> tuple[Fit, tuple[DataMistake, ...]]:
    say("looking for mistakes in the recordings")
    spoilt = shown(simulator, case)
    say(f"fitting {simulator.name} to all runs")
    base = base_fit(simulator, case)
    return base, spoilt or against_others(base)


def _stopped(simulator: Simulator, base: Fit, found: tuple[DataMistake, ...]) -> SimulatorDiagnosis:
    """Return the diagnosis of recordings that hold a mistake: nothing is named and nothing forecast."""
    return SimulatorDiagnosis(
        simulator=simulator,
        serial=base.problem.case.serial,
        verdict="data",
        base=base,
        best=base,
        causes=tuple(RankedCause(c.id, c.stage, 0.0, 0.0, {}) for c in simulator.candidates),
        places=(),
        gap=gap_of_base(base),
        shrink=Shrink(0.0, 0.0, 0.0, 0.0),
        protocol=NOT_MEASURED,
        chosen=(),
        ambiguous_with=[],
        hidden_fraction={},
        next_experiment=NextExperiment("none", several([one.repair for one in found])),
        explained_share=0.0,
        told=Identifiability(()),
        mistakes=found,
    )


def _searched(simulator: Simulator, base: Fit, told: Identifiability, say: Progress) -> "SimulatorSearch":
    """Search, and once more where what is left may be noise that fades; keep that only where it is shown to be."""
    # What every run may have of its own needs no cause: a slightly other equation of it would be named as one.
    candidates = tuple(c for c in simulator.candidates if not told[c.id].is_own)
    search = SimulatorSearch(candidates, base, say)
    search.run()
    if search.is_clean(search.best):
        return search

    def is_floor(found: Fit) -> bool:
        return is_noise(found, (is_high, is_quick), followed)

    # What the most flexible hypothesis leaves is noise, or what a smaller one leaves is not either.
    closest = min(search.fits.values(), key=lambda found: found.chi2)
    problem = coloured(closest)
    if problem is None or not is_floor(fit(problem, closest.hypothesis, closest.coordinates)):
        return search

    def again(problem: Problem) -> SimulatorSearch:
        return SimulatorSearch(candidates, best_start(problem, base.hypothesis), say)

    return under_its_floor(search, again, is_floor, say)


def _trust(quantified: Quantified, best: Fit) -> float:
    """How far the evidence among the candidates is trusted where they leave a gap: the truth may be none of them."""
    return UNKNOWN_TRUST * quantified.shrink.held_out if best.hypothesis.ids else UNKNOWN_TRUST


def _nearest(search: EffectSearch) -> Fit:
    """Return the hypothesis that takes most of the gap away; of those within a little of it, the simplest."""
    most = max(search.share(found) for found in search.fits.values())
    near = [found for found in search.fits.values() if search.share(found) >= most - NEAR_share]
    return min(near, key=lambda found: (len(found.hypothesis.ids), found.chi2))


class SimulatorSearch(EffectSearch):
    """The search over the candidates of a simulator; nothing is placed first, and a cause has one realisation."""

    def __init__(self, candidates: Sequence[Effect], base: Fit, say: Progress) -> None:
        runs = base.problem.case.runs
        duration_s = max(float(run.elapsed_s[-1]) for run in runs)
        extent = Extent(1.0, 1.0, 0.0, 1.0, duration_s, float(np.median(runs[0].step_s[1:])))
        self._candidates = candidates
        probes = tuple(Probe(c, row, c.is_one_sided) for c in candidates for row in c.probes(extent))
        self._begin(base, probes, (), extent, CONFIG, say)

    def _rough_start(self) -> Array:
        return self.base.coordinates[self.base.hypothesis.of_base]

    def _start_again(self) -> None:
        """Fit every cause and every pair from several starts where the likeliest hypothesis leaves structure.

        A level that was never reached promises nothing to first order, and two causes may gain only together.
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
        self._settle_noise(self._leader)

    def _likely_pairs(self) -> list[tuple[Effect, ...]]:
        """Return the pairs that promise most together, to first order and over many places of each."""
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
        return sorted(gains, key=lambda pair: -gains[pair])[:MOST_PAIRS]

    def _try(self, effects: tuple[Effect, ...]) -> None:
        """Fit causes from the likeliest of many places: by what each promises beside the others, and as they are."""
        problem, hypothesis, fits = self.base.problem, self.base.hypothesis, []
        for effect in effects:
            hypothesis = hypothesis.adding(effect)
            parent = self.fits.get(tuple(sorted(e.id for e in effects if e is not effect)))
            lead = None if parent is None else _best_lead(parent, effect)
            if parent is not None and lead is not None:
                fits.append(fit(problem, parent.hypothesis.adding(effect), lead.start(parent), steps=FIRST_STEPS))
        drawn = scattered([p for effect in hypothesis.effects for p in effect.parameters], DRAWS)
        places = [np.append(self.base.coordinates, place) for place in drawn]
        likely = likeliest(problem, hypothesis, places)[0]
        best = min((*fits, fit(problem, hypothesis, likely, steps=FIRST_STEPS)), key=lambda found: found.chi2)
        # What is not better after a few steps than the best with one cause less is left there.
        parts = [f.chi2 for ids, f in self.fits.items() if set(ids) < set(best.hypothesis.ids)]
        if best.chi2 < min(parts) - WORTH * max(self.base.chi2 - problem.count, 0.0):
            self.keep(fit(problem, best.hypothesis, best.coordinates, steps=60))

    def _try_forms(self, share: float) -> None:
        self._settle_noise(self._leader)

    def _try_forms_within(self, best: Fit) -> bool:
        return False

    def _find_stranger(self) -> Fit | None:
        return None


def _best_lead(parent: Fit, effect: Effect) -> Lead | None:
    """Return the best promise of an effect from places all over its bounds."""
    space = Tangent(parent)
    leads = [space.lead(Probe(effect, row, effect.is_one_sided)) for row in _rows(effect)]
    return max((lead for lead in leads if lead is not None), key=lambda lead: lead.gain, default=None)


def _rows(effect: Effect) -> list[tuple[float, ...]]:
    """Return values of an effect's parameters all over their bounds."""
    places = scattered(effect.parameters, DRAWS)
    return [tuple(from_fit(p, float(x)) for p, x in zip(effect.parameters, place, strict=True)) for place in places]


def base_fit(simulator: Simulator, case: Case) -> Fit:
    """Fit the base parameters alone from several starts, with noise levels from the residual.

    Raises:
        InputError: the simulator fails wherever it is tried.
    """
    problem = SimulatorProblem(case, dict.fromkeys(simulator.channels, 1.0), simulator=simulator)
    spans = {c: [problem.measured[b.place] for b in problem.blocks if b.channel == c] for c in simulator.channels}
    rough = {c: 0.02 * max(float(np.std(np.concatenate(parts))), 1e-12) for c, parts in spans.items()}
    hypothesis = Hypothesis(of_all=simulator.base)
    best = best_start(problem.with_noise(rough), hypothesis)
    if best.chi2 == np.inf:
        raise InputError(f"{problem.failures.first}; it fails at all {problem.failures.of} places that were tried")
    for _ in range(3):
        under = fit(best.problem.with_noise(noise_levels(best)), hypothesis, best.coordinates)
        best = fit(_shared_by_base(under), hypothesis, under.coordinates)
    return best


def _shared_by_base(found: Fit) -> Problem:
    """Return the problem with what all runs share of an offset left to the base where the base can take its shape."""
    problem = found.problem
    if not isinstance(problem, SimulatorProblem) or not len(problem.largest_offsets):
        return problem
    bare = fit(problem.bare, found.hypothesis, found.coordinates, steps=0)
    rows = rows_of_runs(problem, problem.directions(found.hypothesis, found.coordinates, bare.predicted, {}))
    space = Tangent(bare)
    shared = [bare.problem.whitened(row) for row in np.sum(list(rows.values()), axis=0)]
    return replace(problem, of_base=tuple(energy(space.visible(row)) < IMITATED * energy(row) for row in shared))


def told_by(simulator: Simulator, base: Fit) -> Identifiability:
    """Return what the runs of a base fit tell of a simulator, and which of its experiments would tell the rest."""
    names = [f"{kind} of {channel}" for channel, kind in simulator.offsets]
    return identifiability(base, simulator.candidates, menu_of(simulator), names)


def menu_of(simulator: Simulator) -> list[MenuEntry]:
    """Return the experiments of a simulator as runs that could be made."""
    return [MenuEntry(name, planned(simulator, name), one.minutes) for name, one in simulator.experiments.items()]


def _stands(quantified: Quantified) -> bool:
    """Whether the causes shrink the gap on samples that no fit has seen, beyond what noise does."""
    return quantified.held_out_gain > LEAST_GAIN and quantified.shrink.held_out > LEAST_SHRINK


def _verdict(search: EffectSearch, group: tuple[Fit, ...], quantified: Quantified) -> DiagnosisVerdict:
    best, held_out = search.best, quantified.shrink.held_out
    if not best.hypothesis.ids or not _stands(quantified):
        return "no_gap" if search.is_clean(search.base) else "unknown"
    if not search.is_clean(best) and held_out < ENOUGH_SHRINK:
        return "unknown"
    return "ambiguous" if len(group) > 1 else "explained"


def _causes(
    search: EffectSearch,
    best: Fit,
    simulator: Simulator,
    group: tuple[Fit, ...],
    chances: dict[str, float],
    held_out: float,
) -> tuple[RankedCause, ...]:
    shares = shares_of(search, best)

    def cause(effect: Effect) -> RankedCause:
        found = next((f for f in (best, *group) if effect.id in f.hypothesis.ids), search.fits.get((effect.id,)))
        parameters = estimates_of(found, effect.id) if found is not None else {}
        return RankedCause(
            effect.id, effect.stage, chances[effect.id], shares.get(effect.id, 0.0) * held_out, parameters
        )

    return tuple(sorted(map(cause, simulator.candidates), key=lambda c: (-c.probability, -c.shrink)))


def _places(
    search: EffectSearch, best: Fit, causes: tuple[RankedCause, ...], verdict: DiagnosisVerdict
) -> tuple[GapPlace, ...]:
    """Where the gap lies: parts of the mechanism where causes are named, then the conditions in which it stands out."""
    if verdict == "no_gap":
        return ()
    seen = regimes_of(search.base)
    everywhere = Reason("gap.regime.everywhere")
    channel, regime = (seen[0].channel, seen[0].name) if seen else (_loudest(search.base), everywhere)
    if verdict == "unknown":
        part, ids = float(np.clip(search.share(best), 0.0, 1.0)), best.hypothesis.ids
        nearest = Reason("gap.seen.no_candidate")
        if ids:
            nearest = reason("gap.seen.nearest", causes=next_experiment.named(ids, "gap.both"), share=part)
        places = [GapPlace("unknown", channel, regime, 1.0, nearest)]
    else:
        named = [c for c in causes if c.effect in best.hypothesis.ids]
        total = sum(c.shrink for c in named) or 1.0
        places = [
            GapPlace(c.stage, channel, regime, c.shrink / total, reason("gap.effect", effect=c.effect)) for c in named
        ]
    at = places[0].stage
    lines = [
        GapPlace(at, r.channel, r.name, r.share, reason("gap.seen.energy_of_all", share=r.share, lift=r.lift))
        for r in seen[:4]
    ]
    return (*places, *lines)


def _loudest(found: Fit) -> str:
    """Return the channel with the most structure left."""
    return max(found.problem.scored_channels, key=lambda channel: structure(found, channel).z)


def regimes_of(found: Fit) -> list[Regime]:
    """Return the conditions in which the residual of a channel stands out, by share and lift, strongest first."""
    out = []
    for channel in found.problem.scored_channels:
        blocks = [b for b in found.problem.blocks if b.channel == channel]
        excess = np.concatenate([found.residual[b.place] ** 2 - 1.0 for b in blocks])
        total = float(excess.sum())
        if total <= 4 * np.sqrt(2 * len(excess)):
            continue
        for name, members in _conditions(found, blocks).items():
            time_share = float(np.mean(members))
            share = float(np.clip(excess[members].sum() / total, 0.0, 1.0)) if 0.01 < time_share < 0.95 else 0.0
            if share > STANDS_OUT * time_share:
                out.append(Regime(channel, name, share, share / time_share))
    return sorted(out, key=lambda r: -r.share * np.log(r.lift))


def _conditions(found: Fit, blocks: list[Block]) -> dict[Reason, Array]:
    """Which samples of a channel lie at a level, a slope or a time, and in which run."""
    runs = [found.problem.case.runs[b.run] for b in blocks]
    predicted = [found.predicted[b.place] for b in blocks]
    slope = np.concatenate([np.gradient(p, r.t_s) for p, r in zip(predicted, runs, strict=True)])
    level, part = np.concatenate(predicted), np.concatenate([r.elapsed_s / r.elapsed_s[-1] for r in runs])
    low, high = np.quantile(level, (0.2, 0.8))
    calm, quick = np.quantile(np.abs(slope), (0.3, 0.7))
    of_run = np.concatenate([np.full(len(r), k) for k, r in enumerate(runs)])
    out = {
        Reason("gap.regime.low_level"): level < low,
        Reason("gap.regime.high_level"): level > high,
        Reason("gap.regime.rising"): slope > quick,
        Reason("gap.regime.falling"): slope < -quick,
        Reason("gap.regime.fast_change"): np.abs(slope) > quick,
        Reason("gap.regime.still"): np.abs(slope) < calm,
        Reason("gap.regime.start"): part < 0.25,
        Reason("gap.regime.end"): part > 0.75,
    }
    return out | {reason("gap.regime.run", run=run.name): of_run == k for k, run in enumerate(runs)}


def _next(simulator: Simulator, group: tuple[Fit, ...], verdict: DiagnosisVerdict) -> NextExperiment:
    if verdict == "unknown":
        return NextExperiment("none", Reason("gap.next.add_candidate"))
    if len(group) < 2:
        no_gap, separated = Reason("gap.next.no_gap"), Reason("gap.next.separated_here")
        return NextExperiment("none", no_gap if verdict == "no_gap" else separated)
    entries = menu_of(simulator)
    if not entries:
        return NextExperiment("none", reason("gap.next.no_experiments", causes=next_experiment.causes_of(group)))
    return next_experiment.most_telling(entries, group)
