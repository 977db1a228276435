"""How unit and source correspond, and what follows from it: coefficients, bounds and the name of each kind."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from softcal.core.settings import SET, setting, table

FITTED = "benchmarks/verdict.py --fit --seeds 1000 1040 (simulated lots; tested on seeds 0-24 and 36-48)"
GOOD_UNITS = "2.5 % and 97.5 % quantiles of log(true / forecast RMSE) over good units, "
FITTED_COVERAGE = "benchmarks/interval_coverage.py --fit (simulated lots; tested on seeds 0-24)"


SHARED, BLIND = "shared", "blind"
ANCHORED = "anchored"
"""Said behind the kind of a unit some loads of which are known."""


@dataclass(frozen=True)
class CorrespondenceConfig:
    """What one kind of correspondence of unit and source is worth.

    Args:
        base_factor: a map errs this much more on loads it was not fitted to than on its own pairs.
        sensitivity: coefficients c_i of the budget's other terms u_i (GUM, JCGM 100:2008, eq. 10).
        log_error: 2.5 % and 97.5 % quantiles of log(true / forecast RMSE): the forecast's own uncertainty.
        interval_share: share of the map's variance that widens the interval so that it covers 90 % of the samples.
        base_term: term of the budget that the forecast starts from: `model`, the error of f on its source, or `paired`,
            the difference from the source's reference at the same instants, which holds the model's error already.
        mismatch_verdict: best verdict of a unit whose loads and speeds are not the source's; empty where those may be.
        is_matched: whether the loads are known otherwise than by how they are distributed.
    """

    sensitivity: tuple[tuple[str, float], ...]
    log_error: tuple[float, float]
    interval_share: float
    base_factor: float = setting(1.0)
    base_term: ClassVar[str] = "model"
    mismatch_verdict: ClassVar[str] = ""
    is_matched: ClassVar[bool] = True


@dataclass(frozen=True)
class PairedConfig(CorrespondenceConfig):
    """Unit and source were pressed by one load at once: the source's reference has measured the rest."""

    base_term: ClassVar[str] = "paired"
    base_factor: float = setting(1.1)
    sensitivity: tuple[tuple[str, float], ...] = table({"clipping": 0.84, "extrapolation": 0.16}, FITTED)
    log_error: tuple[float, float] = setting(
        (-0.35, 0.35), f"{SET}: what errors of slow presses, alike for seconds, leave open on another stretch"
    )
    interval_share: float = setting(1.0)


@dataclass(frozen=True)
class StageMatchedConfig(CorrespondenceConfig):
    """Source and unit carry the stage position: the load over position says more than all the rest."""

    mismatch_verdict: ClassVar[str] = "conditional"
    sensitivity: tuple[tuple[str, float], ...] = table(
        {
            "stage": 0.59,
            "slow": 1.0,
            "support": 0.16,
            "clipping": 0.92,
            "extrapolation": 0.08,
            "resolution": 1.5,
            "overlap": 0.05,
        },
        FITTED,
    )
    log_error: tuple[float, float] = setting((-0.41, 0.23), f"{GOOD_UNITS}{FITTED}")
    interval_share: float = setting(0.1, FITTED_COVERAGE)


@dataclass(frozen=True)
class BlindConfig(CorrespondenceConfig):
    """Nothing speaks for the loads but how the output is distributed."""

    mismatch_verdict: ClassVar[str] = "retest"
    is_matched: ClassVar[bool] = False
    sensitivity: tuple[tuple[str, float], ...] = table(
        {
            "disagreement": 0.07,
            "stability": 0.31,
            "support": 0.78,
            "shift": 0.16,
            "rest": 0.80,
            "resolution": 1.5,
            "clipping": 1.5,
            "extrapolation": 0.16,
            "overlap": 0.25,
            "speed": 0.06,
            "corners": 0.13,
            "gain": 0.37,
        },
        FITTED,
    )
    log_error: tuple[float, float] = setting(
        (-1.75, 0.78), f"{GOOD_UNITS}benchmarks/verdict.py --fit --seeds 1003 1089 4, lots whose loads are unknown"
    )
    interval_share: float = setting(1.1, FITTED_COVERAGE)


@dataclass(frozen=True)
class SharedConfig(CorrespondenceConfig):
    """Units of the lot were pressed by one load at once: they agree on its course, and its level stays a guess.

    `shared` is the uncertainty of the load that is common to all, `own_part` that of the unit's map beside it.
    """

    mismatch_verdict: ClassVar[str] = "conditional"
    is_matched: ClassVar[bool] = False
    sensitivity: tuple[tuple[str, float], ...] = table(
        {
            "shared": 1.0,
            "own_part": 1.0,
            "support": 0.78,
            "shift": 0.16,
            "rest": 0.80,
            "clipping": 1.5,
            "extrapolation": 0.16,
            "overlap": 0.25,
        },
        f"{SET}: both parts of a lot fit are what they say; the others, of f on another day, as without it",
    )
    log_error: tuple[float, float] = setting((-1.75, 0.78), f"{SET}: that of units whose loads are unknown")
    interval_share: float = setting(1.0)


@dataclass(frozen=True)
class CorrespondenceTable:
    """The kinds, best first. A new kind is a class above, a field here and a condition in `find_correspondence`."""

    paired: CorrespondenceConfig = field(default_factory=PairedConfig)
    stage: CorrespondenceConfig = field(default_factory=StageMatchedConfig)
    shared: CorrespondenceConfig = field(default_factory=SharedConfig)
    blind: CorrespondenceConfig = field(default_factory=BlindConfig)


@dataclass(frozen=True)
class Correspondence:
    """How the loads on one unit are known.

    Args:
        kind: `paired` (pressed by the source's load at the same time), `stage` (equal stage positions),
            `shared` (the load of other units of the lot, whose level is a guess) or `blind`. Reports call both blind.
        is_anchored: some known loads were given beside it.
        config: what this kind is worth.
    """

    kind: str
    config: CorrespondenceConfig
    is_anchored: bool = False

    @property
    def is_matched(self) -> bool:
        """Whether the loads are known otherwise than by how they are distributed."""
        return self.config.is_matched

    @property
    def sensitivity(self) -> Mapping[str, float]:
        """Coefficients c_i by term of the budget."""
        return dict(self.config.sensitivity)

    def __str__(self) -> str:
        kind = BLIND if self.kind == SHARED else self.kind
        return f"{kind}, {ANCHORED}" if self.is_anchored else kind


def find_correspondence(
    budget: Mapping[str, float], kinds: CorrespondenceTable, is_anchored: bool = False
) -> Correspondence:
    """Return how the loads are known, by what could be measured.

    `paired` stands in the budget where unit and source were pressed by one load at once, `stage` where both carry the
    stage position, `shared` where the lot was fitted together.
    """
    kind = next((name for name in ("paired", "stage", SHARED) if name in budget), BLIND)
    return Correspondence(kind, getattr(kinds, kind), is_anchored)
