"""The rig: find devices, test them, press a unit and write its recording."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from softcal.app.bootstrap import data_folder
from softcal.app.files.lot_folder import FOLDER_OF
from softcal.app.files.lot_toml import read_lot_toml, update_reference, write_lot_toml
from softcal.app.files.profile_file import read_profile
from softcal.app.files.recording_file import write_columns
from softcal.core.errors import InputError, NoReply
from softcal.core.lot import Lot, check_serial
from softcal.core.messages.reason import Reason, reason, several
from softcal.core.profiles import Profile, source_profile, unit_profile
from softcal.core.recording import Array
from softcal.core.unit.budget import SIMULATED, Reference
from softcal.station.bench.bench import SIMULATED_NAME, Bench, open_bench, open_simulated_bench
from softcal.station.bench.station_file import read_station_file
from softcal.station.clock import HostClock
from softcal.station.devices.config import ForceConfig, ReadoutConfig, StageConfig, StationConfig
from softcal.station.record.method import METHOD
from softcal.station.record.recording import StationRecording
from softcal.station.record.response import check_error
from softcal.station.record.spool import Spool
from softcal.station.tasks.acquisition import OnProgress, record
from softcal.station.tasks.identify import DeviceIdentity, identify
from softcal.station.tasks.self_test import SelfTestItem, self_test
from softcal.station.wire.link import available_ports

if TYPE_CHECKING:
    from softcal.core.twin.simulate import Twin

SERIALS_APART = ","
"""Between the serials of several channels in the header of a spool; no serial contains it."""

PARTS = {"stage": Reason("part.stage"), "readout": Reason("part.readout"), "force": Reason("part.cell")}
"""What a station needs, by the role of the device."""


@contextmanager
def chosen_bench(
    station_file: Path | None, simulated_seed: int | None, simulated_channels: int = 1, twin: "Twin | None" = None
) -> Iterator[Bench]:
    """Return the simulated bench if a seed is given, else the bench of the station file.

    Args:
        simulated_channels: units under the simulated stage, one per channel.
        twin: unit under the simulated stage, equal to the others; None: drawn.

    Raises:
        InputError: neither is given, or the file cannot be read.
        DeviceError: devices are missing; all of them are named.
    """
    if simulated_seed is not None:
        from softcal.core.simulated_lot import draw_lot  # noqa: PLC0415

        rng, count = np.random.default_rng(simulated_seed), simulated_channels
        twins = draw_lot(rng, count) if twin is None else (twin, *draw_lot(rng, count - 1, twin))
        with open_simulated_bench(twins[0], simulated_seed, other_units=twins[1:]) as (bench, _):
            yield bench
    elif station_file is None:
        raise InputError(
            "which station? give --station FILE (made by `softcal station check --write FILE`) or --simulated"
        )
    else:
        with open_bench(read_station_file(station_file)) as bench:
            yield bench


def find_devices(ports: Sequence[str]) -> list[DeviceIdentity]:
    """Return the devices at these ports, or at all USB serial ports by default.

    A port that cannot be opened is listed with the reason.

    Raises:
        NoReply: there is no port, or some that were named cannot be opened; all of them are named.
    """
    candidates = list(ports) or available_ports()
    if not candidates:
        raise NoReply(Reason("port.at.none"))
    identities: list[DeviceIdentity] = []
    faults: list[Reason] = []
    for port in candidates:
        try:
            identities.append(identify(port, HostClock()))
        except NoReply as error:
            faults.append(error.reason)
            identities.append(DeviceIdentity(port, "", "", error.reason))
    if faults and ports:
        raise NoReply(several(faults))
    return identities


Choose = Callable[[Reason, Sequence[DeviceIdentity]], DeviceIdentity | None]
"""(part of the station, what it may be) -> what it is; None where nobody says."""


def station_of(devices: Sequence[DeviceIdentity], choose: Choose | None = None) -> StationConfig:
    """Return the station that these devices make up; `choose` is asked where only a person can
    decide, and a part it leaves open has no port.

    Raises:
        NoReply: a part is missing, or two could be one; all that is missing is named.
    """
    assigned: list[DeviceIdentity] = []
    stage, readout, force = (_only(devices, role, assigned, choose) for role in PARTS)
    if force is None and stage is not None and stage.kind == "esm" and stage.channels:
        force = stage  # The gauge on the stand, behind the same port.
    if stage is None or readout is None or force is None:
        missing = [part for part, device in zip(PARTS.values(), (stage, readout, force), strict=True) if device is None]
        port_names = ", ".join(device.port for device in devices)
        unclear = [reason("port.at", port=device.port, why=device.says) for device in devices if not device.role]
        raise NoReply(several([reason("port.missing", parts=_and(missing), ports=port_names), *unclear]))
    return StationConfig(
        StageConfig(stage.port, stage.kind),
        ReadoutConfig(readout.port, rate_Hz=round(readout.rate_Hz, 1), channels=readout.channels),
        ForceConfig(force.port, force.kind, rate_Hz=round(force.rate_Hz, 1)),
    )


def _only(
    devices: Sequence[DeviceIdentity], role: str, assigned: list[DeviceIdentity], choose: Choose | None
) -> DeviceIdentity | None:
    """Return the only device of a role; of two candidates a person chooses."""
    matching = [device for device in devices if device.role == role]
    streams = [device for device in devices if not device.role and device.channels and device not in assigned]
    if len(matching) == 1 or not (matching or (streams and role in TEXT_STREAM_KINDS and choose)):
        return matching[0] if matching else None
    if choose is None:
        first, second, *_ = (reason("port.at", port=device.port, why=device.says) for device in matching)
        raise NoReply(reason("port.one_of", first=first, second=second, part=PARTS[role]))
    candidates = matching or streams
    chosen = choose(PARTS[role], candidates)
    if chosen is None:
        return replace(candidates[0], port="", role=role, kind=TEXT_STREAM_KINDS.get(role, candidates[0].kind))
    assigned.append(chosen)
    return replace(chosen, role=role, kind=chosen.kind or TEXT_STREAM_KINDS[role])


TEXT_STREAM_KINDS = {"readout": "arduino", "force": "hx711"}
"""What a bare text stream of counts is, as either part."""


def _and(parts: Sequence[Reason]) -> Reason:
    first, *rest = parts
    return reason("part.and", first=first, rest=_and(rest)) if rest else first


@dataclass(frozen=True)
class StationCheck:
    """Result of `softcal station check`."""

    config: StationConfig
    devices: tuple[DeviceIdentity, ...]
    findings: tuple[SelfTestItem, ...]

    def as_json(self) -> dict[str, object]:
        names = ("device", "what", "value", "cure")
        findings = [
            {name: str(getattr(finding, name) or "") for name in names} | {"is_good": finding.is_good}
            for finding in self.findings
        ]
        devices = [vars(device) | {"description": str(device.says)} for device in self.devices]
        return {
            "schema": "softcal.station-check/1",
            "station": self.config.name,
            "devices": [{key: value for key, value in device.items() if key != "says"} for device in devices],
            "findings": findings,
            "is_good": all(finding.is_good for finding in self.findings),
        }


def check_station(
    ports: Sequence[str],
    station_file: Path | None,
    simulated_seed: int | None,
    may_move: bool,
    choose: Choose | None = None,
) -> StationCheck:
    """Find the devices (unless a station is given), open them all and run the self-test. A station
    with a part that `choose` leaves open is not tested.

    Raises:
        DeviceError: a port or a device is missing; all of them are named.
    """
    is_found = station_file is None and simulated_seed is None
    devices = tuple(find_devices(ports)) if ports or is_found else ()
    if is_found:
        config = station_of(devices, choose)
        if not all(device.port for device in (config.stage, config.readout, config.force) if device is not None):
            return StationCheck(config, devices, ())
    with open_bench(config) if is_found else chosen_bench(station_file, simulated_seed) as bench:
        findings = self_test(bench, may_move, profile=unit_profile(np.random.default_rng(0), 25.0))
        return StationCheck(bench.config, devices, tuple(findings))


@dataclass(frozen=True)
class WrittenRun:
    """Result of one run: recording, files, and remarks for people."""

    recording: StationRecording
    files: tuple[Path, ...]
    seconds: float
    remarks: tuple[str, ...] = ()


def record_to_files(
    bench: Bench,
    serials: Sequence[str],
    out: Path,
    profile: Profile,
    with_reference: bool,
    spool_folder: Path,
    on_progress: OnProgress | None = None,
) -> WrittenRun:
    """Press once and write one file per channel, whole or not at all: `out`, with several channels
    a folder. Samples go to a spool as they come, removed when the files are written.

    Raises:
        InputError: a serial that cannot be one, or not one per channel.
        DeviceError: the run was aborted; nothing was written.
    """
    serials = [check_serial(serial) for serial in serials]
    if len(serials) != bench.readout.channels or len(set(serials)) != len(serials):
        raise InputError(f"{len(set(serials))} serials for {bench.readout.channels} channels; give one per channel")
    paths = [out] if len(serials) == 1 else [out / f"{serial}.csv" for serial in serials]
    lot = _lot_of(paths, serials, bench, with_reference)
    began_s = bench.clock.now_s()
    spool_path = spool_folder / f"{serials[0]}-{datetime.now(UTC):%Y%m%dT%H%M%S.%f}.spool"
    header = {"serial": serials[0], "serials": SERIALS_APART.join(serials), "profile": profile.name}
    with Spool(spool_path, header | {"station": bench.config.name}) as spool:
        recording = record(bench, serials[0], profile, with_reference, on_progress, spool)
        if lot is not None and with_reference:
            check_labels(recording, lot)
    for channel, path in enumerate(paths):
        write_columns(path, columns(recording, channel))
    remarks: list[str] = [str(remark) for remark in recording.remarks]
    if with_reference and paths[0].parent.name == "source":
        is_simulated = bench.config.name == SIMULATED_NAME
        reference = SIMULATED if is_simulated else station_reference(bench.config)
        remarks += _state_source(paths[0], recording, with_response(reference, recording))
    force, force_delay_s = bench.config.force, recording.alignment.force_behind_s
    if constant_s := recording.alignment.force_time_constant_s:
        remarks.append(
            f"the load cell follows the force through a low pass of {constant_s:.3f} s; labels are wrong by "
            f"{recording.alignment.force_response_N:.3g} N RMS, which counts as uncertainty of the reference"
        )
    if force is not None and not force.is_latency_declared and np.isfinite(force_delay_s):
        remarks.append(
            f"the load cell was found {force_delay_s:.3f} s behind the stage, which was taken off; write "
            f"latency_s = {max(0.0, force_delay_s):.2f} into [force] of the station file"
        )
    spool_path.unlink()
    return WrittenRun(recording, tuple(paths), bench.clock.now_s() - began_s, tuple(remarks))


def station_reference(config: StationConfig) -> Reference | None:
    """Return the present reference of a station, its load cell, or None."""
    if config.force is None:
        return None
    return Reference(cell=config.force.serial or "not named", used_on=datetime.now(UTC).astimezone().date())


def with_response(reference: Reference | None, recording: StationRecording) -> Reference | None:
    """Return a reference with the error by the low pass of its cell in this recording."""
    return None if reference is None else replace(reference, bandwidth=recording.alignment.force_response_N)


def check_labels(recording: StationRecording, lot: Lot) -> None:
    """Raise `BadReply` where the load cell's low pass leaves labels too wrong for the limit of their lot."""
    if lot.limit_rmse is not None and lot.reference_unit == "N":
        about = recording.alignment
        allowed_N = METHOD.response.limit_share * lot.limit_rmse
        check_error(about.force_time_constant_s, about.force_response_N, allowed_N)


def _lot_of(paths: Sequence[Path], serials: Sequence[str], bench: Bench, with_reference: bool) -> Lot | None:
    """Return the lot of a recording's folder, or None.

    Refuse a recording that the lot could not use, before any motion.
    """
    folder = paths[0].parent
    if folder.name not in FOLDER_OF.values() or not (folder.parent / "lot.toml").is_file():
        return None
    lot, readout = read_lot_toml(folder.parent).lot, bench.readout
    if (lot.sample_rate_Hz, lot.output_unit) != (readout.rate_Hz, readout.unit):
        raise InputError(
            f"{folder.parent / 'lot.toml'} states {lot.sample_rate_Hz:g} Hz and {lot.output_unit}, the readout gives "
            f"{readout.rate_Hz:g} Hz and {readout.unit}; record into another lot folder, nothing moved"
        )
    if not with_reference and lot.source in serials:
        raise InputError(
            f"{lot.source} is the source of {folder.parent / 'lot.toml'}; press it with `softcal station source`, or "
            "scan the unit's own serial, nothing moved"
        )
    return lot


def _state_source(source: Path, recording: StationRecording, reference: Reference | None) -> list[str]:
    """Write the lot.toml of a source in LOT/source/, so that a batch can read the folder; return remarks."""
    folder = source.parent.parent
    if not (folder / "lot.toml").exists():
        lot = Lot(folder.resolve().name, source.stem, recording.sample_rate_Hz, output_unit=recording.output_unit)
        write_lot_toml(folder, lot, reference)
        return []
    lot = read_lot_toml(folder).lot
    if lot.source == source.stem:
        update_reference(folder, reference)
        return []
    return [
        f"{folder / 'lot.toml'} names {lot.source} as the source; {source.stem} lies beside it and is not used; to use "
        f'it, write source = "{source.stem}" and another id of the lot there'
    ]


def spool_folder(option: Path | None) -> Path:
    """Return the folder of spools: the option, else one among the user's data."""
    return option or data_folder() / "spool"


def run_json(run: WrittenRun) -> dict[str, object]:
    """Return the metadata of a run as JSON values; NaN becomes null."""
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
        "proof_method": recording.proof_method,
        "remarks": list(run.remarks),
    }


def columns(recording: StationRecording, channel: int = 0) -> list[tuple[str, Array]]:
    """Return the columns of a lot folder's file, rounded far below the devices' resolution."""
    named_columns = [("t_s", np.round(recording.t_s, 6)), ("output", np.round(recording.output[:, channel], 7))]
    if recording.force_N is not None:
        named_columns.append(("reference", np.round(recording.force_N, 6)))
    return [*named_columns, ("stage_mm", np.round(recording.stage_mm, 5))]


def profile_for(kind: str, seed: int, seconds: float | None, depth_mm: float, file: Path | None = None) -> Profile:
    """Return the profile of a file, else the source or the short unit profile."""
    if file is not None:
        return read_profile(file)
    rng = np.random.default_rng(seed)
    if kind == "source":
        return source_profile(rng, seconds or 170.0, depth_mm)
    return unit_profile(rng, seconds or 25.0, depth_mm)
