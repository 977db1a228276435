"""What is held against recordings, softcal's twin or somebody's simulator: what a diagnosis asks and reports."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from softcal.core.messages.reason import Reason, with_sentences
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Form, Parameter

if TYPE_CHECKING:
    from softcal.core.gap.case import Case, DataMistake, Mask, MenuEntry, Run
    from softcal.core.gap.diagnosis import Assessment, Diagnosis
    from softcal.core.gap.experiments import NextExperiment
    from softcal.core.gap.fit import Fit, Map, Probe, Regime
    from softcal.core.gap.linear import Prior, RigScale
    from softcal.core.gap.method import GapMethod, PresenceConfig, SearchConfig
    from softcal.core.gap.problem import Block, Hypothesis, Problem
    from softcal.core.gap.search import Search

Sizes: TypeAlias = Mapping[int, Array]
"""By run, (k,), the sizes of its offsets that are in a prediction."""

Directions: TypeAlias = list[Array | None]
"""Per block, (k, n), how a channel changes with each offset; None where a run has none."""

Mistakes: TypeAlias = "tuple[DataMistake, ...]"


DiagnosisVerdict = Literal["no_gap", "explained", "explained_in_part", "ambiguous", "unknown", "data"]


@dataclass(frozen=True)
class ParameterEstimate:
    """A fitted parameter of an effect with its 90 % interval."""

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class RankedCause:
    """One effect of the catalogue and how it stands.

    Args:
        shrink: share of the gap that goes with it, of what the set takes; None where it is not in the set.
        parameters: by the catalogue's equation; empty where no hypothesis has it.
        form: the other equation that fits better, empty where the catalogue's does.
        alone, added: share of the gap that goes with it alone, and that comes back without it; None where not fitted.
    """

    effect: str
    stage: str
    probability: float
    shrink: float | None
    parameters: dict[str, ParameterEstimate]
    form: str = ""
    alone: float | None = None
    added: float | None = None


@dataclass(frozen=True)
class FaultLocation:
    """One line of where the gap lies."""

    stage: str
    channel: str
    regime: Reason
    share: float
    detail: Reason = Reason("gap.map.none")

    def record(self) -> dict[str, object]:
        return with_sentences(vars(self), "regime", "detail")


@dataclass(frozen=True)
class Where:
    """Where the gap lies: places, the regimes in which it stands out, and what relations fitted alone leave."""

    locations: tuple[FaultLocation, ...] = ()
    regimes: tuple[Regime, ...] = ()
    maps: tuple[Map, ...] = ()


@dataclass(frozen=True)
class Partial:
    """The causes that come nearest where nothing explains the gap, and their share of it."""

    effects: tuple[str, ...]
    share: float


@dataclass(frozen=True)
class CalibrationGap:
    """Errors of f on a run that neither twin nor f has seen, RMS in N, by what f was trained on.

    Args:
        run: the run that was held back.
        base, repaired: f trained on the refitted base twin, and on the twin with the causes.
        rig: f trained on the rig's other runs.
    """

    run: str
    base: float
    repaired: float
    rig: float


class Model(ABC):
    """What predicts recordings, what it may lack, and what every run may have of its own: a zero, a delay.

    Args:
        method: every number of the diagnosis.
        base: parameters that every hypothesis has.
        candidates: effects it may lack; causes are sought among them.
        offset_names: of what every run may have of its own.
        are_relative: of which offsets only what the runs differ by is taken off.
        priors: what is known of the base before any run.
        are_bending: which offsets move a channel other than in proportion.
        hands_on_closest: whether the set of least error held back is handed on where no cause is certain.
        smooth_order: which differences of a residual hold noise alone: second ones where all is quick.
    """

    method: GapMethod
    smooth_order: int
    hands_on_closest: bool

    @property
    @abstractmethod
    def base(self) -> tuple[Parameter, ...]: ...

    @property
    @abstractmethod
    def candidates(self) -> tuple[Effect, ...]: ...

    def forms_of(self, cause: str) -> Sequence[Form]:
        """Return other realisations of a cause."""
        return next((effect.forms for effect in self.candidates if effect.id == cause), ())

    @property
    @abstractmethod
    def priors(self) -> Sequence[Prior]: ...

    @property
    @abstractmethod
    def offset_names(self) -> tuple[str, ...]: ...

    @property
    @abstractmethod
    def are_relative(self) -> Mask: ...

    @property
    @abstractmethod
    def are_bending(self) -> Mask: ...

    @property
    @abstractmethod
    def search_config(self) -> SearchConfig:
        """How wide causes are sought."""

    @property
    @abstractmethod
    def presence_config(self) -> PresenceConfig:
        """How sure a cause is beside a rest: a short list misses more laws than a catalogue."""

    # What it predicts.

    @abstractmethod
    def scale_of(self, case: Case) -> RigScale:
        """Return by what a rig is larger than the one of the bounds of its parameters."""

    @abstractmethod
    def channels_of(self, run: Run) -> tuple[str, ...]:
        """Return the recorded channels of a run that are predicted."""

    @abstractmethod
    def recorded(self, run: Run, channel: str) -> Array:
        """Return a recorded column of a run, (n,)."""

    @abstractmethod
    def scored_channels(self, problem: Problem) -> list[str]:
        """Return the channels whose gap is measured."""

    @abstractmethod
    def noise_range(self, problem: Problem, channel: str) -> tuple[float, float]:
        """Return the least and the largest noise of a channel that is believed: one without any has no weight."""

    @abstractmethod
    def times_slower(self, case: Case) -> float:
        """Return by what these runs are slower than those of a common rig."""

    @abstractmethod
    def is_free(self, case: Case) -> Array:
        """Return (base,) which base parameters these channels determine."""

    @abstractmethod
    def largest_offsets(self, case: Case) -> Array:
        """Return (k,) bounds of what every run has of its own."""

    def prepare(self, problem: Problem, points: Sequence[tuple[Hypothesis, Array]]) -> None:
        """Make predictions at several places at once, and store them; one after another is as quick."""
        return

    @abstractmethod
    def clean(self, problem: Problem, hypothesis: Hypothesis, coordinates: Array, sizes: Sizes) -> Array:
        """Return the (samples,) prediction with these offsets in it, NaN where nobody can know."""

    @abstractmethod
    def directions(
        self, problem: Problem, hypothesis: Hypothesis, coordinates: Array, clean: Array, sizes: Sizes
    ) -> Directions:
        """Return how a prediction with these offsets in it changes with each of them."""

    @abstractmethod
    def with_unknown(self, problem: Problem, predicted: Array) -> Array:
        """Return a prediction, (samples,), as a fit reads it where it is NaN."""

    # What it leaves.

    @abstractmethod
    def is_clean(self, result: Fit) -> bool:
        """Whether a hypothesis leaves no structure."""

    @abstractmethod
    def is_uneven(self, result: Fit) -> bool:
        """Whether noise that a hypothesis leaves is not the same everywhere."""

    @abstractmethod
    def followed(self, result: Fit, channel: str) -> Iterable[Sequence[Array]]:
        """Give groups of (samples,) columns that the residual of a channel may follow."""

    @abstractmethod
    def halves(self, result: Fit, block: Block) -> tuple[Mask | None, ...]:
        """Return which samples of a block, (n,), lie in one of two conditions; None where nothing tells."""

    @abstractmethod
    def load_of(self, result: Fit) -> Array:
        """Return (samples,) how much the mechanism is loaded."""

    @abstractmethod
    def axes_of(self, result: Fit, run: int) -> tuple[Array, Array]:
        """Return what drives a run and its load, (n,) each, as a figure shows them."""

    # How causes are sought.

    @abstractmethod
    def mistakes(self, case: Case) -> Mistakes:
        """Return mistakes that recordings show by themselves."""

    @abstractmethod
    def base_of_mistaken_case(self, case: Case) -> Fit:
        """Return the base that a report of mistaken recordings shows."""

    @abstractmethod
    def base_fit(self, case: Case) -> Fit:
        """Fit the base alone to all runs, with noise levels taken from its own residual."""

    @abstractmethod
    def mistakes_by_base(self, base: Fit) -> tuple[Mistakes, Mistakes]:
        """Return mistakes that a fitted base shows, and questions that are asked beside a diagnosis."""

    @abstractmethod
    def mistakes_by_search(self, search: Search) -> Mistakes:
        """Return mistakes of recordings that explain more than the causes found do."""

    @abstractmethod
    def visible(self, case: Case) -> tuple[Effect, ...]:
        """Return the candidates that these runs can show at all."""

    @abstractmethod
    def probes(self, base: Fit, effects: Sequence[Effect]) -> tuple[Probe, ...]:
        """Return where a search begins for effects that need not be placed in time first."""

    @abstractmethod
    def start_again(self, search: Search) -> None:
        """Fit hypotheses of a search from other starts, for structure is left."""

    @abstractmethod
    def departures(self, case: Case) -> tuple[Effect, ...]:
        """Return departures outside the list that these runs can show."""

    # What is reported.

    @abstractmethod
    def menu(self, base: Fit) -> Sequence[MenuEntry]:
        """Return the experiments that could be made."""

    @abstractmethod
    def terms(self, base: Fit) -> Iterable[Any]:
        """Give the empirical terms that may be tried on what is left."""

    @abstractmethod
    def where(self, search: Search, assessment: Assessment, causes: Sequence[RankedCause]) -> Where:
        """Return where the gap lies."""

    @abstractmethod
    def next_experiment(self, search: Search, assessment: Assessment, telling: NextExperiment | None) -> NextExperiment:
        """Return what to record next.

        Args:
            telling: the run that tells a rest from the causes nearest to it; None where none does.
        """

    @abstractmethod
    def report(self, diagnosis: Diagnosis[Any]) -> dict[str, object]:
        """Return what the report of this model has besides, ready for JSON."""
