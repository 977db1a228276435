"""A twin as a plain record, for files and reports."""

from collections.abc import Mapping
from typing import Any

from softcal.core.errors import InputError
from softcal.core.twin.empirical_terms import EmpiricalTerm
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin

SCHEMA = "softcal.twin/1"
RICHER = "softcal.twin/2"
"""Of a twin with other forms or empirical terms, which a reader of the first would leave out."""


TERM = ("place", "variable", "coefficient", "load_N", "depth_mm")


def twin_record(twin: Twin) -> dict[str, Any]:
    """Return a twin as JSON values, by the second schema where the first does not do."""
    is_richer = bool(twin.empirical) or any(s.form for s in twin.effects)
    record: dict[str, Any] = {
        "schema": RICHER if is_richer else SCHEMA,
        "parameters": dict(vars(twin.parameters)),
        "metadata": dict(vars(twin.metadata)),
        "effects": [
            {"effect": s.effect_id, "values": dict(s.values), "episodes": [list(row) for row in s.episodes]}
            | ({"form": s.form} if s.form else {})
            for s in twin.effects
        ],
    }
    if twin.empirical:
        record["empirical"] = [{name: getattr(term, name) for name in (*TERM, "unit")} for term in twin.empirical]
    return record


def twin_from_record(record: Mapping[str, Any], place: str) -> Twin:
    """Return the twin of a record.

    Raises:
        InputError: it does not describe a twin.
    """
    try:
        if record["schema"] not in (SCHEMA, RICHER):
            raise InputError(f"{place}: schema {record['schema']!r}; {SCHEMA} or {RICHER} was expected")
        effects = tuple(
            EffectSetting(
                e["effect"], e["values"], tuple((float(a), float(b)) for a, b in e["episodes"]), str(e.get("form", ""))
            )
            for e in record["effects"]
        )
        terms = []
        for e in record.get("empirical", ()):
            numbers = (float(e[name]) for name in ("coefficient", "load_N", "depth_mm"))
            terms.append(term := EmpiricalTerm(e["place"], e["variable"], *numbers))
            if e.get("unit", term.unit) != term.unit:
                raise InputError(f"{term.formula}: its coefficient is in {term.unit}, not in {e['unit']}")
        return Twin(
            BaseParameters(**record["parameters"]), effects, ReadoutMetadata(**record["metadata"]), tuple(terms)
        )
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{place}: does not describe a twin ({error}); write it with softcal gap apply") from error
