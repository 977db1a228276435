"""Check of exports: content of a calibration file; completeness, integrity and signature of a folder."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path

from softcal.app.export.manifest import NAME, SIGNATURE, FileEntry, Manifest, read_manifest
from softcal.app.export.names import AUDIT, DETACHED_SUFFIX
from softcal.app.export.signature import TrustedKey, check_signature
from softcal.core.errors import InputError
from softcal.core.export.blob import CONDITIONAL, FAILED, MAGIC, MAJOR, MINOR, NetworkFile, UnitFile, serial_field
from softcal.core.export.blob_reader import read_network, read_unit
from softcal.core.export.json_text import (
    has_valid_sha256,
    network_from_values,
    network_values,
    unit_from_values,
    unit_values,
)
from softcal.core.export.loader import join
from softcal.core.json_input import parse_json

DeviceFile = NetworkFile | UnitFile
NOT_SIGNED, NOT_CHECKED, INVALID = "not signed", "not checked", "wrong"


@dataclass(frozen=True)
class FolderCheck:
    """Result of a check: complete, unchanged, signed.

    Args:
        files: files the manifest lists.
        opened: units whose device files were opened with all self-tests.
        incomplete: one line for each file that is missing, or not in the manifest.
        changed: one line for each file that was changed, or that a device would refuse.
        signed_by: name and fingerprint, or NOT_SIGNED, NOT_CHECKED (no key) or INVALID.
        signature_problem: why a signature does not hold.
        signed_on: date in the signed manifest.
    """

    files: int
    opened: int
    incomplete: tuple[str, ...]
    changed: tuple[str, ...]
    signed_by: str
    signature_problem: str | None = None
    signed_on: date | None = None

    @property
    def problems(self) -> tuple[str, ...]:
        """Return one line per problem; empty for a folder that may be shipped."""
        return (*self.incomplete, *self.changed, *([self.signature_problem] if self.signature_problem else []))

    @property
    def answers(self) -> tuple[tuple[str, str], ...]:
        """The three questions and their answers, in words."""
        signed = {
            NOT_SIGNED: "no",
            NOT_CHECKED: "not checked: there is a signature; give --public-key to check whose it is",
            INVALID: "NO: the signature does not hold",
        }
        return (
            ("complete", _answer(self.incomplete, f"{self.files} files, nothing more, nothing less")),
            ("unchanged", _answer(self.changed, f"hashes hold, {self.opened} units opened with all self-tests")),
            ("signed", signed.get(self.signed_by, f"yes, by {self.signed_by}, {self.signed_on or 'day not stated'}")),
        )


def _answer(problems: tuple[str, ...], detail: str) -> str:
    return f"NO: {len(problems)} problems" if problems else f"yes: {detail}"


def check_folder(folder: Path, trusted: Sequence[TrustedKey] = ()) -> FolderCheck:
    """Check a folder against its manifest, its device files by opening them, signatures by keys.

    `InputError`: there is no manifest, or it lists a file twice or outside the folder.
    """
    manifest = read_manifest(folder)
    if not manifest.files:
        raise InputError(f"{folder}: no manifest.json; export into it first")
    signed_by, problem = _signer(folder, manifest, trusted)
    present_names, listed, units = {path.name for path in folder.iterdir()}, set(manifest.files), set(manifest.units)
    owners = {entry.serial for entry in manifest.files.values()}
    withdrawn = {serial for serial, values in manifest.units.items() if values.get("withdrawn")}
    unlisted, unowned = (
        present_names - listed - {NAME, SIGNATURE, AUDIT},
        {str(owner) for owner in owners - units - {None}},
    )
    incomplete = (
        *(f"{name}: is missing; export it again" for name in sorted(listed - present_names)),
        *(f"{name}: is not in the manifest; nobody exported it into this folder" for name in sorted(unlisted)),
        *(f"unit {name}: is in the manifest without a file" for name in sorted(units - owners - withdrawn)),
        *(f"unit {name}: has files, but the manifest does not say what it is" for name in sorted(unowned)),
    )
    present = [entry for entry in manifest.files.values() if (folder / entry.name).exists()]
    changed = []
    for entry in present:
        path = folder / entry.name
        if path.is_symlink() or not path.is_file():
            changed.append(f"{entry.name}: is no file of this folder but a link or a folder; export it again")
            continue
        try:
            if FileEntry.from_content(entry.name, path.read_bytes(), entry.serial) != entry:
                changed.append(f"{entry.name}: is not what was exported (SHA-256 differs); export it again")
        except OSError as error:
            changed.append(f"{entry.name}: {error.strerror}; export it again")
    opened = 0
    if not changed:
        problems, opened = _device_problems(folder, [entry.name for entry in present])
        changed += problems
    by_field: dict[bytes, str] = {}
    for serial in manifest.units:
        if (other := by_field.setdefault(serial_field(serial), serial)) != serial:
            changed.append(f"units {other} and {serial} look the same to a device; export them into separate folders")
    return FolderCheck(len(manifest.files), opened, incomplete, tuple(changed), signed_by, problem, manifest.signed_on)


def _signer(folder: Path, manifest: Manifest, trusted: Sequence[TrustedKey]) -> tuple[str, str | None]:
    path = folder / SIGNATURE
    if not path.exists():
        return NOT_SIGNED, f"{SIGNATURE}: is missing; the folder is not signed" if trusted else None
    if not trusted:
        return NOT_CHECKED, None
    detached = [name for name in manifest.files if name.endswith(DETACHED_SUFFIX) and (folder / name).is_file()]
    pairs = [(NAME, SIGNATURE), *((name.removesuffix(DETACHED_SUFFIX), name) for name in sorted(detached))]
    signers = []
    for signed, name in pairs:
        try:
            content, signature = (folder / signed).read_bytes(), (folder / name).read_bytes()
            signers.append(check_signature(content, signature, trusted, manifest.signed_on))
        except (InputError, OSError) as error:
            return INVALID, f"{name}: {error}"
    return signers[0], None


def _device_problems(folder: Path, names: list[str]) -> tuple[list[str], int]:
    networks: dict[bytes, NetworkFile] = {}
    units: list[UnitFile] = []
    problems: list[str] = []
    for name in sorted(names):
        path, is_network = folder / name, name.startswith("network-")
        file: DeviceFile | None = None
        try:
            if path.suffix == ".ssc":
                file = read_network(path.read_bytes()) if is_network else read_unit(path.read_bytes())
            elif path.suffix == ".json":
                values = parse_json(path.read_text(encoding="utf-8"))
                if is_network:
                    file = network_from_values(values)
                elif values.get("device"):
                    file = unit_from_values(values["device"])
        except InputError as error:
            problems.append(f"{name}: {error}")
        if isinstance(file, NetworkFile):
            networks[file.id] = file
        elif file is not None:
            units.append(file)
    for unit in units:
        if unit.network_id not in networks:
            problems.append(f"unit {unit.serial}: its network file {unit.network_id.hex()} is not in the folder")
            continue
        try:
            join(networks[unit.network_id], unit)
        except InputError as error:
            problems.append(str(error))
    return problems, len({unit.serial for unit in units})


def read_device_file(path: Path) -> tuple[DeviceFile, bool]:
    """Return a network or unit file, .ssc or JSON; raise `InputError` for an invalid or changed file.

    Returns:
        the file, and whether it has the hash that proves it unchanged since its export.
    """
    try:
        content = path.read_bytes()
        if content[:4] == MAGIC.to_bytes(4, "little"):
            return (read_network(content) if content[4:5] == b"\x01" else read_unit(content)), True
        try:
            values = parse_json(content)
        except ValueError as error:
            raise InputError("neither a calibration file (.ssc) nor its JSON twin") from error
        if not isinstance(values, Mapping):
            raise InputError("JSON, but no calibration file")
        is_intact = has_valid_sha256(values)
        if values.get("schema") == "softcal.calibration/1":
            if values.get("device") is None:
                raise InputError(f"has no device file: {values.get('device_refused', 'none was exported')}")
            return unit_from_values(values["device"]), is_intact
        return (unit_from_values(values) if "serial" in values else network_from_values(values)), is_intact
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def file_values(file: DeviceFile, is_intact: bool) -> dict[str, object]:
    """Return the content of a file as JSON values, and whether its hash was checked."""
    return (network_values(file) if isinstance(file, NetworkFile) else unit_values(file)) | {"is_proven": is_intact}


def file_rows(file: DeviceFile, is_intact: bool, network: NetworkFile | None = None) -> list[tuple[str, str]]:
    """Return the content of a file for people; a unit file next to its network is self-tested."""
    rows = _network_rows(file) if isinstance(file, NetworkFile) else _unit_rows(file, is_intact, network)
    proof = "its hash holds" if is_intact else "not proven: it carries no sha256; anybody may have changed it"
    return [*rows, ("as exported", proof)]


def _network_rows(file: NetworkFile) -> list[tuple[str, str]]:
    net, unit = file.network, file.output_unit
    return [
        ("kind", f"shared network, format {MAJOR}.{MINOR}"),
        ("id", file.id.hex()),
        ("registry id", file.network_sha256),
        ("source unit", file.source_serial),
        ("sizes", "-".join(map(str, net.sizes))),
        ("multiplications per estimate", f"{net.multiplications}"),
        ("bytes", f"{len(file.to_bytes())}"),
        ("sample period", f"{file.period_us / 1000:g} ms; a gap is more than {file.gap_ms} ms"),
        ("one count of the estimate", f"{10.0**net.output_exponent:g} {file.reference_unit}"),
        ("source window", f"{net.input_zero:.6g} {unit} + {net.input_lsb:.6g} {unit} per count"),
    ]


def _unit_rows(file: UnitFile, is_intact: bool, network: NetworkFile | None) -> list[tuple[str, str]]:
    form = file.device_map
    verdicts = {0: "passed", CONDITIONAL: "passed conditionally", FAILED: "DID NOT PASS, exported on demand"}
    calibrated_at = datetime.fromtimestamp(file.time_s, UTC).isoformat() if file.time_s else "unknown"
    parts = [] if form.curve is None else [f"curve of {len(form.curve.codes)} knots on every sample"]
    parts += [] if form.layer is None else ["linear layer on every window"]
    if form.mix is not None:
        parts.append(f"mix of {len(form.mix.bias)} shapes on every window")
    bands = ", ".join(f"up to {b.level}: -{b.minus} +{b.plus}" for b in file.bands)
    rows = [
        ("kind", f"unit, format {MAJOR}.{MINOR}"),
        ("serial", file.serial),
        ("network", file.network_id.hex()),
        ("revision", f"{file.revision}, calibrated {calibrated_at}"),
        ("verdict", verdicts.get(file.flags, f"unknown flags {file.flags}") if is_intact else "not proven"),
        ("bytes", f"{len(file.to_bytes())}"),
        ("map", ", then ".join(parts)),
        ("code", f"output = {file.scale.zero:.6g} + {file.scale.lsb:.6g} × code"),
        ("codes of the calibration", f"{file.code_min} ... {file.code_max}"),
        ("estimates are clamped to", f"{file.out_min} ... {file.out_max} counts"),
        ("90 % interval, counts", bands),
    ]
    if network is not None:
        join(network, file)
        rows.append(("self-tests", f"{len(file.self_tests)} of {len(file.self_tests)} give what they must"))
    return rows
