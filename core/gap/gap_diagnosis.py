"""What the diagnosis of the twin and that of a simulator of somebody else hold and report alike."""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Generic

import numpy as np

from softcal.core.gap.case import Case
from softcal.core.gap.empirical import LearnedResidual, T
from softcal.core.gap.explained import form_of
from softcal.core.gap.fit import Fit
from softcal.core.gap.identifiability import Identifiability
from softcal.core.gap.named_causes import (
    DiagnosisVerdict,
    GapPlace,
    Partial,
    RankedCause,
    estimates_of,
    nearest,
    shares_of,
)
from softcal.core.gap.next_experiment import NextExperiment
from softcal.core.gap.plausibility import DataMistake
from softcal.core.gap.search import EffectSearch
from softcal.core.gap.shrink import ChannelGap, Shrink
from softcal.core.twin.effects import Effect

SCHEMA = "softcal.gap/1"

NOT_MEASURED = "not measured: the recordings hold a mistake"


@dataclass(frozen=True, eq=False, kw_only=True)
class GapDiagnosis(ABC, Generic[T]):
    """Everything a report or a page needs of one diagnosis. With the verdict `data` only what has no default is there.

    Args:
        base, best: fits of the base alone and of the best hypothesis to all runs.
        protocol: how samples were held back for the shrink.
        chosen: causes that are chosen where each part of the samples in turn is held back, those the shrink is of.
        explained_share: of the structured gap energy, 1 when nothing but noise is left.
        mistakes: what is wrong with the recordings; with the verdict `data` they stand in the way of everything else,
            beside another one they are questions.
        partial: what comes nearest where nothing explains the gap.
        residual: empirical terms that describe what no named cause explains, where they hold on runs held back.
        told: what the runs tell of the base and of every effect; None where the recordings hold a mistake.
    """

    verdict: DiagnosisVerdict
    base: Fit
    best: Fit
    causes: tuple[RankedCause, ...]
    gap: dict[str, ChannelGap]
    next_experiment: NextExperiment
    places: tuple[GapPlace, ...] = ()
    shrink: Shrink = Shrink(0.0, 0.0, 0.0, 0.0)
    protocol: str = NOT_MEASURED
    chosen: tuple[tuple[str, ...], ...] = ()
    ambiguous_with: list[list[str]] = field(default_factory=list)
    hidden_fraction: dict[str, float] = field(default_factory=dict)
    explained_share: float = 0.0
    mistakes: tuple[DataMistake, ...] = ()
    partial: Partial | None = None
    residual: LearnedResidual[T] | None = None
    told: Identifiability | None = None

    @property
    def case(self) -> Case:
        """The recordings."""
        return self.base.problem.case

    def report(self) -> dict[str, object]:
        """Return the report of the contract, ready for JSON."""
        return {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "serial": self.case.serial,
            "data": [found.record() for found in self.mistakes],
            "gap": {self._shown(channel): vars(gap) for channel, gap in self.gap.items()},
            "shrink": vars(self.shrink) | {"protocol": self.protocol, "chosen": [list(ids) for ids in self.chosen]},
            "where": [place.record() for place in self.places],
            "causes": [
                vars(c) | {"form": c.form or None, "parameters": {name: vars(p) for name, p in c.parameters.items()}}
                for c in self.causes
            ],
            "ambiguous_with": self.ambiguous_with,
            "hidden_fraction": self.hidden_fraction,
            "identifiability": None if self.told is None else self.told.record(),
            "next_experiment": self.next_experiment.record(),
            "explained_share": self.explained_share,
            "partial": None if self.partial is None else vars(self.partial) | {"effects": list(self.partial.effects)},
            "residual": None if self.residual is None else self.residual.record() | self._described(self.residual),
            **self._own(),
        }

    def _shown(self, channel: str) -> str:
        """Return the name of a channel in a report."""
        return channel

    @abstractmethod
    def _described(self, residual: LearnedResidual[T]) -> dict[str, object]:
        """Return what a report says of empirical terms beside what all say."""

    @abstractmethod
    def _own(self) -> dict[str, object]:
        """Return what the report of this kind of simulator has beside what all have."""


def partial_of(search: EffectSearch) -> Partial | None:
    """Return the causes that come nearest, and their share; None where none takes anything."""
    found = nearest(search)
    share = float(np.clip(search.share(found), 0.0, 1.0))
    return Partial(found.hypothesis.ids, share) if found.hypothesis.ids and share > 0.0 else None


def ranked_causes(
    search: EffectSearch,
    best: Fit,
    effects: Iterable[Effect],
    fits: tuple[Fit, ...],
    chances: dict[str, float],
    held_out: float,
) -> tuple[RankedCause, ...]:
    """Return every effect with how it stands, the likeliest first.

    Args:
        fits: where the parameters of an effect are taken from, the first that has it; else from the effect alone.
        held_out: share of the gap that goes on samples held back, split among the causes of the best hypothesis.
    """
    shares = shares_of(search, best)
    forms = {e.id: form_of(e) for e in best.hypothesis.effects}

    def cause(effect: Effect) -> RankedCause:
        found = next((f for f in fits if effect.id in f.hypothesis.ids), search.fits.get((effect.id,)))
        parameters = estimates_of(found, effect.id) if found is not None else {}
        share = shares.get(effect.id, 0.0) * held_out
        return RankedCause(effect.id, effect.stage, chances[effect.id], share, parameters, forms.get(effect.id, ""))

    return tuple(sorted(map(cause, effects), key=lambda c: (-c.probability, -c.shrink)))
