"""Recordings of the registry that occur under more than one serial."""

from collections.abc import Collection, Iterable

from softcal.core.messages.reason import Reason
from softcal.core.quality.duplicate_recordings import RecordedOutput, same_recordings
from softcal.db.registry import Registry


def same_recordings_with(registry: Registry, recordings: Iterable[RecordedOutput]) -> tuple[Reason, ...]:
    """Return the remarks on recordings, compared with one another and with all that the registry has."""
    new = list(recordings)
    return same_recordings([*new, *_stored(registry, {one.output_sha256 for one in new})])


def same_recordings_of(registry: Registry, lot_id: str | None = None) -> tuple[Reason, ...]:
    """Return the remarks on the recordings of a lot, or of all lots."""
    return same_recordings(_stored(registry, registry.recordings.shared_outputs(lot_id)))


def _stored(registry: Registry, outputs: Collection[str]) -> list[RecordedOutput]:
    entries = registry.recordings.same_outputs(outputs)
    return [RecordedOutput(one.serial, one.lot_id, one.output_sha256, one.kind) for one in entries]
