"""Where the audit of a lot stands, as rows to read."""

from collections.abc import Callable

from softcal.app.batch.audit import LotAudit
from softcal.app.views.common import number

Words = Callable[..., str]


def plan_rows(audit: LotAudit, unit: str, words: Words) -> list[dict[str, str]]:
    """Return one row a unit of the plan: why it was drawn, what was forecast and measured, and what that says.

    Args:
        unit: of the errors.
    """
    return [
        {
            words("column.serial"): serial,
            words("audit.why"): words(f"audit.why.{'doubtful' if serial in audit.plan.doubtful else 'random'}"),
            words("release.forecast"): number(audit.forecasts[serial], unit),
            words("release.measured"): number(audit.measured.get(serial), unit),
            words("audit.result"): words(f"audit.result.{_result(audit, serial)}"),
        }
        for serial in audit.plan.serials
    ]


def _result(audit: LotAudit, serial: str) -> str:
    if serial not in audit.measured:
        return "open"
    return "within" if audit.measured[serial] <= audit.limit.maximum_rmse else "beyond"
