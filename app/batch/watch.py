"""Calibrate units as their recordings land in a lot folder."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from softcal.app.batch.batch import run_batch
from softcal.app.batch.lot_work import BatchConfig, Callbacks
from softcal.app.batch.report import BatchReport
from softcal.app.files.lot_folder import open_lot_folder
from softcal.db.registry import Registry

FileStates = dict[str, tuple[int, int]]


def watch_lot(
    path: Path,
    registry: Registry,
    batch: BatchConfig,
    progress: Callbacks,
    every_s: float = 2.0,
    idle_s: float | None = None,
    sleep: Callable[[float], None] = time.sleep,
) -> Iterator[BatchReport]:
    """Yield a report each time new recordings were calibrated; stop after `idle_s` without new files.

    A file is taken when its size and time were the same at two looks: a copy under way is not read
    by half. A file that is replaced by another recording is calibrated again, as a new revision.

    Raises:
        InputError: the folder is no lot, or its source cannot be used.
    """
    before: FileStates = {}
    calibrated: FileStates = {}
    still_s = 0.0
    while True:
        folder = open_lot_folder(path)
        now: FileStates = {}
        for serial, file in folder.unit_paths.items():
            with suppress(FileNotFoundError):
                stat = file.stat()
                now[serial] = (stat.st_size, stat.st_mtime_ns)
        new = {serial for serial, state in now.items() if before.get(serial) == state != calibrated.get(serial)}
        if new:
            paths: Mapping[str, Path] = {serial: path for serial, path in folder.unit_paths.items() if serial in new}
            yield run_batch(replace(folder, unit_paths=paths), registry, batch, progress)
            calibrated |= {serial: now[serial] for serial in new}
        is_settling = any(before.get(serial) != state for serial, state in now.items())
        still_s = 0.0 if new or is_settling else still_s + every_s
        if idle_s is not None and still_s >= idle_s:
            return
        before = now
        sleep(every_s)
