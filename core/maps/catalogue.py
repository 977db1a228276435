"""The one list of map families: softcal's own, then plug-ins."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from softcal.core.errors import InputError
from softcal.core.identity import Settings
from softcal.core.maps.affine import Affine, IdentityFamily
from softcal.core.maps.anchors import AnchoredMap
from softcal.core.maps.between import Between
from softcal.core.maps.config import DEFAULT
from softcal.core.maps.exact import Exact
from softcal.core.maps.interface import MapFamily, UnitMap
from softcal.core.maps.joint import Joint
from softcal.core.maps.label_shift import LabelShift
from softcal.core.maps.monotone import Monotone
from softcal.core.maps.phase import Phase
from softcal.core.maps.synchronous import Synchronous
from softcal.core.plugins import PluginKind

_LISTED: tuple[MapFamily, ...] = (
    IdentityFamily(),
    Affine(),
    LabelShift(),
    Monotone(),
    Between(),
    Synchronous(),
    Phase(),
    Exact(),
    Joint(),
)

OWN_FAMILIES: Mapping[str, MapFamily] = {family.name: family for family in _LISTED}


def _is_family(thing: object) -> bool:
    if isinstance(thing, type):
        return False
    has_name = isinstance(getattr(thing, "name", None), str)
    return has_name and all(callable(getattr(thing, name, None)) for name in ("fit", "from_arrays"))


PLUGINS = PluginKind[MapFamily]("softcal.maps", "map family", "a MapFamily", _is_family, lambda family: family.name)
"""Families that other installed packages bring along."""

FAMILIES: Mapping[str, MapFamily] = PLUGINS.beside(OWN_FAMILIES, taken=(DEFAULT,))


def family(name: str) -> MapFamily:
    """Return the family of that name.

    Raises:
        InputError: no such family; the message lists the known ones.
    """
    if name not in FAMILIES:
        raise InputError(f"map family {name!r} is unknown; known: {', '.join((DEFAULT, *FAMILIES))}")
    return FAMILIES[name]


def map_from_arrays(family_name: str, arrays: Mapping[str, NDArray[np.generic]], settings: Settings) -> UnitMap:
    """Rebuild a map from what `UnitMap.arrays()` and `UnitMap.settings()` gave.

    Raises:
        InputError: the family is unknown to this version.
    """
    unit_map = family(family_name).from_arrays(arrays, settings)
    if "anchor_gain" not in arrays:
        return unit_map
    return AnchoredMap(unit_map, float(arrays["anchor_gain"]), float(arrays["anchor_offset"]))
