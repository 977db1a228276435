"""The one list of map families."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from softcal.core.errors import InputError
from softcal.core.identity import Settings
from softcal.core.maps.affine import Affine, Identity
from softcal.core.maps.interface import MapFamily, UnitMap

_LISTED: tuple[MapFamily, ...] = (Identity(), Affine())

FAMILIES: Mapping[str, MapFamily] = {family.name: family for family in _LISTED}

DEFAULT = "auto"
"""Let the evidence of each unit choose (`choose.py`)."""


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
    return family(family_name).from_arrays(arrays, settings)
