"""Map families that other installed packages bring along: entry points of the group `softcal.maps`.

An entry point names a `MapFamily`, or a list of them.
"""

from collections.abc import Iterable, Mapping
from importlib.metadata import EntryPoint
from typing import cast

from softcal.core.errors import InputError
from softcal.core.maps.config import DEFAULT
from softcal.core.maps.interface import MapFamily
from softcal.core.plugins import several, who

GROUP, KIND = "softcal.maps", "map family"


def with_plugins(own: Mapping[str, MapFamily], points: Iterable[EntryPoint]) -> dict[str, MapFamily]:
    """Return the families of the catalogue and those of plug-ins, the plug-ins last.

    Raises:
        InputError: a plug-in cannot be loaded, is no map family, or takes a name that is taken.
    """
    every = dict(own)
    for point in points:
        for found in several(point, KIND, _is_family, "a MapFamily"):
            family = cast(MapFamily, found)
            if family.name in every or family.name == DEFAULT:
                raise InputError(f"{who(point, KIND)}: the name {family.name!r} is taken already; give it another")
            every[family.name] = family
    return every


def _is_family(thing: object) -> bool:
    if isinstance(thing, type):
        return False
    has_name = isinstance(getattr(thing, "name", None), str)
    return has_name and all(callable(getattr(thing, name, None)) for name in ("fit", "from_arrays"))
