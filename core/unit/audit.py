"""Measure a unit by a labelled recording of it: the error of the map in force, and what is stored beside it."""

from dataclasses import replace

import numpy as np

from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.unit.estimate import estimate
from softcal.core.unit.measured_error import AuditResult, MeasuredError
from softcal.core.unit.output_level import load_line, output_level
from softcal.core.unit.scoring import score_map
from softcal.core.unit.state import UnitState
from softcal.core.windows import evenly

INSTANTS = 201
"""Instants of an audit that are stored, evenly spaced: enough for shares of its samples."""


def measure(
    network: Network,
    state: UnitState,
    audit: LabelledRecording,
    recording: OutputRecording,
    own_calibration: NetworkConfig | MeasuredError | None = None,
) -> UnitState:
    """Return the state with an audit of its map in force.

    Args:
        recording: the one that the unit was calibrated from.
        own_calibration: how a network of the unit's own is trained on the audit, for comparison; or the error of one
            that was. Of the audit that the state has already, the stored one stays.
    """
    before = state.audit
    if own_calibration is None and before is not None and before.recording_sha256 == audit.sha256:
        own_calibration = None if before.scores.own is None else before.scores.own.own
    method = state.fit.method
    uninflated = replace(state, release=None)
    value, half = _estimates(network, uninflated, audit)
    fitted = replace(state, release=None, trim=None, correction=None)
    fitted_value = value if state.line_behind is None else _estimates(network, fitted, audit)[0]
    rows = np.flatnonzero(np.isfinite(value))
    spread = rows[evenly(len(rows), INSTANTS)]
    rest = method.map.crossing.robust_range[0]
    unit, now = (output_level(one, is_rising=audit.direction > 0, rest=rest) for one in (recording, audit.unlabelled))
    result = AuditResult(
        map_id=state.map_id,
        recording_sha256=audit.sha256,
        output_sha256=audit.output_sha256,
        scores=score_map(network, state.unit_map, audit, method.decision, own_calibration),
        line=load_line(value, audit.reference),
        fitted_line=load_line(fitted_value, audit.reference),
        unit_rest=unit.rest,
        audit_rest=now.rest,
        span=unit.span,
        residual=_short(np.abs(value - audit.reference)[spread]),
        half=_short(half[spread]),
    )
    return replace(state, audit=result)


def _estimates(network: Network, state: UnitState, audit: LabelledRecording) -> tuple[Array, Array]:
    estimates = estimate(network, state, audit.unlabelled)
    return estimates.estimate, estimates.upper - estimates.estimate


def _short(values: Array) -> tuple[float, ...]:
    return tuple(float(f"{value:.6g}") for value in values)
