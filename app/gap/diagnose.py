"""Diagnose the gap of a case on disk, and write the explained twin."""

import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from softcal.app.bootstrap import current_user
from softcal.app.files.atomic import write_text
from softcal.app.files.case_folder import METADATA, RECORDING, open_case, open_table
from softcal.app.tables.options import DETECT, TableOptions
from softcal.app.texts.catalogue import text
from softcal.core.errors import InputError
from softcal.core.gap.case import Case, DataMistake
from softcal.core.gap.diagnosis import Diagnosis, checked, diagnose
from softcal.core.gap.experiments import Identifiability
from softcal.core.gap.method import METHOD
from softcal.core.gap.places import described_twin, repaired_twin
from softcal.core.gap.twin import TwinModel
from softcal.core.json_input import parse_json
from softcal.core.twin.parameters import ReadoutMetadata
from softcal.core.twin.simulate import Twin, twin_from_record, twin_record
from softcal.db.provenance import Provenance, hash_files, record_provenance

if TYPE_CHECKING:
    from softcal.app.charts.gap import RunView


def diagnose_case(
    place: Path,
    progress: Callable[[str], None] | None = None,
    readout: ReadoutMetadata | None = None,
    table: TableOptions = DETECT,
) -> Diagnosis[TwinModel]:
    """Read a case and diagnose it.

    Args:
        place: folder of a case, or a plain table.
        readout: the electronics of a plain table; a case folder states its own.
        table: the declared layout of a plain table.

    Raises:
        InputError: the case cannot be read, or a table comes without its electronics.
    """
    diagnosis = diagnose(_opened(place, readout, table), progress)
    return replace(diagnosis, provenance=case_provenance(place).to_json())


def check_case(
    place: Path, readout: ReadoutMetadata | None = None, table: TableOptions = DETECT
) -> tuple[tuple[DataMistake, ...], Identifiability | None]:
    """Return a case's mistakes and, where it can be diagnosed, what its runs tell."""
    return checked(_opened(place, readout, table))


def _opened(place: Path, readout: ReadoutMetadata | None, table: TableOptions) -> Case:
    if not place.is_file():
        return open_case(place)
    if readout is None:
        raise InputError(f"{place}: a plain table does not say its electronics; give vref_V, adc_bits and rate_Hz")
    return open_table(place, readout, table)


def write_page(path: Path, diagnosis: Diagnosis[Any]) -> None:
    """Write the page of figures of a diagnosis in English, whole or not at all."""
    from softcal.app.charts.gap_page import gap_page

    page = gap_page(diagnosis.report(), run_views(diagnosis), diagnosis.case.serial, partial(text, "en"))
    write_text(path, page)


def run_views(diagnosis: Diagnosis[Any]) -> list["RunView"]:
    """Return every pressed run as a page shows it: measured, and predicted before and after."""
    from softcal.app.charts.gap import ChannelView, RunView

    problem, views = diagnosis.best.problem, []
    for k, run in enumerate(diagnosis.case.runs):
        if run.kind != "press":
            continue
        channels = {
            block.channel: ChannelView(
                problem.measured[block.place],
                diagnosis.base.predicted[block.place],
                diagnosis.best.predicted[block.place],
                problem.floor(block.channel),
            )
            for block in problem.blocks
            if block.run == k
        }
        drive, load_N = diagnosis.model.axes_of(diagnosis.best, k)
        views.append(RunView(run.name, run.profile, run.elapsed_s, drive, load_N, channels))
    return views


NO_TERMS = "no empirical terms: nothing is left, or no term holds on runs that were held back; leave --empirical out"


def apply_case(
    folder: Path, out: Path, progress: Callable[[str], None] | None = None, empirical: bool = False
) -> tuple[Diagnosis[TwinModel], Twin]:
    """Diagnose a case and write the twin that explains it, whole or not at all.

    Args:
        empirical: with the empirical terms that describe what no cause explains.

    Raises:
        InputError: the recordings hold a mistake, or there are no such terms.
    """
    diagnosis = diagnose_case(folder, progress)
    twin = repaired_twin(diagnosis)
    if empirical:
        described = described_twin(diagnosis)
        if described is None:
            raise InputError(f"{folder}: {NO_TERMS}")
        twin = described
    write_twin(out, twin, case_provenance(folder))
    return diagnosis, twin


def apply_report(report_file: Path, out: Path, empirical: bool = False) -> Twin:
    """Write the twin that a report of `softcal gap diagnose` holds.

    Args:
        empirical: with the empirical terms that describe what no cause explains.

    Raises:
        InputError: the report cannot be read, holds no twin, or no such terms.
    """
    report = read_report(report_file)
    if report.get("verdict") == "data":
        raise InputError(f"{report_file}: the recordings hold a mistake, so there is no twin of them; repair it first")
    if not isinstance(report.get("twin"), dict):
        raise InputError(f"{report_file}: holds no twin; diagnose the case again with softcal gap diagnose --json")
    record = report["twin"]
    if empirical:
        described = report.get("residual")
        if not isinstance(described, dict):
            raise InputError(f"{report_file}: {NO_TERMS}")
        record = described.get("twin")
    twin = twin_from_record(record, str(report_file))
    inputs = hash_files(report_file.parent, [report_file])
    write_twin(out, twin, record_provenance(METHOD.id, inputs, current_user()))
    return twin


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
    content = read_report(path)
    record = content[key] if isinstance(content.get(key), dict) else content
    return twin_from_record(record, str(path))


def read_report(path: Path) -> Mapping[str, Any]:
    """Read a report, or a twin, as it stands in its file.

    Raises:
        InputError: the file is missing or holds no JSON object.
    """
    try:
        content = parse_json(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise InputError(f"{path}: does not describe a twin ({error}); write it with softcal gap apply") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: does not describe a twin; a JSON object was expected")
    return content
