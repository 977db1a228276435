"""What a calibration file holds, in words and numbers."""

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

from softcal.core.errors import InputError
from softcal.core.export.blob import CONDITIONAL, FAILED, MAGIC, MAJOR, NetworkFile, UnitFile
from softcal.core.export.blob_reader import read_network, read_unit
from softcal.core.export.json_text import network_from_values, network_values, unit_from_values, unit_values
from softcal.core.export.loader import join

DeviceFile = NetworkFile | UnitFile


def read_device_file(path: Path) -> DeviceFile:
    """Read a network or unit file: .ssc or its JSON twin.

    Raises:
        InputError: it cannot be read, is damaged, or is none of these.
    """
    try:
        content = path.read_bytes()
        if content[:4] == MAGIC.to_bytes(4, "little"):
            return read_network(content) if content[4:5] == b"\x01" else read_unit(content)
        try:
            values = json.loads(content)
        except ValueError as error:
            raise InputError("neither a calibration file (.ssc) nor its JSON twin") from error
        if not isinstance(values, Mapping):
            raise InputError("JSON, but no calibration file")
        if values.get("schema") == "softcal.calibration/1":
            if values.get("device") is None:
                raise InputError(f"has no device file: {values.get('device_refused', 'none was exported')}")
            return unit_from_values(values["device"])
        return unit_from_values(values) if "serial" in values else network_from_values(values)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def file_values(file: DeviceFile) -> dict[str, object]:
    """Return everything in a file as JSON values."""
    return network_values(file) if isinstance(file, NetworkFile) else unit_values(file)


def file_rows(file: DeviceFile, network: NetworkFile | None = None) -> list[tuple[str, str]]:
    """Return what a person wants to know of a file; beside its network a unit's is self-tested."""
    if isinstance(file, NetworkFile):
        net, unit = file.network, file.output_unit
        return [
            ("kind", f"shared network, format {MAJOR}.{file.minor}"),
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
    form = file.device_map
    words = {0: "passed", CONDITIONAL: "passed conditionally", FAILED: "DID NOT PASS, exported on demand"}
    made = datetime.fromtimestamp(file.time_s, UTC).isoformat() if file.time_s else "unknown"
    parts = [] if form.curve is None else [f"curve of {len(form.curve.codes)} knots on every sample"]
    parts += [] if form.layer is None else ["linear layer on every window"]
    if form.mix is not None:
        parts.append(f"{'wide ' if form.mix.is_wide else ''}mix of {len(form.mix.bias)} shapes on every window")
    bands = ", ".join(f"up to {b.level}: -{b.minus} +{b.plus}" for b in file.bands)
    rows = [
        ("kind", f"unit, format {MAJOR}.{file.minor}"),
        ("serial", file.serial),
        ("network", file.network_id.hex()),
        ("revision", f"{file.revision}, calibrated {made}"),
        ("verdict", words.get(file.flags, f"unknown flags {file.flags}")),
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
