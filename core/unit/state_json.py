"""A unit's state as named arrays and JSON values, and back: what the registry stores of it."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from typing import Any, get_args, get_type_hints

import msgspec
import numpy as np

from softcal.core.metrics import finite_or_none
from softcal.core.recording import Arrays
from softcal.core.unit.correspondence import Correspondence
from softcal.core.unit.fit import Fit, FittedMap
from softcal.core.unit.health import OutputLimits
from softcal.core.unit.method import Method
from softcal.core.unit.state import UnitState
from softcal.core.unit.uncertainty import Interval

Json = dict[str, Any]

_WRITTEN_APART = ("method", "correspondence", "fitted", "fit_s")
"""Fields of a fit that are not written as they are; how long it took is no part of what it is."""


@dataclass(frozen=True, eq=False)
class StoredFit:
    """A fit as values: its numbers and words as JSON, its arrays by name; the method is stored once for many."""

    content: Json
    arrays: Arrays


def fit_to_json(fit: Fit) -> StoredFit:
    """Return a fit as JSON values and arrays."""
    content = {one.name: _plain(getattr(fit, one.name)) for one in fields(Fit) if one.name not in _WRITTEN_APART}
    content["correspondence"] = {"kind": fit.correspondence.kind, "is_anchored": fit.correspondence.is_anchored}
    if fit.fitted is None:
        return StoredFit(content, {})
    unit_map, interval, limits = fit.fitted.unit_map, fit.fitted.interval, fit.fitted.output_limits
    content["fitted"] = {
        "map": dict(unit_map.settings()),
        "interval": interval.settings(),
        "output_limits": {name: finite_or_none(value) for name, value in vars(limits).items()},
    }
    arrays = {f"map.{name}": array for name, array in unit_map.arrays().items()}
    return StoredFit(content, arrays | {f"interval.{name}": array for name, array in interval.arrays().items()})


def fit_from_json(content: Mapping[str, Any], method: Method, arrays: Arrays | None = None) -> Fit:
    """Read what `fit_to_json` wrote; without arrays the fit can be listed and decided on, and estimates nothing.

    Raises:
        ValueError: the content is not what was written.
    """
    kinds, stored = _types(Fit), content["correspondence"]
    names = [one.name for one in fields(Fit) if one.name not in _WRITTEN_APART]
    values = {name: msgspec.convert(content[name], kinds[name]) for name in names}
    correspondence = Correspondence(
        stored["kind"], getattr(method.correspondence, stored["kind"]), stored["is_anchored"]
    )
    fit = Fit(**values, method=method, correspondence=correspondence)
    return fit if arrays is None else replace(fit, fitted=_fitted(fit.family, content["fitted"], arrays))


def adjustments_to_json(state: UnitState) -> Json:
    """Return all of a state but its fit as JSON values: equal ones for equal states."""
    kinds = _types(UnitState)
    names = [one.name for one in fields(UnitState) if one.name != "fit"]
    # A whole number is a float where one belongs, and a zero has no sign: so databases give them back.
    typed = {name: msgspec.convert(_plain(getattr(state, name)), kinds[name]) for name in names}
    return {name: _unsigned(_plain(value)) for name, value in typed.items()}


def part_to_columns(part: Mapping[str, Any], names: Collection[str], prefix: str = "") -> Json:
    """Return a part of a state as values of columns; a nested value has the name of its field before its own."""
    columns = Json()
    for name, value in part.items():
        if (column := f"{prefix}{name}") in names:
            columns[column] = value
        elif value is not None:
            columns |= part_to_columns(value, names, f"{column}_")
    return columns


def part_from_columns(field: str, columns: Mapping[str, Any]) -> Json:
    """Return a part of a state as JSON values: what `part_to_columns` made columns of."""
    return _nested(_dataclass_in(_types(UnitState)[field]), columns, "")


def _nested(kind: type, columns: Mapping[str, Any], prefix: str) -> Json:
    values = Json()
    for name, hint in _types(kind).items():
        if (column := f"{prefix}{name}") in columns:
            values[name] = columns[column]
        else:
            inner = _nested(_dataclass_in(hint), columns, f"{column}_")
            values[name] = None if _is_empty(inner) else inner
    return values


def _is_empty(values: object) -> bool:
    return all(map(_is_empty, values.values())) if isinstance(values, dict) else values is None


def _dataclass_in(hint: Any) -> type:
    return next(one for one in (hint, *get_args(hint)) if is_dataclass(one))  # type: ignore[return-value]


def _unsigned(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _unsigned(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_unsigned(one) for one in value]
    return value + 0.0 if isinstance(value, float) else value


def state_from_json(fit: Fit, content: Mapping[str, Any]) -> UnitState:
    """Read what `adjustments_to_json` wrote, beside its fit."""
    kinds = _types(UnitState)
    return UnitState(fit=fit, **{name: msgspec.convert(value, kinds[name]) for name, value in content.items()})


def _fitted(family: str, content: Mapping[str, Any], arrays: Arrays) -> FittedMap:
    # The families bring solvers that take seconds to import; a registry that lists units needs none of them.
    from softcal.core.maps.catalogue import map_from_arrays

    limits = content["output_limits"]
    return FittedMap(
        map_from_arrays(family, _group(arrays, "map."), content["map"]),
        Interval.from_arrays(_group(arrays, "interval."), content["interval"]),
        OutputLimits(
            rail_low=-np.inf if limits["rail_low"] is None else float(limits["rail_low"]),
            rail_high=np.inf if limits["rail_high"] is None else float(limits["rail_high"]),
            stuck_samples=int(limits["stuck_samples"]),
        ),
    )


@cache
def _types(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)


def _plain(value: object) -> Any:
    return msgspec.to_builtins(value, enc_hook=lambda number: number.item())


def _group(arrays: Arrays, prefix: str) -> Arrays:
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
