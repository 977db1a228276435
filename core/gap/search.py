"""Which hypotheses are fitted: forward from the base, a few of the best at every size, each by full joint fits."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from softcal.core.gap.candidates import Extent, probes, visible_effects
from softcal.core.gap.case import Case
from softcal.core.gap.episodes import with_bad_contacts, with_clipping, with_hum, with_lost_samples
from softcal.core.gap.fit import BASE, Fit, Hypothesis, fit, start_coordinates
from softcal.core.gap.forms import FORMS, Form
from softcal.core.gap.residual import structure
from softcal.core.gap.screen import screen
from softcal.core.gap.start import base_fit, noise_levels, with_driving_noise

Progress = Callable[[str], None]


@dataclass(frozen=True)
class SearchConfig:
    """How wide the search goes.

    Args:
        leads: effects fitted fully on top of the base, then of each hypothesis with one, with two effects.
        beam: hypotheses of one, two effects that are grown further.
        gain: a lead must promise this drop of χ² to be fitted (a third of it for the first effect).
        relative_gain: and this share of the χ² that the best lead promises.
        with_forms: single causes whose other realisations are tried where the catalogue's leave structure.
        enough: share of the gap that one cause must explain to be named although structure is left.
        clean: share of the gap beyond which what one cause leaves does not matter, however significant it is.
        several_clean: the same for several causes, which are more flexible.
        part: share of the gap that a further cause must take away; an ADC that is coarse against its noise leaves
            structure of its own and asks for `coarse_part`.
        patch: share of the gap that steps placed freely in time must take away.
    """

    leads: tuple[int, ...] = (9, 6, 4)
    beam: tuple[int, ...] = (3, 3)
    gain: float = 14.0
    relative_gain: float = 0.02
    with_forms: int = 3
    enough: float = 0.85
    clean: float = 0.998
    several_clean: float = 0.9995
    patch: float = 0.005
    part: float = 0.0002
    coarse_part: float = 0.005


class Search:
    """All hypotheses fitted to one case, under one noise level."""

    def __init__(self, case: Case, config: SearchConfig | None = None, progress: Progress | None = None) -> None:
        self._config = config or SearchConfig()
        self._say = progress or (lambda _: None)
        self._say("fitting the base twin to all runs")
        self.base = base_fit(case)
        self._extent = _extent(self.base)
        self._probes = probes(case, self._extent)
        self._visible = set(visible_effects(case))
        self.fits: dict[tuple[str, ...], Fit] = {(): self.base}
        self.best = self.base
        self.considered = self.fits

    def run(self) -> None:
        """Grow the hypotheses until no effect promises anything more."""
        parents = [self.base]
        for size, leads in enumerate(self._config.leads, start=1):
            self._say(f"fitting {size} effect{'s' if size > 1 else ''} jointly with the base")
            grown = [child for parent in parents for child in self._grow(parent, leads)]
            if not grown:
                break
            self._settle_noise(self._leader)
            if size == len(self._config.leads) or not self._is_wanting(self._leader):
                break
            ranked = sorted((f for f in self.fits.values() if len(f.hypothesis.ids) == size), key=lambda f: f.bic)
            parents = ranked[: self._config.beam[size - 1]]
        self._conclude()

    def _conclude(self) -> None:
        """Choose among catalogue equations and other realisations; nothing that leaves structure by several causes.

        Several causes that together still leave structure are a sign of a cause that acts by another equation, or of
        one outside the catalogue: then a single cause that explains most of the gap is named, or none.
        """
        self.best, self.considered = self._leader, self.fits
        if len(self.best.hypothesis.ids) < 2 and self.is_clean(self.best):
            return
        self._say("fitting other realisations of the likely causes")
        self._try_forms()
        self.best = self._leader
        if len(self.best.hypothesis.ids) < 2 or self.is_clean(self.best):
            return
        singles = {i: f for i, f in self.fits.items() if len(i) < 2 and not self._is_patchwork(f)}
        one = min((f for ids, f in singles.items() if ids), key=lambda f: f.bic)
        if self.share(one) >= self._config.enough:
            self.best, self.considered = one, singles

    def _is_worth_patching(self, parent: Fit, steps: Fit) -> bool:
        """Steps placed freely in time take a little off any structure; they must take a visible part of the gap."""
        excess = max(self.base.chi2 - self.base.problem.count, 0.0)
        return parent.chi2 - steps.chi2 > self._config.patch * excess

    def _is_patchwork(self, found: Fit) -> bool:
        """Whether steps placed freely in time stand for a structure they do not end."""
        return "intermittent_contact" in found.hypothesis.ids and not self.is_clean(found)

    def share(self, found: Fit) -> float:
        """Return which share of the excess of the base over the noise a hypothesis takes away."""
        excess = self.base.chi2 - self.base.problem.count
        return 1.0 - (found.chi2 - found.problem.count) / excess if excess > 0 else 1.0

    def is_clean(self, found: Fit) -> bool:
        """Whether nothing is left that matters: no structure, or hardly any of what there was."""
        several = len(found.hypothesis.ids) > 1
        enough = self._config.several_clean if several else self._config.clean
        return not structure(found).is_significant or self.share(found) > enough

    @property
    def depth_mm(self) -> float:
        """Deepest stage position beyond contact."""
        return self._extent.depth_mm

    @property
    def force_N(self) -> float:
        """Largest force of the runs."""
        return self._extent.force_N

    @property
    def _leader(self) -> Fit:
        """The hypothesis of best evidence, without causes that take away next to nothing of the gap."""
        best = min(self.fits.values(), key=lambda f: f.bic)
        need = self._config.coarse_part if best.problem.is_coarse else self._config.part
        need *= max(self.base.chi2 - self.base.problem.count, 0.0)
        while len(best.hypothesis.ids) > 1:
            ids = best.hypothesis.ids
            smaller = [self.fits[s] for k in range(len(ids)) if (s := ids[:k] + ids[k + 1 :]) in self.fits]
            nearest = min(smaller, key=lambda f: f.chi2, default=None)
            if nearest is None or nearest.chi2 - best.chi2 > need:
                break
            best = nearest
        return best

    def _try_forms(self) -> None:
        """Fit the other realisations of the best single causes."""
        singles = sorted((f for ids, f in self.fits.items() if len(ids) == 1), key=lambda f: f.bic)
        likely = [f for f in singles if self.share(f) > 0.4 * self.share(singles[0])] if singles else []
        for found in likely[: self._config.with_forms]:
            for form in FORMS.get(found.hypothesis.ids[0], ()):
                self.keep(self._in_form(found, form))
        self._settle_noise(self._leader)

    def _in_form(self, found: Fit, form: Form) -> Fit:
        start = start_coordinates([form.effect], [form.start(found.effect_values[0])])
        hypothesis = Hypothesis((form.effect,), found.hypothesis.episodes)
        return fit(found.problem, hypothesis, np.concatenate([found.coordinates[: len(BASE)], start]), steps=30)

    def _is_wanting(self, found: Fit) -> bool:
        """Whether any further effect promises enough, or must be placed to know."""
        leads = screen(found, self._probes)
        if leads and leads[0].gain > self._config.gain:
            return True
        return any(child.bic < found.bic for child in self._placed(found))

    def keep(self, found: Fit) -> None:
        """Keep a fit where it is the best of its set of causes."""
        ids = found.hypothesis.ids
        if ids not in self.fits or found.bic < self.fits[ids].bic:
            self.fits[ids] = found

    def _grow(self, parent: Fit, count: int) -> list[Fit]:
        leads = screen(parent, self._probes)
        strongest = leads[0].gain if leads else 0.0
        need = max(self._config.gain / 3, self._config.relative_gain * strongest)
        children = []
        for lead in leads[:count]:
            ids = tuple(sorted({*parent.hypothesis.ids, lead.effect.id}))
            if lead.gain < need or ids in self.fits:
                continue
            children.append(fit(parent.problem, parent.hypothesis.adding(lead.effect), lead.start(parent)))
        children += self._placed(parent)
        for child in children:
            self.keep(child)
        return children

    def _placed(self, parent: Fit) -> list[Fit]:
        found: list[Fit | None] = []
        missing = self._visible - set(parent.hypothesis.ids)
        if "dropped_samples" in missing:
            found.append(with_lost_samples(parent))
        if "intermittent_contact" in missing:
            steps = with_bad_contacts(parent)
            found.append(steps if steps is not None and self._is_worth_patching(parent, steps) else None)
        if "mains_hum" in missing:
            found.append(with_hum(parent))
        if "adc_saturation" in missing:
            found += [with_clipping(parent, self._extent, side) for side in (1, -1)]
        return [f for f in found if f is not None]

    def _settle_noise(self, best: Fit) -> None:
        """Score all hypotheses under the noise that the best one leaves, so that their χ² can be compared."""
        problem = with_driving_noise(best.problem.with_noise(noise_levels(best)), best)
        self.fits = {ids: found.under(problem) for ids, found in self.fits.items()}
        self.base = self.fits[()]


def _extent(base: Fit) -> Extent:
    case = base.problem.case
    depths = [float(run.stage_mm.max()) for run in case.presses if run.stage_mm is not None]
    depth_mm = max(depths) - base.base.u0_mm if depths else 1.0
    forces = [float(run.force_N.max()) for run in case.presses if run.force_N is not None]
    force_N = max(forces) if forces else base.base.k1_N_mm * depth_mm + base.base.k3_N_mm3 * depth_mm**3
    return Extent.of(case, depth_mm, force_N)
