"""Trim a registered unit by known loads at its place of use: a new revision of its calibration, or nothing."""

from dataclasses import replace
from pathlib import Path

from softcal.app.files.anchors import read_anchors
from softcal.app.registry.source import source_recording, unlabelled
from softcal.core.identity import content_sha256
from softcal.core.maps.config import MapConfig
from softcal.core.maps.interface import Anchors, FitProblem, map_sha256
from softcal.core.unit.calibration import Calibration, CalibrationRecord
from softcal.core.unit.method import Method
from softcal.core.unit.verdict import Decision, Judgement, Verdict
from softcal.core.use.method import TrimConfig, UseMethod
from softcal.core.use.trim import Trimmed, trim
from softcal.core.words.reason import reason
from softcal.db.registry import Registry


def trim_unit(registry: Registry, serial: str, loads_file: Path, actor: str | None = None) -> tuple[Trimmed, int]:
    """Re-anchor a unit's map by the loads of a file, and keep it as its next revision.

    Args:
        loads_file: table with the columns output, reference; a row a load; a column serial names this unit.

    Returns:
        What the trim found, and the new revision.

    Raises:
        InputError: the loads cannot be of this unit, or the unit is not in the registry; nothing was changed.
    """
    record = registry.calibration(serial).record
    loads = read_anchors(loads_file, [serial])[serial]
    problem = FitProblem(
        source_recording(registry, record.network_id),
        registry.network(record.network_id),
        unlabelled(registry.recording(record.recording_sha256)),
    )
    config = UseMethod().trim
    problem = replace(problem, config=_config(record, problem, config))
    found = trim(problem, Calibration.from_record(record).unit_map, loads, config)
    lot_id = registry.calibration(serial).lot_id
    trimmed = _record(record, found, loads)
    why = f"trimmed by {len(loads.output)} loads"
    revision = registry.add_calibration(lot_id, trimmed, actor=actor, reason=why, decided_by="trim")
    return found, revision


def _config(record: CalibrationRecord, problem: FitProblem, trim: TrimConfig) -> MapConfig:
    """Return how far loads are believed beside the map: a paired map is firm, and f itself misreads a load at rest."""
    config = (record.method or Method()).map
    # Two loads must not outvote the many pairs a map was fitted to.
    firm = {"paired": trim.firm_paired, "stage": trim.firm_stage}
    model_N = float(str(record.evidence.get("u_model") or 0.0))
    error = max(config.anchors.load_error, model_N / problem.network.reference_scale)
    spread = min(config.anchors.gain_spread, firm.get(record.knowledge.kind, config.anchors.gain_spread))
    return replace(config, anchors=replace(config.anchors, load_error=error, gain_spread=spread))


def _record(record: CalibrationRecord, found: Trimmed, loads: Anchors) -> CalibrationRecord:
    """Return the calibration with the trimmed map. What was measured or sampled was so with the map before."""
    said = reason("trimmed", loads=len(loads.output), before=found.before_rmse, after=found.after_rmse)
    predicted = record.decision.predicted
    best = max(predicted.verdict, Verdict.CONDITIONAL, key=lambda word: word.severity)
    decision = Decision(Judgement(best, (said, *predicted.reasons)))
    told = {"map_anchor_gain": found.unit_map.gain, "map_anchor_offset": found.unit_map.offset}
    arrays = {name: array for name, array in record.arrays.items() if not name.startswith("map.")}
    arrays |= {f"map.{name}": array for name, array in found.unit_map.arrays().items()}
    kept = {"base": record.input_sha256, "output": loads.output.tolist(), "reference": loads.reference.tolist()}
    return replace(
        record,
        map_sha256=map_sha256(found.unit_map),
        arrays=arrays,
        settings={**record.settings, "decision": decision.to_json()},
        verdict=str(decision.verdict),
        reasons=decision.reasons,
        before_rmse=None,
        after_rmse=None,
        own_rmse=None,
        evidence={**record.evidence, **told},
        input_sha256=content_sha256({}, kept),
    )
