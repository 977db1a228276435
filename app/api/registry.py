"""The registry as Python users open it."""

from typing import TYPE_CHECKING

from softcal.app.bootstrap import open_chosen_registry

if TYPE_CHECKING:
    from softcal.db.registry import Registry


def open_registry(url: str | None = None, *, create: bool = False) -> "Registry":
    """Open the registry of calibrations; use it in a `with` block.

    >>> import pathlib, tempfile, softcal
    >>> path = pathlib.Path(tempfile.mkdtemp(), "registry.db")
    >>> with softcal.open_registry(f"sqlite:///{path}", create=True) as registry:
    ...     registry.lots.ids()
    []

    Args:
        url: SQLAlchemy URL; by default $SOFTCAL_REGISTRY, else the SQLite file in the user's data folder.
        create: make the tables where there are none.

    Raises:
        RegistryError: it cannot be opened; the line says why and what to do.
    """
    return open_chosen_registry(url, create=create)
