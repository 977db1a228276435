"""Golden run of the source for a unit, stored with the unit's recording like known loads.

One home for it. A station finds it when a unit is pressed, a lot folder brings it, and every later calibration of that
recording crosses the same bridge.
"""

from collections.abc import Collection, Mapping
from datetime import datetime

from softcal.core.errors import AmbiguousUnit, InputError
from softcal.core.unit.day_correction import DayCorrection, fit_day_correction
from softcal.core.unit.source_model import SourceModel
from softcal.db.registry import Registry
from softcal.db.schema.deadline import MAX_CLOCK_ERROR


def find_golden_runs(registry: Registry, lot_id: str, serials: Collection[str]) -> Mapping[str, tuple[str, str]]:
    """Return, by the hash of a unit's recording, its serial and its golden run's hash."""
    rows = registry.declarations.in_force("unit_golden_runs", lot_id, serials)
    return {row["recording_sha256"]: (row["serial"], row["golden_sha256"]) for row in rows}


def store_golden_runs(
    registry: Registry, lot_id: str, golden_runs: Mapping[str, tuple[str, str]], *, actor: str | None
) -> None:
    """Store the golden run of recordings; a stored golden run gets no second row.

    Args:
        golden_runs: hash of a unit's recording → (serial, hash of the golden run).
    """
    rows = (
        {"lot_id": lot_id, "serial": serial, "recording_sha256": sha256, "golden_sha256": golden}
        for sha256, (serial, golden) in golden_runs.items()
    )
    registry.declarations.declare("unit_golden_runs", *rows, actor=actor)


def newest_golden(registry: Registry, station: str, lot_id: str, since: datetime) -> str | None:
    """Return the hash of the newest golden run of a lot's source on a station that passed.

    Lots may share a source; of another one with the same serial, the recordings differ.
    """
    source_serials = sources_of(registry, lot_id)
    runs = registry.stations.golden_runs(station, registry.lots.get(lot_id).source, since)
    latest = registry.settings.clock() + MAX_CLOCK_ERROR  # What is later was written by a clock that was ahead.
    runs = [run for run in reversed(runs) if run.passed and run.recording_sha256 and run.made_at <= latest]
    lot_runs = (run for run in runs if run.lot_id == lot_id or source_serials & sources_of(registry, run.lot_id))
    return next((run.recording_sha256 for run in lot_runs), None)


def sources_of(registry: Registry, lot_id: str) -> set[str]:
    """Return the hashes of the recordings of a lot's source units."""
    return {entry.sha256 for entry in registry.recordings.of_lot(lot_id, kind="source")}


def load_day_correction(registry: Registry, model: SourceModel, golden_sha256: str) -> DayCorrection | str:
    """Return a stored golden run in the form for comparison with the units of its sitting, or a refusal."""
    try:
        return fit_day_correction(model, registry.recordings.get(golden_sha256))
    except InputError as error:
        return str(error)


def golden_lot(registry: Registry, serial: str, lot_id: str = "") -> str | None:
    """Return the lot with a released network whose source a serial is, or None.

    Raises:
        AmbiguousUnit: the sources of several lots have the serial, they differ, and no lot is named.
    """
    lots = [lot.id for lot in registry.lots.all() if lot.source == serial and lot_id in ("", lot.id)]
    lots = [lot for lot in lots if registry.networks.released(lot) is not None]
    if len(lots) > 1 and not set.intersection(*(sources_of(registry, lot) for lot in lots)):
        raise AmbiguousUnit(f"lots {', '.join(lots)} have sources {serial!r} that differ; name the lot that is meant")
    return next(iter(lots), None)
