"""Which recordings stand under more than one serial: one of them is of another unit than it says."""

from collections.abc import Iterable
from dataclasses import dataclass

from softcal.core.messages.reason import Reason, reason


@dataclass(frozen=True)
class RecordedOutput:
    """Whose recording an output is.

    Args:
        output_sha256: content hash of the output alone, (n,).
        kind: `source`, `unit` or `audit`; an audit of a source is its golden run.
    """

    serial: str
    lot_id: str
    output_sha256: str
    kind: str = "unit"


def same_recordings(recordings: Iterable[RecordedOutput]) -> tuple[Reason, ...]:
    """Return a remark for every output that stands under several serials, or is source and golden run at once.

    Several lots may have the same press of one serial, and a unit and its audit may be one press.
    """
    groups: dict[str, list[RecordedOutput]] = {}
    for one in recordings:
        groups.setdefault(one.output_sha256, []).append(one)
    unit_sets = [{(one.serial, one.lot_id) for one in group} for group in groups.values()]
    shared = [names for names in unit_sets if len({serial for serial, _ in names}) > 1]
    # The press of a unit and a part of it as its audit are two outputs and one mistake.
    largest = [names for k, names in enumerate(shared) if not any(names < o or names == o for o in shared[k + 1 :])]
    largest = [names for names in largest if not any(names < other for other in largest)]
    remarks = []
    for names in largest:
        units = ", ".join(f"{serial} ({lot_id})" for serial, lot_id in sorted(names))
        remarks.append(reason("lot.same_recording", units=units))
    for group in groups.values():
        sources = {one.serial: one.lot_id for one in group if one.kind == "source"}
        for serial, lot_id in sorted({(one.serial, one.lot_id) for one in group if one.kind == "audit"}):
            if serial in sources:
                lots = {"lot": lot_id, "source_lot": sources[serial]}
                remarks.append(reason("lot.golden_is_source", serial=serial, **lots))
    return tuple(remarks)
