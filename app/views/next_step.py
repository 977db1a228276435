"""What is to be done next with a lot, computed from where it stands. No Streamlit."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime

import msgspec

from softcal.app.texts.reasons import Translator, render_reason
from softcal.core.messages.reason import Reason
from softcal.core.quality.lot_status import Disposition, LotStatus, UnitInLot
from softcal.db.provenance import Provenance
from softcal.db.registry import Registry
from softcal.db.repositories.in_use import STALE

MAX_SERIALS = 8
"""So many serials are named in a sentence; the tab it leads to has all."""


@dataclass(frozen=True)
class NextStep:
    """The next step of a lot: the text `next.KIND`.

    Args:
        tab: of the lot's page, where it is done; "" where it is done elsewhere.
        reason: why units wait; None where the kind says it.
    """

    kind: str
    tab: str = ""
    values: Mapping[str, object] = field(default_factory=dict)
    reason: Reason | None = None

    def render(self, translate: Translator) -> str:
        """Return it as one sentence."""
        reason_value = {} if self.reason is None else {"why": render_reason(self.reason, translate)}
        return translate(f"next.{self.kind}", **self.values, **reason_value)


@dataclass(frozen=True)
class ReleaseRecord:
    """The release of a lot that is in force: when, by whom, and which serials."""

    at: datetime | None
    actor: str
    serials: tuple[str, ...]


def release_record(registry: Registry, status: LotStatus) -> ReleaseRecord | None:
    """Return what of a lot is released now; None where nothing is."""
    released = tuple(unit.serial for unit in status.units if unit.verdict == "pass")
    if not released:
        return None
    entry = registry.decisions.in_force(status.lot_id)
    if entry is not None and entry.decision.get("released") and (stored_provenance := entry.decision.get("provenance")):
        # Of the statement, not of the entry: whoever fitted the lot since, or took that back, released nothing.
        provenance = msgspec.convert(stored_provenance, Provenance)
        return ReleaseRecord(datetime.fromisoformat(provenance.made_at), provenance.actor, released)
    runs = [run for run in registry.lots.runs(status.lot_id) if run.serial in set(released)]
    newest = max(runs, key=lambda run: run.made_at, default=None)
    if newest is None:
        return ReleaseRecord(None, "", released)
    actor = registry.calibrations.get(newest.serial, lot_id=status.lot_id).actor
    return ReleaseRecord(newest.made_at, actor, released)


def next_step(registry: Registry, status: LotStatus, unmeasured: Sequence[str] | None) -> NextStep:
    """Return the one thing to do next: what others wait for comes first.

    Args:
        unmeasured: serials that the audit plan of the lot drew and nobody measured yet; None without a plan.
    """
    lot_id, counts = status.lot_id, status.counts
    lot = registry.lots.get(lot_id)
    if not registry.recordings.of_lot(lot_id, kind="source") and registry.networks.released(lot_id) is None:
        return NextStep("source", values={"serial": lot.source})
    if not status.units or counts["none"] == len(status.units):
        pressed_serials = {entry.serial for entry in registry.recordings.of_lot(lot_id, kind="unit")}
        return (
            NextStep("calibrate", "units", {"count": len(pressed_serials)})
            if pressed_serials
            else NextStep("record", "units")
        )
    waiting = status.on(Disposition.WAITING)
    if status.limit is None or not status.limit.is_stated:
        return NextStep("limit", "limits", {"count": len(waiting)})
    if suspects := [unit for unit in status.audited if unit.suspect_reason is not None]:
        return NextStep("confirm", "audit", _unit_values(suspects))
    if unmeasured:
        return NextStep("measure", "audit", _serial_values(unmeasured))
    if becoming := status.releasable:
        return NextStep("release", "release", _serial_values(becoming))
    if waiting and all(unit.reasons[:1] and unit.reasons[0].code in STALE for unit in waiting):
        return NextStep("again", values={"count": len(waiting)})
    if (retests := [unit for unit in waiting if unit.verdict == "retest"]) and len(retests) == len(waiting):
        return NextStep("retest", "units", _unit_values(retests))
    if waiting and unmeasured is None:
        return NextStep("draw", "audit", {"count": len(waiting)})
    if waiting:
        cause, _ = Counter(unit.reasons[:1] for unit in waiting).most_common(1)[0]
        return NextStep("waiting", "release", {"count": len(waiting)}, cause[0] if cause else None)
    record = release_record(registry, status)
    if record is not None:
        values = {"count": len(record.serials), "at": record.at or "", "actor": record.actor}
        return NextStep("released", "release", values)
    return NextStep("decided", "release", {"count": counts["fail"]})


def _unit_values(units: Sequence[UnitInLot]) -> dict[str, object]:
    return _serial_values([unit.serial for unit in units])


def _serial_values(serials: Sequence[str]) -> dict[str, object]:
    rest = len(serials) - MAX_SERIALS
    text = ", ".join(serials[:MAX_SERIALS])
    return {"count": len(serials), "serials": f"{text} … (+{rest})" if rest > 0 else text}
