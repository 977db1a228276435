"""The diagnosis of a simulator of somebody else: where, which, how far, how sure, what next.

Hypotheses, evidence, rivals, hidden fractions and held-out shrink are those of the twin.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from softcal.core.errors import InputError
from softcal.core.gap import next_experiment
from softcal.core.gap.case import Case
from softcal.core.gap.data_mistake import DataMistake
from softcal.core.gap.empirical import learned
from softcal.core.gap.fit import Fit, fit
from softcal.core.gap.floor import coloured, is_noise
from softcal.core.gap.gap_diagnosis import (
    DiagnosisVerdict,
    GapDiagnosis,
    GapPlace,
    RankedCause,
    beside_rest,
    judged,
    partial_of,
    places_of,
    ranked_causes,
    regime_places,
    under_its_floor,
)
from softcal.core.gap.identifiability import Identifiability, identifiability, reasons
from softcal.core.gap.next_experiment import MenuEntry, NextExperiment
from softcal.core.gap.problem import Block, Hypothesis, Problem
from softcal.core.gap.residual import Regime, shares_of_gap, structure
from softcal.core.gap.search import EffectSearch, Progress
from softcal.core.gap.simulator import Simulator, SimulatorRun, SimulatorTerm, planned, terms_of
from softcal.core.gap.simulator_check import check_calls
from softcal.core.gap.simulator_plausibility import against_others, cut_off, shown
from softcal.core.gap.simulator_problem import Failures, SimulatorProblem, followed, is_high, is_quick
from softcal.core.gap.simulator_search import SimulatorSearch, base_fit
from softcal.core.metrics import finite_or_none
from softcal.core.recording import Array
from softcal.core.words.reason import Reason, reason

STANDS_OUT = 1.5
"""Share of the gap over share of time from which a condition is listed."""


def _places(
    search: EffectSearch, best: Fit, causes: tuple[RankedCause, ...], verdict: DiagnosisVerdict
) -> tuple[GapPlace, ...]:
    if verdict == "no_gap":
        return ()
    base, seen = search.base, []
    for channel in base.problem.scored_channels:
        blocks = base.problem.blocks_of(channel)
        for name, part, time_share in shares_of_gap(base, blocks, _conditions(base, blocks)):
            share = float(np.clip(part, 0.0, 1.0))
            if share > STANDS_OUT * time_share:
                seen.append(Regime(channel, name, share, share / time_share))
    seen.sort(key=lambda r: -r.share * np.log(r.lift))
    loudest = max(base.problem.scored_channels, key=lambda channel: structure(base, channel).z)
    channel, regime = (seen[0].channel, seen[0].name) if seen else (loudest, Reason("gap.regime.everywhere"))
    if verdict == "unknown":
        part, ids = search.explained_share(best), best.ids
        nearest = Reason("gap.seen.no_candidate")
        if ids:
            nearest = reason("gap.seen.nearest", causes=next_experiment.named(ids, "gap.both"), share=part)
        places = [GapPlace("unknown", channel, regime, 1.0, nearest)]
    else:
        named = [c for c in causes if c.effect in best.ids]
        places = places_of(named, channel, regime, lambda effect_id: reason("gap.effect", effect=effect_id))
        if verdict == "explained_in_part":
            places = beside_rest(places, GapPlace("unknown", channel, regime, 1.0 - search.explained_share(best)))
    return (*places, *regime_places(places[0].stage, seen, "gap.seen.energy_of_all"))


def _conditions(found: Fit, blocks: list[Block]) -> dict[Reason, Array]:
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


@dataclass(frozen=True, eq=False, kw_only=True)
class SimulatorDiagnosis(GapDiagnosis[SimulatorTerm]):
    """The diagnosis of a simulator of somebody else."""

    simulator: Simulator

    def report(self) -> dict[str, object]:
        """Return the report of the contract, ready for JSON; an effect that is off at infinity is None."""
        report, named = super().report(), self._parameters
        if self.residual is not None:
            found = self.residual.fit
            report["residual"] = self.residual.record() | {
                "added": [one.term.record() for one in self.residual.terms],
                "parameters": named(found.hypothesis, found.coordinates),
            }
        return report | {
            "simulator": self.simulator.name,
            "failed": self.failures.record(),
            "offsets": self.offsets,
            "parameters": named(self.best.hypothesis, self.best.coordinates),
            "base": named(self.base.hypothesis, self.base.coordinates),
        }

    def _parameters(self, hypothesis: Hypothesis, coordinates: Array) -> dict[str, float | None]:
        return {name: finite_or_none(v) for name, v in self.simulator.named(hypothesis, coordinates).items()}

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

    Raises:
        InputError: no run, or the simulator gives something else than finite channels.
    """
    if not runs:
        raise InputError(f"simulator {simulator.name}: no run was given; a diagnosis needs one")
    say = progress or (lambda _: None)
    say("calling the simulator a few times")
    check_calls(simulator, runs)
    case, simulator = Case(serial, tuple(runs)), simulator.of_runs([run.name for run in runs])
    base, mistakes, questions = _base_and_mistakes(simulator, case, say)
    if mistakes:
        return SimulatorDiagnosis.stopped(base, simulator.candidates, mistakes, simulator=simulator)
    told = told_by(simulator, base)
    for untold in reasons(told):
        say(str(untold))
    search = _searched(simulator, base, told, say)
    judgement = judged(search, [c.id for c in simulator.candidates], say)
    best, verdict = judgement.best, judgement.verdict
    held_out = judgement.quantified.shrink.held_out
    causes = ranked_causes(search, best, simulator.candidates, judgement.group, judgement.chances, held_out)
    diagnosis = SimulatorDiagnosis.of(
        search.base,
        judgement,
        simulator=simulator,
        best=best,
        causes=causes,
        places=_places(search, best, causes, verdict),
        next_experiment=_next(simulator, judgement.group, verdict),
        explained_share=search.explained_share(best),
        told=told,
        mistakes=questions,
        partial=partial_of(search, judgement),
    )
    if verdict == "no_gap":
        return diagnosis
    say("describing what is left")
    parents = (search.base, best) if verdict == "unknown" and best.ids else (best,)
    return replace(diagnosis, residual=learned(search.base, parents, partial(terms_of, simulator)))


def check_simulator(
    simulator: Simulator, runs: Sequence[SimulatorRun]
) -> tuple[tuple[DataMistake, ...], Identifiability | None]:
    """Return the mistakes in recordings and, without any, what they tell of a simulator; no search.

    Raises:
        InputError: as for `diagnose_simulator`.
    """
    if not runs:
        raise InputError(f"simulator {simulator.name}: no run was given; a check needs one")
    check_calls(simulator, runs)
    case, simulator = Case("", tuple(runs)), simulator.of_runs([run.name for run in runs])
    base, mistakes, questions = _base_and_mistakes(simulator, case, lambda _: None)
    return (mistakes, None) if mistakes else (questions, told_by(simulator, base))


def _base_and_mistakes(
    simulator: Simulator, case: Case, say: Progress
) -> tuple[Fit, tuple[DataMistake, ...], tuple[DataMistake, ...]]:
    """Return the fitted base, the mistakes that stop a diagnosis, and those that are a question beside it."""
    say("looking for mistakes in the recordings")
    mistakes = shown(simulator, case)
    say(f"fitting {simulator.name} to all runs")
    base = base_fit(simulator, case)
    if mistakes:
        return base, mistakes, ()
    test, questions = against_others(base), cut_off(simulator, case)
    if test is None:
        return base, (), questions
    return (base, (test.mistake,), ()) if test.is_claim else (base, (), (test.mistake, *questions))


def _searched(simulator: Simulator, base: Fit, told: Identifiability, say: Progress) -> "SimulatorSearch":
    # What every run may have of its own needs no cause: its equation's error would be named as one.
    candidates = tuple(c for c in simulator.candidates if not told[c.id].is_own)
    search = SimulatorSearch(candidates, base, say)
    search.run()
    if search.is_clean(search.best):
        return search

    def is_floor(found: Fit) -> bool:
        return is_noise(found, (is_high, is_quick), followed)

    # What the most flexible hypothesis leaves is noise, or what a smaller one leaves is not either.
    closest = search.closest
    problem = coloured(closest)
    if problem is None or not is_floor(fit(problem, closest.hypothesis, closest.coordinates)):
        return search

    def again(problem: Problem) -> SimulatorSearch:
        # Another noise moves the minimum a little: it is near the base's, or that of the closest.
        starts = (base.coordinates, closest.coordinates[base.hypothesis.of_base])
        fits = [fit(problem, base.hypothesis, start, steps=60) for start in starts]
        return SimulatorSearch(candidates, min(fits, key=lambda found: found.chi2), say)

    return under_its_floor(search, again, is_floor, say)


def told_by(simulator: Simulator, base: Fit) -> Identifiability:
    """Return what the runs of a base fit tell, and which experiments tell the rest."""
    names = [f"{kind} of {channel}" for channel, kind in simulator.offsets]
    return identifiability(base, simulator.candidates, menu_of(simulator), names)


def menu_of(simulator: Simulator) -> list[MenuEntry]:
    """Return the experiments of a simulator as runs that could be made."""
    return [MenuEntry(name, planned(simulator, name), one.minutes) for name, one in simulator.experiments.items()]


def _next(simulator: Simulator, group: tuple[Fit, ...], verdict: DiagnosisVerdict) -> NextExperiment:
    if verdict == "unknown":
        return NextExperiment("none", Reason("gap.next.add_candidate"))
    if verdict == "explained_in_part" and len(group) < 2:
        return NextExperiment("none", Reason("gap.next.name_rest"))
    if len(group) < 2:
        no_gap, separated = Reason("gap.next.no_gap"), Reason("gap.next.separated_here")
        return NextExperiment("none", no_gap if verdict == "no_gap" else separated)
    entries = menu_of(simulator)
    if not entries:
        return NextExperiment("none", reason("gap.next.no_experiments", causes=next_experiment.causes_of(group)))
    return next_experiment.most_telling(entries, group)
