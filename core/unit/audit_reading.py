"""What a labelled recording of one unit says beside its error, kept with the calibration: nobody reads it again."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from softcal.core.identity import content_sha256
from softcal.core.recording import Array, LabelledRecording

SHARES = np.linspace(0, 1, 101)
"""Shares of the samples at which `AuditReading.ratios` are kept."""


@dataclass(frozen=True)
class AuditReading:
    """One audit, read once.

    Args:
        output_sha256: content hash of the output alone: one recording that stands for two units is known by it.
        reference_sha256: content hash of the reference.
        gain: slope of the estimates over the reference (least squares): 1 where the unit reads its loads in full.
        ratios: (101,) quantiles of |residual| over the half-width of the 90 % interval, at `SHARES`.
    """

    output_sha256: str
    reference_sha256: str
    gain: float
    ratios: tuple[float, ...]

    def to_json(self) -> dict[str, object]:
        """Return it as JSON values."""
        return {**vars(self), "ratios": list(self.ratios)}

    @classmethod
    def of(cls, kept: Mapping[str, object]) -> "AuditReading":
        """Read what `to_json` wrote."""
        values: list[float] = kept["ratios"]  # type: ignore[assignment]
        names = str(kept["output_sha256"]), str(kept["reference_sha256"])
        return cls(*names, float(str(kept["gain"])), tuple(map(float, values)))


def read_audit(value: Array, half: Array, audit: LabelledRecording) -> AuditReading:
    """Compare estimates over an audit with its reference.

    Args:
        value: (n,) estimates, NaN where there is none.
        half: (n,) half-width of their 90 % interval, before audits of other units scaled it.
        audit: labelled recording of the unit.
    """
    rows = np.isfinite(value)
    ratios = np.quantile((np.abs(value - audit.reference) / np.maximum(half, 1e-12))[rows], SHARES)
    return AuditReading(
        content_sha256({"output": audit.unlabelled.output}, {}),
        content_sha256({"reference": audit.reference}, {}),
        float(np.polyfit(audit.reference[rows], value[rows], 1)[0]),
        tuple(float(f"{ratio:.6g}") for ratio in ratios),
    )
