"""Sealed cases on disk: make them, ask a sealed rig for one more run, score the reports."""

import hashlib
import json
import secrets
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from softcal.app.bootstrap import current_user
from softcal.app.files.atomic import atomic_folder, write_text
from softcal.app.files.case_folder import read_json
from softcal.app.files.lot_toml import write_lot_toml
from softcal.app.files.recording_file import write_columns
from softcal.app.gap.sealed_file import default_key_path, read_sealed, write_sealed
from softcal.core.challenge.case_generator import LINES, SEED_BITS, draw_case, draw_challenge, draw_seed
from softcal.core.challenge.cases import EXPERIMENTS, RunPlan, SealedCase, press_lot
from softcal.core.challenge.explained_fraction import explained_fraction
from softcal.core.challenge.recording_mistakes import RunOnFile
from softcal.core.challenge.score import ScoreSheet, score_reports
from softcal.core.challenge.seal import Label, Seal, open_seal, seal_labels, seed_origin
from softcal.core.errors import InputError
from softcal.core.gap.method import METHOD
from softcal.core.lot import Lot
from softcal.db.provenance import Provenance, hash_files, record_provenance

SCHEMA = "softcal.challenge/1"
FOLDER_FILE = "challenge.json"
DECIMALS = {"t_s": 5, "stage_mm": 5, "force_N": 5, "output_V": 7, "temperature_C": 3, "known_force_N": 5}


@dataclass(frozen=True)
class ChallengeSummary:
    """The commitment of a challenge to publish, and its cases."""

    commitment: str
    cases: tuple[str, ...]


def make_challenge(
    folder: Path,
    seal_file: Path,
    count: int,
    seed: int | None = None,
    line: str | None = None,
    on_case: Callable[[str], None] = lambda name: None,
    key_file: Path | None = None,
) -> ChallengeSummary:
    """Draw sealed cases, write recordings into a folder and labels into a separate file.

    Args:
        folder: where the cases go; must not exist or be empty.
        seal_file: where the labels go, encrypted; outside of `folder`.
        seed: seed of the draw; a secret one is chosen when it is not given. Who knows it can make the labels.
        key_file: where their key goes, outside of `folder`; beside the seal where None.

    Raises:
        InputError: the folder is not empty, the seal would lie in it or exists, a count below 1, an unknown line.
    """
    if count < 1:
        raise InputError(f"--cases {count}: at least one case was expected")
    key_file = key_file or default_key_path(seal_file)
    for label, path in (("seal", seal_file), ("key", key_file)):
        if path.resolve().is_relative_to(folder.resolve()):
            raise InputError(f"{path}: the {label} must not lie in the folder that is handed over; name another place")
        if path.exists():
            raise InputError(f"{path}: exists; a {label} is never overwritten; name another file")
    origin = "drawn" if seed is None else "stated"
    seed = secrets.randbits(SEED_BITS) if seed is None else seed
    if line is None:
        cases = draw_challenge(seed, count)
    elif line in LINES:
        rng, width = np.random.default_rng([seed, 20_011]), max(3, len(str(count)))
        cases = [draw_case(draw_seed(rng), f"case-{k:0{width}d}", line) for k in range(1, count + 1)]
    else:
        raise InputError(f"--line {line}: not known; known are {', '.join(LINES)}")
    contents = {}
    with atomic_folder(folder) as part:
        for case in cases:
            contents[case.name] = write_case(part / case.name, case)
            on_case(case.name)
        seal = seal_labels(cases, contents, seed, secrets.token_hex(32), origin)
        published = {"schema": SCHEMA, "cases": contents, "commitment": seal.commitment, "hash": "sha256"}
        write_text(part / FOLDER_FILE, json.dumps(published, indent=2) + "\n")
        write_sealed(seal_file, key_file, seal)
    return ChallengeSummary(seal.commitment, tuple(contents))


def write_case(folder: Path, case: SealedCase) -> str:
    """Record every run of a sealed case and return the content hash of the folder."""
    for number, written in enumerate(case.write_runs(case.plans), start=1):
        write_run(folder / "runs" / str(number), case, written)
    return folder_sha256(folder)


def write_run(folder: Path, case: SealedCase, run: RunOnFile) -> None:
    """Write one run as `recording.csv` and `recording.json`."""
    for name, content in run_files(case, run).items():
        write_text(folder / name, content)


def run_files(case: SealedCase, run: RunOnFile) -> dict[str, str]:
    """Return what one run is on disk, by the name of each file."""
    measured = run.measured
    metadata: dict[str, object] = {
        "serial": case.name.upper(),
        "kind": measured.kind,
        "profile": measured.profile,
        "vref_V": case.rig.vref_V,
        "adc_bits": case.rig.adc_bits,
        "r_series_ohm": case.rig.r_series_ohm,
        "sample_rate_Hz": run.sample_rate_Hz,
    }
    if measured.dummy_ohm is not None:
        metadata["dummy_ohm"] = measured.dummy_ohm
    names = list(measured.columns)
    columns = [[f"{value:.{DECIMALS[name]}f}" for value in measured.columns[name].tolist()] for name in names]
    lines = [",".join(names), *(",".join(row) for row in zip(*columns, strict=True))]
    return {"recording.csv": "\n".join(lines) + "\n", "recording.json": json.dumps(metadata, indent=2) + "\n"}


def folder_sha256(folder: Path) -> str:
    """Hash names and contents of the runs of a case; runs asked for later do not belong to it."""
    digest = hashlib.sha256()
    for path in sorted((folder / "runs").rglob("recording.*")):
        if not path.parent.name.startswith("asked"):
            digest.update(f"{path.relative_to(folder).as_posix()}\0".encode())
            digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def ask_rig(folder: Path, ask: Callable[[str, str, int], dict[str, str]], case_name: str, experiment: str) -> Path:
    """Have one more experiment run on a sealed rig; it is added to the case as `runs/asked-<n>`.

    Args:
        ask: returns the files of the run: `record_experiment` with the seal, or a process of the examiner that has it.

    Raises:
        InputError: no such case in the folder, or whoever is asked refuses.
    """
    runs = folder / case_name / "runs"
    if not runs.is_dir():
        case_names = sorted(path.parent.name for path in folder.glob("*/runs"))
        raise InputError(f"{case_name}: no case of {folder}; known are {', '.join(case_names)}")
    number = 1 + sum(path.name.startswith("asked") for path in runs.iterdir())
    for name, content in ask(case_name, experiment, number).items():
        write_text(runs / f"asked-{number}" / Path(name).name, content)
    return runs / f"asked-{number}"


def record_experiment(
    folder: Path, seal_file: Path, case_name: str, experiment: str, number: int, key_file: Path | None = None
) -> dict[str, str]:
    """Return the files of one more run of a sealed rig, as the examiner records it.

    Raises:
        InputError: the seal is broken, no such case, or an experiment that is not on the menu.
    """
    case = _find_label(folder, seal_file, case_name, key_file).case
    if experiment not in EXPERIMENTS:
        raise InputError(f"{experiment}: not on the menu; known are {', '.join(EXPERIMENTS)}")
    measured = case.measure(RunPlan(experiment, case.kept_back.seed + number))
    return run_files(case, RunOnFile(measured, case.rig.sample_rate_Hz))


def press_rig_lot(
    folder: Path, seal_file: Path, case_name: str, units: int, out: Path, key_file: Path | None = None
) -> Path:
    """Press a lot on a sealed rig and write it as a lot folder with audits.

    Raises:
        InputError: the seal is broken, no such case, no unit asked for, or `out` exists.
    """
    if units < 1:
        raise InputError(f"--units {units}: at least one unit was expected")
    case = _find_label(folder, seal_file, case_name, key_file).case
    with atomic_folder(out) as part:
        write_lot_toml(part, Lot(case_name, "R00", case.rig.sample_rate_Hz, "sealed rig"))
        for run in press_lot(case, units):
            columns = run.measured.columns
            table = [("t_s", columns["t_s"]), ("output", columns["output_V"]), ("stage_mm", columns["stage_mm"])]
            if run.folder != "units":
                table.append(("reference", columns["force_N"]))
            write_columns(part / run.folder / f"{run.serial}.csv", table)
    return out


def _find_label(folder: Path, seal_file: Path, case_name: str, key_file: Path | None = None) -> Label:
    labels = {label.case.name: label for label in open_challenge(folder, seal_file, key_file)}
    if case_name not in labels:
        raise InputError(f"{case_name}: no case of {folder}; known are {', '.join(labels)}")
    return labels[case_name]


def open_challenge(
    folder: Path, seal_file: Path, key_file: Path | None = None, commitment: str | None = None
) -> list[Label]:
    """Open the seal of a challenge and check that its cases are those that were handed out.

    Args:
        key_file: the key of the labels; the file beside the seal where None.
        commitment: as it was published; the one in the folder, which the examinee holds, where None.

    Raises:
        InputError: a file is missing, the seal is broken, or a case was changed.
    """
    published = read_json(folder / FOLDER_FILE)
    if published.get("schema") != SCHEMA:
        raise InputError(f"{folder / FOLDER_FILE}: schema {published.get('schema')!r}; {SCHEMA!r} was expected")
    text = read_sealed(seal_file, key_file or default_key_path(seal_file))
    labels = open_seal(text, commitment or str(published.get("commitment")))
    for label in labels:
        case_folder = folder / label.case.name
        if not case_folder.is_dir() or folder_sha256(case_folder) != label.sha256:
            raise InputError(f"{case_folder}: is not the case that was sealed; nothing was scored")
    return labels


@dataclass(frozen=True)
class ScoredChallenge:
    """A score sheet and what stands behind it.

    Args:
        commitment: of the labels it was scored by.
        has_commitment: whether the commitment came from whoever scores, not from the folder of the examinee.
        seed_origin: `drawn` in secret, or `stated` by whoever made the cases, who can make them again.
    """

    sheet: ScoreSheet
    commitment: str
    has_commitment: bool
    seed_origin: str
    provenance: Provenance

    def to_json(self) -> dict[str, Any]:
        return self.sheet.to_record() | {
            "commitment": self.commitment,
            "commitment_from": "stated" if self.has_commitment else "folder",
            "seed_origin": self.seed_origin,
            "provenance": self.provenance.to_json(),
        }


def score_challenge(
    folder: Path, reports: Path, seal_file: Path, key_file: Path | None = None, commitment: str | None = None
) -> ScoredChallenge:
    """Open the seal and score the reports `<case>.json`; an unreadable one is wrong.

    Args:
        commitment: as it was published; the one in the folder where None.

    Raises:
        InputError: the seal is broken, a case was changed, or the folder has no report.
    """
    labels = open_challenge(folder, seal_file, key_file, commitment)
    text = read_sealed(seal_file, key_file or default_key_path(seal_file))
    paths = {label.case.name: reports / f"{label.case.name}.json" for label in labels}
    contents: dict[str, dict[str, Any]] = {}
    for name, path in paths.items():
        if path.exists():
            contents[name] = {}
            with suppress(InputError):
                contents[name] = read_json(path)
    if not contents:
        raise InputError(f"{reports}: no report of this challenge; expected files such as {labels[0].case.name}.json")
    sheet = score_reports(labels, contents, lambda label, report: explained_fraction(label.case, report))
    files = [path for path in paths.values() if path.exists()]
    provenance = record_provenance(METHOD.id, hash_files(reports, files), current_user())
    return ScoredChallenge(sheet, Seal(text).commitment, commitment is not None, seed_origin(text), provenance)
