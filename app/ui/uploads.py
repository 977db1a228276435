"""Where dropped recordings lie: one folder of this server, gone when it ends, and at the latest at the next start."""

import os
import shutil
import socket
import tempfile
from functools import cache
from pathlib import Path

from softcal.app.bootstrap import data_folder, is_alive


def new_upload_folder() -> Path:
    """Make a folder for what one tab drops; only who runs this server can read it."""
    return Path(tempfile.mkdtemp(dir=server_folder()))


@cache
def server_folder() -> Path:
    """Make the folder of this server; those of servers that ended without a word are removed."""
    mine = _folder(os.getpid())
    for left in mine.parent.glob(f"{socket.gethostname()}@*") if mine.parent.is_dir() else ():
        if left == mine or is_alive(left.name.replace("@", ":")) is False:
            shutil.rmtree(left, ignore_errors=True)
    mine.mkdir(mode=0o700, parents=True)
    return mine


def remove_server_folder(process_id: int) -> None:
    """Remove what was dropped at a server of this machine that has ended."""
    shutil.rmtree(_folder(process_id), ignore_errors=True)


def _folder(process_id: int) -> Path:
    return data_folder() / "uploads" / f"{socket.gethostname()}@{process_id}"
