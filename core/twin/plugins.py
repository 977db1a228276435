"""Effects that other installed packages bring along: entry points of the group `softcal.effects`.

An entry point names an `Effect`, or a list of them.
"""

from collections.abc import Iterable, Mapping
from importlib.metadata import EntryPoint
from typing import cast

from softcal.core.errors import InputError
from softcal.core.plugins import installed, several, who
from softcal.core.twin.effects import Effect

GROUP, KIND = "softcal.effects", "effect"


def installed_effects() -> Iterable[EntryPoint]:
    """Return the entry points of all installed packages that bring effects along, by name."""
    return installed(GROUP)


def with_plugins(own: Mapping[str, Effect], points: Iterable[EntryPoint]) -> dict[str, Effect]:
    """Return the effects of the catalogue and those of plug-ins, the plug-ins last.

    Raises:
        InputError: a plug-in cannot be loaded, is no effect, or takes an identifier that is taken.
    """
    every = dict(own)
    for point in points:
        for found in several(point, KIND, lambda thing: isinstance(thing, Effect), "an Effect"):
            effect = cast(Effect, found)
            if effect.id in every:
                raise InputError(
                    f"{who(point, KIND)}: effect {effect.id!r} is in the catalogue already; give it another id"
                )
            every[effect.id] = effect
    return every
