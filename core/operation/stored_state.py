"""State as JSON: the declared fields of a dataclass, arrays with their shapes; refused where it does not fit.

The type of a field says how it is stored; of an array `array_field` gives the shape. Only declared fields are written,
so that an attribute added for another purpose never becomes part of a stored state by accident.
"""

from collections.abc import Mapping
from dataclasses import Field, field, fields, is_dataclass
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from softcal.core.errors import InputError
from softcal.core.recording import Array

Value = TypeVar("Value")


def array_field(*shape: int | str) -> Mapping[str, Any]:
    """Return the metadata of an array: `field(metadata=array_field("n"))`; an axis named by a letter has any length.

    Axes of one letter have one length in a value.
    """
    return {"shape": shape}


def not_stored(default: Any) -> Any:
    """Return a field that is given anew on restoring, such as a configuration."""
    return field(default=default, metadata={"is_kept": False})


def to_state(value: Any) -> dict[str, object]:
    """Return the declared fields of a dataclass as JSON values, nothing of them shared with it."""
    return {one.name: _to_json(getattr(value, one.name)) for one in _stored_fields(value)}


def _to_json(content: Any) -> object:
    if isinstance(content, np.ndarray):
        return content.tolist()
    if is_dataclass(content):
        return to_state(content)
    # A copy: the stream goes on while the state is written by another thread.
    return [_to_json(each) for each in content] if isinstance(content, list) else content


def from_state(kind: type[Value], state: Mapping[str, Any], **unstored: Any) -> Value:
    """Return a value from what `to_state` wrote.

    Args:
        unstored: fields that are not stored.

    Raises:
        InputError: a field is missing or unknown, or an array has another shape than declared.
    """
    declared, types = _stored_fields(kind), get_type_hints(kind)
    # Unknown fields are refused as well: a newer version may have meant something by them.
    mismatched = {one.name for one in declared} ^ set(state)
    if mismatched:
        raise InputError(
            f"its state does not fit this version: {kind.__name__}.{min(mismatched)} is missing or unknown"
        )
    lengths: dict[str, int] = {}
    values = {}
    for one in declared:
        content, field_type = state[one.name], types[one.name]
        if "shape" in one.metadata:
            content = _array(f"{kind.__name__}.{one.name}", one.metadata["shape"], content, lengths)
        elif is_dataclass(field_type):
            content = from_state(field_type, content)  # type: ignore[arg-type]
        elif get_origin(field_type) is list:
            (item,) = get_args(field_type)
            content = [from_state(item, each) if is_dataclass(item) else each for each in content]  # type: ignore[arg-type]
        values[one.name] = content
    return kind(**values, **unstored)


def _stored_fields(kind: Any) -> "list[Field[Any]]":
    return [one for one in fields(kind) if one.metadata.get("is_kept", True)]


def _array(name: str, shape: tuple[int | str, ...], value: Any, lengths: dict[str, int]) -> Array:
    try:
        values = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"its state does not fit this version: {name} is no array of numbers") from error
    expected = tuple(lengths.get(axis, axis) if isinstance(axis, str) else axis for axis in shape)
    fits = len(expected) == values.ndim and all(
        isinstance(axis, str) or axis == length for axis, length in zip(expected, values.shape, strict=True)
    )
    if not fits:
        raise InputError(f"its state does not fit this version: {name} has shape {values.shape}, expected {expected}")
    lengths.update({axis: n for axis, n in zip(shape, values.shape, strict=True) if isinstance(axis, str)})
    return values
