"""Which effects a case can show, and where the search for each of them begins on it."""

from dataclasses import dataclass

import numpy as np

from softcal.core.gap.case import Case
from softcal.core.gap.scale import RigScale
from softcal.core.twin.catalogue import EFFECTS
from softcal.core.twin.effects import Alias, Effect
from softcal.core.twin.probes import Extent


@dataclass(frozen=True)
class Probe:
    """An effect at a small size and one shape, to see which way it would move the prediction.

    Args:
        values: parameter values, the size first.
        is_one_sided: the size cannot change its sign.
    """

    effect: Effect
    values: tuple[float, ...]
    is_one_sided: bool


def extent_of(case: Case, deformation_mm: float, force_N: float) -> Extent:
    """Measure a case; deformation and force come from the fitted base."""
    outputs = [run.output_V for run in case.presses if run.output_V is not None]
    every_V = np.concatenate(outputs) if outputs else np.array([0.0, 1.0])
    return Extent(
        depth_mm=max(deformation_mm, 1e-9),
        force_N=max(force_N, 1e-9),
        lowest_V=float(every_V.min()),
        highest_V=float(every_V.max()),
        duration_s=max(float(run.elapsed_s[-1]) for run in case.presses),
        period_s=1.0 / case.readout.sample_rate_Hz,
        series_ohm=case.readout.r_series_ohm,
    )


def visible_effects(case: Case) -> tuple[Effect, ...]:
    """Return the effects that the recorded channels can show at all."""

    def is_followed(channel: str) -> bool:
        logs = [getattr(run, channel) for run in case.presses]
        return any(log is not None and np.ptp(log) > 0 for log in logs)

    seen = [effect for effect in EFFECTS.values() if effect.stage not in case.unseen_stages]
    return tuple(effect for effect in seen if all(map(is_followed, effect.signs.needs)))


def probes(case: Case, extent: Extent) -> tuple[Probe, ...]:
    """Return the probes of every visible effect whose place in time need not be searched first."""
    sized = RigScale.of(case).sized
    return tuple(Probe(e, row, e.is_one_sided) for e in visible_effects(case) for row in e.probes(extent, sized))


def is_told(case: Case, alias: Alias) -> bool:
    """Whether a run of the case tells an effect from what looks exactly like it elsewhere."""
    logs = [getattr(run, alias.changing) for run in case.runs if run.kind == alias.told_by]
    return any(log is not None and np.ptp(log) >= alias.by for log in logs)
