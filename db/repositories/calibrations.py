"""Calibrations with their full history per serial: revisions, rollbacks and refusals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from sqlalchemy import RowMapping, bindparam, select

from softcal.core.errors import AmbiguousUnit, InputError, NoSuchNetwork, NoSuchRevision, NoSuchUnit
from softcal.core.identity import content_sha256
from softcal.core.lot import UnitKey
from softcal.core.messages.reason import Reason, to_stored
from softcal.db.entries import StoredCalibration
from softcal.db.provenance import software_now
from softcal.db.repositories import history
from softcal.db.repositories.in_use import NEWEST_FIRST, InUseTable, heads_of, names_several, newest_of_unit, rows_of
from softcal.db.repositories.lot_pages import units_with_status
from softcal.db.repositories.registry_base import damage_error, entry_from_row
from softcal.db.repositories.unit_states import FIT_SHA256, read_parts, state_of
from softcal.db.schema.arrays import put_arrays
from softcal.db.schema.column_types import canonical_json
from softcal.db.schema.database import equality_conditions
from softcal.db.schema.tables import STATE_PARTS, calibrations, fits, methods, networks, refusals

if TYPE_CHECKING:
    from softcal.core.unit.fit import Fit
    from softcal.core.unit.state import UnitState

SELECT_NETWORK = select(networks.c.id).where(networks.c.id == bindparam("network"))
SELECT_METHOD = select(methods.c.id).where(methods.c.id == bindparam("method"))
SELECT_FIT = select(fits.c.sha256).where(fits.c.lot_id == bindparam("lot"), fits.c.sha256 == bindparam("fit"))

STORED_PARTS = {
    field: select(table.c.sha256).where(table.c.lot_id == bindparam("lot"), table.c.sha256 == bindparam("part"))
    for field, table in STATE_PARTS.items()
}

ASKING = ("batch", "line")
"""Who asks for what an input gives; all others decide about what there is."""


def state_sha256(fit_sha256: str, adjustments: Mapping[str, Any]) -> str:
    """Return the content hash of a state: equal states of a unit are one revision."""
    return content_sha256({}, {"fit": fit_sha256, "state": canonical_json(adjustments)})


class CalibrationTables(InUseTable):
    """The calibrations of every unit, and which one is in use."""

    def add(
        self,
        lot_id: str,
        state: UnitState,
        actor: str | None = None,
        reason: str = "",
        *,
        input_sha256: str | None = None,
        decided_by: str = "line",
        work_sha256: str | None = None,
    ) -> int:
        """Store a state of a unit as the next revision of its serial and put it into use.

        Args:
            input_sha256: content hash of what asked for it; by default that of the revision with this fit.
            decided_by: who puts it into use. A batch and the line ask for what their input gives; what others decide
                (release, trim) stays until another input is asked for.
            work_sha256: hash of the files and settings it answers.

        Raises:
            InputError: the lot or the network is not registered.
        """
        from softcal.core.unit.state_json import adjustments_to_json

        fit = state.fit
        with self.database.writing():
            self._lot_row(lot_id)
            stored, network = self.database.cache.networks, fit.network_id
            if network not in stored:
                if self.database.row(SELECT_NETWORK, {"network": network}) is None:
                    raise NoSuchNetwork(f"network {network[:12]} is not in the registry; add it before its maps")
                stored.add(network)
            if not self._revisions(lot_id, fit.serial):
                self._add_unit(lot_id, fit.serial, "target", actor)
            content = adjustments_to_json(state)
            fit_sha256 = self._store_fit(lot_id, fit, actor)
            first = [row["input_sha256"] for row in self._revisions(lot_id, fit.serial, fit_sha256=fit_sha256)]
            requested_input = input_sha256 or next(reversed(first), fit.id)
            values: dict[str, Any] = {
                "serial": fit.serial,
                "lot_id": lot_id,
                "rolled_back_to": None,
                "fit_sha256": fit_sha256,
                "network_id": network,
                "method_id": fit.method.id,
                "family": fit.family,
                "map_sha256": state.map_sha256,
                "state_sha256": state_sha256(fit_sha256, content),
                **self._store_parts(lot_id, content, actor),
                **state.errors,
                "fit_s": fit.fit_s,
                "is_limit_stated": state.limit.is_stated,
                "verdict": str(state.verdict),
                "reasons": [to_stored(cause) for cause in state.decision.reasons],
                "input_sha256": requested_input,
                "recording_sha256": fit.recording_sha256,
            }
            statement = {"decided_by": decided_by, "work_sha256": work_sha256}
            statement["input_sha256"] = requested_input if decided_by in ASKING else None
            return self._add_revision(values, statement, "calibrate", actor, reason)

    def put_state(self, lot_id: str, state: UnitState, decided_by: str, *, actor: str | None, reason: str) -> bool:
        """Put a state of a unit into use if another state is in use; return whether it did.

        A state that was stored before comes back as its own revision.
        """
        from softcal.core.unit.state_json import adjustments_to_json

        serial = state.serial
        with self.database.writing():
            sha256 = state_sha256(self._store_fit(lot_id, state.fit, actor), adjustments_to_json(state))
            row = next(iter(self._revisions(lot_id, serial, state_sha256=sha256)), None)
            if row is None:
                self.add(lot_id, state, actor, reason, decided_by=decided_by)
                return True
            heads = heads_of(self.database, lot_id, serial)
            if [(head["revision"], head["made_by"]) for head in heads] == [(row["revision"], row["origin"])]:
                return False
            statement = {"revision": row["revision"], "made_by": row["origin"]}
            self._write_statement(lot_id, serial, statement, {"decided_by": decided_by}, actor, reason)
            return True

    def _store_parts(self, lot_id: str, adjustments: Mapping[str, Any], actor: str | None) -> dict[str, Any]:
        """Store each part of a state once, and return the columns of the revision that name them."""
        from softcal.core.unit.state_json import part_to_columns

        columns = {name: adjustments[name] for name in ("unreadable_audit", "suspect_audit")}
        columns |= {f"limit_{name}": value for name, value in adjustments["limit"].items()}
        columns["limit_rmse"] = columns.pop("limit_maximum_rmse")
        for field, table in STATE_PARTS.items():
            part = adjustments[field]
            sha256 = columns[f"{field}_sha256"] = None if part is None else content_sha256({}, part)
            if sha256 is None or (table.name, lot_id, sha256) in self.database.cache.parts:
                continue
            if self.database.row(STORED_PARTS[field], {"lot": lot_id, "part": sha256}) is None:
                values = {column.name: None for column in table.columns} | part_to_columns(part, table.c.keys())
                self._store(table, values | {"lot_id": lot_id, "sha256": sha256}, "add", actor)
            self.database.cache.parts.add((table.name, lot_id, sha256))
        return columns

    def is_stored(self, lot_id: str, fit: Fit, input_sha256: str) -> bool:
        """Whether a revision from this input rests on an equal fit: then a fit made again says nothing new."""
        with self.database.writing():
            revisions = self._revisions(lot_id, fit.serial, input_sha256=input_sha256)
            return bool(revisions) and self._store_fit(lot_id, fit, None) in {row["fit_sha256"] for row in revisions}

    def _store_fit(self, lot_id: str, fit: Fit, actor: str | None) -> str:
        """Store a fit once, with its method, and return its hash."""
        if (stored_sha256 := FIT_SHA256.get(fit)) is not None and self._has_fit(lot_id, fit.serial, stored_sha256):
            return stored_sha256
        from softcal.core.unit.state_json import fit_to_json

        stored = fit_to_json(fit)
        blob = put_arrays(self.database, stored.arrays)
        sha256 = content_sha256({}, {"content": stored.content, "blob": blob})
        FIT_SHA256[fit] = sha256
        if self._has_fit(lot_id, fit.serial, sha256):
            return sha256
        if fit.method.id not in self.database.cache.methods:
            if self.database.row(SELECT_METHOD, {"method": fit.method.id}) is None:
                self._store(methods, {"id": fit.method.id, "numbers": fit.method.to_json()}, "add", actor)
            self.database.cache.methods.add(fit.method.id)
        values = {name: getattr(fit, name) for name in ("serial", "network_id", "recording_sha256")}
        values |= {"lot_id": lot_id, "sha256": sha256, "method_id": fit.method.id}
        self._store(fits, values | {"content": stored.content, "blob_sha256": blob}, "fit", actor)
        self.database.cache.without_fit.discard((lot_id, fit.serial))
        return sha256

    def _has_fit(self, lot_id: str, serial: str, sha256: str) -> bool:
        if (lot_id, serial) in self.database.cache.without_fit:
            return False
        if self._revisions(lot_id, serial, fit_sha256=sha256):
            return True
        return self.database.row(SELECT_FIT, {"lot": lot_id, "fit": sha256}) is not None

    def _revisions(self, lot_id: str, serial: str, **equal: str) -> list[RowMapping]:
        """Return the revisions of a unit with equal columns, newest first."""
        rows = rows_of(self.database, calibrations, "", serial)
        return [row for row in rows if row["lot_id"] == lot_id and all(row[name] == one for name, one in equal.items())]

    def rollback(
        self,
        serial: str,
        to: int,
        *,
        reason: str,
        actor: str | None = None,
        lot_id: str | None = None,
        origin: str | None = None,
    ) -> int:
        """Put an older revision back into use as a new revision, and return that.

        It is also how a person decides between two registries that put different maps into use.

        Args:
            lot_id: lot of the unit; required if several lots have the serial.
            origin: registry that made the revision; needed where two made one of this number.

        Raises:
            InputError: no reason, not one such revision, or it is in use.
        """
        if not reason.strip():
            raise InputError("a rollback needs a reason; nothing was changed")
        with self.database.writing():
            lot = self.unit_key(serial, lot_id).lot_id
            old = self._revision_row(lot, serial, to, origin)
            heads = heads_of(self.database, lot, serial)
            before = None
            if heads and not names_several(self.database, heads):
                current = self._revision_row(lot, serial, heads[0]["revision"], heads[0]["made_by"])
                if old["state_sha256"] == current["state_sha256"]:
                    raise InputError(f"revision {to} of {serial} is the one in use; nothing was changed")
                before = {"revision": current["revision"], "map_sha256": current["map_sha256"]}
            values, content = {**old, "rolled_back_to": to}, {"decided_by": "rollback"}
            return self._add_revision(values, content, "rollback", actor, reason, before)

    def find(self, serial: str, input_sha256: str, *, lot_id: str | None = None) -> StoredCalibration | None:
        """Return the newest calibration of a serial from this input; None without one."""
        c = calibrations.c
        conditions = equality_conditions((c.serial, serial), (c.input_sha256, input_sha256), (c.lot_id, lot_id))
        with self.database.reading():
            row = self.database.row(select(calibrations).where(*conditions).order_by(*NEWEST_FIRST).limit(1))
            return None if row is None else self._stored(row)

    def stored_inputs(self, lot_id: str, serials: Sequence[str]) -> dict[str, frozenset[str]]:
        """Return the input hashes of the calibrations of some units of a lot, by serial."""
        c = calibrations.c
        query = select(c.serial, c.input_sha256).where(c.lot_id == lot_id, c.serial.in_(serials))
        inputs: dict[str, frozenset[str]] = {}
        for serial, sha256 in self.database.tuples(query):
            inputs[serial] = inputs.get(serial, frozenset()) | {sha256}
        return inputs

    def get(
        self, serial: str, revision: int | None = None, *, lot_id: str | None = None, origin: str | None = None
    ) -> StoredCalibration:
        """Return the calibration of a unit in use, or one revision of its history.

        Args:
            lot_id: lot of the unit; required if several lots have the serial.
            origin: registry that made the revision; needed where two made one of this number.

        Raises:
            InputError: the serial or the revision is not in the registry, it is not clear which one is meant, or two
                registries put different maps into use.
        """
        with self.database.reading():
            lot = self.unit_key(serial, lot_id).lot_id
            if revision is None:
                statement = self._in_use(lot, serial)
                if statement is None:
                    raise InputError(f"serial {serial!r} has no calibration in lot {lot!r}")
                try:
                    row = self._revision_row(lot, serial, statement["revision"], statement["made_by"])
                except NoSuchRevision as error:
                    raise damage_error(f"unit {serial} of lot {lot}: the calibration in use was not found") from error
            else:
                row = self._revision_row(lot, serial, revision, origin)
            return self._stored(row)

    def history(self, serial: str, lot_id: str | None = None) -> list[StoredCalibration]:
        """Return every revision of a serial, of one lot or of all, oldest first (`InputError`: no such serial)."""
        query = select(calibrations).where(calibrations.c.serial == serial).order_by(*NEWEST_FIRST)
        with self.database.reading():
            self._require_serial(serial)
            rows = self.database.rows(query)
            revisions = {row["revision"] for row in rows}
            newest = max(revisions, default=0)
            # A damaged index hides rows without a word.
            if len(revisions) != newest:
                raise damage_error(f"serial {serial}: a revision before {newest} was not found")
            names = {*history.origins(self.database), *(row["origin"] for row in rows)}
            self._check_hidden(calibrations, [(serial, newest + 1, name) for name in sorted(names)])
            for row in rows:
                self._check_row(calibrations, row)
            return [self._stored(row) for row in reversed(rows) if lot_id in (None, row["lot_id"])]

    def refuse(
        self,
        lot_id: str,
        serial: str,
        verdict: str,
        reasons: tuple[Reason, ...],
        *,
        actor: str | None = None,
        work_sha256: str | None = None,
    ) -> None:
        """Store that a unit got no map, with verdict (fail or retest) and reasons, unless it has these already.

        `work_sha256` is of what it answers; None: asking again may end otherwise.
        """
        with self.database.writing():
            self._lot_row(lot_id)
            self._add_unit(lot_id, serial, "target", actor)
            ((unit, _),) = units_with_status(self.database, lot_id, [serial])
            decided_work = self.decided_works(lot_id, [serial]).get(serial)
            if (unit.verdict, unit.reasons, decided_work) == (verdict, reasons, work_sha256):
                return
            made_at = self._after(newest_of_unit(self.database, lot_id, serial))
            values = {"lot_id": lot_id, "serial": serial, "made_at": made_at, "origin": self.origin}
            values |= {"actor": self._actor(actor), "verdict": verdict, "work_sha256": work_sha256}
            values["reasons"] = [to_stored(cause) for cause in reasons]
            self._store(refusals, values, "refuse", actor)

    def _add_revision(
        self,
        values: Mapping[str, Any],
        content: Mapping[str, Any],
        action: str,
        actor: str | None,
        reason: str,
        before: Mapping[str, object] | None = None,
    ) -> int:
        lot_id, serial = values["lot_id"], values["serial"]
        revisions = rows_of(self.database, calibrations, "", serial)
        times = (*(row["made_at"] for row in revisions[:1]), newest_of_unit(self.database, lot_id, serial))
        revision = max((row["revision"] for row in revisions), default=0) + 1
        made_at = self._after(max((at for at in times if at is not None), default=None))
        new = {"revision": revision, "origin": self.origin, "made_at": made_at}
        new |= {"actor": self._actor(actor), "reason": reason, **software_now()}
        self._store(calibrations, {**values, **new}, action, actor, reason, before)
        statement = {"revision": revision, "made_by": self.origin}
        self._write_statement(lot_id, serial, statement, content, actor, reason, made_at)
        return int(revision)

    def unit_key(self, serial: str, lot_id: str | None = None) -> UnitKey:
        """Return the key of a unit by its serial, with its lot if several lots have the serial.

        `NoSuchUnit`, `NoSuchLot`: unknown; `AmbiguousUnit`: several lots have the serial and no lot is given.
        """
        self._require_serial(serial)
        lots = self.lots_of(serial)
        if lot_id is None and len(lots) > 1:
            names = ", ".join(map(repr, lots))
            raise AmbiguousUnit(f"serial {serial!r} stands in the lots {names}; say which one, as --lot {lots[0]!r}")
        if lot_id is not None and lot_id not in lots:
            self._lot_row(lot_id)
            raise NoSuchUnit(f"serial {serial!r} is not in lot {lot_id!r}; it is in {', '.join(map(repr, lots))}")
        return UnitKey(lot_id or lots[0], serial)

    def _revision_row(self, lot_id: str, serial: str, revision: int, origin: str | None) -> RowMapping:
        c = calibrations.c
        conditions = equality_conditions(
            (c.lot_id, lot_id), (c.serial, serial), (c.revision, revision), (c.origin, origin)
        )
        rows = self.database.rows(select(calibrations).where(*conditions).order_by(c.origin))
        if not rows:
            by = "" if origin is None else f" of registry {origin}"
            raise NoSuchRevision(f"serial {serial!r} has no revision {revision}{by} in lot {lot_id!r}")
        if len(rows) > 1:
            names = ", ".join(f"{row['origin']} ({row['made_at']:%Y-%m-%d %H:%M:%S} UTC)" for row in rows)
            raise AmbiguousUnit(
                f"revision {revision} of serial {serial!r} was made by the registries {names}; say which origin"
            )
        self._check_row(calibrations, rows[0])
        return rows[0]

    def _stored(self, row: RowMapping) -> StoredCalibration:
        heads = heads_of(self.database, row["lot_id"], row["serial"])
        is_conflict = names_several(self.database, heads)
        heads_in_use = {(head["revision"], head["made_by"]) for head in (heads if is_conflict else heads[:1])}
        is_head = (row["revision"], row["origin"]) in heads_in_use
        flags = {"is_current": is_head and not is_conflict, "is_conflict": is_head and is_conflict}
        return entry_from_row(
            StoredCalibration, row, state=state_of(self.database, row, read_parts(self.database, [row])), **flags
        )
