"""Read the files of a folder and nothing else: no pipe, no device, no link out, no half copy."""

import os
import stat
from pathlib import Path

from softcal.core.errors import InputError

MAX_BYTES = 1_000_000_000
"""A recording is a few MB; more than this is something else, and would fill all memory."""

KINDS = {
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFDIR: "a folder",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def read_regular(path: Path, folder: Path, max_bytes: int = MAX_BYTES) -> bytes:
    """Return the content of a file that lies in a folder. It never waits, whatever the path names.

    Raises:
        InputError: no file, a link out of the folder, too large, not readable, or changed while it
            is read.
    """
    try:
        real = path.resolve(strict=True)
        if not real.is_relative_to(folder.resolve()):
            raise InputError(f"{path}: is a link that leads out of {folder}; put the file itself there")
        _check_kind(path, os.stat(real).st_mode)
        # A pipe that takes the file's place just now must not block the lot either.
        handle = os.open(real, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with os.fdopen(handle, "rb") as file:
            before = os.fstat(file.fileno())
            _check_kind(path, before.st_mode)
            if before.st_size > max_bytes:
                raise InputError(f"{path}: {before.st_size / 1e6:.0f} MB; at most {max_bytes / 1e6:.0f} MB are read")
            # One byte more than there was shows that it grew.
            content, remaining_bytes = b"", before.st_size + 1
            while remaining_bytes and (part := os.read(file.fileno(), remaining_bytes)):
                content, remaining_bytes = content + part, remaining_bytes - len(part)
            after = os.fstat(file.fileno())
    except (OSError, RuntimeError) as error:
        raise InputError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if len(content) != before.st_size or (after.st_size, after.st_mtime_ns) != (before.st_size, before.st_mtime_ns):
        raise InputError(f"{path}: is still being written; run the batch again when the copy is done")
    return content


def _check_kind(path: Path, mode: int) -> None:
    if not stat.S_ISREG(mode):
        raise InputError(f"{path}: is {KINDS.get(stat.S_IFMT(mode), 'no file')}; a file was expected")
