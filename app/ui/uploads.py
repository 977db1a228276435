"""Where dropped recordings lie until their tab ends: a folder of this server, gone at its next start at the latest."""

import os
import shutil
import socket
import weakref
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

from softcal.app.bootstrap import data_folder, is_alive


class UploadFolder:
    """A folder for what one tab drops, gone with the tab; only who runs this server can read it."""

    def __init__(self) -> None:
        self.path = Path(mkdtemp(dir=server_folder()))
        self.remove = weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)


@cache
def server_folder() -> Path:
    """Make the folder of this server; those of servers that ended without a word are removed."""
    folder = _folder(os.getpid())
    for stale_folder in folder.parent.glob(f"{socket.gethostname()}@*") if folder.parent.is_dir() else ():
        if stale_folder == folder or is_alive(stale_folder.name.replace("@", ":")) is False:
            shutil.rmtree(stale_folder, ignore_errors=True)
    folder.mkdir(mode=0o700, parents=True)
    return folder


def remove_server_folder(process_id: int) -> None:
    """Remove what was dropped at a server of this machine that has ended."""
    shutil.rmtree(_folder(process_id), ignore_errors=True)


def _folder(process_id: int) -> Path:
    return data_folder() / "uploads" / f"{socket.gethostname()}@{process_id}"
