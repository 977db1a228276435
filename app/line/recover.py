"""Recovery of interrupted runs from their spools: finished runs become recordings, others are marked."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from softcal.app.files.recording_file import write_columns
from softcal.app.line.rig import SERIALS_APART, columns
from softcal.app.line.scan_codes import channel_serial
from softcal.core.errors import BadReply, InputError
from softcal.core.lot import check_serial
from softcal.station.interfaces import Sample
from softcal.station.record.recording import restore
from softcal.station.record.spool import SpooledRun, read_spool


@dataclass(frozen=True)
class RecoveredRun:
    """One recovered spool: "done" or its end, and one file per channel of a finished run."""

    spool: Path
    serial: str
    profile: str
    end: str
    samples: int
    files: tuple[Path, ...]


def recover(folder: Path, out: Path) -> list[RecoveredRun]:
    """Write the content of the spools of a folder: finished runs as recordings, others marked.

    Spools stay where they are: deleting them is a decision of a person. One that cannot be read is
    named and keeps no other from being recovered. A file that is another recording is not written
    over.

    Raises:
        InputError: no such folder.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder of spools")
    return [_recover(path, out) for path in sorted(folder.glob("*.spool"))]


def _recover(path: Path, out: Path) -> RecoveredRun:
    try:
        run = read_spool(path)
        serial = check_serial(run.header.get("serial", "unknown"))
    except InputError as error:
        return RecoveredRun(path, "", "", f"not readable: {error}", 0, ())
    profile = run.header.get("profile", "")
    try:
        recording = restore(run)
        channels = recording.output.shape[1]
        names = run.header.get("serials", serial).split(SERIALS_APART)
        if len(names) != channels:
            names = [channel_serial(serial, channel) for channel in range(channels)]
        serials = [check_serial(name) for name in names]
    except (BadReply, InputError) as error:
        end = str(error) if run.is_complete else str(run.end)
        file = out / f"{path.stem}.aborted.csv"
        write_columns(file, _aborted_columns(run, end))
        return RecoveredRun(path, serial, profile, end, len(run.output), (file,))
    files = []
    for channel, name in enumerate(serials):
        # Under its serial, or its spool where that file is another recording
        file, spool_file = out / f"{name}.csv", out / f"{path.stem}-{name}.csv"
        if file.exists():
            write_columns(spool_file, columns(recording, channel))
            if spool_file.read_bytes() != file.read_bytes():
                files.append(spool_file)
                continue
            spool_file.unlink()
        else:
            write_columns(file, columns(recording, channel))
        files.append(file)
    return RecoveredRun(path, serial, profile, str(run.end), len(recording.t_s), tuple(files))


def _aborted_columns(run: SpooledRun, end: str) -> list[tuple[str, Any]]:
    """Return every channel at the times of the first channel with samples.

    The others are interpolated between two of their samples, and empty outside.
    """
    polls = [Sample(poll.host_s, None, (poll.position_mm,)) for poll in run.polls]
    leading = run.output or run.force or polls
    host_s = np.array([sample.host_s for sample in leading])
    device_s = [sample.host_s if sample.device_s is None else sample.device_s for sample in leading]
    columns: list[tuple[str, Any]] = [("device_s", np.array(device_s)), ("host_s", host_s)]
    for channel in range(len(run.output[0].values) if run.output else 0):
        columns.append((f"output_{channel}", np.array([sample.values[channel] for sample in run.output])))
    for name, samples in (("force_N", run.force), ("stage_mm", polls)):
        if samples:
            at_s, values = zip(*((sample.host_s, sample.values[0]) for sample in samples), strict=True)
            columns.append((name, np.interp(host_s, at_s, values, left=np.nan, right=np.nan)))
    return [*columns, ("aborted", [end] * len(host_s))]
