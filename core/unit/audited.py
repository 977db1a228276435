"""A calibration judged again, by an audit of its unit or against another limit: its map stays."""

from dataclasses import replace

from softcal.core.identity import content_sha256
from softcal.core.network.network import Network
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.audit_reading import line_of, read_audit
from softcal.core.unit.calibration import AUDIT_GAIN, AUDIT_ZERO, Calibration, CalibrationRecord
from softcal.core.unit.estimate import estimate
from softcal.core.unit.judging import TRIM_BARS, UNREADABLE, limit_evidence
from softcal.core.unit.measured_error import MeasuredError
from softcal.core.unit.method import Method
from softcal.core.unit.scoring import score_map
from softcal.core.unit.verdict import Limit


def with_audit(
    network: Network, calibration: Calibration, audit: LabelledRecording, recording: OutputRecording
) -> Calibration:
    """Return the calibration with what an audit says beside the error; `recording` is the one it was made from."""
    estimates = estimate(network, calibration, audit.unlabelled)
    half, rest = estimates.upper - estimates.estimate, (calibration.method or Method()).map.crossing.robust_range[0]
    reading = read_audit(estimates.estimate, half, audit, recording, rest)
    return replace(
        calibration,
        audit=reading,
        evidence={**calibration.evidence, AUDIT_GAIN: reading.gain, AUDIT_ZERO: reading.zero},
    )


def measured(
    network: Network,
    record: CalibrationRecord,
    audit: LabelledRecording,
    recording: OutputRecording,
    limit: Limit,
    *,
    is_newer: bool = True,
    own: MeasuredError | None = None,
) -> CalibrationRecord:
    """Return a calibration scored on an audit, and judged by it; its map stays.

    Args:
        record: as it was fitted or trimmed, with its grounds.
        recording: the one it was calibrated from.
        is_newer: whether the audit is another than it was made with: what barred the older one is over.
        own: error of its own network, where one was trained on this audit.
    """
    calibration, grounds = Calibration.from_record(record), record.grounds
    if grounds is None:
        raise ValueError("a calibration that kept no grounds cannot be judged again")
    config = (calibration.method or Method()).decision
    scores = score_map(network, calibration.unit_map, audit, own, config)
    grounds = replace(
        grounds,
        measured=scores,
        bars=tuple(why for why in grounds.bars if not is_newer or why.code not in (*TRIM_BARS, UNREADABLE)),
    )
    decision = grounds.decide(limit)
    scored = with_audit(network, replace(calibration, grounds=grounds, decision=decision), audit, recording)
    identity = content_sha256({}, {"base": record.input_sha256, "audit": audit.sha256, "limit": limit.to_json()})
    audit_record = scored.to_record(identity, record.recording_sha256, record.fit_s)
    return replace(
        audit_record,
        settings={**record.settings, **audit_record.settings},
        evidence={**record.evidence, **audit_record.evidence, **limit_evidence(limit)},
    )


def judged(record: CalibrationRecord, limit: Limit) -> CalibrationRecord | None:
    """Return a calibration judged against another limit; None where only a new fit can judge it.

    Calibrations of older versions kept no grounds, and rules of other packages have to see the recording again.

    Args:
        record: as it was fitted, before audits of other units scaled it.
    """
    grounds = record.grounds
    if grounds is None or grounds.rules:
        return None
    decision = grounds.decide(limit)
    return replace(
        record,
        settings={**record.settings, "decision": decision.to_json()},
        verdict=str(decision.verdict),
        reasons=decision.reasons,
        evidence={**record.evidence, **limit_evidence(limit)},
        input_sha256=content_sha256({}, {"base": record.input_sha256, "limit": limit.to_json()}),
    )


def read_gain(network: Network, calibration: Calibration, recording: LabelledRecording) -> float:
    """Return the slope of a unit's estimates over the reference: 1 where it reads its loads in full."""
    return line_of(estimate(network, calibration, recording.unlabelled).estimate, recording.reference)[0]
