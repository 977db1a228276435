"""Certificates of load cells and checks with golden units, which open the gate of a station."""

from dataclasses import fields
from datetime import date, datetime

from sqlalchemy import RowMapping, select

from softcal.core.errors import InputError
from softcal.core.messages.reason import to_stored
from softcal.db.entries import CellCertificate, GoldenRun
from softcal.db.repositories.history import row_key
from softcal.db.repositories.registry_base import RegistryBase, entry_from_row
from softcal.db.schema.arrays import get_bytes, put_bytes
from softcal.db.schema.column_types import canonical_json
from softcal.db.schema.database import Database, equality_conditions, parts
from softcal.db.schema.tables import audit, certificates, golden_runs


class StationTables(RegistryBase):
    """Certificates of load cells and runs of golden units."""

    def add_certificate(self, certificate: CellCertificate, *, actor: str | None = None) -> None:
        """Store a load cell's certificate; the same again changes nothing.

        `InputError`: another certificate of this cell begins on the same day.
        """
        day = (certificates.c.cell_serial == certificate.cell_serial, certificates.c.issued_on == certificate.issued_on)
        with self.database.writing():
            stored = self.database.row(select(certificates).where(*day))
            if stored is not None:
                if _certificate(self.database, stored) != certificate:
                    raise InputError(
                        f"load cell {certificate.cell_serial} has certificate {stored['number']} of the same day; "
                        "nothing was changed"
                    )
                return
            values = {f.name: getattr(certificate, f.name) for f in fields(certificate) if f.name != "document"}
            document = certificate.document
            values["blob_sha256"] = None if document is None else put_bytes(self.database, "document", document)
            values |= {"origin": self.origin, "added_at": self.settings.clock()}
            self._store(certificates, values, "add", actor)

    def certificates(self, cell_serial: str | None = None) -> list[CellCertificate]:
        """Return the certificates of one load cell or of all, oldest first per cell."""
        c = certificates.c
        query = (
            select(certificates)
            .where(*equality_conditions((c.cell_serial, cell_serial)))
            .order_by(c.cell_serial, c.issued_on)
        )
        with self.database.reading():
            return [_certificate(self.database, row) for row in self.database.rows(query)]

    def certificate(self, cell_serial: str, on: date) -> CellCertificate | None:
        """Return the newest valid certificate of a cell on a day; None without one."""
        return next((entry for entry in reversed(self.certificates(cell_serial)) if entry.is_valid(on)), None)

    def add_golden_run(self, run: GoldenRun) -> None:
        """Store a check with a golden unit."""
        values = {f.name: getattr(run, f.name) for f in fields(run)}
        values |= {"reasons": [to_stored(cause) for cause in run.reasons], "actor": self._actor(run.actor)}
        values["origin"] = self.origin
        with self.database.writing():
            self._store(golden_runs, values, "golden_run", run.actor)

    def golden_runs(
        self,
        station: str | None = None,
        serial: str | None = None,
        since: datetime | None = None,
        *,
        lot_id: str | None = None,
    ) -> list[GoldenRun]:
        """Return checks with golden units, oldest first, of one station, lot or serial, or all."""
        c = golden_runs.c
        query = select(golden_runs).where(
            *equality_conditions((c.station, station), (c.serial, serial), (c.lot_id, lot_id))
        )
        query = query if since is None else query.where(c.made_at >= since)
        rows = self.database.rows(query.order_by(c.made_at, c.station, c.lot_id, c.serial))
        return [entry_from_row(GoldenRun, row, reasons=tuple(row["reasons"])) for row in rows]

    def stored_checks(self, station: str, since: datetime | None = None) -> dict[str, list[GoldenRun]]:
        """Return the checks of a station by the registry that stored them, in the order of its chain.

        Args:
            since: of those stamped then or later.
        """
        c, stored = golden_runs.c, list[RowMapping]()
        query = select(golden_runs).where(c.station == station)
        with self.database.reading():
            candidates = self.database.rows(query if since is None else query.where(c.made_at >= since))
            rows = {canonical_json(row_key(golden_runs, dict(row))): row for row in candidates}
            for part in parts(list(rows)):
                audit_query = select(audit).where(audit.c.entity == golden_runs.name, audit.c.key.in_(part))
                stored += self.database.rows(audit_query)
        checks: dict[str, list[GoldenRun]] = {}
        for entry in sorted(stored, key=lambda entry: entry["seq"]):
            row = rows[entry["key"]]
            if entry["origin"] == row["origin"]:
                run = entry_from_row(GoldenRun, row, reasons=tuple(row["reasons"]))
                checks.setdefault(row["origin"], []).append(run)
        return checks


def _certificate(database: Database, row: RowMapping) -> CellCertificate:
    blob = row["blob_sha256"]
    return entry_from_row(CellCertificate, row, document=None if blob is None else get_bytes(database, blob))
