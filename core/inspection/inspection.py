"""Result of an inspection: typed findings, each with its rows, time, value and size."""

from dataclasses import dataclass, field

from softcal.core.recording import MaskedSamples

MAX_TIMES = 1e300
"""A value so many ranges away is told as that: reports hold no infinity."""


@dataclass(frozen=True)
class InspectionFinding:
    """One finding of an inspection.

    Args:
        kind: short name, for example `spike`, `gap`, `step`, `lag`.
        column: `output`, `reference`, `stage_mm` or `t_s`.
        start, stop: rows of the input, the last one excluded.
        time_s: time stamp of the first of these rows.
        value: the value there, in the column's unit; a duration in s for a gap or a lag.
        amount: how much: times the range of the others, a share, or a number of samples, by kind.
    """

    kind: str
    column: str
    start: int
    stop: int
    time_s: float
    value: float
    amount: float


@dataclass(frozen=True)
class Inspection:
    """All findings of a recording, with the masked samples.

    Args:
        samples: number of rows of the input.
        masked: samples that no fit sees.
        findings: in order of time within a kind.
        window_share: share of the rows that fill a window once masked rows are taken out.
    """

    samples: int
    masked: MaskedSamples
    findings: tuple[InspectionFinding, ...] = field(default=())
    window_share: float = 1.0

    def of_kind(self, *kinds: str) -> tuple[InspectionFinding, ...]:
        """Return the findings of some kinds."""
        return tuple(finding for finding in self.findings if finding.kind in kinds)
