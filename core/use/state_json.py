"""State as JSON: the declared fields of a dataclass, arrays with their shapes; refused where it does not fit.

A class says with `array`, `part`, `parts` and `not_kept` what its fields are. Only declared fields are written, so that
an attribute added for another purpose never becomes part of a stored state by accident.
"""

from collections.abc import Mapping
from dataclasses import Field, field, fields
from typing import Any, TypeVar

import numpy as np

from softcal.core.errors import InputError
from softcal.core.recording import Array

Value = TypeVar("Value")
Metadata = Mapping[str, Any]
"""Of a dataclass field: `shape: Array = field(metadata=array("n"))`."""


def array(*shape: int | str) -> Metadata:
    """Declare an array; an axis named by a letter may have any length, the same wherever the letter stands."""
    return {"shape": shape}


def part(kind: type) -> Metadata:
    """Declare a value that has declared fields itself."""
    return {"kind": kind}


def parts(kind: type) -> Metadata:
    """Declare a list of values that have declared fields themselves."""
    return {"kinds": kind}


def not_kept(default: Any) -> Any:
    """Declare a field that is given anew on restoring, such as a configuration."""
    return field(default=default, metadata={"is_kept": False})


def state_of(value: Any) -> dict[str, object]:
    """Return the declared fields of a dataclass as JSON values, nothing of them shared with it."""
    state: dict[str, object] = {}
    for one in _declared(value):
        own = getattr(value, one.name)
        if "shape" in one.metadata:
            own = own.tolist()
        elif "kind" in one.metadata:
            own = state_of(own)
        elif "kinds" in one.metadata:
            own = [state_of(each) for each in own]
        # A copy: the stream goes on while the state is written by another thread.
        state[one.name] = list(own) if isinstance(own, list) else own
    return state


def restored(kind: type[Value], state: Mapping[str, Any], **given: Any) -> Value:
    """Return a value from what `state_of` wrote.

    Args:
        given: fields that are not kept.

    Raises:
        InputError: a field is missing or unknown, or an array has another shape than declared.
    """
    declared = _declared(kind)
    # Unknown fields are refused as well: a newer version may have meant something by them.
    wrong = {one.name for one in declared} ^ set(state)
    if wrong:
        raise InputError(f"its state does not fit this version: {kind.__name__}.{min(wrong)} is missing or unknown")
    lengths: dict[str, int] = {}
    values = {}
    for one in declared:
        own = state[one.name]
        if "shape" in one.metadata:
            own = _array(f"{kind.__name__}.{one.name}", one.metadata["shape"], own, lengths)
        elif "kind" in one.metadata:
            own = restored(one.metadata["kind"], own)
        elif "kinds" in one.metadata:
            own = [restored(one.metadata["kinds"], each) for each in own]
        values[one.name] = list(own) if isinstance(own, list) else own
    return kind(**values, **given)


def _declared(kind: Any) -> "list[Field[Any]]":
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
