"""Findings of a look at a recording as reasons, and what makes a reference unusable."""

from collections.abc import Sequence

from softcal.core.errors import InputError
from softcal.core.inspection.inspection import Inspection, InspectionFinding
from softcal.core.messages.reason import Reason, reason
from softcal.core.recording import Indices

OF_COLUMN = {
    "missing": "inspect.missing",
    "overflow": "inspect.overflow",
    "spike": "inspect.spike",
    "dropout": "inspect.dropout",
    "step": "inspect.step",
    "wrap": "inspect.wrap",
    "stuck": "inspect.stuck",
    "clipped": "inspect.clipped",
    "sign": "inspect.sign",
    "constant": "inspect.constant",
}
"""Kind of a finding on one column → code of its reason."""

CURES = {
    "tare": Reason("part.cure_tare"),
    "held": Reason("part.cure_held"),
    "lag": Reason("part.cure_lag"),
    "constant": Reason("part.cure_constant"),
    "stuck": Reason("part.cure_constant"),
}
"""Kinds of findings with which a reference labels nothing, and what to do."""


def finding_reason(finding: InspectionFinding, lines: Sequence[int] | Indices | None = None) -> Reason:
    """Return a finding as a sentence with its place, value and size.

    Args:
        lines: (n,) line of the file of each row; None names rows, counted from 1.
    """
    where = "part.at_row" if lines is None else "part.at_line"
    number = finding.start + 1 if lines is None else int(lines[finding.start])
    at, rows = reason(where, number=number, at=finding.time_s), finding.stop - finding.start
    value, amount = finding.value, finding.amount
    if finding.kind == "gap":
        return reason("inspect.gap", where=at, seconds=value, missing=amount)
    if finding.kind == "pause":
        return reason("inspect.pause", where=at, seconds=value)
    if finding.kind == "rate":
        return reason("inspect.rate", where=at, rate=value, rows=rows)
    if finding.kind == "tare":
        return reason("inspect.tare", where=at, value=value, share=amount)
    if finding.kind == "held":
        return reason("inspect.held", rate=value, rows=amount)
    if finding.kind == "lag":
        return reason("inspect.late" if value > 0 else "inspect.early", seconds=abs(value))
    return reason(OF_COLUMN[finding.kind], where=at, column=finding.column, value=value, amount=amount, rows=rows)


def summarise(inspection: Inspection, lines: Sequence[int] | Indices | None = None) -> list[Reason]:
    """Return the findings on a recording, one sentence a kind and column: the first one and how many there are."""
    groups: dict[tuple[str, str], list[InspectionFinding]] = {}
    for finding in inspection.findings:
        groups.setdefault((finding.kind, finding.column), []).append(finding)
    remarks = []
    for group in groups.values():
        first = finding_reason(group[0], lines)
        remarks.append(first if len(group) == 1 else reason("inspect.several", first=first, more=len(group) - 1))
    return remarks


def check_reference(inspection: Inspection, lines: Sequence[int] | Indices | None = None) -> None:
    """Check that a reference can label its output.

    Raises:
        InputError: it was tared in the middle, lags, has another rate or never changes; the line is named.
    """
    for finding in inspection.of_kind(*CURES):
        if finding.column == "reference":
            raise InputError(
                reason("inspect.unusable", finding=finding_reason(finding, lines), cure=CURES[finding.kind])
            )
