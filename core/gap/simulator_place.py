"""Where the gap of a simulator lies: parts of the mechanism, then the conditions in which it stands out."""

import numpy as np

from softcal.core.gap import next_experiment
from softcal.core.gap.fit import Fit
from softcal.core.gap.named_causes import DiagnosisVerdict, GapPlace, RankedCause
from softcal.core.gap.problem import Block
from softcal.core.gap.residual import Regime, shares_of_gap, structure
from softcal.core.gap.search import EffectSearch
from softcal.core.recording import Array
from softcal.core.words.reason import Reason, reason

STANDS_OUT = 1.5
"""Share of the gap over share of time from which a condition is listed."""


def places_of(
    search: EffectSearch, best: Fit, causes: tuple[RankedCause, ...], verdict: DiagnosisVerdict
) -> tuple[GapPlace, ...]:
    """Where the gap lies: parts of the mechanism where causes are named, then the conditions in which it stands out."""
    if verdict == "no_gap":
        return ()
    seen = regimes_of(search.base)
    everywhere = Reason("gap.regime.everywhere")
    loudest = max(search.base.problem.scored_channels, key=lambda channel: structure(search.base, channel).z)
    channel, regime = (seen[0].channel, seen[0].name) if seen else (loudest, everywhere)
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


def regimes_of(found: Fit) -> list[Regime]:
    """Return the conditions in which the residual of a channel stands out, by share and lift, strongest first."""
    out = []
    for channel in found.problem.scored_channels:
        blocks = found.problem.blocks_of(channel)
        for name, part, time_share in shares_of_gap(found, blocks, _conditions(found, blocks)):
            share = float(np.clip(part, 0.0, 1.0))
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
