"""Recordings of a lot in the registry: sources of networks, and audits."""

from softcal.app.registry.golden import find_golden_runs
from softcal.core.errors import InputError
from softcal.core.lot import Lot
from softcal.core.messages.reason import reason
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.audit import measure
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import SourceModel, make_source_model
from softcal.core.unit.state import UnitState
from softcal.db.entries import RecordingEntry
from softcal.db.registry import Registry


def source_sha256(registry: Registry, network_id: str) -> str:
    """Return the content hash of the recording a network was trained on."""
    return str(registry.networks.entry(network_id).training["source_recording_sha256"])


def source_recording(registry: Registry, network_id: str) -> LabelledRecording:
    """Return the labelled recording a network was trained on.

    Raises:
        InputError: the network is not in the registry, or its source recording has no reference.
    """
    source = registry.recordings.get(source_sha256(registry, network_id))
    if not isinstance(source, LabelledRecording):
        raise InputError(reason("run.bare_network", network=network_id[:12]))
    return source


def source_of_lot(registry: Registry, lot: Lot) -> LabelledRecording | None:
    """Return the newest recording of a lot's source with its reference, or None."""
    entries = [one for one in registry.recordings.of_lot(lot.id, lot.source) if one.kind == "source"]
    recording = registry.recordings.get(entries[-1].sha256) if entries else None
    return recording if isinstance(recording, LabelledRecording) else None


def source_model(registry: Registry, network_id: str, method: Method) -> SourceModel:
    """Return the source of a network in the form for comparison with units; build it once for all units."""
    return make_source_model(source_recording(registry, network_id), registry.networks.get(network_id), method=method)


def unlabelled(recording: OutputRecording | LabelledRecording) -> OutputRecording:
    """Return the part of a recording that a fit may use."""
    return recording.unlabelled if isinstance(recording, LabelledRecording) else recording


def target_serials(registry: Registry, lot_id: str) -> list[str]:
    """Return the serials of a lot's target units."""
    return registry.lots.serials(lot_id, "target")


def newest_audits(registry: Registry, lot_id: str, serial: str | None = None) -> dict[str, RecordingEntry]:
    """Return the newest audit of each unit of a lot, or of one of them, by serial.

    A golden unit's labelled runs check the station and its day; they are no audits of the lot. Of a run that does not
    say which recording it is, all of its unit's are. Neither is what gave the loads of a sitting.
    """
    runs = registry.stations.golden_runs(lot_id=lot_id)
    checks = {run.recording_sha256 for run in runs}
    units = {run.serial for run in runs if run.recording_sha256 is None} | {registry.lots.get(lot_id).source}
    entries = registry.recordings.of_lot(lot_id, serial, "audit")
    golden_runs = find_golden_runs(registry, lot_id, {one.serial for one in entries})
    checks |= {golden for _, golden in golden_runs.values()}
    return {one.serial: one for one in entries if one.serial not in units and one.sha256 not in checks}


def measure_unit(registry: Registry, state: UnitState, audit: LabelledRecording) -> UnitState:
    """Return the state of a unit with an audit of its map in force."""
    recording = unlabelled(registry.recordings.get(state.fit.recording_sha256))
    return measure(registry.networks.get(state.fit.network_id), state, audit, recording)


def audit_of(registry: Registry, entry: RecordingEntry | None) -> LabelledRecording | None:
    """Return an audit, or None."""
    recording = None if entry is None else registry.recordings.get(entry.sha256)
    return recording if isinstance(recording, LabelledRecording) else None
