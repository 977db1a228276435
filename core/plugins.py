"""What other installed packages bring along: entry points by group, loaded and checked.

The core reads the list of installed packages here only: a plug-in that one process knows and another does not would
make the same result mean two things.
"""

import os
import sys
from collections.abc import Callable, Iterable
from functools import lru_cache
from importlib.metadata import EntryPoint, EntryPoints, entry_points

from softcal.core.errors import InputError


def installed(group: str) -> list[EntryPoint]:
    """Return the entry points of all installed packages in a group, by name."""
    found = _in_folders(group, tuple((folder, _changed_ns(folder)) for folder in sys.path))
    return sorted(found, key=lambda point: point.name)


@lru_cache(maxsize=16)
def _in_folders(group: str, folders: tuple[tuple[str, int], ...]) -> EntryPoints:
    """Return a group of the folders on the path; a package that comes or goes changes the time of its folder."""
    # Every installed package is opened for this: a station that opens its devices would do so dozens of times.
    return entry_points(group=group)


def _changed_ns(folder: str) -> int:
    try:
        return os.stat(folder or ".").st_mtime_ns
    except OSError:
        return 0


def loaded(point: EntryPoint, kind: str) -> object:
    """Load what an entry point names.

    Args:
        kind: what it should be, in words, for the message.

    Raises:
        InputError: it cannot be loaded; the line names package and entry point.
    """
    try:
        return point.load()
    except Exception as error:
        raise InputError(f"{who(point, kind)}: cannot be loaded ({error}); repair or uninstall the package") from error


def several(point: EntryPoint, kind: str, is_kind: Callable[[object], bool], expected: str) -> list[object]:
    """Load one thing or a list of them and check that each is of the kind.

    Raises:
        InputError: it cannot be loaded, or is something else.
    """
    found = loaded(point, kind)
    things = [found] if is_kind(found) or not isinstance(found, Iterable) else list(found)
    for thing in things:
        if not is_kind(thing):
            raise InputError(
                f"{who(point, kind)}: is {type(thing).__name__}; {expected}, or a list of them, was expected"
            )
    return things


def who(point: EntryPoint, kind: str) -> str:
    """Return how a message names a plug-in: its kind, its name, its package and what it points to."""
    package = f" of {point.dist.name} {point.dist.version}" if point.dist is not None else ""
    return f"{kind} plug-in {point.name!r}{package} ({point.value})"
