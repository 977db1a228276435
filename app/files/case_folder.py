"""A case for diagnosis on disk: runs of one unit, each with recording.csv and recording.json."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np

from softcal.app.files.recording_file import ColumnNames, prefix_errors, read_times
from softcal.app.tables.options import DETECT, TableOptions
from softcal.app.tables.read import READERS, read_table
from softcal.app.tables.table import Table
from softcal.core.errors import InputError
from softcal.core.gap.case import CHANNELS, KINDS, Case, Run
from softcal.core.json_input import parse_json
from softcal.core.recording import Array
from softcal.core.twin.parameters import ReadoutMetadata, SensorType

RECORDING, METADATA = "recording.csv", "recording.json"
CASE_COLUMNS = (*CHANNELS, "known_force_N")


def open_case(folder: Path) -> Case:
    """Read a case: `runs/<name>/` below the folder, or the folder itself as its only run.

    Raises:
        InputError: a file is missing or cannot be read, metadata are missing or wrong, or the runs do not belong
            together.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder; a case holds runs/<n>/{RECORDING} and {METADATA}")
    runs_folder = folder / "runs"
    run_folders = (
        sorted((p for p in runs_folder.iterdir() if p.is_dir()), key=_run_order) if runs_folder.is_dir() else []
    )
    if (folder / RECORDING).is_file():
        run_folders = [folder]
    if not run_folders:
        tables = sorted(p.name for p in folder.iterdir() if p.suffix.lower() in READERS)
        hint = f"; to diagnose {tables[0]} alone, name it and give vref_V, adc_bits and rate_Hz" if tables else ""
        raise InputError(f"{folder}: neither {RECORDING} nor runs/<n>/{RECORDING}; this is no case{hint}")
    for run_folder in run_folders:
        if not (run_folder / RECORDING).is_file():
            raise InputError(f"{run_folder}: there is no {RECORDING}; add it, or remove the folder")
    runs_metadata = [_metadata(run_folder / METADATA) for run_folder in run_folders]
    serials = [str(metadata["serial"]) for metadata in runs_metadata]
    runs = [_run(run_folder, folder, metadata) for run_folder, metadata in zip(run_folders, runs_metadata, strict=True)]
    if len(set(serials)) > 1:
        raise InputError(f"{folder}: runs of several units ({', '.join(sorted(set(serials)))}); a case is of one unit")
    stiffness = None
    if (bounds := runs_metadata[0].get("stiffness_N_mm")) is not None:
        # Lowest and highest peak force over depth of the lot's units
        numbers = [v for v in bounds if isinstance(v, int | float)] if isinstance(bounds, list) else []
        if len(numbers) != 2 or not 0 < numbers[0] < numbers[1] or not math.isfinite(numbers[1]):
            path = run_folders[0] / METADATA
            raise InputError(f"{path}: stiffness_N_mm is {bounds!r}; [lowest, highest] in N/mm was expected")
        stiffness = float(numbers[0]), float(numbers[1])
    with prefix_errors(folder):
        return Case(serials[0], tuple(runs), stiffness_N_mm=stiffness)


LOT_COLUMNS = {"output": "output_V", "reference": "force_N"}
"""Columns of a lot folder's audits, and what they are to the twin."""


def open_table(path: Path, readout: ReadoutMetadata, options: TableOptions = DETECT) -> Case:
    """Return one plain table as the only run of a case, with the electronics that it does not state.

    Args:
        path: columns `force_N, output_V` or those of an audit, `stage_mm` and `t_s` where there are
            any.

    Raises:
        InputError: the table cannot be read or shows no gap.
    """
    table = read_table(path, options)
    renamed = {LOT_COLUMNS.get(name, name): name for name in table.names}
    t_s, channels = _samples(table, {name: renamed[name] for name in CHANNELS if name in renamed}, readout, options)
    with prefix_errors(path):
        return Case(path.stem, (Run(name=path.stem, t_s=t_s, readout=readout, **channels),))


def _run_order(run_folder: Path) -> tuple[int, str]:
    return (int(run_folder.name), "") if run_folder.name.isdigit() else (10**9, run_folder.name)


def read_json(path: Path) -> dict[str, Any]:
    """Return the JSON object of a file.

    Raises:
        InputError: the file cannot be read, is no JSON, or holds something else than names with values.
    """
    try:
        content = parse_json(path.read_text(encoding="utf-8"))
    except (ValueError, OSError) as error:
        raise InputError(f"{path}: cannot be read as JSON: {error}") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: holds {type(content).__name__}; an object with names and values was expected")
    return content


def _metadata(path: Path) -> Mapping[str, object]:
    if not path.is_file():
        raise InputError(
            f"{path}: missing; it must declare vref_V, adc_bits, r_series_ohm, sample_rate_Hz and serial of the run"
        )
    content = read_json(path)
    missing = [k for k in ("vref_V", "adc_bits", "r_series_ohm", "sample_rate_Hz", "serial") if content.get(k) is None]
    if missing:
        raise InputError(f"{path}: {', '.join(missing)} missing; the diagnosis cannot guess the electronics")
    return content


def _number(metadata: Mapping[str, object], name: str, path: Path) -> float:
    value = metadata[name]
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{path}: {name} is {value!r}; a number was expected")
    return float(value)


def _run(run_folder: Path, case: Path, metadata: Mapping[str, object]) -> Run:
    path, metadata_path = run_folder / RECORDING, run_folder / METADATA
    table = read_table(path)
    kind = metadata.get("kind") or "press"
    if kind not in KINDS:
        raise InputError(f"{metadata_path}: kind {kind!r} is not known; known are {', '.join(KINDS)}")
    bits = _number(metadata, "adc_bits", metadata_path)
    if bits != int(bits):
        raise InputError(f"{metadata_path}: adc_bits is {bits}; a whole number was expected")
    with prefix_errors(metadata_path):
        readout = ReadoutMetadata(
            vref_V=_number(metadata, "vref_V", metadata_path),
            adc_bits=int(bits),
            r_series_ohm=_number(metadata, "r_series_ohm", metadata_path),
            sample_rate_Hz=_number(metadata, "sample_rate_Hz", metadata_path),
            sensor_type=cast(SensorType, metadata.get("sensor_type") or "pressure"),
        )
    t_s, channels = _samples(table, {name: name for name in CASE_COLUMNS if name in table.names}, readout)
    with prefix_errors(path):
        return Run(
            name=run_folder.name if run_folder != case else "recording",
            t_s=t_s,
            readout=readout,
            dummy_ohm=_number(metadata, "dummy_ohm", metadata_path) if metadata.get("dummy_ohm") is not None else None,
            kind=kind,
            profile=str(metadata.get("profile") or ""),
            **channels,
        )


def _samples(
    table: Table, columns: Mapping[str, str], readout: ReadoutMetadata, options: TableOptions = DETECT
) -> tuple[Array, dict[str, Any]]:
    """Return the time and the channels that were recorded: a column of nothing but empty cells is none.

    A row that lacks its time or a recorded channel is left out, which leaves a gap.
    """
    values = {channel: table.numbers(name) for channel, name in columns.items()}
    recorded = {channel: cells for channel, cells in values.items() if not bool(np.isnan(cells).all())}
    if not columns and "t_s" not in table.names:
        names = ", ".join(table.names[:12])
        raise InputError(f"{table.path}: none of t_s, {', '.join(CASE_COLUMNS)}; the file has: {names}")
    if "t_s" in table.names and options.time_format is None:
        # As it stands: the diagnosis itself finds a wrong unit or rate.
        t_s = table.numbers("t_s")
    else:
        t_s, *_ = read_times(table, ColumnNames(output="", table=options), readout.sample_rate_Hz)
    is_complete = np.isfinite(t_s)
    for cells in recorded.values():
        is_complete &= np.isfinite(cells)
    return t_s[is_complete], {channel: cells[is_complete] for channel, cells in recorded.items()}
