"""Recordings, addressed by the hash of their content."""

from __future__ import annotations

from collections.abc import Collection
from datetime import datetime, timedelta
from typing import TYPE_CHECKING, cast

from sqlalchemy import RowMapping, and_, bindparam, or_, select

from softcal.core.errors import InputError, NoSuchRecording
from softcal.db.entries import INSTANTS_AGREE, RecordingEntry
from softcal.db.repositories.registry_base import RegistryBase, entry_from_row
from softcal.db.schema.arrays import get_arrays, put_arrays
from softcal.db.schema.database import equality_conditions, parts
from softcal.db.schema.tables import recordings

if TYPE_CHECKING:
    from softcal.core.recording import Array, LabelledRecording, OutputRecording

    Recording = OutputRecording | LabelledRecording

SELECT_RECORDING = select(recordings).where(
    recordings.c.sha256 == bindparam("sha"),
    recordings.c.lot_id == bindparam("lot"),
    recordings.c.kind == bindparam("of_kind"),
)
KINDS = ("source", "unit", "audit")


def _check_instant(stored: RecordingEntry, measured_at: datetime | None) -> None:
    """Refuse another time of measurement for a stored recording, as draws depend on it."""
    within = timedelta(0) if stored.measured_at is None else INSTANTS_AGREE
    if measured_at is not None and abs(measured_at - stored.observed_at) > within:
        basis = "first seen" if stored.measured_at is None else "measured"
        raise InputError(
            f"{stored.serial}: lot {stored.lot_id!r} has this very recording, {basis} "
            f"{stored.observed_at:%Y-%m-%d %H:%M:%S} UTC; that it was measured {measured_at:%Y-%m-%d %H:%M:%S} UTC "
            "comes too late: leave that out, or press the unit again"
        )


class RecordingTables(RegistryBase):
    """Recordings, by the hash of their content."""

    def add(
        self,
        lot_id: str,
        recording: Recording,
        kind: str,
        *,
        actor: str | None = None,
        measured_at: datetime | None = None,
        proof_method: str | None = None,
    ) -> str:
        """Store a recording of kind source, unit or audit once, with its unit; return its content hash.

        `measured_at` is the time of measurement, UTC, by its stamps or as stated, or None.
        `proof_method` is the identity of the method by which a station proved it, None for a file that was brought.
        Only a `unit` recording has no reference. `InputError`: the lot is not registered, or it has the recording with
        another instant.
        """
        if kind not in KINDS or (kind == "unit") == ("reference" in recording.arrays()):
            raise ValueError(f"{type(recording).__name__} of kind {kind!r}; only `unit` recordings have no reference")
        with self.database.writing():
            self._lot_row(lot_id)
            self._add_unit(lot_id, recording.serial, "source" if kind == "source" else "target", actor)
            sha256 = recording.sha256
            is_first = (recordings.name, lot_id, recording.serial) in self.database.cache.rows
            key = {"sha": sha256, "lot": lot_id, "of_kind": kind}
            stored = None if is_first else self.database.row(SELECT_RECORDING, key)
            if stored is not None:
                _check_instant(entry_from_row(RecordingEntry, stored), measured_at)
            else:
                blob = put_arrays(self.database, recording.arrays())
                fields = {"sha256": sha256, "lot_id": lot_id, "kind": kind, "samples": len(recording)}
                fields["output_sha256"] = recording.output_sha256
                values = fields | recording.settings() | {"blob_sha256": blob, "added_at": self.settings.clock()}
                optional = {"reference_unit": None, "measured_at": measured_at, "proof_method": proof_method}
                self._store(recordings, optional | values, "add", actor)
            return sha256

    def get(self, sha256: str) -> Recording:
        """Return a recording, labelled if it has a reference; raise `InputError` for an unknown one."""
        query = select(recordings).where(recordings.c.sha256 == sha256).limit(1)
        with self.database.reading():
            row = self.database.row(query)
            if row is None:
                raise NoSuchRecording(f"recording {sha256[:12]} is not in the registry")
            self._check_row(recordings, row)
            arrays = cast("dict[str, Array]", get_arrays(self.database, row["blob_sha256"]))
            # Whoever lists units reads none.
            from softcal.core.recording import LabelledRecording, MaskedSamples, OutputRecording

            masked = MaskedSamples.from_arrays(arrays)
            signals = (row["sample_rate_Hz"], row["output_unit"], arrays.get("stage_mm"), masked)
            unlabelled = OutputRecording(row["serial"], arrays["t_s"], arrays["output"], *signals)
            if "reference" not in arrays:
                return unlabelled
            return LabelledRecording(unlabelled, arrays["reference"], row["reference_unit"])

    def proof_methods(self, lot_id: str, serial: str) -> dict[str, str | None]:
        """Return by which method a station proved each recording of a unit; None for a file that was brought."""
        return {entry.sha256: entry.proof_method for entry in self.of_lot(lot_id, serial)}

    def shared_outputs(self, lot_id: str | None = None) -> list[str]:
        """Return outputs of a lot, or of all lots, that also occur under another serial or kind of recording."""
        other = recordings.alias("other")
        first = recordings.c
        is_golden = [
            and_(one.kind == "source", two.kind == "audit") for one, two in ((first, other.c), (other.c, first))
        ]
        query = select(first.output_sha256).distinct().join(other, first.output_sha256 == other.c.output_sha256)
        query = query.where(
            or_(first.serial != other.c.serial, *is_golden), *equality_conditions((first.lot_id, lot_id))
        )
        return self.database.values(query)

    def same_outputs(self, output_sha256s: Collection[str]) -> list[RecordingEntry]:
        """Return the metadata of the recordings of all lots that have one of these outputs."""
        rows: list[RowMapping] = []
        for some in parts(sorted(output_sha256s)):
            query = select(recordings).where(recordings.c.output_sha256.in_(some))
            rows += self.database.rows(query.order_by(recordings.c.added_at, recordings.c.sha256))
        return [entry_from_row(RecordingEntry, row) for row in rows]

    def of_lot(self, lot_id: str, serial: str | None = None, kind: str | None = None) -> list[RecordingEntry]:
        """Return the metadata of a lot's recordings, oldest first, without samples."""
        c = recordings.c
        query = select(recordings).where(*equality_conditions((c.lot_id, lot_id), (c.serial, serial), (c.kind, kind)))
        rows = self.database.rows(query.order_by(c.added_at, c.sha256))
        return [entry_from_row(RecordingEntry, row) for row in rows]
