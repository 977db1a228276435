"""Diagnose the gap of a case on disk, and write the explained twin."""

import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from softcal.app.bootstrap import current_user
from softcal.app.files.atomic import write_text
from softcal.app.files.case_folder import METADATA, RECORDING, open_case, open_table, read_json
from softcal.app.tables.options import DETECT, TableOptions
from softcal.app.views.gap_runs import ChannelView, RunView
from softcal.core.errors import InputError
from softcal.core.gap.case import Case
from softcal.core.gap.diagnosis import Diagnosis
from softcal.core.gap.method import METHOD
from softcal.core.gap.twin import TwinModel, diagnose
from softcal.core.transfer import calibration_gap
from softcal.core.twin.parameters import ReadoutMetadata
from softcal.core.twin.simulate import Twin, twin_from_record, twin_record
from softcal.db.provenance import Provenance, hash_files, record_provenance


def open_case_or_table(path: Path, readout: ReadoutMetadata | None = None, table: TableOptions = DETECT) -> Case:
    """Read a case.

    Args:
        path: folder of a case, or a plain table.
        readout: the electronics of a plain table; a case folder states its own.
        table: the declared layout of a plain table.

    Raises:
        InputError: the case cannot be read, or a table comes without its electronics.
    """
    if not path.is_file():
        return open_case(path)
    if readout is None:
        raise InputError(f"{path}: a plain table does not say its electronics; give vref_V, adc_bits and rate_Hz")
    return open_table(path, readout, table)


def diagnose_case(
    path: Path,
    progress: Callable[[str], None] | None = None,
    readout: ReadoutMetadata | None = None,
    table: TableOptions = DETECT,
    with_calibration: bool = False,
) -> Diagnosis[TwinModel]:
    """Read a case as `open_case_or_table` does and diagnose it; the diagnosis knows what it was made from.

    Args:
        with_calibration: with what the gap costs a calibration; not where the recordings hold a mistake.
    """
    diagnosis = diagnose(open_case_or_table(path, readout, table), progress)
    if with_calibration and diagnosis.verdict != "data":
        diagnosis = replace(diagnosis, calibration=calibration_gap(diagnosis, progress or (lambda _: None)))
    return replace(diagnosis, provenance=case_provenance(path).to_json())


def run_views(diagnosis: Diagnosis[Any]) -> list[RunView]:
    """Return every pressed run as a page shows it: measured, and predicted before and after."""
    problem, views = diagnosis.best.problem, []
    for k, run in enumerate(diagnosis.case.runs):
        if run.kind != "press":
            continue
        channels = {
            block.channel: ChannelView(
                problem.measured[block.rows],
                diagnosis.base.predicted[block.rows],
                diagnosis.best.predicted[block.rows],
                problem.noise_floor(block.channel),
            )
            for block in problem.blocks
            if block.run == k
        }
        name, drive, load_N = diagnosis.model.axes_of(diagnosis.best, k)
        views.append(RunView(run.name, run.profile, name, run.elapsed_s, drive, load_N, channels))
    return views


NO_TERMS = "no empirical terms: nothing is left, or no term holds on runs that were held back; leave --empirical out"


def apply_report(
    out: Path, report: Mapping[str, Any], source: str, provenance: Provenance, empirical: bool = False
) -> Twin:
    """Write the twin that a report of a diagnosis holds, whole or not at all.

    Args:
        report: of schema `softcal.gap/1`.
        source: of the report, for messages.
        empirical: with the empirical terms that describe what no cause explains.

    Raises:
        InputError: the recordings hold a mistake, or the report holds no twin or no such terms.
    """
    if report.get("verdict") == "data":
        raise InputError(f"{source}: the recordings hold a mistake, so there is no twin of them; repair it first")
    content = report.get("residual") if empirical else report
    if not isinstance(content, Mapping):
        raise InputError(f"{source}: {NO_TERMS}")
    if not isinstance(content.get("twin"), dict):
        raise InputError(f"{source}: holds no twin; diagnose the case again with softcal gap diagnose --json")
    twin = twin_from_record(content["twin"], source)
    write_twin(out, twin, provenance)
    return twin


def report_provenance(report_file: Path) -> Provenance:
    """Return what is made from a report rests on."""
    return record_provenance(METHOD.id, hash_files(report_file.parent, [report_file]), current_user())


def case_provenance(folder: Path, simulator: str = "") -> Provenance:
    """Return what a diagnosis that is made now rests on: the recordings of a case, and the module of a simulator."""
    root, files = folder.parent, [folder]
    if folder.is_dir():
        root = folder
        files = [path for path in root.rglob("*") if path.name in (RECORDING, METADATA) and path.is_file()]
    if simulator:
        files += [Path(str(sys.modules[simulator.partition(":")[0]].__file__))]
    return record_provenance(METHOD.id, hash_files(root, files), current_user())


def write_twin(path: Path, twin: Twin, provenance: Provenance) -> None:
    """Write a twin as JSON, ready for the simulated station and for simulated lots."""
    record = twin_record(twin) | {"provenance": provenance.to_json()}
    write_text(path, json.dumps(record, indent=2, allow_nan=False) + "\n")


def read_twin(path: Path, key: str = "twin") -> Twin:
    """Read a twin that `write_twin` wrote, or the one a report of a diagnosis holds.

    Args:
        key: of a report, `twin` for the explained one or `base_twin` for the refitted base alone.

    Raises:
        InputError: the file is missing or does not describe a twin.
    """
    content = read_json(path)
    record = content[key] if isinstance(content.get(key), dict) else content
    return twin_from_record(record, str(path))
