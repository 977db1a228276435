"""Recordings out of what callers give: a `Recording`, a DataFrame, or the output alone."""

from collections.abc import Mapping
from typing import Any

from softcal.app.api.arguments import shown, times_of_index
from softcal.app.api.recording import Recording
from softcal.core.errors import InputError
from softcal.core.inspection.words import check_reference
from softcal.core.recording import LabelledRecording


def recording_of(given: Any, name: str, rate_Hz: float | None = None, **facts: Any) -> Recording:
    """Return a recording: as it is, out of a table, or out of the output alone.

    Args:
        given: a `Recording`, a DataFrame, or the output: (n,) array, list or Series.
        name: of the argument, for the message.
        rate_Hz: the sample rate where the data have no time of their own.
        facts: other arguments of `Recording`, or of `from_frame` for a table.

    Raises:
        InputError: it is none of these.
    """
    if isinstance(given, Recording):
        return given
    facts = {name: value for name, value in facts.items() if value is not None}
    if isinstance(given, str | bytes | dict) or not hasattr(given, "__len__"):
        raise InputError(
            f"{name} is {shown(given)}; a Recording, a DataFrame or the output itself was expected "
            "(Recording.read takes a file)"
        )
    is_table = hasattr(given, "columns")
    has_time = times_of_index(given) is not None or {"t_s", "time_s"} & facts.keys() or (is_table and "t_s" in given)
    if not has_time and rate_Hz is not None:
        facts = {"sample_rate_Hz": rate_Hz, **facts}
    return Recording.from_frame(given, **facts) if is_table else Recording(given, **facts)


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
    given: Any, name: str, facts: Mapping[str, Any], rate_Hz: float | None = None, **usual: Any
) -> Recording:
    """Return `recording_of`, with facts that the caller gave beside the data; a `Recording` takes none.

    Args:
        usual: facts where neither the data nor the caller state them.
    """
    extra = {fact: value for fact, value in facts.items() if value is not None}
    if isinstance(given, Recording) and extra:
        options = "=, ".join(extra)
        raise InputError(
            f"{name} is a Recording already: leave {options}= out of this call; arrays take that in "
            f"softcal.Recording(..., {options}=...)"
        )
    return recording_of(given, name, rate_Hz, **usual | extra)
