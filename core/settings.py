"""How a number of the method is declared: with its value goes where it comes from."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import Field, asdict, dataclass, field, fields, is_dataclass
from functools import cache, lru_cache
from typing import Any, Self, TypeVar

from softcal.core.identity import content_sha256

Config = TypeVar("Config")

SET = "set, not fitted"
"""Origin of a number that somebody chose by judgement; no data decided it."""


def setting(value: Any, origin: str = SET) -> Any:
    """Declare one number of a frozen configuration, and where it comes from.

    A command of benchmarks/ with the rows it was chosen on, a paper, a standard, or `SET`. Printed
    by `softcal explain --method`.
    """
    return field(default=value, metadata={"origin": origin})


def table(values: Mapping[str, float], origin: str = SET) -> Any:
    """Declare named coefficients of a configuration as pairs of name and value; see `setting`."""
    return setting(tuple(values.items()), origin)


def origins(config: object, prefix: str = "") -> Iterator[tuple[str, object, str]]:
    """Yield (dotted name, value, origin) of every number of a nested configuration."""
    declared: tuple[Field[Any], ...] = fields(config)  # type: ignore[arg-type]
    for one in declared:
        value, name = getattr(config, one.name), f"{prefix}{one.name}"
        if is_dataclass(value):
            yield from origins(value, f"{name}.")
        else:
            yield name, value, str(one.metadata.get("origin", ""))


def rebuild_config(default: Config, stored: Mapping[str, Any]) -> Config:
    """Return a configuration like `default` with the numbers that were kept as JSON."""
    declared: tuple[Field[Any], ...] = fields(default)  # type: ignore[arg-type]
    values = {}
    for field_ in declared:
        default_value = getattr(default, field_.name)
        values[field_.name] = (
            rebuild_config(default_value, stored.get(field_.name, {}))
            if is_dataclass(default_value)
            else _tupled(stored.get(field_.name, default_value))
        )
    return type(default)(**values)


def _tupled(value: Any) -> Any:
    return tuple(_tupled(part) for part in value) if isinstance(value, list | tuple) else value


@dataclass(frozen=True)
class NumberedMethod:
    """A frozen, nested configuration with one identity; every number of it has an origin."""

    @property
    def id(self) -> str:
        return _id(self)

    def numbers(self) -> Iterator[tuple[str, object, str]]:
        return origins(self)

    def to_json(self) -> dict[str, object]:
        """Return every number as nested JSON values; one object for equal methods, to be read only."""
        return _json(self)

    @classmethod
    def from_json(cls, stored: Mapping[str, Any]) -> Self:
        """Read what `to_json` wrote; a number that came later has its default."""
        method: Self = _from_json(cls, json.dumps(stored))  # type: ignore[arg-type]
        return method


MAX_CACHED_METHODS = 32
"""Each unit of a lot carries a copy of one of a few methods: reading each costs more than a query."""


@lru_cache(maxsize=MAX_CACHED_METHODS)
def _from_json(kind: type[NumberedMethod], stored: str) -> Any:
    return rebuild_config(kind(), json.loads(stored))


@lru_cache(maxsize=MAX_CACHED_METHODS)
def _json(method: NumberedMethod) -> dict[str, object]:
    return asdict(method)


@cache
def _id(method: NumberedMethod) -> str:
    return content_sha256({}, method.to_json())
