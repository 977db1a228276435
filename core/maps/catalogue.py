"""The one list of map families: those built in, then plug-ins."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from softcal.core.errors import InputError
from softcal.core.identity import Settings
from softcal.core.maps.affine_map import (
    AFFINE,
    IDENTITY,
    TWO_POINT,
    AffineMap,
    fit_affine,
    fit_identity,
    fit_two_point,
)
from softcal.core.maps.anchors import AnchoredMap
from softcal.core.maps.config import DEFAULT
from softcal.core.maps.curve import CurveMap
from softcal.core.maps.interface import FitProblem, MapFamily, UnitMap
from softcal.core.maps.monotone import AVERAGED, MONOTONE, fit_averaged, fit_monotone
from softcal.core.maps.paired import (
    SHARED_LOAD,
    STAGE_MATCHED,
    SYNCHRONOUS,
    fit_stage_matched,
    fit_synchronous,
    paired_map_from_arrays,
)
from softcal.core.maps.plan import EXACT, JOINT, TransportMap, fit_exact, fit_joint
from softcal.core.plugins import PluginKind
from softcal.core.recording import Arrays


@dataclass(frozen=True)
class BuiltinFamily:
    """A family that is built in: how it is fitted, and how a map of its form is rebuilt."""

    name: str
    fit: Callable[[FitProblem], UnitMap]
    rebuild: Callable[[Arrays, Settings, str], UnitMap]

    def from_arrays(self, arrays: Arrays, settings: Settings) -> UnitMap:
        return self.rebuild(arrays, settings, self.name)


_LISTED = (
    BuiltinFamily(IDENTITY, fit_identity, AffineMap.from_arrays),
    BuiltinFamily(AFFINE, fit_affine, AffineMap.from_arrays),
    BuiltinFamily(TWO_POINT, fit_two_point, AffineMap.from_arrays),
    BuiltinFamily(MONOTONE, fit_monotone, CurveMap.from_arrays),
    BuiltinFamily(AVERAGED, fit_averaged, CurveMap.from_arrays),
    BuiltinFamily(SYNCHRONOUS, fit_synchronous, paired_map_from_arrays),
    BuiltinFamily(STAGE_MATCHED, fit_stage_matched, paired_map_from_arrays),
    BuiltinFamily(EXACT, fit_exact, TransportMap.from_arrays),
    BuiltinFamily(JOINT, fit_joint, TransportMap.from_arrays),
)

BUILTIN_FAMILIES: Mapping[str, MapFamily] = {family.name: family for family in _LISTED}


def _is_family(candidate: object) -> bool:
    if isinstance(candidate, type):
        return False
    has_name = isinstance(getattr(candidate, "name", None), str)
    return has_name and all(callable(getattr(candidate, name, None)) for name in ("fit", "from_arrays"))


PLUGINS = PluginKind[MapFamily]("softcal.maps", "map family", "a MapFamily", _is_family, lambda family: family.name)
"""Families that other installed packages bring along."""

FAMILIES: Mapping[str, MapFamily] = PLUGINS.merge_plugins(BUILTIN_FAMILIES, reserved=(DEFAULT,))


def family(name: str) -> MapFamily:
    """Return the family of that name.

    Raises:
        InputError: no such family; the message lists the known ones.
    """
    if name not in FAMILIES:
        raise InputError(f"map family {name!r} is unknown; known: {', '.join((DEFAULT, *FAMILIES))}")
    return FAMILIES[name]


def check_family(name: str) -> str:
    """Return the name of a family, or `auto`, that maps can be fitted by; `InputError` lists those there are."""
    return name if name == DEFAULT else family(name).name


def map_from_arrays(family_name: str, arrays: Arrays, settings: Settings) -> UnitMap:
    """Rebuild a map from what `UnitMap.arrays()` and `UnitMap.settings()` gave.

    Raises:
        InputError: the family is unknown to this version.
    """
    unit_map: UnitMap
    # Nobody can choose it: only a whole lot is fitted so (`shared_load.py`).
    if family_name == SHARED_LOAD:
        unit_map = paired_map_from_arrays(arrays, settings, SHARED_LOAD)
    else:
        unit_map = family(family_name).from_arrays(arrays, settings)
    if "anchor_gain" not in arrays:
        return unit_map
    return AnchoredMap(unit_map, float(arrays["anchor_gain"]), float(arrays["anchor_offset"]))
