"""What a map γ is: windows of a target unit in, windows in the source's space out."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

from softcal.core.identity import Settings, content_sha256
from softcal.core.maps.config import MapConfig
from softcal.core.maps.ends import EndMatch, match_ends
from softcal.core.maps.synchrony import Synchrony, find_synchrony
from softcal.core.network.network import Network
from softcal.core.recording import Array, Arrays, LabelledRecording, OutputRecording
from softcal.core.windows import TAPS


class UnitMap(Protocol):
    """A fitted map γ. Complete when it exists; the same input always gives the same output."""

    @property
    def family(self) -> str:
        """Name of the family in `catalogue.py`."""

    def apply(self, windows: Array) -> Array:
        """Carry (n, taps) target windows, newest sample last, into the source's window space."""

    def apply_signal(self, signal: Array) -> Array:
        """Carry every full window of a gap-free (n,) signal: (n - taps + 1, taps).

        Equal to `apply(windows(signal))`; a map that works sample by sample does it in one pass over the signal.
        """

    def arrays(self) -> Arrays:
        """Return the parameters under stable names."""

    def settings(self) -> Settings:
        """Return JSON values that `arrays` does not hold."""


@dataclass(frozen=True, eq=False)
class Anchors:
    """(k,) known loads on the target unit, and its outputs at rest under each."""

    output: Array
    reference: Array


@dataclass(frozen=True, eq=False)
class FitProblem:
    """All that a fit of γ may know, with the seed of its random choices. The target's reference is not among it."""

    source: LabelledRecording
    network: Network
    target: OutputRecording
    anchors: Anchors | None = None
    config: MapConfig = MapConfig()  # noqa: RUF009 - frozen
    seed: int = 0

    @cached_property
    def synchrony(self) -> Synchrony:
        """What the two outputs say about a common load; found once for all who ask."""
        return find_synchrony(self.source.unlabelled, self.target, self.config)

    @cached_property
    def ends(self) -> EndMatch:
        """Rest and peak of the target beside those of the source; found once for all who ask.

        Raises:
            UnitRefused: the target's output makes no swing that stands out of its noise.
        """
        return match_ends(self.source, self.target, self.config)


class MapFamily(Protocol):
    """One way to fit γ."""

    @property
    def name(self) -> str: ...

    def fit(self, problem: FitProblem) -> UnitMap:
        """Fit γ, or raise `UnitRefused` saying why this recording allows none."""

    def from_arrays(self, arrays: Arrays, settings: Settings) -> UnitMap:
        """Rebuild a map from `UnitMap.arrays()` and `UnitMap.settings()`."""


def mapped_segments(unit_map: UnitMap, recording: OutputRecording) -> Iterator[tuple[slice, Array]]:
    """Map a recording sample by sample: the rows at which full windows end, and (n, TAPS) these windows mapped."""
    for segment in recording.segments:
        if segment.stop - segment.start >= TAPS:
            yield slice(segment.start + TAPS - 1, segment.stop), unit_map.apply_signal(recording.output[segment])


def map_sha256(unit_map: UnitMap) -> str:
    """Return the content hash of a map: its family and its parameters."""
    return content_sha256(unit_map.arrays(), {"family": unit_map.family, **unit_map.settings()})
