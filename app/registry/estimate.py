"""Estimates of one calibrated unit over a recording: f∘γ with interval and flags."""

from dataclasses import dataclass
from pathlib import Path

from softcal.app.files.recording_file import PLAIN, ColumnNames, FileRecording, inspect_recording, write_columns
from softcal.app.files.stream_file import COLUMNS
from softcal.app.registry.unit import calibrated_unit
from softcal.core.unit.estimate import Estimate, estimate
from softcal.db.registry import Registry


@dataclass(frozen=True, eq=False)
class FileEstimate:
    """Estimates of a file, one row for each of its rows, and the layout of the file."""

    estimate: Estimate
    file: FileRecording


def estimate_file(
    registry: Registry,
    source: Path,
    target: Path,
    serial: str,
    revision: int | None = None,
    lot_id: str | None = None,
    names: ColumnNames = PLAIN,
) -> FileEstimate:
    """Read `t_s, output` of `source`, write `t_s, estimate, lower, upper, flag` to `target`, whole or not at all.

    A row of `source` without a usable sample is `invalid`; rows whose window reaches over it are a `gap`.
    """
    lot, network, calibration = calibrated_unit(registry, serial, revision, lot_id)
    config = calibration.fit.method.inspection
    file = inspect_recording(source, serial, lot.sample_rate_Hz, lot.output_unit, names=names, config=config)
    result = estimate(network, calibration, file.recording).spread(file.t_s, file.rows)
    numbers = [(name, getattr(result, name)) for name in COLUMNS[:-1]]
    write_columns(target, [*numbers, ("flag", result.flag.tolist())])
    return FileEstimate(result, file)
