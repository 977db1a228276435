"""What runs that were cut off left on the disk: finished ones become recordings again, all others are marked."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from softcal.app.files.recording_file import write_columns
from softcal.app.line.rig import SERIALS_APART, columns
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

    Raises:
        InputError: no such folder, or a file in it that is no spool.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder of spools")
    return [_recover(path, out) for path in sorted(folder.glob("*.spool"))]


def _recover(path: Path, out: Path) -> Recovered:
    run = read_spool(path)
    serial, profile = check_serial(run.header.get("serial", "unknown")), run.header.get("profile", "")
    if run.is_whole and run.facts:
        recording = restore(run)
        files = tuple(out / f"{check_serial(name)}.csv" for name in _serials(run, recording.output.shape[1]))
        for channel, file in enumerate(files):
            write_columns(file, columns(recording, channel))
        return Recovered(path, serial, profile, run.end, len(recording.t_s), files)
    file = out / f"{path.stem}.aborted.csv"
    channels = len(run.output[0].values) if run.output else 0
    device_s = [sample.host_s if sample.device_s is None else sample.device_s for sample in run.output]
    outputs = [(f"output_{c}", np.array([s.values[c] for s in run.output])) for c in range(channels)]
    write_columns(file, [("device_s", np.array(device_s)), *outputs, ("aborted", [run.end] * len(device_s))])
    return Recovered(path, serial, profile, run.end, len(run.output), (file,))


def _serials(run: SpooledRun, channels: int) -> list[str]:
    """Return the serial of each channel: as the run was told, else numbered behind the substrate's."""
    serial = run.header.get("serial", "unknown")
    told = run.header.get("serials", serial).split(SERIALS_APART)
    return told if len(told) == channels else [f"{serial}-{channel + 1}" for channel in range(channels)]
