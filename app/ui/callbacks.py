"""Callbacks that are never broken off half way."""

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec

from streamlit.runtime.scriptrunner import get_script_run_ctx

P = ParamSpec("P")


def run_uninterrupted(callback: Callable[P, None]) -> Callable[P, None]:
    """Return the callback so that Streamlit runs it to its end.

    Streamlit breaks a callback off where it touches the session state, when the browser has meanwhile asked for the
    whole page again. What caused the callback then counts as done: a press was lost, or half of it.
    """

    @wraps(callback)
    def wrapper(*args: P.args, **kwargs: P.kwargs) -> None:
        context = get_script_run_ctx()
        if context is None:
            return callback(*args, **kwargs)
        state = context.session_state
        break_off = state._yield_callback
        # Streamlit has no public way to hold a request back. The page is drawn again right after the callback.
        object.__setattr__(state, "_yield_callback", lambda: None)
        try:
            callback(*args, **kwargs)
        finally:
            object.__setattr__(state, "_yield_callback", break_off)

    return wrapper
