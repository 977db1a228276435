"""What runs that were cut off left on the disk: finished ones become recordings again, all others are marked."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from softcal.app.files.recording_file import write_columns
from softcal.app.line.rig import SERIALS_APART, columns
from softcal.app.line.serials import numbered
from softcal.core.errors import InputError
from softcal.core.lot import check_serial
from softcal.station.recording import restore
from softcal.station.spool import SpooledRun, read_spool


@dataclass(frozen=True)
class Recovered:
    """One spool that was found.

    Args:
        spool: its file.
        serial, profile: of the run.
        end: "done", or how it ended.
        samples: how many samples of the output it holds.
        files: what was written from it: one file per channel of a finished run.
    """

    spool: Path
    serial: str
    profile: str
    end: str
    samples: int
    files: tuple[Path, ...]


def recover(folder: Path, out: Path) -> list[Recovered]:
    """Write what the spools of a folder hold: finished runs as recordings, all others marked as aborted.

    Spools stay where they are; deleting them is a decision of a person.

    A spool that cannot be read (a full disk leaves an empty one) is named and keeps no other from being recovered.

    Raises:
        InputError: no such folder.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder of spools")
    return [_recover(path, out) for path in sorted(folder.glob("*.spool"))]


def _recover(path: Path, out: Path) -> Recovered:
    try:
        run = read_spool(path)
    except InputError as error:
        return Recovered(path, "", "", f"not readable: {error}", 0, ())
    serial, profile = check_serial(run.header.get("serial", "unknown")), run.header.get("profile", "")
    if run.is_whole and run.facts:
        recording = restore(run)
        files = tuple(out / f"{check_serial(name)}.csv" for name in _serials(run, recording.output.shape[1]))
        for channel, file in enumerate(files):
            write_columns(file, columns(recording, channel))
        return Recovered(path, serial, profile, str(run.end), len(recording.t_s), files)
    file = out / f"{path.stem}.aborted.csv"
    write_columns(file, _aborted_columns(run))
    return Recovered(path, serial, profile, str(run.end), len(run.output), (file,))


def _aborted_columns(run: SpooledRun) -> list[tuple[str, Any]]:
    """Return every channel of a run that is no recording, force and stage read at the times the output was."""
    channels = len(run.output[0].values) if run.output else 0
    device_s = [sample.host_s if sample.device_s is None else sample.device_s for sample in run.output]
    host_s = np.array([sample.host_s for sample in run.output])
    columns: list[tuple[str, Any]] = [("device_s", np.array(device_s)), ("host_s", host_s)]
    columns += [(f"output_{c}", np.array([s.values[c] for s in run.output])) for c in range(channels)]
    if run.force:
        force_s, force_N = zip(*((s.host_s, s.values[0]) for s in run.force), strict=True)
        columns.append(("force_N", np.interp(host_s, force_s, force_N)))
    if run.polls:
        poll_s, stage_mm = zip(*((p.host_s, p.position_mm) for p in run.polls), strict=True)
        columns.append(("stage_mm", np.interp(host_s, poll_s, stage_mm)))
    return [*columns, ("aborted", [str(run.end)] * len(device_s))]


def _serials(run: SpooledRun, channels: int) -> list[str]:
    """Return the serial of each channel: as the run was told, else numbered behind the substrate's."""
    serial = run.header.get("serial", "unknown")
    told = run.header.get("serials", serial).split(SERIALS_APART)
    return told if len(told) == channels else [numbered(serial, channel) for channel in range(channels)]
