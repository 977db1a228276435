"""How a number of the method is declared: with its value goes where it comes from."""

from collections.abc import Iterator, Mapping
from dataclasses import Field, field, fields, is_dataclass
from typing import Any, TypeVar

Config = TypeVar("Config")

SET = "set, not fitted"
"""Origin of a number that somebody chose by judgement; no data decided it."""


def setting(value: Any, origin: str = SET) -> Any:
    """Declare one number of a frozen configuration.

    Args:
        value: the default.
        origin: where it comes from: a command of benchmarks/ with the rows it was chosen on, a paper, a standard, or
            `SET`. Printed by `softcal explain --method`.
    """
    return field(default=value, metadata={"origin": origin})


def table(values: Mapping[str, float], origin: str = SET) -> Any:
    """Declare named coefficients of a frozen configuration as pairs of name and value; see `setting`."""
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


def rebuilt(default: Config, kept: Mapping[str, Any]) -> Config:
    """Return a configuration like `default` with the numbers that were kept as JSON; what is missing stays as it is.

    Args:
        default: a frozen configuration, nested ones included.
        kept: from `dataclasses.asdict` through JSON.
    """
    declared: tuple[Field[Any], ...] = fields(default)  # type: ignore[arg-type]
    values = {}
    for one in declared:
        own = getattr(default, one.name)
        value = kept.get(one.name, own)
        values[one.name] = rebuilt(own, value) if is_dataclass(own) else _tupled(value)
    return type(default)(**values)


def _tupled(value: Any) -> Any:
    return tuple(_tupled(part) for part in value) if isinstance(value, list | tuple) else value
