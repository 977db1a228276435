"""What other installed packages bring along: entry points by group, loaded and checked.

The core reads the list of installed packages here only. A plug-in that one process knows and
another does not would make the same result mean two things.
"""

import os
import sys
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import EntryPoint, EntryPoints, entry_points
from typing import Generic, TypeVar, cast

from softcal.core.errors import InputError

Plugin = TypeVar("Plugin")


def find_plugins(group: str) -> list[EntryPoint]:
    """Return the entry points of all installed packages in a group, by name."""
    entries = _in_folders(group, tuple((folder, _changed_ns(folder)) for folder in sys.path))
    return sorted(entries, key=lambda point: point.name)


@lru_cache(maxsize=16)
def _in_folders(group: str, folders: tuple[tuple[str, int], ...]) -> EntryPoints:
    """Return a group of the path's folders; a package that comes or goes changes a folder's time."""
    # Every installed package is opened for this: a station would do so dozens of times.
    return entry_points(group=group)


def _changed_ns(folder: str) -> int:
    try:
        return os.stat(folder or ".").st_mtime_ns
    except OSError:
        return 0


def load_plugin(point: EntryPoint, kind: str) -> object:
    """Load what an entry point names.

    Raises:
        InputError: it cannot be loaded; the line names package and entry point.
    """
    try:
        return point.load()
    except Exception as error:
        raise InputError(
            f"{name_point(point, kind)}: cannot be loaded ({error}); repair or uninstall the package"
        ) from error


@dataclass(frozen=True)
class PluginKind(Generic[Plugin]):
    """One kind of thing that packages bring along: an entry point names one, or a list of them.

    Args:
        kind, expected: what it is and what was expected, in words, for messages.
        name_of: the name that no two of them may have.
    """

    group: str
    kind: str
    expected: str
    is_kind: Callable[[object], bool]
    name_of: Callable[[Plugin], str]

    def merge_plugins(
        self, builtin: Mapping[str, Plugin], points: Iterable[EntryPoint] | None = None, reserved: Collection[str] = ()
    ) -> dict[str, Plugin]:
        """Return softcal's own things and those of plug-ins, the plug-ins last, by name.

        Args:
            reserved: names that no plug-in may have, besides those of its own.

        Raises:
            InputError: one cannot be loaded, is something else, or takes a name that is taken.
        """
        every = dict(builtin)
        for point in find_plugins(self.group) if points is None else points:
            plugin = load_plugin(point, self.kind)
            for entry in [plugin] if self.is_kind(plugin) or not isinstance(plugin, Iterable) else list(plugin):
                if not self.is_kind(entry):
                    problem = f"is {type(entry).__name__}; {self.expected}, or a list of them, was expected"
                    raise InputError(f"{name_point(point, self.kind)}: {problem}")
                name = self.name_of(cast(Plugin, entry))
                if name in every or name in reserved:
                    raise InputError(
                        f"{name_point(point, self.kind)}: the name {name!r} is taken already; give it another"
                    )
                every[name] = cast(Plugin, entry)
        return every


def name_point(point: EntryPoint, kind: str) -> str:
    """Return how a message names a plug-in: kind, name, package and what it points to."""
    package = f" of {point.dist.name} {point.dist.version}" if point.dist is not None else ""
    return f"{kind} plug-in {point.name!r}{package} ({point.value})"
