"""Effects that other installed packages bring along: entry points of the group `softcal.effects`.

An entry point names an `Effect`, or a list of them. The core reads the list of installed packages here only.
"""

from collections.abc import Iterable, Mapping
from importlib.metadata import EntryPoint, entry_points

from softcal.core.errors import InputError
from softcal.core.twin.effects import Effect

GROUP = "softcal.effects"


def installed_effects() -> Iterable[EntryPoint]:
    """Return the entry points of all installed packages that bring effects along, by name."""
    return sorted(entry_points(group=GROUP), key=lambda point: point.name)


def with_plugins(own: Mapping[str, Effect], points: Iterable[EntryPoint]) -> dict[str, Effect]:
    """Return the effects of the catalogue and those of plug-ins, the plug-ins last.

    Raises:
        InputError: a plug-in cannot be loaded, is no effect, or takes an identifier that is taken.
    """
    every = dict(own)
    for point in points:
        for effect in _loaded(point):
            if effect.id in every:
                raise InputError(f"{_who(point)}: effect {effect.id!r} is in the catalogue already; give it another id")
            every[effect.id] = effect
    return every


def _loaded(point: EntryPoint) -> list[Effect]:
    try:
        found = point.load()
    except Exception as error:
        raise InputError(f"{_who(point)}: cannot be loaded ({error}); repair or uninstall the package") from error
    effects = [found] if isinstance(found, Effect) else list(found) if isinstance(found, Iterable) else [found]
    for effect in effects:
        if not isinstance(effect, Effect):
            raise InputError(f"{_who(point)}: is {type(effect).__name__}; an Effect, or a list of them, was expected")
    return effects


def _who(point: EntryPoint) -> str:
    package = f" of {point.dist.name} {point.dist.version}" if point.dist is not None else ""
    return f"effect plug-in {point.name!r}{package} ({point.value})"
