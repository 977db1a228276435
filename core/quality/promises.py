"""What so many audits of a lot can promise: the table beside an audit plan."""

from softcal.core.quality.acceptance import Promise, audits_by_count, failing_share, tolerance_factor
from softcal.core.quality.conformal import least_risk
from softcal.core.quality.release import audits_wanted
from softcal.core.unit.method import ReleaseConfig

PROMISE_HEADER = ("if all hold", "beyond, on average", "beyond, at 90 %", "margin needed", "promise of 1 in 10")


def promise_rows(
    units: int | None = None,
    promise: Promise = Promise(),  # noqa: B008 - frozen
) -> list[list[object]]:
    """Return one row per number of audits that leaves a unit over, none beyond the limit, under `PROMISE_HEADER`.

    The average and the share at a confidence hold for errors of any form. The margin is by how many standard deviations
    of the log ratio the mean must stay below the limit for the promise by variables (ISO 3951).

    Args:
        units: of the lot; None for any.
    """
    counts = sorted({3, ReleaseConfig.least_audits, audits_wanted(promise), 10, 20, audits_by_count(promise)})
    rows: list[list[object]] = []
    for count in (count for count in counts if units is None or count < units):
        margin, share = tolerance_factor(count, count - 1, promise), failing_share(count, 0, promise.confidence)
        by_margin = "by margin" if count >= audits_wanted(promise) else "none"
        word = "by counting alone" if share <= promise.risk else by_margin
        rows.append([f"{count} audits", f"{least_risk(count):.1%}", f"{share:.1%}", f"{margin:.2f} SD", word])
    return rows
