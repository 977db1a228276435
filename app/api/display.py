"""How objects of the Python API show themselves in a notebook, and what is missing where they cannot be drawn."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from html import escape

from softcal.app.extras import missing_extra


def html_table(title: str, rows: Iterable[tuple[str, str]]) -> str:
    """Return a small table of names and values as HTML, for `_repr_html_`."""
    alignment = "style='text-align:left'"
    cells = [f"<th {alignment}>{escape(name)}</th><td {alignment}>{escape(value)}</td>" for name, value in rows]
    lines = "".join(f"<tr>{pair}</tr>" for pair in cells)
    return f"<table><caption><b>{escape(title)}</b></caption><tbody>{lines}</tbody></table>"


@contextmanager
def plotting(task: str) -> Iterator[None]:
    """Name the extra that brings a library which a figure needs.

    Raises:
        ModuleNotFoundError: it is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if (line := missing_extra(error)) is None:
            raise
        raise ModuleNotFoundError(f"{task}: {line}", name=error.name) from error
