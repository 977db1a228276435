"""The one place that chooses what is real: which registry, and who stands in its audit trail."""

import getpass
import os
import socket
from pathlib import Path
from typing import TYPE_CHECKING

import platformdirs

from softcal.core.errors import RegistryError

if TYPE_CHECKING:
    from softcal.db.registry import Registry

REGISTRY_VARIABLE = "SOFTCAL_REGISTRY"

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
"""Environment of a process whose numerical libraries start no threads of their own.

All matrices here are small: threads that wait for each other cost more than they compute, and many times more where
other work keeps the cores busy. What runs in parallel runs in processes.
"""


def registry_url(option: str | None = None) -> str:
    """Return the registry's URL: the option, else $SOFTCAL_REGISTRY, else an SQLite file in the user's data folder.

    Raises:
        RegistryError: the user's data folder cannot be made.
    """
    url = option or os.environ.get(REGISTRY_VARIABLE)
    return url or f"sqlite:///{data_folder() / 'registry.db'}"


def data_folder() -> Path:
    """Return softcal's folder among the user's data, made where it is missing."""
    folder = Path(platformdirs.user_data_dir("softcal", appauthor=False))
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RegistryError(
            f"the data folder {folder} cannot be made: {error.strerror}; give --registry URL or set {REGISTRY_VARIABLE}"
        ) from error
    return folder


def current_user() -> str:
    """Return the name of the person the operating system knows, for the audit trail."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return "unknown"


def open_chosen_registry(option: str | None, *, create: bool = True) -> "Registry":
    """Open the registry of the option, environment or default, as the current user."""
    from softcal.db.connection import open_registry  # noqa: PLC0415
    from softcal.db.repositories.registry_base import RegistrySettings  # noqa: PLC0415

    return open_registry(registry_url(option), RegistrySettings(actor=current_user()), create=create)


def is_alive(process: str) -> bool | None:
    """Return whether a process lives: `host:process id`. None where it is on another machine."""
    host, _, number = process.rpartition(":")
    if host != socket.gethostname() or not number.isdecimal():
        return None
    try:
        os.kill(int(number), 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True  # It is there, and somebody else's.
    return True
