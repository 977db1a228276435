"""What a labelled recording of one unit says: its error, and what is kept beside it; nobody reads it again for that."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from softcal.core.identity import content_sha256
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.windows import evenly

INSTANTS = 201
"""Instants of an audit that are kept, evenly spaced: enough for shares of its samples."""


@dataclass(frozen=True)
class OutputLevel:
    """Where the output of a unit stands at rest, and its span to its highest loads (above 0), in the output's unit."""

    rest: float
    span: float


def output_level(recording: OutputRecording, *, is_rising: bool, rest: float) -> OutputLevel:
    """Return where the output of a unit stands."""
    low, high = (float(value) for value in np.quantile(recording.output, (rest, 1 - rest)))
    return OutputLevel(low if is_rising else high, high - low)


@dataclass(frozen=True)
class AuditReading:
    """One audit, read once.

    Args:
        output_sha256: content hash of the output alone: one recording that stands for two units is known by it.
        gain, zero: of the straight line of the estimates over the reference (least squares): 1 where the unit reads its
            loads in full, and in the reference's unit.
        unit_rest, audit_rest: output at rest in the unit's recording and in the audit, in the output's unit.
        span: of the output in the unit's recording, in the same.
        recording_sha256: identity of the recording; "" of what older versions kept.
        residual, half: (k,) |residual| and half-width of the 90 % interval at evenly spaced instants, in the
            reference's unit.
    """

    output_sha256: str
    reference_sha256: str
    gain: float
    unit_rest: float
    audit_rest: float
    span: float
    residual: tuple[float, ...]
    half: tuple[float, ...]
    recording_sha256: str = ""
    zero: float = 0.0

    def to_json(self) -> dict[str, object]:
        return {**vars(self), "residual": list(self.residual), "half": list(self.half)}

    @classmethod
    def of(cls, kept: Mapping[str, Any]) -> "AuditReading | None":
        """Read what `to_json` wrote; None of what an older version kept, whose recording is to be read again."""
        if not {"residual", "zero"} <= kept.keys():
            return None
        known = {name: value for name, value in kept.items() if name in cls.__dataclass_fields__}
        return cls(**known | {name: tuple(map(float, kept[name])) for name in ("residual", "half")})


def read_audit(
    value: Array, half: Array, audit: LabelledRecording, recording: OutputRecording, rest: float
) -> AuditReading:
    """Compare estimates over an audit with its reference, and the audit with the recording its unit was fitted on.

    Args:
        value: (n,) estimates, NaN where there is none.
        half: (n,) half-width of their 90 % interval, before audits of other units scaled it.
        rest: share of the samples at whose quantile a unit is at rest.
    """
    rows = np.flatnonzero(np.isfinite(value))
    spread = rows[evenly(len(rows), INSTANTS)]
    unit, now = (output_level(one, is_rising=audit.direction > 0, rest=rest) for one in (recording, audit.unlabelled))
    gain, zero = line_of(value, audit.reference)
    return AuditReading(
        output_sha256=audit.output_sha256,
        reference_sha256=content_sha256({"reference": audit.reference}, {}),
        gain=gain,
        unit_rest=unit.rest,
        audit_rest=now.rest,
        span=unit.span,
        residual=_short(np.abs(value - audit.reference)[spread]),
        half=_short(half[spread]),
        recording_sha256=audit.sha256,
        zero=zero,
    )


def _short(values: Array) -> tuple[float, ...]:
    return tuple(float(f"{value:.6g}") for value in values)


def line_of(value: Array, reference: Array) -> tuple[float, float]:
    """Return gain and zero of estimates over the reference (least squares), rows without an estimate left out."""
    rows = np.isfinite(value)
    gain, zero = np.polyfit(reference[rows], value[rows], 1)
    return float(gain), float(zero)
