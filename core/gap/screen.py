"""Which effects a case can show and which are worth a full fit: score tests of every probe."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from softcal.core.gap.case import Case
from softcal.core.gap.coordinates import RigScale, start_coordinates
from softcal.core.gap.fit import Fit, fit
from softcal.core.gap.linear import combine, dots, energy, gram
from softcal.core.gap.problem import Around
from softcal.core.recording import Array
from softcal.core.twin.catalogue import EFFECTS
from softcal.core.twin.effects import Alias, Effect
from softcal.core.twin.probes import Extent


@dataclass(frozen=True)
class Probe:
    """An effect at a small size and one shape, to see which way it would move the prediction."""

    effect: Effect
    values: tuple[float, ...]
    is_one_sided: bool


def extent_of(base: Fit) -> Extent:
    """Measure a case; depth and force beyond what was recorded come from the fitted base."""
    case = base.problem.case
    depths = [float(stage_mm.max()) for stage_mm in case.recorded("stage_mm")]
    depth_mm = max(depths) - base.base.u0_mm if depths else 1.0
    forces = [float(force_N.max()) for force_N in case.recorded("force_N")]
    force_N = max(forces, default=base.base.k1_N_mm * depth_mm + base.base.k3_N_mm3 * depth_mm**3)
    every_V = np.concatenate(case.recorded("output_V") or [np.array([0.0, 1.0])])
    return Extent(
        depth_mm=max(depth_mm, 1e-9),
        force_N=max(force_N, 1e-9),
        lowest_V=float(every_V.min()),
        highest_V=float(every_V.max()),
        duration_s=max(float(run.elapsed_s[-1]) for run in case.presses),
        period_s=1.0 / case.readout.sample_rate_Hz,
        series_ohm=case.readout.r_series_ohm,
    )


def visible_effects(case: Case, effects: Mapping[str, Effect] = EFFECTS) -> tuple[Effect, ...]:
    """Return the effects of a list that the recorded channels can show at all."""
    seen = [effect for effect in effects.values() if effect.stage not in case.unseen_stages]
    return tuple(effect for effect in seen if all(map(case.changes, effect.signs.needs)))


def probes(case: Case, extent: Extent, effects: Mapping[str, Effect] = EFFECTS) -> tuple[Probe, ...]:
    """Return the probes of every visible effect whose place in time need not be searched first."""
    sized, visible = RigScale.of(case).sized, visible_effects(case, effects)
    return tuple(Probe(e, row, e.is_one_sided) for e in visible for row in e.probes(extent, sized))


def is_told(case: Case, alias: Alias) -> bool:
    """Whether a run of the case tells an effect from what looks exactly like it elsewhere."""
    return case.changes(alias.changing, alias.told_by, alias.by)


GENTLER = (0.1, 0.003)
"""Shares of a promised size from which a fit begins once more."""

KEPT_PART = 0.1
"""Share of the promised drop of χ² that a fit must bring, or it begins once more."""


@dataclass(frozen=True, eq=False)
class Lead:
    """A probe that would lower χ².

    Args:
        gain: expected drop of χ² when the effect is added and all is refitted, to first order.
        hidden: share of its signature that the fitted parameters imitate.
        shift: (parameters of the fit,) how its coordinates would move along.
    """

    effect: Effect
    values: tuple[float, ...]
    gain: float
    hidden: float
    shift: Array

    def start(self, found: Fit, share: float = 1.0) -> Array:
        """Return where a fit of the larger hypothesis begins, at a share of the promised size."""
        _, left = found.hypothesis.without(self.effect.id)
        kept = (found.coordinates + share * self.shift)[left]
        first = self.effect.parameters[0]
        size = self.values[0] * share if first.neutral == 0.0 else self.values[0] / share
        values = (size, *self.values[1:]) if first.neutral in (0.0, np.inf) and share < 1.0 else self.values
        return np.concatenate([kept, start_coordinates([self.effect], [values])])


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


class Tangent:
    """The directions in which a fit can move, and how a signature stands to them."""

    def __init__(self, found: Fit, base_only: bool = False) -> None:
        self._found = found
        jacobian = found.jacobian
        normal = gram(jacobian)
        scale = np.sqrt(np.diag(normal))
        if base_only:
            scale[found.hypothesis.of_base.stop :] = 0.0
        self._rows = np.flatnonzero(scale > 0)
        scale = scale[self._rows]
        strength, axes = np.linalg.eigh(normal[np.ix_(self._rows, self._rows)] / np.outer(scale, scale))
        keep = strength > 1e-10 * strength.max(initial=0.0)
        # Rows of `turn` times the Jacobian are orthonormal.
        self._turn = (axes[:, keep] / np.sqrt(strength[keep])).T / scale
        self._basis = np.array([combine(row, jacobian[self._rows]) for row in self._turn])
        self._residual = found.residual

    @cached_property
    def _around(self) -> Around:
        return self._found.problem.predict_around(self._found.hypothesis, self._found.coordinates)[1]

    def signature(self, probe: Probe) -> Array:
        """(samples,) change of the whitened prediction when the probe is switched on."""
        found = self._found
        hypothesis = found.hypothesis.adding(probe.effect)
        x = np.concatenate([found.coordinates, start_coordinates([probe.effect], [probe.values])])
        change = found.problem.whitened(self._around(hypothesis, x) - found.predicted)
        return change if np.all(np.isfinite(change)) else np.zeros(len(change))

    def visible(self, signature: Array) -> Array:
        """Return the part of a signature that the fitted parameters cannot imitate."""
        return signature - combine(dots(self._basis, signature), self._basis)

    def lead(self, probe: Probe) -> Lead | None:
        """Return what this probe promises, None if it promises nothing."""
        signature = self.signature(probe)
        size = energy(signature)
        seen = self.visible(signature)
        power = energy(seen)
        if power <= 1e-9 * max(size, 1e-30) or power <= 1e-12:
            return None
        times = float(dots(seen.reshape(1, -1), self._residual)[0]) / power
        if probe.is_one_sided and times <= 0:
            return None
        # The probe is linear for small effects only: begin within a decade of it.
        stretch = float(np.clip(times, -30.0, 30.0))
        shift = np.zeros(len(self._found.coordinates))
        shift[self._rows] = -stretch * (self._turn.T @ dots(self._basis, signature))
        first, usual = self._found.problem.scale.sized(probe.effect.parameters[0]), probe.values[0]
        if first.scale == "inverse_square":
            value = usual / max(stretch, 1e-3) ** 0.5
        else:
            # A level does not scale with what it cuts off.
            value = usual if first.neutral == np.inf else usual * stretch
        values = (float(np.clip(value, first.low, first.high)), *probe.values[1:])
        return Lead(probe.effect, values, times**2 * power, 1.0 - power / size, shift)
