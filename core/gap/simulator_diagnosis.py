"""The diagnosis of a simulator of somebody else: where, which, how far, how sure, what to run next.

Hypotheses, evidence, rivals, hidden fractions and held-out shrink are those of the soft sensor's twin; only what
predicts the channels is another.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from softcal.core.errors import InputError
from softcal.core.gap import next_experiment
from softcal.core.gap.ambiguity import confused_pairs, hidden_fraction, rivals
from softcal.core.gap.candidates import Probe
from softcal.core.gap.case import Case
from softcal.core.gap.coordinates import from_fit
from softcal.core.gap.diagnosis import (
    SCHEMA,
    UNKNOWN_TRUST,
    DiagnosisVerdict,
    GapPlace,
    RankedCause,
    chances_of,
    estimates_of,
    shares_of,
)
from softcal.core.gap.fit import Block, Fit, Hypothesis, fit
from softcal.core.gap.next_experiment import NextExperiment
from softcal.core.gap.posterior import log_evidences
from softcal.core.gap.residual import Regime, structure
from softcal.core.gap.screen import Tangent
from softcal.core.gap.search import EffectSearch, Progress, SearchConfig
from softcal.core.gap.shrink import ChannelGap, Shrink, quantify
from softcal.core.gap.simulator import (
    Simulator,
    SimulatorProblem,
    SimulatorRun,
    planned,
)
from softcal.core.gap.start import best_of, best_start, noise_levels, scattered
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect
from softcal.core.twin.probes import Extent
from softcal.core.words.reason import Reason, reason

CONFIG = SearchConfig(leads=(8, 5), beam=(3,))
"""As for the twin, up to two causes at once."""

DRAWS = 10
"""Places at which an effect is tried, over its bounds."""

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

    def report(self) -> dict[str, object]:
        """Return the report of schema `softcal.gap/1`; `parameters` are those of the simulator that explains most."""
        found = self.base if self.verdict == "unknown" else self.best
        return {
            "schema": SCHEMA,
            "simulator": self.simulator.name,
            "verdict": self.verdict,
            "serial": self.serial,
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
            "parameters": self.simulator.named(found.hypothesis, found.coordinates),
        }


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
    search = SimulatorSearch(simulator, Case(serial, tuple(runs)), say)
    search.run()
    best, ids = search.best, [c.id for c in simulator.candidates]
    logs = log_evidences(search.fits)
    group = rivals(search.fits, best, logs)
    say("measuring the shrink on samples no fit has seen")
    quantified = quantify(search.base, best, search.fits.values())
    share = float(np.clip(search.share(best), 0.0, 1.0))
    verdict = _verdict(search, group)
    doubt = UNKNOWN_TRUST * share if verdict == "unknown" else 1.0
    chances = {i: p * doubt for i, p in chances_of(logs, group, ids).items()}
    causes = _causes(search, simulator, group, chances, quantified.shrink.held_out)
    return SimulatorDiagnosis(
        simulator=simulator,
        serial=serial,
        verdict=verdict,
        base=search.base,
        best=best,
        causes=causes,
        places=_places(search, causes, verdict),
        gap=quantified.gap,
        shrink=quantified.shrink,
        protocol=quantified.protocol,
        chosen=quantified.chosen,
        ambiguous_with=confused_pairs(group),
        hidden_fraction={i: hidden_fraction(best, i) for i in best.hypothesis.ids},
        next_experiment=_next(simulator, group, verdict),
        explained_share=share,
    )


class SimulatorSearch(EffectSearch):
    """The search over the candidates of a simulator; nothing is placed first, and a cause has one realisation."""

    def __init__(self, simulator: Simulator, case: Case, say: Progress) -> None:
        say(f"fitting {simulator.name} to all runs")
        base = base_fit(simulator, case)
        duration_s = max(float(run.elapsed_s[-1]) for run in case.runs)
        extent = Extent(1.0, 1.0, 0.0, 1.0, duration_s, float(np.median(case.runs[0].step_s[1:])))
        probes = tuple(Probe(c, row, c.is_one_sided) for c in simulator.candidates for row in c.probes(extent))
        self._candidates = simulator.candidates
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
            self._try(self.base, effect)
        singles = sorted((f for ids, f in self.fits.items() if len(ids) == 1), key=lambda f: f.chi2)
        for found in singles:
            for effect in self._candidates:
                self._try(found, effect)
        super()._start_again()

    def _try(self, parent: Fit, effect: Effect) -> None:
        """Fit an effect on top of a parent from the likeliest of many places, by promise and as they are."""
        if effect.id in parent.hypothesis.ids:
            return
        tangent, hypothesis = Tangent(parent), parent.hypothesis.adding(effect)
        places = scattered(effect.parameters, DRAWS)
        rows = [[from_fit(p, float(x)) for p, x in zip(effect.parameters, place, strict=True)] for place in places]
        leads = [tangent.lead(Probe(effect, tuple(row), effect.is_one_sided)) for row in rows]
        starts = [lead.start(parent) for lead in sorted((x for x in leads if x), key=lambda x: -x.gain)[:2]]
        starts += [np.append(parent.coordinates, place) for place in places]
        self.keep(best_of(parent.problem, hypothesis, starts))

    def _try_forms(self, share: float) -> None:
        self._settle_noise(self._leader)

    def _try_forms_within(self, best: Fit) -> bool:
        return False

    def _find_stranger(self) -> Fit | None:
        return None


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
        best = fit(best.problem.with_noise(noise_levels(best)), hypothesis, best.coordinates)
    return best


def _verdict(search: EffectSearch, group: tuple[Fit, ...]) -> DiagnosisVerdict:
    best = search.best
    if not best.hypothesis.ids:
        return "unknown" if structure(best).is_significant else "no_gap"
    if not search.is_explained(best):
        return "unknown"
    return "ambiguous" if len(group) > 1 else "explained"


def _causes(
    search: EffectSearch, simulator: Simulator, group: tuple[Fit, ...], chances: dict[str, float], held_out: float
) -> tuple[RankedCause, ...]:
    shares = shares_of(search, search.best)

    def cause(effect: Effect) -> RankedCause:
        found = next((f for f in group if effect.id in f.hypothesis.ids), search.fits.get((effect.id,)))
        parameters = estimates_of(found, effect.id) if found is not None else {}
        return RankedCause(
            effect.id, effect.stage, chances[effect.id], shares.get(effect.id, 0.0) * held_out, parameters
        )

    return tuple(sorted(map(cause, simulator.candidates), key=lambda c: (-c.probability, -c.shrink)))


def _places(search: EffectSearch, causes: tuple[RankedCause, ...], verdict: DiagnosisVerdict) -> tuple[GapPlace, ...]:
    """Where the gap lies: parts of the mechanism where causes are named, then the conditions in which it stands out."""
    if verdict == "no_gap":
        return ()
    seen = regimes_of(search.base)
    everywhere = Reason("gap.regime.everywhere")
    channel, regime = (seen[0].channel, seen[0].name) if seen else (_loudest(search.base), everywhere)
    if verdict == "unknown":
        part, ids = float(np.clip(search.share(search.best), 0.0, 1.0)), search.best.hypothesis.ids
        nearest = Reason("gap.seen.no_candidate")
        if ids:
            nearest = reason("gap.seen.nearest", causes=next_experiment.named(ids, "gap.both"), share=part)
        places = [GapPlace("unknown", channel, regime, 1.0, nearest)]
    else:
        named = [c for c in causes if c.effect in search.best.hypothesis.ids]
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
    entries = [
        next_experiment.MenuEntry(name, planned(simulator, name), entry.minutes)
        for name, entry in simulator.experiments.items()
    ]
    if not entries:
        return NextExperiment("none", reason("gap.next.no_experiments", causes=next_experiment.causes_of(group)))
    return next_experiment.most_telling(entries, group)
