"""Trims of a unit: what a trim began from, what it makes, and its loads behind a new fit.

A trim is a measured fact of its unit. Whoever calibrates the recording again, its loads go behind the new map, or the
unit says why they do not.
"""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from softcal.app.registry.known_loads import loads_of, values
from softcal.app.registry.limit import lot_limit
from softcal.app.registry.lot_recordings import audit_of, newest_audits, source_recording, unlabelled
from softcal.core.errors import InputError, MapsConflict
from softcal.core.identity import content_sha256
from softcal.core.maps.interface import Anchors, FitProblem, map_sha256
from softcal.core.unit.audited import measured
from softcal.core.unit.calibration import Calibration, CalibrationRecord
from softcal.core.unit.judging import AUDITED_BEFORE_TRIM, LIMIT_EVIDENCE, TRIM_BARS, TRIM_LEFT_OUT, TRIM_OLDER, TRIMMED
from softcal.core.unit.method import Method
from softcal.core.unit.trim import NeedlessTrim, Trimmed, trim
from softcal.core.unit.uncertainty import Interval
from softcal.core.unit.verdict import Decision, Verdict
from softcal.core.words.reason import Reason, reason
from softcal.db.entries import StoredCalibration
from softcal.db.registry import Registry

LOADS = "loads"
"""Group of a calibration's settings: the loads it was trimmed by, and after what."""

UNTRIMMED = "untrimmed_revision"
"""Number among a trimmed calibration's evidence: the revision it was made from."""

READ = "trim.read"
"""Code of the reason that the map reads the loads of a trim without it."""

DECIDED_BY = "trim"
"""Who put a trimmed calibration into use."""


@dataclass(frozen=True, eq=False)
class KnownTrim:
    """What a unit was trimmed by.

    Args:
        recording: hash of the recording that its map was fitted to.
        audit: hash of its newest audit of then; "" where it had none.
    """

    loads: Anchors
    recording: str
    audit: str

    def to_json(self) -> dict[str, object]:
        return {**values(self.loads), "recording": self.recording, "audit": self.audit}


def is_trimmed_by(record: CalibrationRecord, loads: Anchors) -> bool:
    """Return whether the map of a calibration was trimmed by these very loads."""
    kept: Mapping[str, Any] = record.settings.get(LOADS) or {}  # type: ignore[assignment]
    return UNTRIMMED in record.evidence and values(loads).items() <= kept.items()


def untrimmed(registry: Registry, stored: StoredCalibration) -> StoredCalibration:
    """Return the calibration behind trims and others' audits: a new trim replaces them.

    Those audits are asked again what the trimmed one is worth; what trims do not settle does not add up.
    """
    evidence = stored.record.evidence
    revision = evidence.get(UNTRIMMED, evidence.get("base_revision"))
    if revision is None:
        return stored
    return registry.calibrations.get(stored.serial, int(revision), lot_id=stored.lot_id)


def keep_trim(registry: Registry, stored: StoredCalibration, loads: Anchors) -> Trimmed:
    """Trim a calibration in use by known loads, and put the result into use.

    Raises:
        InputError: the loads cannot be of this unit; nothing was changed.
    """
    audit = newest_audits(registry, stored.lot_id, stored.serial).get(stored.serial)
    known = KnownTrim(loads, stored.record.recording_sha256, "" if audit is None else audit.sha256)
    return _trimmed(registry, stored, known, f"trimmed by {len(loads.output)} loads", None)


@contextmanager
def trim_kept(registry: Registry, lot_id: str, serial: str, actor: str | None) -> Iterator[None]:
    """Keep the trim of a unit while another calibration comes into use: both, or neither.

    The trim goes behind the new map, or the unit says why it is left out. The loads of another recording are left out:
    they say how the unit was when that one was made. So are loads that the new map cannot take.
    """
    known = _known_trim(registry, lot_id, serial)
    with registry.transaction():
        yield
        if known is None:
            return
        stored = registry.calibrations.get(serial, lot_id=lot_id)
        if LOADS in stored.record.settings:
            return
        count = len(known.loads.output)
        if known.recording != stored.record.recording_sha256:
            _leave_out(registry, stored, known, reason(TRIM_OLDER, loads=count), True, actor)
            return
        try:
            _trimmed(registry, stored, known, "the trim of this recording, behind its new map", actor)
        except NeedlessTrim:
            _leave_out(registry, stored, known, reason(READ, loads=count), False, actor)
        except InputError as error:
            _leave_out(registry, stored, known, reason(TRIM_LEFT_OUT, error=str(error)), True, actor)


def _known_trim(registry: Registry, lot_id: str, serial: str) -> KnownTrim | None:
    """Return what the calibration in use of a unit was trimmed by; None where it was not."""
    if not registry.calibrations.was_decided_by(DECIDED_BY, lot_id, serial):
        return None
    try:
        stored = registry.calibrations.get(serial, lot_id=lot_id)
    except MapsConflict:
        # A person decides first.
        return None
    kept: Mapping[str, Any] | None = stored.record.settings.get(LOADS)  # type: ignore[assignment]
    return None if kept is None else KnownTrim(loads_of(kept), kept["recording"], kept["audit"])


def _trimmed(registry: Registry, stored: StoredCalibration, known: KnownTrim, why: str, actor: str | None) -> Trimmed:
    base = untrimmed(registry, stored)
    record = base.record
    f, source = registry.networks.get(record.network_id), source_recording(registry, record.network_id)
    recording = unlabelled(registry.recordings.get(record.recording_sha256))
    problem = FitProblem(source, f, recording, config=(record.method or Method()).map)
    before = Calibration.from_record(record)
    result = trim(problem, before.unit_map, before.interval, known.loads)
    # What the trim leaves open, whichever way the load moves.
    wider = before.interval.widened(result.variance(before.interval))
    trimmed = _record(base, stored.record, result, wider, known)
    entry = newest_audits(registry, stored.lot_id, stored.serial).get(stored.serial)
    audit = None if entry is None or entry.sha256 == known.audit else audit_of(registry, entry)
    if audit is not None and trimmed.grounds is not None and not trimmed.grounds.rules:
        trimmed = measured(f, trimmed, audit, recording, lot_limit(registry, stored.lot_id))
    registry.calibrations.add(stored.lot_id, trimmed, actor=actor, reason=why, decided_by=DECIDED_BY)
    return result


def _leave_out(
    registry: Registry, stored: StoredCalibration, known: KnownTrim, why: Reason, is_bar: bool, actor: str | None
) -> None:
    """Let a unit say why its trim is not behind its map; the loads stay known."""
    record, decision, grounds = stored.record, stored.record.decision, stored.record.grounds
    if is_bar:
        decision = replace(decision, bars=(why, *decision.bars))
        grounds = None if grounds is None else replace(grounds, bars=decision.bars)
    else:
        predicted = replace(decision.predicted, reasons=(*decision.predicted.reasons, why))
        decision = replace(decision, predicted=predicted)
        grounds = None if grounds is None else replace(grounds, told=(*grounds.told, why))
    judged_by = {"decision": decision.to_json(), "grounds": None if grounds is None else grounds.to_json()}
    restated = replace(
        record,
        settings={**record.settings, **judged_by, LOADS: known.to_json()},
        verdict=str(decision.verdict),
        reasons=decision.reasons,
        input_sha256=content_sha256({}, {"base": record.input_sha256, "left_out": why.to_json(), **known.to_json()}),
    )
    registry.calibrations.add(stored.lot_id, restated, actor=actor, reason=why.code, decided_by=DECIDED_BY)


def _decided(decision: Decision, result: Trimmed, loads: Anchors) -> Decision:
    """Return what is decided on a trimmed unit: nothing passes that was measured with another map.

    A measured fail stays: known loads say nothing about what lies between and beyond them.
    """
    is_held = decision.measured is not None and decision.measured.verdict is Verdict.FAIL
    said = [reason(TRIMMED, loads=len(loads.output), before=result.before_rmse, after=result.after_rmse)]
    if decision.is_audited or AUDITED_BEFORE_TRIM in {why.code for why in decision.bars}:
        said.append(reason(AUDITED_BEFORE_TRIM))
    bars = (*said, *(why for why in decision.bars if why.code not in TRIM_BARS))
    predicted = replace(decision.predicted, reasons=_trimless(decision.predicted.reasons))
    # Audits of other units spoke for the map before; the lot is judged again.
    return Decision(predicted, decision.measured if is_held else None, bars=bars)


def _trimless(reasons: Iterable[Reason]) -> tuple[Reason, ...]:
    """Return reasons without what was said of a trim that was left out."""
    return tuple(why for why in reasons if why.code != READ)


def _record(
    base: StoredCalibration, before: CalibrationRecord, result: Trimmed, wider: Interval, known: KnownTrim
) -> CalibrationRecord:
    """Return the calibration with the trimmed map. What was measured was so before it."""
    record, decision = base.record, _decided(before.decision, result, known.loads)
    grounds = before.grounds
    if grounds is not None:
        kept = grounds.measured if decision.measured else None
        grounds = replace(grounds, measured=kept, bars=decision.bars, told=_trimless(grounds.told))
    numbers: dict[str, float | str | None] = {
        UNTRIMMED: float(base.revision),
        "map_anchor_gain": result.unit_map.gain,
        "map_anchor_offset": result.unit_map.offset,
        "map_gain_error": result.gain_error,
        "map_rest_error": result.rest_error,
    }
    arrays = {name: array for name, array in record.arrays.items() if not name.startswith("map.")}
    arrays |= {f"map.{name}": array for name, array in result.unit_map.arrays().items()}
    arrays["interval.half_width"] = wider.half_width
    numbers |= {name: before.evidence[name] for name in LIMIT_EVIDENCE if name in before.evidence}
    judged_by = {"decision": decision.to_json(), "grounds": None if grounds is None else grounds.to_json()}
    trimmed = replace(
        record,
        map_sha256=map_sha256(result.unit_map),
        arrays=arrays,
        settings={**record.settings, **judged_by, LOADS: known.to_json()},
        verdict=str(decision.verdict),
        reasons=decision.reasons,
        evidence={**record.evidence, **numbers},
        input_sha256=content_sha256({}, {"base": record.input_sha256, **values(known.loads)}),
    )
    return trimmed if decision.is_audited else replace(trimmed, before_rmse=None, after_rmse=None, own_rmse=None)
