"""Diagnose the gap of a case on disk, and write the explained twin."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from softcal.app.case_folder import open_case
from softcal.app.files import write_text
from softcal.core.errors import InputError
from softcal.core.gap.diagnosis import Diagnosis, diagnose
from softcal.core.gap.explained import explained_twin
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin

if TYPE_CHECKING:
    from softcal.app.gap_figures import RunView

TWIN_SCHEMA = "softcal.twin/1"


def diagnose_case(folder: Path, progress: Callable[[str], None] | None = None) -> Diagnosis:
    """Read a case and diagnose it.

    Raises:
        InputError: the case cannot be read.
    """
    return diagnose(open_case(folder), progress)


def write_page(path: Path, diagnosis: Diagnosis) -> None:
    """Write the page of figures of a diagnosis, whole or not at all."""
    from softcal.app.gap_page import gap_page

    write_text(path, gap_page(diagnosis.report(), run_views(diagnosis), diagnosis.case.serial))


def run_views(diagnosis: Diagnosis) -> list["RunView"]:
    """Return what a page shows of every pressed run: measured and predicted channels before and after the causes."""
    from softcal.app.gap_figures import ChannelView, RunView

    views = []
    for k, run in enumerate(diagnosis.case.runs):
        if run.kind != "press":
            continue
        channels = {
            block.channel: ChannelView(
                diagnosis.best.problem.measured[block.place],
                diagnosis.base.predicted[block.place],
                diagnosis.best.predicted[block.place],
                diagnosis.best.problem.sigma[block.channel],
            )
            for block in diagnosis.best.problem.blocks
            if block.run == k
        }
        load_N = run.force_N if run.force_N is not None else diagnosis.elastic_force_N(k)
        drive = run.stage_mm if run.stage_mm is not None else load_N
        views.append(RunView(run.name, run.profile, run.elapsed_s, drive, load_N, channels))
    return views


def apply_case(folder: Path, out: Path, progress: Callable[[str], None] | None = None) -> Diagnosis:
    """Diagnose a case and write the twin that explains it, whole or not at all."""
    diagnosis = diagnose_case(folder, progress)
    write_twin(out, explained_twin(diagnosis))
    return diagnosis


def write_twin(path: Path, twin: Twin) -> None:
    """Write a twin as JSON, ready for the simulated station and for simulated lots."""
    content = {
        "schema": TWIN_SCHEMA,
        "parameters": vars(twin.parameters),
        "metadata": vars(twin.metadata),
        "effects": [
            {"effect": s.effect_id, "values": dict(s.values), "episodes": [list(row) for row in s.episodes]}
            for s in twin.effects
        ],
    }
    write_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def read_twin(path: Path) -> Twin:
    """Read a twin that `write_twin` wrote.

    Raises:
        InputError: the file is missing or does not describe a twin.
    """
    try:
        content: Mapping[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if content["schema"] != TWIN_SCHEMA:
            raise InputError(f"{path}: schema {content['schema']!r}; {TWIN_SCHEMA} was expected")
        effects = tuple(
            EffectSetting(e["effect"], e["values"], tuple((float(a), float(b)) for a, b in e["episodes"]))
            for e in content["effects"]
        )
        return Twin(BaseParameters(**content["parameters"]), effects, ReadoutMetadata(**content["metadata"]))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: does not describe a twin ({error}); write it with softcal gap apply") from error
