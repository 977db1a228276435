"""Catalogue of the effects of a diagnosis: softcal's own in the order of the chain, then plug-ins."""

from collections.abc import Mapping
from types import MappingProxyType

from softcal.core.errors import InputError
from softcal.core.plugins import PluginKind
from softcal.core.twin import acquisition, electronics, load_cell, mechanics, transduction
from softcal.core.twin.effects import Effect

BUILTIN_EFFECTS: Mapping[str, Effect] = MappingProxyType(
    {
        effect.id: effect
        for module in (mechanics, transduction, electronics, load_cell, acquisition)
        for effect in module.EFFECTS
    }
)
"""The effects of the written catalogue, by identifier."""

PLUGINS = PluginKind[Effect](
    "softcal.effects", "effect", "an Effect", lambda entry: isinstance(entry, Effect), lambda effect: effect.id
)
"""Effects that other installed packages bring along."""

EFFECTS: Mapping[str, Effect] = MappingProxyType(PLUGINS.merge_plugins(BUILTIN_EFFECTS))
"""Every effect that a diagnosis can name, by identifier."""


def effect(effect_id: str) -> Effect:
    """Return the effect of this identifier.

    Raises:
        InputError: not in the catalogue.
    """
    if effect_id not in EFFECTS:
        raise InputError(f"{effect_id!r} is not an effect of the catalogue; known are {', '.join(EFFECTS)}")
    return EFFECTS[effect_id]
