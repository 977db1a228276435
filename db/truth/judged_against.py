"""Whether a verdict was given against the limit in force; against another limit it is none."""

import json
from collections.abc import Mapping
from dataclasses import dataclass

from sqlalchemy import ColumnElement, Text, and_, or_, type_coerce

from softcal.core.words.reason import Reason, reason
from softcal.db.schema.tables import calibrations

STALE = (LIMIT_IS_OTHER, LIMIT_IS_GONE) = ("stale_limit", "stale_limit_open")
"""Codes of the reasons why a verdict does not stand any more."""

STATED = str(Reason("part.stated"))
RMSE, ORIGIN = "limit_rmse", "limit_origin"


@dataclass(frozen=True)
class LimitInForce:
    """The limit of a lot as verdicts are held against it.

    Args:
        rmse: in `unit`; None leaves it to the source's own error.
        unit: of the lot's reference.
    """

    rmse: float | None
    unit: str

    def is_other_in_sql(self) -> ColumnElement[bool]:
        """Return whether a row of the calibrations was judged against another limit, by its evidence: canonical JSON.

        Older versions did not keep it.
        """
        text = type_coerce(calibrations.c.evidence, Text)

        def says(name: str, value: object) -> ColumnElement[bool]:
            pair = json.dumps({name: value}, separators=(",", ":"))[1:-1]
            return or_(*(text.contains(f"{pair}{end}", autoescape=True) for end in ",}"))

        if self.rmse is None:
            return says(ORIGIN, STATED)
        return and_(text.contains(f'"{RMSE}":', autoescape=True), ~says(RMSE, self.rmse))

    def why(self, evidence: Mapping[str, object]) -> Reason:
        """Return why a verdict does not stand any more."""
        judged = float(str(evidence[RMSE]))
        if self.rmse is None:
            return reason(LIMIT_IS_GONE, judged=judged, unit=self.unit)
        return reason(LIMIT_IS_OTHER, judged=judged, limit=self.rmse, unit=self.unit)
