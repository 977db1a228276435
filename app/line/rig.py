"""The rig as a use case: find it, test it, press a unit and write its recording, or press a whole simulated lot."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from softcal.app.bootstrap import data_folder
from softcal.app.files.lot_folder import write_lot_toml
from softcal.app.files.profile_file import read_profile
from softcal.app.files.recording_file import write_columns
from softcal.core.errors import InputError, NoReply
from softcal.core.lot import Lot, check_serial
from softcal.core.profiles import Profile, source_profile, unit_profile
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.twin.simulate import Twin
from softcal.core.twin.spread import draw_lot
from softcal.core.unit.budget import SIMULATED, Reference
from softcal.core.words.reason import Reason, several
from softcal.station.acquisition import OnProgress, record
from softcal.station.bench import SIMULATED_NAME, Bench, open_bench, open_simulated_bench
from softcal.station.clock import HostClock
from softcal.station.config import ForceConfig, ReadoutConfig, StageConfig, StationConfig, read_station_file
from softcal.station.identify import DeviceIdentity, identify
from softcal.station.link import available_ports
from softcal.station.recording import StationRecording
from softcal.station.self_test import SelfTestItem, self_test
from softcal.station.spool import Spool

SERIALS_APART = ","
"""Between the serials of several channels in the header of a spool; no serial contains it."""

LOOKED_FOR = (
    "a stage (GRBL, Zaber, Mark-10 stand), a load cell (HX711, Mark-10, Loadstar, indicator) and a sensor readout"
)


@contextmanager
def chosen_bench(
    station_file: Path | None, simulated_seed: int | None, simulated_channels: int = 1, twin: Twin | None = None
) -> Iterator[Bench]:
    """Open the simulated bench where a seed is given, else the one the station file describes.

    Args:
        simulated_channels: units under the simulated stage, one per channel.
        twin: what stands under the simulated stage; further channels hold units like it. None for a drawn lot.

    Raises:
        InputError: neither is given, or the file cannot be read.
        DeviceError: devices are missing; all of them are named.
    """
    if simulated_seed is not None:
        twins = _units_like(twin, simulated_seed, simulated_channels)
        with open_simulated_bench(twins[0], simulated_seed, beside=twins[1:]) as (bench, _):
            yield bench
    elif station_file is None:
        raise InputError(
            "which station? give --station FILE (made by `softcal station check --write FILE`) or --simulated"
        )
    else:
        with open_bench(read_station_file(station_file)) as bench:
            yield bench


def _units_like(twin: Twin | None, seed: int, count: int) -> tuple[Twin, ...]:
    rng = np.random.default_rng(seed)
    if twin is None:
        return draw_lot(rng, count)
    return (twin, *draw_lot(rng, count - 1, twin.parameters, twin.metadata, twin.effects))


def find_devices(ports: Sequence[str]) -> list[DeviceIdentity]:
    """Return what answers at these ports, or at all USB serial ports of this machine where none is given.

    Raises:
        NoReply: there is no port, or some cannot be opened; all of them are named.
    """
    candidates = list(ports) or available_ports()
    if not candidates:
        raise NoReply(f"no USB serial port on this machine; looked for {LOOKED_FOR}; plug them in, or use --simulated")
    found: list[DeviceIdentity] = []
    faults: list[Reason] = []
    for port in candidates:
        try:
            found.append(identify(port, HostClock()))
        except NoReply as error:
            faults.append(error.reason)
    if faults and ports:
        raise NoReply(several(faults))
    return found


def station_of(devices: Sequence[DeviceIdentity]) -> StationConfig:
    """Return the station that these devices make up.

    Raises:
        NoReply: stage, readout or load cell is missing, or two could be the same part; all that is missing is named.
    """
    stage = _only(devices, "stage", "the stage")
    readout = _only(devices, "readout", "the sensor readout")
    force = _only(devices, "force", "the load cell")
    if force is None and stage is not None and stage.kind == "esm" and stage.channels:
        force = stage  # The gauge on the stand, behind the same port.
    parts = (("a stage", stage), ("a sensor readout", readout), ("a load cell", force))
    missing = [name for name, device in parts if device is None]
    if stage is None or readout is None or force is None:
        unclear = "".join(f"; {device.port}: {device.description}" for device in devices if not device.role)
        looked_at = ", ".join(device.port for device in devices)
        raise NoReply(f"not found: {' and '.join(missing)}; looked at {looked_at}{unclear}")
    return StationConfig(
        StageConfig(stage.port, stage.kind),
        ReadoutConfig(readout.port, rate_Hz=round(readout.rate_Hz, 1), channels=readout.channels),
        ForceConfig(force.port, force.kind, rate_Hz=round(force.rate_Hz, 1)),
    )


def _only(devices: Sequence[DeviceIdentity], role: str, name: str) -> DeviceIdentity | None:
    """Return the one device of a role; between two nobody but a person can decide."""
    found = [device for device in devices if device.role == role]
    if len(found) > 1:
        ports = " and ".join(f"{device.port} ({device.description})" for device in found)
        raise NoReply(f"{ports} could each be {name}; name the ports you mean with --port, nothing was written")
    return found[0] if found else None


@dataclass(frozen=True)
class StationCheck:
    """What `softcal station check` found."""

    config: StationConfig
    devices: tuple[DeviceIdentity, ...]
    findings: tuple[SelfTestItem, ...]

    def as_json(self) -> dict[str, object]:
        """Return the report as JSON values."""
        return {
            "schema": "softcal.station-check/1",
            "station": self.config.name,
            "devices": [asdict(device) for device in self.devices],
            "findings": [_finding_json(finding) for finding in self.findings],
            "is_good": all(finding.is_good for finding in self.findings),
        }


def _finding_json(finding: SelfTestItem) -> dict[str, object]:
    texts = {name: str(getattr(finding, name) or "") for name in ("device", "what", "value", "cure")}
    return texts | {"is_good": finding.is_good}


def check_station(
    ports: Sequence[str], station_file: Path | None, simulated_seed: int | None, may_move: bool
) -> StationCheck:
    """Find the devices (unless a station is given), open them all and run the self-test.

    Raises:
        DeviceError: a port or a device is missing; all of them are named.
    """
    devices: list[DeviceIdentity] = []
    if ports or (station_file is None and simulated_seed is None):
        devices = find_devices(ports)
    if station_file is None and simulated_seed is None:
        with open_bench(station_of(devices)) as bench:
            return StationCheck(bench.config, tuple(devices), tuple(self_test(bench, may_move)))
    with chosen_bench(station_file, simulated_seed) as bench:
        return StationCheck(bench.config, tuple(devices), tuple(self_test(bench, may_move)))


@dataclass(frozen=True)
class WrittenRun:
    """What one run left behind: the recording and the files or registry entries that hold it."""

    recording: StationRecording
    files: tuple[Path, ...]
    seconds: float


def record_to_files(
    bench: Bench,
    serials: Sequence[str],
    out: Path,
    profile: Profile,
    with_reference: bool,
    spool_folder: Path,
    on_progress: OnProgress | None = None,
) -> WrittenRun:
    """Press once and write one file per channel, whole or not at all.

    Args:
        serials: one per channel of the readout.
        out: the file; with several channels the folder.
        spool_folder: samples go there as they come; removed again when the files are written.

    Raises:
        InputError: a serial that cannot be one, or not one per channel.
        DeviceError: the run was aborted; nothing was written.
    """
    for serial in serials:
        check_serial(serial)
    if len(serials) != bench.readout.channels or len(set(serials)) != len(serials):
        raise InputError(f"{len(set(serials))} serials for {bench.readout.channels} channels; give one per channel")
    began_s = bench.clock.now_s()
    spool_path = new_spool(spool_folder, serials[0])
    header = {"serial": serials[0], "serials": SERIALS_APART.join(serials), "profile": profile.name}
    with Spool(spool_path, header | {"station": bench.config.name}) as spool:
        recording = record(bench, serials[0], profile, with_reference, on_progress, spool)
    paths = [out] if len(serials) == 1 else [out / f"{serial}.csv" for serial in serials]
    for channel, path in enumerate(paths):
        write_columns(path, columns(recording, channel))
    if with_reference:
        is_simulated = bench.config.name == SIMULATED_NAME
        _begin_lot(paths[0], recording, SIMULATED if is_simulated else station_reference(bench.config))
    spool_path.unlink()
    return WrittenRun(recording, tuple(paths), bench.clock.now_s() - began_s)


def station_reference(config: StationConfig) -> Reference | None:
    """Return what a station compares sources with today, by the serial of its load cell; None without one."""
    if config.force is None:
        return None
    return Reference(cell=config.force.serial or "not named", used_on=datetime.now(UTC).date())


def _begin_lot(source: Path, recording: StationRecording, reference: Reference | None) -> None:
    """Write the lot.toml of a source that lies in LOT/source/, so that `softcal batch LOT` takes the folder."""
    folder = source.parent.parent
    if source.parent.name == "source" and not (folder / "lot.toml").exists():
        lot = Lot(folder.resolve().name, source.stem, recording.sample_rate_Hz, output_unit=recording.output_unit)
        write_lot_toml(folder, lot, reference)


def spool_folder(option: Path | None) -> Path:
    """Return the folder of spools: the option, else one among the user's data."""
    return option or data_folder() / "spool"


def new_spool(folder: Path, serial: str) -> Path:
    """Return the path of a new spool, named by unit and time."""
    return folder / f"{serial}-{datetime.now(UTC):%Y%m%dT%H%M%S.%f}.spool"


def run_json(run: WrittenRun) -> dict[str, object]:
    """Return what is known of a run as JSON values; NaN becomes null."""
    recording = run.recording
    alignment = {key: value if np.isfinite(value) else None for key, value in asdict(recording.alignment).items()}
    return {
        "schema": "softcal.station-run/1",
        "files": [str(path) for path in run.files],
        "profile": recording.profile,
        "samples": len(recording.t_s),
        "lost": recording.lost,
        "station_s": run.seconds,
        "contact_mm": recording.contact_mm,
        "zero_N": recording.zero_N,
        "zero_return_N": recording.zero_return_N,
        "alignment": alignment,
    }


def columns(recording: StationRecording, channel: int = 0) -> list[tuple[str, Array]]:
    """Return the columns of a lot folder's file, rounded far below what the devices resolve."""
    named = [("t_s", np.round(recording.t_s, 6)), ("output", np.round(recording.output[:, channel], 7))]
    if recording.force_N is not None:
        named.append(("reference", np.round(recording.force_N, 6)))
    return [*named, ("stage_mm", np.round(recording.stage_mm, 5))]


def profile_for(kind: str, seed: int, seconds: float | None, depth_mm: float, file: Path | None = None) -> Profile:
    """Return the profile of a file where one is given, else the source or the short unit profile."""
    if file is not None:
        return read_profile(file)
    rng = np.random.default_rng(seed)
    if kind == "source":
        return source_profile(rng, seconds or 170.0, depth_mm)
    return unit_profile(rng, seconds or 25.0, depth_mm)


@dataclass(frozen=True)
class RecordedLot:
    """A lot as the station records it: the source with its reference, units without, audits to score them."""

    source: LabelledRecording
    units: Mapping[str, OutputRecording]
    audits: Mapping[str, LabelledRecording]


@dataclass(frozen=True)
class PressTimes:
    """How long each kind of run presses, in s."""

    source_s: float = 170.0
    unit_s: float = 25.0
    audit_s: float = 25.0


def press_simulated_lot(
    twins: Sequence[Twin],
    serials: Sequence[str],
    seed: int = 0,
    times: PressTimes | None = None,
    on_run: Callable[[str], None] | None = None,
) -> RecordedLot:
    """Press every unit of a simulated lot on one simulated station, over its serial lines.

    Args:
        twins, serials: (number of units,) the units, the source first.
        seed: of mounting, noise and profiles.
        times: how long each run presses; an audit is only there to score.
        on_run: called with a sentence before each run.

    Raises:
        DeviceError: the station failed.
    """
    times, rng = times or PressTimes(), np.random.default_rng(seed)
    units: dict[str, OutputRecording] = {}
    audits: dict[str, LabelledRecording] = {}
    tell = on_run or (lambda sentence: None)
    with open_simulated_bench(twins[0], seed) as (bench, station):
        tell(f"source unit {serials[0]}: pressing with the load cell")
        source = record(bench, serials[0], source_profile(rng, times.source_s), with_reference=True)
        for twin, serial in zip(twins[1:], serials[1:], strict=True):
            station.mount(twin)
            tell(f"unit {serial}: pressing, output only")
            profile = unit_profile(rng, times.unit_s)
            units[serial] = record(bench, serial, profile, with_reference=False).output_recording()
            tell(f"unit {serial}: audit with the load cell, to score")
            audit = record(bench, serial, unit_profile(rng, times.audit_s), with_reference=True)
            audits[serial] = audit.labelled_recording()
    return RecordedLot(source.labelled_recording(), units, audits)
