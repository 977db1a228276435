"""The source behind a shared network: the one place that puts its recording, network and model together."""

from softcal.core.errors import InputError
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import SourceModel, make_source_model
from softcal.core.words.reason import reason
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


def source_model(registry: Registry, network_id: str, method: Method) -> SourceModel:
    """Return the source of a network as the units of its lot are compared with it; make it once for all of them."""
    return make_source_model(source_recording(registry, network_id), registry.networks.get(network_id), method=method)


def unlabelled(recording: OutputRecording | LabelledRecording) -> OutputRecording:
    """Return what a fit may see of a recording."""
    return recording.unlabelled if isinstance(recording, LabelledRecording) else recording
