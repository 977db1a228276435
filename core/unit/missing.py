"""What a logger did to a unit's recording: samples left out, gaps, jumps; how much of it allows no verdict."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from softcal.core.errors import UnitRefused
from softcal.core.inspection.config import InspectionConfig
from softcal.core.inspection.inspection import MAX_TIMES, InspectionFinding
from softcal.core.inspection.levels import level_findings
from softcal.core.inspection.timing import timing_findings, window_share
from softcal.core.maps.crossing import CACHED
from softcal.core.messages.reason import Reason, reason
from softcal.core.recording import MaskedSamples, OutputRecording
from softcal.core.unit.method import Method
from softcal.core.unit.verdict import Finding, Verdict

MASKED = {
    "missing": "masked.missing",
    "overflow": "masked.overflow",
    "spike": "masked.spike",
    "dropout": "masked.dropout",
    "no_reference": "masked.no_reference",
    "reference_outlier": "masked.reference_outlier",
}
"""Kind of masked samples → code of the reason that says so."""


@dataclass(frozen=True)
class MissingShares:
    """What is missing of a recording, as a fit stores it.

    Args:
        masked: samples that were left out, by kind.
        share: of the samples that its time would hold, those that are masked or in no row.
        window_share: of the windows that its rows would fill, those that are left.
    """

    masked: Mapping[str, int]
    share: float
    window_share: float

    def numbers(self) -> dict[str, float]:
        """Return its numbers by the names that reports give them."""
        masked = {f"masked_{kind}": float(count) for kind, count in self.masked.items()}
        return {**masked, "missing_share": self.share, "window_share": self.window_share}


@dataclass(frozen=True)
class MissingSamples(MissingShares):
    """What is missing of a recording, and where.

    Args:
        gaps: stretches without rows in its file.
        pauses: such stretches at rest: nobody pressed, and nothing is lost.
        slow: stretches at a slower rate than the rest.
    """

    gaps: tuple[InspectionFinding, ...]
    pauses: tuple[InspectionFinding, ...]
    slow: tuple[InspectionFinding, ...]

    @property
    def is_any(self) -> bool:
        return bool(self.masked or self.gaps or self.slow)

    @property
    def shares(self) -> MissingShares | None:
        """What a fit stores of it; None where nothing is missing."""
        return MissingShares(self.masked, self.share, self.window_share) if self.is_any else None


@lru_cache(maxsize=CACHED)
def missing_samples(recording: OutputRecording, config: InspectionConfig) -> MissingSamples:
    """Count what is missing of a recording."""
    rate_Hz, valid = recording.sample_rate_Hz, len(recording)
    t_s = np.sort(np.concatenate([recording.t_s, recording.masked.t_s]))
    timing = timing_findings(t_s, np.interp(t_s, recording.t_s, recording.output), rate_Hz, config)
    gaps, pauses, slow = (tuple(one for one in timing if one.kind == kind) for kind in ("gap", "pause", "rate"))
    steps = np.diff(t_s) * rate_Hz
    absent = float(np.sum(np.maximum(np.round(steps) - 1, 0))) - sum(pause.amount for pause in pauses)
    windows, _ = missing_windows(recording)
    share = (len(recording.masked) + absent) / (valid + len(recording.masked) + absent)
    return MissingSamples(recording.masked.counts, share, windows, gaps, pauses, slow)


@lru_cache(maxsize=CACHED)
def missing_windows(recording: OutputRecording) -> tuple[float, int]:
    """Return the share of the windows that the rows of a recording would fill and still do, and how many are lost."""
    share = window_share(recording.t_s, len(recording) + len(recording.masked), recording.sample_rate_Hz)
    return share, round((1 - share) / max(share, 1e-9) * len(recording.window_rows))


def check_windows(recording: OutputRecording, config: InspectionConfig) -> None:
    """Refuse a recording with gaps so close that no window fits between them.

    Raises:
        UnitRefused: there is no window; the reason says what is missing.
    """
    if not len(recording.window_rows):
        missing = missing_samples(recording, config)
        raise UnitRefused(_too_much(missing, _observed(recording, missing)[0]))


def missing_findings(recording: OutputRecording, method: Method) -> tuple[Finding, ...]:
    """Say what is missing of a recording, and that too much is; none where nothing is."""
    missing, config = missing_samples(recording, method.inspection), method.health
    paused = tuple(Finding(one, Verdict.PASS) for one in _paused(missing))
    if not missing.is_any:
        return paused
    observed = _observed(recording, missing)
    if missing.share <= config.max_missing_share and missing.window_share >= config.min_window_share:
        return (*map(Finding, observed), *paused)
    first, *rest = observed
    return (Finding(_too_much(missing, first), Verdict.RETEST), *map(Finding, rest), *paused)


def _paused(missing: MissingSamples) -> list[Reason]:
    if not missing.pauses:
        return []
    longest = max(missing.pauses, key=lambda pause: pause.value)
    return [reason("paused", pauses=len(missing.pauses), longest=longest.value, at=longest.time_s)]


@lru_cache(maxsize=CACHED)
def jump_findings(recording: OutputRecording, config: InspectionConfig) -> tuple[Finding, ...]:
    """Say where the level of an output jumps for good: a counter that starts again, or a baseline that moved."""
    levels = level_findings(recording.t_s, recording.output, recording.sample_rate_Hz, config)
    wraps = [one for one in levels if one.kind == "wrap"]
    if wraps:
        wrapped = reason("wraps", count=len(wraps), first=wraps[0].time_s, jump=wraps[0].value)
        return (Finding(wrapped, Verdict.RETEST),)
    return tuple(
        Finding(reason("stepped", first=one.time_s, jump=one.value, unit=recording.output_unit, share=one.amount))
        for one in levels
        if one.kind == "step"
    )


def _too_much(missing: MissingSamples, observed: Reason) -> Reason:
    return reason("samples_missing", observed=observed, share=missing.share, windows=missing.window_share)


def _observed(recording: OutputRecording, missing: MissingSamples) -> list[Reason]:
    """Return what was observed, the most samples first."""
    masked, observed = recording.masked, list[tuple[float, Reason]]()
    for kind, count in missing.masked.items():
        times = {"times": _times_the_range(recording, masked)} if kind == "overflow" else {}
        observed.append(
            (count, reason(MASKED[kind], count=count, first=_describe_first(masked.of_kind(kind)), **times))
        )
    if gaps := missing.gaps:
        rows = sum(gap.amount for gap in gaps)
        longest = max(gaps, key=lambda gap: gap.value)
        absent = rows / (rows + len(recording) + len(masked))
        observed.append(
            (rows, reason("gaps", gaps=len(gaps), longest=longest.value, at=longest.time_s, rows=rows, share=absent))
        )
    for slow in missing.slow:
        # A slower stretch is as many samples short as its rate is lower.
        observed.append(
            (len(recording), reason("slow", rate=slow.value, usual=recording.sample_rate_Hz, first=slow.time_s))
        )
    return [one for _, one in sorted(observed, key=lambda pair: -pair[0])]


def _describe_first(masked: MaskedSamples) -> Reason:
    """Return where the first masked sample stands, and its value."""
    line, at, value = int(masked.lines[0]), float(masked.t_s[0]), float(masked.values[0])
    location = reason("part.at_line", number=line, at=at) if line else reason("part.at_time", at=at)
    return location if np.isnan(value) else reason("part.value_at", place=location, value=value)


def _times_the_range(recording: OutputRecording, masked: MaskedSamples) -> float:
    """Return how far the furthest overflow lies from the output, in ranges of it."""
    span, values = float(np.ptp(recording.output)), masked.of_kind("overflow").values
    furthest = float(np.max(np.abs(values - np.median(recording.output))))
    return min(furthest / span, MAX_TIMES) if span > 0 else MAX_TIMES
