"""Other realisations of the catalogue's causes, by cause: what a rig may show instead of the catalogue's equation."""

from collections.abc import Mapping
from types import MappingProxyType

from softcal.core.twin.catalogue import EFFECTS
from softcal.core.twin.effects import Form

FORMS: Mapping[str, tuple[Form, ...]] = MappingProxyType({e.id: e.forms for e in EFFECTS.values() if e.forms})
"""A cause that is missing here has one realisation only."""
