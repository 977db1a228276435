"""The one list of map families: softcal's own, then plug-ins."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from softcal.core.errors import InputError
from softcal.core.identity import Settings
from softcal.core.maps.affine_map import (
    AFFINE,
    IDENTITY,
    LABEL_SHIFT,
    AffineMap,
    fit_affine,
    fit_identity,
    fit_label_shift,
)
from softcal.core.maps.anchors import AnchoredMap
from softcal.core.maps.config import DEFAULT
from softcal.core.maps.curve import CurveMap
from softcal.core.maps.interface import FitProblem, MapFamily, UnitMap
from softcal.core.maps.monotone import BETWEEN, MONOTONE, fit_between, fit_monotone
from softcal.core.maps.paired import PHASE, SYNCHRONOUS, fit_phase, fit_synchronous, paired_map_from_arrays
from softcal.core.maps.plan import EXACT, JOINT, TransportMap, fit_exact, fit_joint
from softcal.core.plugins import PluginKind
from softcal.core.recording import Arrays


@dataclass(frozen=True)
class OwnFamily:
    """A family of softcal's own: how it is fitted, and how a map of its form is rebuilt."""

    name: str
    fit: Callable[[FitProblem], UnitMap]
    rebuild: Callable[[Arrays, Settings, str], UnitMap]

    def from_arrays(self, arrays: Arrays, settings: Settings) -> UnitMap:
        return self.rebuild(arrays, settings, self.name)


_LISTED = (
    OwnFamily(IDENTITY, fit_identity, AffineMap.from_arrays),
    OwnFamily(AFFINE, fit_affine, AffineMap.from_arrays),
    OwnFamily(LABEL_SHIFT, fit_label_shift, AffineMap.from_arrays),
    OwnFamily(MONOTONE, fit_monotone, CurveMap.from_arrays),
    OwnFamily(BETWEEN, fit_between, CurveMap.from_arrays),
    OwnFamily(SYNCHRONOUS, fit_synchronous, paired_map_from_arrays),
    OwnFamily(PHASE, fit_phase, paired_map_from_arrays),
    OwnFamily(EXACT, fit_exact, TransportMap.from_arrays),
    OwnFamily(JOINT, fit_joint, TransportMap.from_arrays),
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


def map_from_arrays(family_name: str, arrays: Arrays, settings: Settings) -> UnitMap:
    """Rebuild a map from what `UnitMap.arrays()` and `UnitMap.settings()` gave.

    Raises:
        InputError: the family is unknown to this version.
    """
    unit_map = family(family_name).from_arrays(arrays, settings)
    if "anchor_gain" not in arrays:
        return unit_map
    return AnchoredMap(unit_map, float(arrays["anchor_gain"]), float(arrays["anchor_offset"]))
