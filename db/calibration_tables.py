"""Calibrations with their full history per serial: revisions, rollbacks, refusals and the rule for the one in use."""

from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import Connection, RowMapping, bindparam, func, select

from softcal.core.errors import InputError
from softcal.core.identity import Settings
from softcal.core.reason import Reason, to_kept
from softcal.core.unit.calibration import CalibrationRecord
from softcal.db.arrays import get_arrays, put_arrays
from softcal.db.entries import MadeCalibration, StoredCalibration
from softcal.db.lot_tables import unit_entries
from softcal.db.registry_base import RegistryBase
from softcal.db.tables import calibrations, networks, refusals

PLAIN_FIELDS = (
    "serial",
    "network_id",
    "family",
    "map_sha256",
    "predicted_rmse",
    "before_rmse",
    "after_rmse",
    "own_rmse",
    "fit_s",
    "verdict",
    "input_sha256",
    "recording_sha256",
)
"""Fields of `CalibrationRecord` that are columns as they are."""

NEWEST_FIRST = (calibrations.c.made_at.desc(), calibrations.c.revision.desc(), calibrations.c.origin.desc())
"""The rule for the calibration in use: the newest. No registry writes a revision older than the one it follows."""

KNOWN_NETWORK = select(networks.c.id).where(networks.c.id == bindparam("network"))
LAST_REVISION = select(
    func.max(calibrations.c.revision).label("revision"), func.max(calibrations.c.made_at).label("made_at")
).where(calibrations.c.serial == bindparam("unit"))


class CalibrationTables(RegistryBase):
    """The part of the registry that knows calibrations."""

    def add_calibration(
        self, lot_id: str, record: CalibrationRecord, actor: str | None = None, reason: str = ""
    ) -> int:
        """Store a calibration as the next revision of its serial and return the revision.

        Raises:
            InputError: the lot or the network is not registered.
        """
        with self.database.writing() as connection:
            self._lot_row(connection, lot_id)
            if connection.execute(KNOWN_NETWORK, {"network": record.network_id}).first() is None:
                raise InputError(f"network {record.network_id[:12]} is not in the registry; add it before its maps")
            self._add_unit(connection, lot_id, record.serial, "target", actor)
            values = {field: getattr(record, field) for field in PLAIN_FIELDS} | {
                "lot_id": lot_id,
                "settings": dict(record.settings),
                "reasons": [to_kept(why) for why in record.reasons],
                "evidence": dict(record.evidence),
                "blob_sha256": put_arrays(connection, record.arrays),
                "rolled_back_to": None,
            }
            return self._add_revision(connection, values, "calibrate", actor, reason)

    def rollback(self, serial: str, to: int, *, reason: str, actor: str | None = None) -> int:
        """Bring an older revision back into use, as a new revision that repeats it; return the new one.

        Raises:
            InputError: no reason, no such serial or revision, or it is the one in use.
        """
        if not reason.strip():
            raise InputError("a rollback needs a reason; nothing was changed")
        with self.database.writing() as connection:
            old = self._calibration_row(connection, serial, to)
            newest = self._calibration_row(connection, serial, None)
            if (old["map_sha256"], old["blob_sha256"]) == (newest["map_sha256"], newest["blob_sha256"]):
                raise InputError(f"revision {to} of {serial} is the one in use; nothing was changed")
            before = {"revision": newest["revision"], "map_sha256": newest["map_sha256"]}
            return self._add_revision(connection, {**old, "rolled_back_to": to}, "rollback", actor, reason, before)

    def find_calibration(
        self, serial: str, input_sha256: str, *, lot_id: str | None = None
    ) -> StoredCalibration | None:
        """Return the newest calibration of a serial made from this input, or None: the work is still to be done."""
        c = calibrations.c
        query = select(calibrations).where(c.serial == serial, c.input_sha256 == input_sha256)
        query = query if lot_id is None else query.where(c.lot_id == lot_id)
        with self.database.reading() as connection:
            row = connection.execute(query.order_by(*NEWEST_FIRST).limit(1)).mappings().first()
            return None if row is None else self._stored(connection, row)

    def known_inputs(self, lot_id: str, serials: Sequence[str]) -> dict[str, frozenset[str]]:
        """Return the input hashes from which units of a lot have calibrations, by serial; few serials at a time."""
        c = calibrations.c
        query = select(c.serial, c.input_sha256).where(c.lot_id == lot_id, c.serial.in_(serials))
        known: dict[str, set[str]] = {}
        with self.database.reading() as connection:
            for serial, sha256 in connection.execute(query):
                known.setdefault(serial, set()).add(sha256)
        return {serial: frozenset(hashes) for serial, hashes in known.items()}

    def made_calibrations(self, lot_id: str) -> dict[tuple[str, int], MadeCalibration]:
        """Return what is known of every calibration this registry made in a lot, without its arrays, by serial and
        revision."""
        c = calibrations.c
        columns = [c[field] for field in PLAIN_FIELDS] + [c.revision, c.settings, c.reasons, c.evidence]
        query = select(*columns).where(c.lot_id == lot_id, c.origin == self.origin)
        with self.database.reading() as connection:
            rows = connection.execute(query).mappings()
            made = [MadeCalibration.of(_record(row, {}, row["settings"]), row["revision"]) for row in rows]
        return {(entry.serial, entry.revision): entry for entry in made}

    def calibration(self, serial: str, revision: int | None = None) -> StoredCalibration:
        """Return the calibration of a serial in use, or one revision of its history.

        Raises:
            InputError: the serial or the revision is not in the registry.
        """
        with self.database.reading() as connection:
            return self._stored(connection, self._calibration_row(connection, serial, revision))

    def history(self, serial: str) -> list[StoredCalibration]:
        """Return every revision of a serial, oldest first; a unit that got no map yet has none.

        Raises:
            InputError: the serial is not in the registry.
        """
        query = select(calibrations).where(calibrations.c.serial == serial).order_by(*NEWEST_FIRST)
        with self.database.reading() as connection:
            self._known_serial(connection, serial)
            rows = connection.execute(query).mappings().all()
            return [self._stored(connection, row) for row in reversed(rows)]

    def add_refusal(
        self, lot_id: str, serial: str, verdict: str, reasons: tuple[Reason, ...], *, actor: str | None = None
    ) -> None:
        """Register that a unit got no map (`UnitRefused`, unreadable recording); its verdict is fail or retest.

        The verdict and reasons the unit has already are not written again.
        """
        with self.database.writing() as connection:
            self._lot_row(connection, lot_id)
            self._add_unit(connection, lot_id, serial, "target", actor)
            (unit,) = unit_entries(connection, lot_id, serial)
            if (unit.verdict, unit.reasons) == (verdict, reasons):
                return
            values = {
                "lot_id": lot_id,
                "serial": serial,
                "made_at": self._after(unit.made_at),
                "origin": self.origin,
                "actor": self._actor(actor),
                "verdict": verdict,
                "reasons": [to_kept(why) for why in reasons],
            }
            self._store(connection, refusals, values, "refuse", actor)

    def _add_revision(
        self,
        connection: Connection,
        values: Mapping[str, Any],
        action: str,
        actor: str | None,
        reason: str,
        before: Mapping[str, object] | None = None,
    ) -> int:
        newest = connection.execute(LAST_REVISION, {"unit": values["serial"]}).one()
        revision = (newest.revision or 0) + 1
        new = {
            "revision": revision,
            "origin": self.origin,
            "made_at": self._after(newest.made_at),
            "actor": self._actor(actor),
            "reason": reason,
        }
        self._store(connection, calibrations, {**values, **new}, action, actor, reason, before)
        return int(revision)

    def _calibration_row(self, connection: Connection, serial: str, revision: int | None) -> RowMapping:
        query = select(calibrations).where(calibrations.c.serial == serial)
        query = query if revision is None else query.where(calibrations.c.revision == revision)
        row = connection.execute(query.order_by(*NEWEST_FIRST).limit(1)).mappings().first()
        if row is None:
            self._known_serial(connection, serial)
            what = "no calibration" if revision is None else f"no revision {revision}"
            raise InputError(f"serial {serial!r} has {what} in the registry")
        return row

    def _stored(self, connection: Connection, row: RowMapping) -> StoredCalibration:
        c = calibrations.c
        same_serial = select(c.revision, c.origin).where(c.serial == row["serial"]).order_by(*NEWEST_FIRST)
        known = connection.execute(same_serial).all()
        revisions = [revision for revision, _ in known]
        fields = ("lot_id", "revision", "made_at", "actor", "reason", "rolled_back_to", "origin")
        return StoredCalibration(
            record=_record(row, get_arrays(connection, row["blob_sha256"]), row["settings"]),
            **{field: row[field] for field in fields},
            is_current=tuple(known[0]) == (row["revision"], row["origin"]),
            is_conflict=revisions.count(row["revision"]) > 1,
        )


def _record(row: RowMapping, arrays: Mapping[str, Any], settings: Settings) -> CalibrationRecord:
    return CalibrationRecord(
        **{field: row[field] for field in PLAIN_FIELDS},
        arrays=arrays,
        settings=settings,
        reasons=tuple(map(Reason.of, row["reasons"])),
        evidence=row["evidence"],
    )
