"""A calibrated unit of the registry, and the values that exports derive from it."""

from dataclasses import dataclass, field, replace
from datetime import date
from functools import cached_property
from pathlib import Path

from softcal.app.export.laboratory import Laboratory, read_laboratory, registry_laboratory
from softcal.app.export.signature import SigningKey
from softcal.app.registry.lot_recordings import source_recording, source_sha256, unlabelled
from softcal.app.registry.unit_status import find_unit_status
from softcal.core.errors import InputError, NotReleased
from softcal.core.export.blob import NetworkFile
from softcal.core.export.compile_map import InputScale
from softcal.core.export.device import DeviceOptions, DeviceRecord, DeviceUnit, build_network_file, build_unit_file
from softcal.core.lot import Lot, escape_serial
from softcal.core.maps.config import AnchorConfig
from softcal.core.messages.reason import Reason, to_line
from softcal.core.network.network import Network
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.estimate import estimate
from softcal.core.unit.state import UnitState
from softcal.core.unit.trim import as_trimmed
from softcal.core.unit.verdict import Release, Verdict
from softcal.db.entries import RecordingEntry, StoredCalibration, UnitResult
from softcal.db.provenance import Provenance
from softcal.db.registry import Registry


@dataclass(frozen=True)
class ExportOptions:
    """Choices of one export.

    Args:
        adc_bits, adc_full_scale: the device's converter: codes are left-aligned to 16 bits, full scale in the output
            unit; None covers the unit's output with a round full scale.
        device: limits of the device form.
        unit_address, network_address: where `hex` places the files.
        release: which verdicts release device files.
        failed_too: write device files of every unit, for the laboratory.
        revision: an older calibration; None is the one in use.
        lot_id: lot of the units; required if several lots have a serial.
        signing_key: opened key that signs the manifest and every certificate.
        laboratory: TOML with laboratory, customer, person and load cell; None: the data of the registry.
        issued_on: of certificates; None: as the laboratory file says, else today.
    """

    adc_bits: int | None = None
    adc_full_scale: float | None = None
    device: DeviceOptions = DeviceOptions()
    unit_address: int = 0x3FF00
    network_address: int = 0x38000
    release: Release = Release.PASS
    failed_too: bool = False
    revision: int | None = None
    lot_id: str | None = None
    signing_key: SigningKey | None = None
    laboratory: Path | None = None
    issued_on: date | None = None

    def releases(self, verdict: str) -> bool:
        """Whether device files of a unit with this verdict are written."""
        return self.failed_too or self.release.releases(verdict)

    @property
    def scaled_device(self) -> DeviceOptions:
        """Device options with the converter's scale, where one is given."""
        if self.adc_bits is None and self.adc_full_scale is None:
            return self.device
        if self.adc_bits is None or self.adc_full_scale is None:
            raise InputError("a converter needs both its bits and its full scale; give both or neither")
        if not 1 <= self.adc_bits <= 16 or not 0 < self.adc_full_scale < float("inf"):
            raise InputError(
                f"a converter of {self.adc_bits} bits over {self.adc_full_scale}: 1 ... 16 bits and a positive full "
                "scale were expected"
            )
        return replace(self.device, scale=InputScale.from_converter(self.adc_bits, self.adc_full_scale))


@dataclass(frozen=True, eq=False)
class SharedNetwork:
    """Network of a lot with its source, registered on `source_since` (UTC day); its device file is built once."""

    network: Network
    source: LabelledRecording
    source_sha256: str
    source_since: date | None
    anchors: AnchorConfig

    @cached_property
    def file(self) -> NetworkFile:
        return build_network_file(self.network, self.source, self.anchors)


@dataclass(frozen=True, eq=False)
class CalibratedUnit:
    """A unit of the registry; the values that exports derive are computed on first use.

    Args:
        stored: the calibration to export: the one in use, or one asked for.
        in_registry_since: UTC day its recording came into the registry.
        proof_method: identity of the method by which a station proved it; None for a file that was brought.
        status: present status of the unit, whichever its calibration.
        laboratory: what its certificates say that no recording knows.
    """

    stored: StoredCalibration
    lot: Lot
    shared: SharedNetwork
    recording: OutputRecording
    in_registry_since: date
    proof_method: str | None
    options: ExportOptions
    status: UnitResult
    laboratory: Laboratory

    @property
    def serial(self) -> str:
        return self.stored.serial

    @property
    def escaped_serial(self) -> str:
        """Serial in ASCII, as in file names."""
        return escape_serial(self.serial)

    @property
    def state(self) -> UnitState:
        return self.stored.state

    @property
    def network(self) -> Network:
        return self.shared.network

    @property
    def provenance(self) -> Provenance:
        """Provenance of the exported revision, equal in each of its files."""
        stored_provenance = self.stored.provenance
        inputs = {**stored_provenance.inputs, "source recording": self.shared.source_sha256}
        if self.proof_method is not None:
            inputs["method that proved the unit's recording"] = self.proof_method
        return replace(stored_provenance, inputs=inputs)

    @cached_property
    def record(self) -> DeviceRecord:
        """Input of the device form."""
        estimates = estimate(self.network, self.state, self.recording)
        rows = self.recording.window_rows
        return DeviceRecord(
            serial=self.serial,
            revision=self.stored.revision,
            verdict=str(self.state.verdict),
            time_s=int(self.stored.made_at.timestamp()),
            unit_map=self.state.unit_map,
            recording=self.recording,
            lower=estimates.lower[rows],
            upper=estimates.upper[rows],
            predicted_rmse=self.state.predicted_rmse,
        )

    @property
    def verdict(self) -> str:
        """Verdict of the requested revision, else of the unit's present state."""
        return str(self.state.verdict) if self.options.revision is not None else str(self.status.verdict)

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """Reasons of the verdict, most important first."""
        return self.state.decision.reasons if self.options.revision is not None else self.status.reasons

    def check_not_withdrawn(self) -> None:
        """Raise `NotReleased` where the unit's newest result is no calibration.

        Who names a revision asks for that one, whatever came after it.
        """
        now = self.status
        if now.calibration is None and self.options.revision is None:
            raise NotReleased(
                f"unit {self.serial} of lot {self.lot.id} is {now.verdict}: {to_line(now.reasons)}; no file of the map "
                "it had before is given out"
            )

    def check_usable(self) -> None:
        """Raise `NotReleased` where this unit's verdict forbids files that give numbers."""
        decision, current = self.state.decision, self.status.calibration
        measured = None if current is None else current.state.decision.measured
        if current is not None and measured is not None and measured.verdict is Verdict.FAIL:
            # What was measured since stands, whichever revision is named.
            decision = current.state.decision
        if not self.options.releases(decision.verdict):
            reason, is_conditional = decision.reasons[0], decision.verdict is Verdict.CONDITIONAL
            raise NotReleased(
                f"unit {self.serial} has the verdict {decision.verdict} ({reason}); "
                "its device files are not written unless "
                + ("conditional units are released" if is_conditional else "those of failed units are asked for")
            )

    @cached_property
    def device_unit(self) -> DeviceUnit:
        """Device file of the unit with its cost; raises `NotReleased` without one."""
        self.check_usable()
        return build_unit_file(self.record, self.network, self.shared.file, self.options.scaled_device)


@dataclass
class UnitLoader:
    """Reads units one by one; units of one network share the network."""

    registry: Registry
    options: ExportOptions
    _networks: dict[tuple[str, AnchorConfig], SharedNetwork] = field(default_factory=dict)

    def load(self, serial: str) -> CalibratedUnit:
        """Return one unit; raise `InputError` for a unit outside the registry."""
        stored = self.registry.calibrations.get(serial, self.options.revision, lot_id=self.options.lot_id)
        fit = stored.state.fit
        recording = unlabelled(self.registry.recordings.get(fit.recording_sha256))
        if stored.state.trim_in_force is not None:
            # As the unit would give it since its trim.
            recording = as_trimmed(recording, stored.state.fitted.unit_map, stored.state.unit_map)
        lot = self.registry.lots.get(stored.lot_id)
        entry = self._entry(stored.lot_id, fit.recording_sha256)
        since, proof = (entry.added_at.date(), entry.proof_method) if entry else (stored.made_at.date(), None)
        network_id, anchors = fit.network_id, fit.method.map.anchors
        if (network_id, anchors) not in self._networks:
            sha256, source = source_sha256(self.registry, network_id), source_recording(self.registry, network_id)
            first = self._entry(self.registry.networks.entry(network_id).lot_id, sha256)
            source_since = None if first is None else first.added_at.date()
            network = self.registry.networks.get(network_id)
            self._networks[network_id, anchors] = SharedNetwork(network, source, sha256, source_since, anchors)
        shared, status = self._networks[network_id, anchors], find_unit_status(self.registry, stored)
        return CalibratedUnit(stored, lot, shared, recording, since, proof, self.options, status, self._laboratory)

    @cached_property
    def _laboratory(self) -> Laboratory:
        """Return the laboratory data of certificates; raise `InputError` for an unusable file."""
        path = self.options.laboratory
        return registry_laboratory(self.registry) if path is None else read_laboratory(path)

    def _entry(self, lot_id: str, sha256: str) -> RecordingEntry | None:
        """Return the metadata of a recording of a lot."""
        return next((entry for entry in self.registry.recordings.of_lot(lot_id) if entry.sha256 == sha256), None)
