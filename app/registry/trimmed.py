"""Trims of a unit: known loads adjust its fitted map, and the map of every later fit of that recording.

A trim is a measured fact of its unit. Whoever calibrates the recording again, its loads go behind the new map, or the
unit says why they do not. It changes this unit alone.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from softcal.app.registry.lot_recordings import audit_of, measure_unit, newest_audits, source_recording, unlabelled
from softcal.core.errors import InputError, MapsConflict
from softcal.core.maps.interface import Anchors, FitProblem
from softcal.core.messages.reason import Reason, reason
from softcal.core.unit.adjustments import Trim
from softcal.core.unit.state import UnitState
from softcal.core.unit.trim import NeedlessTrim, trim
from softcal.db.entries import StoredCalibration
from softcal.db.registry import Registry

DECIDED_BY = "trim"
"""Who put a trimmed calibration into use."""


def is_trimmed_by(state: UnitState, loads: Anchors) -> bool:
    """Return whether the map of a unit was trimmed by these very loads."""
    trim_now = state.trim_in_force
    return trim_now is not None and (trim_now.output, trim_now.reference) == _values(loads)


def store_trim(registry: Registry, stored: StoredCalibration, loads: Anchors, actor: str | None = None) -> Trim:
    """Trim the calibration in use of a unit by known loads, and put the result into use.

    Raises:
        InputError: the loads cannot be of this unit; nothing was changed.
    """
    result = trim_state(registry, stored, loads)
    put_trim(registry, stored, result, f"trimmed by {len(loads.output)} loads", actor)
    return result


def trim_state(registry: Registry, stored: StoredCalibration, loads: Anchors) -> Trim:
    """Return the state of a unit after a trim of its fitted map; nothing is stored.

    Raises:
        InputError: the loads cannot be of this unit.
    """
    fit, fitted = stored.state.fit, stored.state.fitted
    network, source = registry.networks.get(fit.network_id), source_recording(registry, fit.network_id)
    recording = unlabelled(registry.recordings.get(fit.recording_sha256))
    problem = FitProblem(source, network, recording, config=fit.method.map)
    result = trim(problem, fitted.unit_map, fitted.interval, loads)
    entry = newest_audits(registry, stored.lot_id, stored.serial).get(stored.serial)
    return replace(result, audit_sha256="" if entry is None else entry.sha256)


def put_trim(registry: Registry, stored: StoredCalibration, new: Trim, note: str, actor: str | None) -> None:
    """Put a unit with a trim into use; an audit newer than its loads measures the trimmed map."""
    state = replace(stored.state, trim=new)
    entry = newest_audits(registry, stored.lot_id, stored.serial).get(stored.serial)
    audit = None if entry is None or entry.sha256 == new.audit_sha256 else audit_of(registry, entry)
    if audit is not None and entry is not None and new.left_out is None and not state.fit.rules:
        state = measure_unit(registry, replace(state, unreadable_audit=None), audit)
    registry.calibrations.put_state(stored.lot_id, state, DECIDED_BY, actor=actor, reason=note)


@contextmanager
def trim_stored(registry: Registry, lot_id: str, serial: str, actor: str | None) -> Iterator[None]:
    """Apply the trim of a unit to another calibration that comes into use: both, or neither.

    Loads of another recording are left out: they say how the unit was when that one was made. So are loads that the new
    map cannot take; the unit says why.
    """
    older = _trim_in_use(registry, lot_id, serial)
    with registry.transaction():
        yield
        if older is None:
            return
        stored = registry.calibrations.get(serial, lot_id=lot_id)
        if stored.state.trim is not None:
            return
        new = older
        cause: Reason | None = reason("trim.older", loads=len(older.output))
        if older.recording_sha256 == stored.state.fit.recording_sha256:
            try:
                new = replace(trim_state(registry, stored, older.loads), audit_sha256=older.audit_sha256)
                cause = None
            except NeedlessTrim:
                cause = reason("trim.read", loads=len(older.output))
            except InputError as error:
                cause = reason("trim.left_out", error=str(error))
        if cause is not None:
            new = replace(older, left_out=cause, is_blocking=cause.code != "trim.read")
        note = "the trim of this recording, behind its new map" if cause is None else cause.code
        put_trim(registry, stored, new, note, actor)


def _trim_in_use(registry: Registry, lot_id: str, serial: str) -> Trim | None:
    """Return the trim of the calibration in use of a unit, or None."""
    if not registry.calibrations.was_decided_by(DECIDED_BY, lot_id, serial):
        return None
    try:
        return registry.calibrations.get(serial, lot_id=lot_id).state.trim
    except MapsConflict:
        # A person decides first.
        return None


def _values(loads: Anchors) -> tuple[tuple[float, ...], tuple[float, ...]]:
    return tuple(map(float, loads.output)), tuple(map(float, loads.reference))
