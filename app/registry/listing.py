"""Units and revisions of the registry as rows of a table and as JSON values."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from softcal.app.texts.catalogue import format_local_instant
from softcal.app.texts.reason_groups import reasons_by_verdict
from softcal.core.messages.reason import Reason, plain
from softcal.db.entries import StoredCalibration, UnitEntry

UNIT_HEADER = tuple("lot serial role verdict rev map predicted before after own made reason".split())
HISTORY_HEADER = ("rev", "registry", "in use", "made", "by", "lot", "verdict", "map", "predicted", "after", "remark")

VERDICTS, NO_VERDICT = ("retest", "fail", "conditional", "pass"), "without verdict"
"""Worst first. `softcal.core.unit.verdict` has them as well, but loads NumPy, which no list needs."""


def unit_row(unit: UnitEntry) -> list[object]:
    """Return one row of the table under `UNIT_HEADER`."""
    reason = "; ".join(map(str, _remarks(unit)))
    errors = [unit.predicted_rmse, unit.before_rmse, unit.after_rmse, unit.own_rmse]
    made_on = unit.made_at and format_local_instant(unit.made_at)
    return [unit.lot_id, unit.serial, unit.role, unit.verdict, unit.revision, unit.family, *errors, made_on, reason]


def first_reasons(units: Sequence[UnitEntry]) -> list[tuple[str, list[str]]]:
    """Return for each verdict its units and, each once, the most important reason of each of them."""
    lots = {unit.lot_id for unit in units}
    firsts = [
        replace(unit, serial=unit.serial if len(lots) == 1 else f"{unit.serial} of {unit.lot_id}", reasons=remarks[:1])
        for unit in units
        if (remarks := _remarks(unit))
    ]
    return reasons_by_verdict(firsts, VERDICTS) + reasons_by_verdict(
        [replace(unit, verdict=NO_VERDICT) for unit in firsts if unit.verdict is None], (NO_VERDICT,)
    )


def _remarks(unit: UnitEntry) -> tuple[Reason, ...]:
    conflict = plain("two registries put different maps into use; see history") if unit.is_conflict else None
    stale = plain("stale: made with another method than this version's; run the batch again") if unit.is_stale else None
    return tuple(filter(None, (conflict, stale, *unit.reasons)))


def unit_json(unit: UnitEntry) -> dict[str, object]:
    """Return a unit as JSON values."""
    return {name: value for name, value in vars(unit).items() if name != "state_sha256"} | {
        "reasons": [str(reason) for reason in unit.reasons],
        "made_at": unit.made_at and unit.made_at.isoformat(),
    }


def history_row(stored: StoredCalibration) -> list[object]:
    """Return one row of the table under `HISTORY_HEADER`."""
    state = stored.state
    remarks = [
        f"back to revision {stored.rolled_back_to}" if stored.rolled_back_to else "",
        "put into use by one of two registries" if stored.is_conflict else "",
        stored.reason,
    ]
    in_use, errors = (
        "yes" if stored.is_current else "",
        [state.errors[name] for name in ("predicted_rmse", "after_rmse")],
    )
    details = [format_local_instant(stored.made_at), stored.actor, stored.lot_id, state.verdict, state.fit.family]
    return [stored.revision, stored.origin, in_use, *details, *errors, "; ".join(filter(None, remarks))]


def history_json(stored: StoredCalibration, proofs: Mapping[str, str | None]) -> dict[str, object]:
    """Return a revision as JSON values, without its arrays; `proofs` are the methods that proved its recordings."""
    from softcal.core.unit.state_json import adjustments_to_json, fit_to_json

    state = stored.state
    plain = {
        name: value for name, value in vars(stored).items() if name not in ("state", "made_at", "version", "build")
    }
    return {
        **plain,
        "made_at": stored.made_at.isoformat(),
        "serial": stored.serial,
        "verdict": str(state.verdict),
        "reasons": [str(reason) for reason in state.decision.reasons],
        "network_id": state.fit.network_id,
        "recording_sha256": state.fit.recording_sha256,
        "proof_method": proofs.get(state.fit.recording_sha256),
        "family": state.fit.family,
        "map_sha256": state.map_sha256,
        "method_id": state.fit.method.id,
        **state.errors,
        "fit_s": state.fit.fit_s,
        "fit": {name: value for name, value in fit_to_json(state.fit).content.items() if name != "fitted"},
        "state": adjustments_to_json(state),
        "provenance": stored.provenance.to_json(),
    }
