"""Cases of the gap page: where they lie, uploads, sealed rigs, a diagnosis to keep."""

import json
import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from softcal.app.bootstrap import data_folder
from softcal.app.files.atomic import atomic_folder, write_bytes, write_text
from softcal.app.files.case_folder import METADATA, RECORDING, open_case
from softcal.app.gap.challenge import ask_rig, make_challenge, open_challenge, record_experiment
from softcal.app.gap.diagnose import run_views
from softcal.app.views.gap_runs import ChannelView, RunView
from softcal.core.challenge.recording_mistakes import Mistake
from softcal.core.errors import InputError
from softcal.core.recording import Array

if TYPE_CHECKING:
    from softcal.core.gap.diagnosis import Diagnosis
    from softcal.core.gap.twin import TwinModel
    from softcal.db.schema.arrays import Arrays

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,63}")
MAX_RUN_BYTES = 50_000_000
MAX_RUNS = 40


def cases_folder() -> Path:
    """Return the folder of cases among the user's data."""
    folder = data_folder() / "cases"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def cases() -> list[Path]:
    """Return the cases of that folder, the newest first: plain ones and those of sealed rigs."""
    folders = [p for p in cases_folder().iterdir() if p.is_dir() and not p.name.startswith(".")]
    case_folders = [
        c
        for folder in folders
        for c in (folder, *folder.iterdir())
        if (c / "runs").is_dir() or (c / RECORDING).is_file()
    ]
    return sorted(case_folders, key=lambda case: -case.stat().st_mtime)


def practise(line: str | None = None) -> Path:
    """Make a sealed rig with something hidden and return its case."""
    folder = cases_folder() / f"practice-{datetime.now(UTC):%Y%m%d-%H%M%S}"
    challenge = make_challenge(folder, _seal(folder), 1, line=line)
    return folder / challenge.cases[0]


def has_sealed_rig(case: Path) -> bool:
    """Whether a case comes from a sealed rig that can be pressed again."""
    return _seal(case.parent).is_file()


def ask_case(case: Path, experiment: str) -> Path:
    """Press a sealed rig once more and return the new run.

    Raises:
        InputError: the case comes from no sealed rig, or the experiment is not on its menu.
    """
    if not has_sealed_rig(case):
        raise InputError(f"{case.name}: no simulated rig belongs to this case; press {experiment!r} on the station")
    return ask_rig(case.parent, partial(record_experiment, case.parent, _seal(case.parent)), case.name, experiment)


def truth(case: Path) -> tuple[tuple[str, ...], Mistake | None]:
    """Open the seal of a case and return the effects hidden in its rig, and what went wrong when it was recorded."""
    labels = open_challenge(case.parent, _seal(case.parent))
    sealed = next(label for label in labels if label.case.name == case.name).case
    effects = tuple(cause.effect for cause in sealed.causes)
    return effects, Mistake.from_text(sealed.mistake) if sealed.mistake else None


def _seal(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}.seal.json")


def store_upload(name: str, runs: Sequence[bytes], metadata: Mapping[str, object]) -> Path:
    """Write uploaded runs as a case, whole or not at all, and read it once to see that it is one.

    Args:
        name: of the case; it becomes a folder. The names of uploaded files are not used.
        runs: contents of CSV files, in order.
        metadata: of every run: serial, vref_V, adc_bits, r_series_ohm, sample_rate_Hz, sensor_type.

    Raises:
        InputError: a name that is none, too many or too large runs, or the case cannot be read; nothing is kept.
    """
    if not NAME.fullmatch(name) or ".." in name:
        raise InputError(f"case {name[:60]!r}: 1 to 64 letters, digits, spaces, '.', '-' or '_' were expected")
    if not 1 <= len(runs) <= MAX_RUNS or any(len(run) > MAX_RUN_BYTES for run in runs):
        raise InputError(f"{len(runs)} runs: 1 to {MAX_RUNS} files of at most {MAX_RUN_BYTES // 10**6} MB each")
    target = cases_folder() / name
    with atomic_folder(target) as part:
        for number, content in enumerate(runs, 1):
            write_bytes(part / "runs" / str(number) / RECORDING, content)
            write_text(part / "runs" / str(number) / METADATA, json.dumps(dict(metadata), indent=2) + "\n")
        try:
            open_case(part)
        except InputError as error:
            # The person knows runs by their number, not by the place they were checked in.
            raise InputError(str(error).replace(str(part), name)) from error
    return target


def pack_diagnosis(diagnosis: "Diagnosis[TwinModel]") -> "tuple[dict[str, Any], Arrays]":
    """Return the report of a diagnosis with a list of runs, and the arrays of their figures."""
    views = run_views(diagnosis)
    runs = [
        {
            "name": v.name,
            "profile": v.profile,
            "drive": v.drive_name,
            "noise": {name: c.noise for name, c in v.channels.items()},
        }
        for v in views
    ]
    arrays: dict[str, Any] = {}
    for k, view in enumerate(views):
        arrays |= {f"{k}.{name}": getattr(view, name) for name in ("t_s", "drive", "load_N")}
        for name, channel in view.channels.items():
            arrays |= {f"{k}.{name}.{part}": getattr(channel, part) for part in ("measured", "base", "explained")}
    return diagnosis.report() | {"runs": runs}, {name: np.asarray(a, dtype=np.float32) for name, a in arrays.items()}


def run_views_of(report: Mapping[str, Any], arrays: "Arrays") -> list[RunView]:
    """Return the runs of a kept diagnosis, ready for its figures."""

    def array(k: int, *parts: str) -> Array:
        return np.asarray(arrays[".".join((str(k), *parts))], dtype=float)

    def channel(k: int, name: str, noise: float) -> ChannelView:
        return ChannelView(array(k, name, "measured"), array(k, name, "base"), array(k, name, "explained"), noise)

    return [
        RunView(
            run["name"],
            run["profile"],
            run["drive"],
            array(k, "t_s"),
            array(k, "drive"),
            array(k, "load_N"),
            {name: channel(k, name, noise) for name, noise in run["noise"].items()},
        )
        for k, run in enumerate(report["runs"])
    ]
