"""Recordings out of what callers give: a `Recording`, a DataFrame, or the output alone."""

from collections.abc import Mapping
from typing import Any

from softcal.app.api.arguments import show_value, times_of_index
from softcal.app.api.recording import Recording
from softcal.core.errors import InputError
from softcal.core.inspection.reasons import check_reference
from softcal.core.recording import LabelledRecording


def recording_of(data: Any, name: str, rate_Hz: float | None = None, **options: Any) -> Recording:
    """Return a recording: as it is, out of a table, or out of the output alone.

    Args:
        data: a `Recording`, a DataFrame, or the output: (n,) array, list or Series.
        name: of the argument, for the message.
        rate_Hz: the sample rate where the data have no time of their own.
        options: other arguments of `Recording`, or of `from_frame` for a table.

    Raises:
        InputError: it is none of these.
    """
    if isinstance(data, Recording):
        return data
    options = {name: value for name, value in options.items() if value is not None}
    if isinstance(data, str | bytes | dict) or not hasattr(data, "__len__"):
        raise InputError(
            f"{name} is {show_value(data)}; a Recording, a DataFrame or the output itself was expected "
            "(Recording.read takes a file)"
        )
    is_table = hasattr(data, "columns")
    has_time = times_of_index(data) is not None or {"t_s", "time_s"} & options.keys() or (is_table and "t_s" in data)
    if not has_time and rate_Hz is not None:
        options = {"sample_rate_Hz": rate_Hz, **options}
    return Recording.from_frame(data, **options) if is_table else Recording(data, **options)


def labelled_of(recording: Recording, name: str, call: str) -> LabelledRecording:
    """Return output and reference of a recording.

    Args:
        name: of the argument, and `call` that needs it, for the message.

    Raises:
        InputError: it has no reference, and the message has the call that gives it one; or one that can label nothing.
    """
    if recording.reference is None:
        raise InputError(
            f"{name}: this Recording has no reference; {call} needs one: softcal.Recording(..., reference=...), or "
            'Recording.from_frame(table, reference="name of its column")'
        )
    check_reference(recording.inspection)
    return recording.labelled


def recording_with(
    data: Any, name: str, values: Mapping[str, Any], rate_Hz: float | None = None, **defaults: Any
) -> Recording:
    """Return `recording_of`, with facts that the caller gave beside the data; a `Recording` takes none.

    Args:
        defaults: facts where neither the data nor the caller state them.
    """
    extra = {option: value for option, value in values.items() if value is not None}
    if isinstance(data, Recording) and extra:
        options = "=, ".join(extra)
        raise InputError(
            f"{name} is a Recording already: leave {options}= out of this call; arrays take that in "
            f"softcal.Recording(..., {options}=...)"
        )
    return recording_of(data, name, rate_Hz, **defaults | extra)
