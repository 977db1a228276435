"""A twin as a plain record, for files and reports."""

from collections.abc import Mapping
from typing import Any

from softcal.core.errors import InputError
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin

SCHEMA = "softcal.twin/1"


def twin_record(twin: Twin) -> dict[str, Any]:
    """Return a twin as JSON values, schema `softcal.twin/1`."""
    return {
        "schema": SCHEMA,
        "parameters": dict(vars(twin.parameters)),
        "metadata": dict(vars(twin.metadata)),
        "effects": [
            {"effect": s.effect_id, "values": dict(s.values), "episodes": [list(row) for row in s.episodes]}
            for s in twin.effects
        ],
    }


def twin_from_record(record: Mapping[str, Any], place: str) -> Twin:
    """Return the twin of a record.

    Args:
        place: where the record comes from, for messages.

    Raises:
        InputError: it does not describe a twin.
    """
    try:
        if record["schema"] != SCHEMA:
            raise InputError(f"{place}: schema {record['schema']!r}; {SCHEMA} was expected")
        effects = tuple(
            EffectSetting(e["effect"], e["values"], tuple((float(a), float(b)) for a, b in e["episodes"]))
            for e in record["effects"]
        )
        return Twin(BaseParameters(**record["parameters"]), effects, ReadoutMetadata(**record["metadata"]))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{place}: does not describe a twin ({error}); write it with softcal gap apply") from error
