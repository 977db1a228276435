"""States of units as small as they can be, for tests of whatever stores and shows them."""

from dataclasses import replace

import numpy as np

from softcal.core.identity import content_sha256
from softcal.core.maps.affine_map import AffineMap
from softcal.core.maps.interface import map_sha256
from softcal.core.messages.reason import plain
from softcal.core.unit.adjustments import Correction, SampleRelease, Trim
from softcal.core.unit.correspondence import find_correspondence
from softcal.core.unit.fit import Fit, FittedMap
from softcal.core.unit.health import OutputLimits
from softcal.core.unit.measured_error import AuditResult, MeasuredError, Scores
from softcal.core.unit.method import LEVELS, Method
from softcal.core.unit.output_level import LoadLine
from softcal.core.unit.state import UnitState
from softcal.core.unit.uncertainty import ErrorForecast, Interval, IntervalInflation, Support
from softcal.core.unit.verdict import Finding, Limit, Verdict

METHOD = Method()
ROWS = 10_000
"""Of an audit: so many that its interval is narrow."""


def interval() -> Interval:
    support = Support(0.0, 1.0, np.zeros(2), np.ones(2), np.zeros((2, 2)), 1.0, 1.0)
    return Interval(support, np.full((3, LEVELS), 0.1), 0.0, 3.0, 1.0, 1.0, 1.0)


def fit_of(serial: str, network_id: str, recording_sha256: str, number: int = 1, **others: object) -> Fit:
    """Return a fit that differs by its number: its gain is 1 + number, its forecast number / 10."""
    unit_map = AffineMap(1.0 + number, 0.0)
    values: dict[str, object] = {
        "id": content_sha256({}, {"serial": serial, "number": number}),
        "serial": serial,
        "network_id": network_id,
        "recording_sha256": recording_sha256,
        "family": unit_map.family,
        "map_sha256": map_sha256(unit_map),
        "method": METHOD,
        "correspondence": find_correspondence({}, METHOD.correspondence),
        "forecast": ErrorForecast(0.1 * number, 0.05 * number, 0.2 * number),
        "budget": {"model": 0.05},
        "fit_s": 0.25,
        "fitted": FittedMap(unit_map, interval(), OutputLimits(-np.inf, np.inf, 100)),
    }
    return Fit(**{**values, **others})  # type: ignore[arg-type]


def with_fitted(state: UnitState, **parts: object) -> UnitState:
    """Return a state whose fit has another map, interval or limits of the output."""
    assert state.fit.fitted is not None
    return replace(state, fit=replace(state.fit, fitted=replace(state.fit.fitted, **parts)))  # type: ignore[arg-type]


def sample_release(**others: object) -> SampleRelease:
    """Return what a statement for the limit of 2 says of a unit that it releases."""
    values: dict[str, object] = {
        "number": 1,
        "limit_rmse": 2.0,
        "is_released": True,
        "scale": 1.0,
        "factor": 2.0,
        "interval_inflation": IntervalInflation(),
        "day_rmse": 0.0,
        "audits": plain("ten audits"),
        "risk": 0.05,
        "confidence": 0.95,
    }
    return SampleRelease(**{**values, **others})  # type: ignore[arg-type]


def adjusted(state: UnitState) -> UnitState:
    """Return a state with every kind of adjustment."""
    trim = Trim(output=(0.5, 1.0), reference=(0.0, 2.0), recording_sha256=state.fit.recording_sha256, gain=1.1)
    correction = Correction(number=1, line=LoadLine(1.02, 0.0), gain_error=0.01, zero_error=0.0, audits=9)
    return replace(state, trim=trim, correction=correction, release=sample_release())


def audit_of(state: UnitState, before: float, after: float) -> AuditResult:
    """Return an audit of the map of a state with these errors."""
    return AuditResult(
        map_id=state.map_id,
        recording_sha256=content_sha256({}, {"audit": state.serial, "after": after}),
        output_sha256=content_sha256({}, {"output": state.serial, "after": after}),
        scores=Scores(MeasuredError(before, ROWS), MeasuredError(after, ROWS)),
        line=LoadLine(1.0, 0.0),
        fitted_line=LoadLine(1.0, 0.0),
        unit_rest=0.5,
        audit_rest=0.5,
        span=1.0,
        residual=(0.0, 0.1),
        half=(0.1, 0.1),
    )


def audit_result(name: str, gain: float = 1.0, unit_rest: float = 0.5, audit_rest: float | None = None) -> AuditResult:
    """Return an audit of a unit whose load is read by this gain, and whose output at rest stood there."""
    return AuditResult(
        map_id="",
        recording_sha256=name,
        output_sha256=name,
        scores=Scores(MeasuredError(0.2, 1000), MeasuredError(0.1, 1000)),
        line=LoadLine(gain, 0.0),
        fitted_line=LoadLine(gain, 0.0),
        unit_rest=unit_rest,
        audit_rest=unit_rest if audit_rest is None else audit_rest,
        span=1.0,
        residual=(0.0, 1.0),
        half=(1.0, 1.0),
    )


def state_of(
    serial: str, network_id: str, recording_sha256: str, number: int = 1, verdict: str = "pass", limit_rmse: float = 2.0
) -> UnitState:
    """Return a state whose verdict is as asked: a pass was measured, a fail or a retest has a finding."""
    findings = () if verdict in ("pass", "conditional") else (Finding(plain("bent in the press"), Verdict(verdict)),)
    fit = fit_of(serial, network_id, recording_sha256, number, findings=findings)
    state = UnitState(fit=fit, limit=Limit("N", limit_rmse))
    if verdict == "pass":
        state = UnitState(fit=fit, limit=state.limit, audit=audit_of(state, 1.5 * limit_rmse, 0.1 * limit_rmse))
    assert state.verdict == verdict
    return state
