"""Trim a registered unit by known loads at its place of use: a new revision of its calibration, or nothing."""

from dataclasses import replace
from pathlib import Path

from softcal.app.batch.judging import judge_again
from softcal.app.files.anchors import read_anchors
from softcal.app.registry.source import source_recording, unlabelled
from softcal.app.registry.untrimmed import UNTRIMMED, untrimmed
from softcal.core.identity import content_sha256
from softcal.core.maps.interface import Anchors, FitProblem, map_sha256
from softcal.core.unit.calibration import Calibration, CalibrationRecord
from softcal.core.unit.judging import AUDITED_BEFORE_TRIM, LIMIT_EVIDENCE
from softcal.core.unit.method import Method
from softcal.core.unit.uncertainty import Interval
from softcal.core.unit.verdict import Decision, Verdict
from softcal.core.use.method import UseMethod
from softcal.core.use.trim import Trimmed, trim
from softcal.core.words.reason import reason
from softcal.db.entries import StoredCalibration
from softcal.db.registry import Registry

LOADS = "loads"
"""Group of a calibration's settings that keeps the known loads it was trimmed by."""


def trim_unit(
    registry: Registry, serial: str, loads_file: Path, lot_id: str | None = None, actor: str | None = None
) -> tuple[Trimmed, int]:
    """Re-anchor a unit's map by the loads of a file, and keep it as its next revision.

    Args:
        loads_file: table with the columns output, reference; a row a load; a column serial names this unit.
        lot_id: lot of the unit; needed where the serial stands in several.

    Returns:
        What the trim found, and the new revision.

    Raises:
        InputError: the loads cannot be of this unit, or the unit is not in the registry; nothing was changed.
    """
    stored = registry.calibration(serial, lot_id=lot_id)
    base = untrimmed(registry, stored)
    record = base.record
    loads = read_anchors(loads_file, [serial])[serial]
    problem = FitProblem(
        source_recording(registry, record.network_id),
        registry.network(record.network_id),
        unlabelled(registry.recording(record.recording_sha256)),
    )
    problem = replace(problem, config=(record.method or Method()).map)
    before = Calibration.from_record(record)
    found = trim(problem, before.unit_map, before.interval, loads, UseMethod().trim)
    # What the trim leaves open, whichever way the load moves.
    wider = before.interval.widened(found.variance(before.interval))
    trimmed = _record(base, stored.record, found, wider, loads)
    why = f"trimmed by {len(loads.output)} loads"
    registry.add_calibration(stored.lot_id, trimmed, actor=actor, reason=why, decided_by="trim")
    judge_again(registry, [stored.lot_id], actor)
    return found, registry.calibration(serial, lot_id=stored.lot_id).revision


def trimmed_by(registry: Registry, serial: str, loads_file: Path, lot_id: str | None = None) -> int:
    """Return the revision of a unit that known loads made, trimming it only where they have not done so yet.

    A stream that is followed again from its start is then followed from the same map.

    Raises:
        InputError: as `trim_unit`.
    """
    stored = registry.calibration(serial, lot_id=lot_id)
    if stored.record.settings.get(LOADS) == _values(read_anchors(loads_file, [serial])[serial]):
        return stored.revision
    return trim_unit(registry, serial, loads_file, lot_id)[1]


def _values(loads: Anchors) -> dict[str, list[float]]:
    return {"output": loads.output.tolist(), "reference": loads.reference.tolist()}


def _decided(decision: Decision, found: Trimmed, loads: Anchors) -> Decision:
    """Return what is decided on a trimmed unit: nothing passes that was measured with another map.

    A measured fail stays: known loads say nothing about what lies between and beyond them.
    """
    is_held = decision.measured is not None and decision.measured.verdict is Verdict.FAIL
    said = [reason("trimmed", loads=len(loads.output), before=found.before_rmse, after=found.after_rmse)]
    if decision.is_audited or AUDITED_BEFORE_TRIM in {why.code for why in decision.bars}:
        said.append(reason(AUDITED_BEFORE_TRIM))
    bars = (*said, *(why for why in decision.bars if why.code not in ("trimmed", AUDITED_BEFORE_TRIM)))
    # Audits of other units spoke for the map before; the lot is judged again.
    return replace(decision, measured=decision.measured if is_held else None, sampled=None, bars=bars)


def _record(
    base: StoredCalibration,
    before: CalibrationRecord,
    found: Trimmed,
    wider: Interval,
    loads: Anchors,
) -> CalibrationRecord:
    """Return the calibration with the trimmed map. What was measured or sampled was so with the map before.

    Args:
        base: the trim begins from it.
        before: what was in use, by which the unit was judged last.
    """
    record, decision = base.record, _decided(before.decision, found, loads)
    grounds = before.grounds
    if grounds is not None:
        grounds = replace(grounds, measured=grounds.measured if decision.measured else None, bars=decision.bars)
    told: dict[str, float | str | None] = {
        UNTRIMMED: float(base.revision),
        "map_anchor_gain": found.unit_map.gain,
        "map_anchor_offset": found.unit_map.offset,
        "map_gain_error": found.gain_error,
        "map_rest_error": found.rest_error,
    }
    arrays = {name: array for name, array in record.arrays.items() if not name.startswith("map.")}
    arrays |= {f"map.{name}": array for name, array in found.unit_map.arrays().items()}
    arrays["interval.half_width"] = wider.half_width
    kept = {"base": record.input_sha256, **_values(loads)}
    told |= {name: before.evidence[name] for name in LIMIT_EVIDENCE if name in before.evidence}
    judged_by = {"decision": decision.to_json(), "grounds": None if grounds is None else grounds.to_json()}
    settings = {**record.settings, **judged_by, LOADS: _values(loads)}
    trimmed = replace(
        record,
        map_sha256=map_sha256(found.unit_map),
        arrays=arrays,
        settings=settings,
        verdict=str(decision.verdict),
        reasons=decision.reasons,
        evidence={**record.evidence, **told},
        input_sha256=content_sha256({}, kept),
    )
    return trimmed if decision.is_audited else replace(trimmed, before_rmse=None, after_rmse=None, own_rmse=None)
