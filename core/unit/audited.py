"""A calibration beside an audit of its unit: what the audit says of it, and how it is judged by it; its map stays."""

from dataclasses import replace

from softcal.core.identity import content_sha256
from softcal.core.network.network import Network
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.audit_reading import read_audit
from softcal.core.unit.calibration import AUDIT_GAIN, AUDIT_ZERO, Calibration, CalibrationRecord
from softcal.core.unit.estimate import estimate
from softcal.core.unit.judging import TRIM_BARS, UNREADABLE, MeasuredError, limit_evidence
from softcal.core.unit.method import Method
from softcal.core.unit.scoring import score_map
from softcal.core.unit.verdict import Limit


def with_audit(
    network: Network, calibration: Calibration, audit: LabelledRecording, recording: OutputRecording
) -> Calibration:
    """Return the calibration with what a labelled recording of its unit says beside the error.

    Args:
        network: the shared network f.
        calibration: of the unit, before audits of other units scaled its interval.
        recording: the one it was calibrated from.
    """
    found = estimate(network, calibration, audit.unlabelled)
    half, rest = found.upper - found.estimate, (calibration.method or Method()).decision.audit_rest
    reading = read_audit(found.estimate, half, audit, recording, rest)
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
) -> CalibrationRecord:
    """Return a calibration scored on an audit, and judged by it; its map stays.

    Args:
        network: the shared network f.
        record: as it was fitted or trimmed, with its grounds.
        audit: labelled recording of the unit.
        recording: the one it was calibrated from.
        limit: in force.
        is_newer: whether the audit is another than it was made with: what barred the older one is over.
    """
    calibration, grounds = Calibration.from_record(record), record.grounds
    if grounds is None:
        raise ValueError("a calibration that kept no grounds cannot be judged again")
    config = (calibration.method or Method()).decision
    scores = score_map(network, calibration.unit_map, audit, None, config)
    grounds = replace(
        grounds,
        measured=MeasuredError(scores, len(audit.windows)),
        bars=tuple(why for why in grounds.bars if not is_newer or why.code not in (*TRIM_BARS, UNREADABLE)),
    )
    decision = grounds.decide(limit, config)
    scored = with_audit(
        network, replace(calibration, scores=scores, grounds=grounds, decision=decision), audit, recording
    )
    identity = content_sha256({}, {"base": record.input_sha256, "audit": audit.sha256, "limit": limit.to_json()})
    found = scored.to_record(identity, record.recording_sha256, record.fit_s)
    return replace(
        found,
        settings={**record.settings, **found.settings},
        evidence={**record.evidence, **found.evidence, **limit_evidence(limit)},
    )
