"""Export formats: one function each, from a calibrated unit to the contents of its files."""

import json
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

from softcal.app.export.calibrated_unit import CalibratedUnit
from softcal.app.export.names import GROUP, formats
from softcal.core.errors import InputError, UnitRefused
from softcal.core.export.blob import longest_step_ms
from softcal.core.export.c_text import intel_hex, network_header, unit_header
from softcal.core.export.compile_map import compile_map, fine_forms
from softcal.core.export.device import device_cost, device_limit, limits_of_unit, sample_period_us
from softcal.core.export.graph import compose
from softcal.core.export.json_text import add_sha256, json_text, network_values, unit_values
from softcal.core.export.loader import CLAMPED, OUT_OF_RANGE
from softcal.core.lot import escape_serial
from softcal.core.plugins import find_plugins, load_plugin, name_point
from softcal.core.unit.fit import FittedMap
from softcal.core.unit.state_json import adjustments_to_json, fit_to_json
from softcal.core.windows import TAPS

Writer = Callable[[CalibratedUnit], dict[str, bytes]]


def runtime_header() -> bytes:
    """Return softsensor.h, from the checkout or from the installed wheel."""
    candidates = (
        Path(__file__).parents[2] / "firmware" / "softsensor" / "softsensor.h",
        Path(sys.prefix) / "share" / "softcal" / "softsensor.h",
    )
    for folder_name in candidates:
        if folder_name.is_file():
            return folder_name.read_bytes()
    raise InputError(
        f"softsensor.h is neither in {candidates[0].parent} nor in {candidates[1].parent}; install softcal again"
    )


def _json_files(unit: CalibratedUnit) -> dict[str, bytes]:
    """Return the JSON files; without a device form `device` is the reason, as the map itself is for PCs too."""
    unit.check_usable()
    values: dict[str, object] = {"schema": "softcal.calibration/1", "calibration": calibration_values(unit)}
    files = {}
    try:
        values["device"] = unit_values(unit.device_unit.file)
        network = unit.shared.file
        files[f"network-{network.id.hex()}.json"] = json_text(add_sha256(network_values(network))).encode()
    except UnitRefused as error:
        values["device"] = None
        values["device_refused"] = str(error)
    return {f"unit-{unit.escaped_serial}.json": json_text(add_sha256(values)).encode(), **files}


def calibration_values(unit: CalibratedUnit) -> dict[str, object]:
    """Return the calibration without loss: map and interval, hashes, verdict and scores."""
    state = unit.state
    # The map and the interval in force, with all that they rest on.
    in_force = FittedMap(state.unit_map, state.interval, unit.state.fitted.output_limits)
    stored = fit_to_json(replace(state.fit, fitted=in_force))
    return {
        "serial": unit.serial,
        "lot": unit.lot.id,
        "source": unit.shared.source.unlabelled.serial,
        "revision": unit.stored.revision,
        "made_at": unit.stored.made_at.isoformat(),
        "verdict": str(state.verdict),
        "reasons": [str(reason) for reason in state.decision.reasons],
        "network_id": state.fit.network_id,
        "family": state.fit.family,
        "map_sha256": state.map_sha256,
        **state.errors,
        "recording_sha256": state.fit.recording_sha256,
        "input_sha256": unit.stored.input_sha256,
        "output_unit": unit.network.output_unit,
        "reference_unit": unit.network.reference_unit,
        "fit": stored.content,
        "state": adjustments_to_json(state),
        "method": state.fit.method.to_json(),
        "arrays": {
            name: {"dtype": array.dtype.str, "shape": list(array.shape), "values": array.ravel().tolist()}
            for name, array in sorted(stored.arrays.items())
        },
        "provenance": unit.provenance.to_json(),
    }


def _device_files(unit: CalibratedUnit, ending: str, of_unit: bytes, of_network: bytes) -> dict[str, bytes]:
    network = unit.shared.file.id.hex()
    return {f"unit-{unit.escaped_serial}.{ending}": of_unit, f"network-{network}.{ending}": of_network}


def _blob_files(unit: CalibratedUnit) -> dict[str, bytes]:
    return _device_files(unit, "ssc", unit.device_unit.file.to_bytes(), unit.shared.file.to_bytes())


def _c_files(unit: CalibratedUnit) -> dict[str, bytes]:
    of_unit, of_network = unit_header(unit.device_unit.file).encode(), network_header(unit.shared.file).encode()
    return _device_files(unit, "h", of_unit, of_network) | {"softsensor.h": runtime_header()}


def _hex_files(unit: CalibratedUnit) -> dict[str, bytes]:
    files = (unit.device_unit.file, unit.options.unit_address), (unit.shared.file, unit.options.network_address)
    try:
        of_unit, of_network = (intel_hex(file.to_bytes(), address).encode() for file, address in files)
    except ValueError as error:
        raise InputError(f"no Intel HEX: {error}") from error
    return _device_files(unit, "hex", of_unit, of_network)


def _onnx_files(unit: CalibratedUnit) -> dict[str, bytes]:
    from softcal.app.files.onnx_file import onnx_bytes

    unit.check_usable()
    limit = device_limit(unit.record, unit.network, unit.options.device)
    period_us = sample_period_us(unit.shared.source)
    compiled = compile_map(unit.state.unit_map, unit.network, unit.recording, limit, fine_forms)
    metadata = {
        "serial": unit.serial,
        "revision": str(unit.stored.revision),
        "verdict": str(unit.state.verdict),
        "lot": unit.lot.id,
        "network_id": unit.state.fit.network_id,
        "map_sha256": unit.state.map_sha256,
        "output_unit": unit.network.output_unit,
        "reference_unit": unit.network.reference_unit,
        "sample_rate_Hz": repr(unit.lot.sample_rate_Hz),
        "window": f"{TAPS} samples in the output unit, oldest first, newest last",
        "window_period_ms": repr(period_us / 1000),
        "window_longest_step_ms": str(longest_step_ms(period_us)),
        "interval": "lower ... upper holds 90 %",
        "flag": f"sum of {OUT_OF_RANGE} (a sample outside the calibrated range) and {CLAMPED} (the estimate clamped)",
        "map_rms_deviation": repr(compiled.rms_deviation),
        "provenance": json.dumps(unit.provenance.to_json()),
    }
    graph = compose(compiled.form, unit.network, limits_of_unit(unit.record, unit.network, unit.options.scaled_device))
    return {f"unit-{unit.escaped_serial}.onnx": onnx_bytes(graph, metadata)}


def _pdf_files(unit: CalibratedUnit) -> dict[str, bytes]:
    from softcal.app.export.certificates.content import build_certificate
    from softcal.app.export.certificates.pdf import certificate_pdf

    return {f"certificate-{unit.escaped_serial}.pdf": certificate_pdf(build_certificate(unit))}


def _dcc_files(unit: CalibratedUnit) -> dict[str, bytes]:
    from softcal.app.export.certificates.content import build_certificate
    from softcal.app.export.certificates.dcc import certificate_xml

    return {f"certificate-{unit.escaped_serial}.xml": certificate_xml(build_certificate(unit))}


def device_summary(unit: CalibratedUnit) -> dict[str, object]:
    """Return sizes of the device form and its cost in accuracy, or raise `UnitRefused`."""
    device, network = unit.device_unit, unit.shared.file.network
    cost = device_cost(network, device.file.device_map)
    return {
        "network_file_id": unit.shared.file.id.hex(),
        "unit_bytes": len(device.file.to_bytes()),
        "network_bytes": len(unit.shared.file.to_bytes()),
        "multiplications": network.multiplications,
        "map_rms_deviation": device.compiled.rms_deviation,
        "map_max_deviation": device.compiled.max_deviation,
        "rms_error": device.rms_error,
        "max_error": device.max_error,
        "limit": device.limit,
        "goal": device.goal,
        "ram_bytes": cost.ram_bytes,
        "cortex_m0_instructions": cost.instructions,
        "cortex_m0_ms": cost.estimate_ms,
        "unit": unit.network.reference_unit,
    }


WRITERS: Mapping[str, Writer] = {
    "json": _json_files,
    "c": _c_files,
    "blob": _blob_files,
    "hex": _hex_files,
    "onnx": _onnx_files,
    "pdf": _pdf_files,
    "dcc": _dcc_files,
}
"""What writes each of softcal's own formats, `names.FORMATS`."""


def find_writer(name: str) -> Writer:
    """Return the writer of a format; it raises `UnitRefused` if result, verdict or map forbid such a file.

    `InputError`: no such format, or a plug-in that cannot be loaded or takes a name.
    """
    points = [point for point in find_plugins(GROUP) if point.name == name]
    if name in WRITERS and not points:
        return partial(_write_released, WRITERS[name])
    if not points:
        raise InputError(f"format {name}; known: {', '.join(formats())}")
    if name in WRITERS or len(points) > 1:
        raise InputError(f"{name_point(points[-1], KIND)}: the name {name!r} is taken already; give it another")
    write = load_plugin(points[0], KIND)
    if not callable(write):
        raise InputError(f"{name_point(points[0], KIND)}: is {type(write).__name__}; a function was expected")
    return partial(_write_released, partial(_plugin_files, points[0], write))


def _write_released(write: Writer, unit: CalibratedUnit) -> dict[str, bytes]:
    unit.check_not_withdrawn()
    return write(unit)


KIND = "exporter"


def _plugin_files(point: EntryPoint, write: Callable[[CalibratedUnit], Any], unit: CalibratedUnit) -> dict[str, bytes]:
    # What a plug-in writes may give numbers: a unit that is not released has none of it.
    unit.check_usable()
    try:
        files: dict[str, bytes] = write(unit)
    except UnitRefused:
        raise
    except Exception as error:
        raise InputError(
            f"{name_point(point, KIND)}: cannot write unit {unit.serial} ({error}); repair the package"
        ) from error
    is_valid = isinstance(files, dict) and all(
        isinstance(content, bytes)
        and re.fullmatch(r"[\w][\w.~-]*", str(name))
        and escape_serial(unit.serial) in str(name)
        for name, content in files.items()
    )
    if not is_valid:
        raise InputError(
            f"{name_point(point, KIND)}: gave no files; names with {escape_serial(unit.serial)} and bytes were expected"
        )
    return dict(files)
