"""The lossless JSON twin of the device files, and back into the same bytes."""

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from softcal.core.errors import InputError
from softcal.core.export.blob import Band, LoadLevels, NetworkFile, SelfTest, UnitFile
from softcal.core.export.compile_map import InputScale
from softcal.core.export.integer_network import DeviceMap, IntegerLayer, IntegerMix, IntegerNetwork, PiecewiseMap

NETWORK_SCHEMA, UNIT_SCHEMA = "softcal.network-file/1", "softcal.unit-file/1"
LAYER_FIELDS = ("weights", "bias", "multiplier", "shift1", "shift2")
MIX_FIELDS = ("weights", "shift", "bias")
OF_NETWORK = {"network_sha256": str, "source_serial": str, "period_us": int, "output_unit": str, "reference_unit": str}
OF_UNIT = {"revision": int, "time_s": int, "flags": int}
"""Fields of the files that are JSON values as they are."""


def network_values(file: NetworkFile) -> dict[str, object]:
    """Return a network file as JSON values."""
    net = file.network
    return {
        "schema": NETWORK_SCHEMA,
        "id": file.id.hex(),
        **{name: getattr(file, name) for name in OF_NETWORK},
        "output_exponent": net.output_exponent,
        "input_zero": net.input_zero,
        "input_lsb": net.input_lsb,
        "sizes": list(net.sizes),
        "layers": [_layer_values(layer) for layer in net.layers],
        "levels": vars(file.levels),
    }


def network_from_values(values: Mapping[str, Any]) -> NetworkFile:
    """Rebuild a network file; `InputError` where a value is missing or impossible."""
    _check_schema(values, NETWORK_SCHEMA)
    try:
        table = values["levels"]
        levels = LoadLevels(int(table["first"]), int(table["step"]), tuple(map(int, table["counts"])))
        network = IntegerNetwork(
            tuple(_layer_from(layer) for layer in values["layers"]),
            float(values["input_zero"]),
            float(values["input_lsb"]),
            int(values["output_exponent"]),
        )
        return NetworkFile(network, **{name: kind(values[name]) for name, kind in OF_NETWORK.items()}, levels=levels)
    except (KeyError, TypeError, ValueError) as error:
        raise _refusal(error) from error


def unit_values(file: UnitFile) -> dict[str, object]:
    """Return a unit file as JSON values."""
    curve, layer, mix = file.device_map.curve, file.device_map.layer, file.device_map.mix
    knots = None if curve is None else np.column_stack([curve.codes, curve.values]).tolist()
    mix_values = None
    if mix is not None:
        mix_values = {"keep": mix.keep, **{name: getattr(mix, name).tolist() for name in MIX_FIELDS}}
    return {
        "schema": UNIT_SCHEMA,
        "serial": file.serial,
        "network_id": file.network_id.hex(),
        **{name: getattr(file, name) for name in OF_UNIT},
        "code": {"zero": file.scale.zero, "lsb": file.scale.lsb, "min": file.code_min, "max": file.code_max},
        "estimate": {"min": file.out_min, "max": file.out_max},
        "map": {"knots": knots, "layer": None if layer is None else _layer_values(layer), "mix": mix_values},
        "bands": [vars(band) for band in file.bands],
        "self_tests": [vars(test) for test in file.self_tests],
        "pivot": file.pivot,
    }


def unit_from_values(values: Mapping[str, Any]) -> UnitFile:
    """Rebuild a unit file; `InputError` where a value is missing or impossible."""
    _check_schema(values, UNIT_SCHEMA)
    try:
        code, estimate, of_map = values["code"], values["estimate"], values["map"]
        knots, layer, mix = of_map["knots"], of_map["layer"], None
        if (of_mix := of_map["mix"]) is not None:
            mix = IntegerMix(int(of_mix["keep"]), *(np.array(of_mix[name], dtype=np.int64) for name in MIX_FIELDS))
        return UnitFile(
            serial=str(values["serial"]),
            network_id=bytes.fromhex(values["network_id"]),
            **{name: kind(values[name]) for name, kind in OF_UNIT.items()},
            device_map=DeviceMap(
                None if knots is None else PiecewiseMap(*np.array(knots, dtype=np.int64).reshape(-1, 2).T),
                None if layer is None else _layer_from(layer),
                mix,
            ),
            scale=InputScale(float(code["zero"]), float(code["lsb"])),
            code_min=int(code["min"]),
            code_max=int(code["max"]),
            out_min=int(estimate["min"]),
            out_max=int(estimate["max"]),
            bands=tuple(Band(**band) for band in values["bands"]),
            self_tests=tuple(SelfTest(**test) for test in values["self_tests"]),
            pivot=int(values["pivot"]),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise _refusal(error) from error


def add_sha256(values: Mapping[str, object]) -> dict[str, object]:
    """Return values with their own SHA-256, in the form of a file."""
    return {**values, "sha256": _sha256(values)}


def has_valid_sha256(values: Mapping[str, Any]) -> bool:
    """Return whether values have their SHA-256; raise `InputError` for a wrong hash."""
    if "sha256" not in values:
        return False
    if values["sha256"] != _sha256({name: value for name, value in values.items() if name != "sha256"}):
        raise InputError("it is not what was exported: its values are not those of its sha256; export it again")
    return True


def _sha256(values: Mapping[str, object]) -> str:
    text = json.dumps(values, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _check_schema(values: Mapping[str, Any], schema: str) -> None:
    if values.get("schema") != schema:
        raise InputError(f"schema {values.get('schema')!r}; {schema!r} was expected")


def _refusal(error: Exception) -> InputError:
    missing = f"{error} is missing" if isinstance(error, KeyError) else str(error)
    return InputError(f"the JSON holds no calibration file: {missing}; export it again")


def _layer_values(layer: IntegerLayer) -> dict[str, object]:
    return {name: getattr(layer, name).tolist() for name in LAYER_FIELDS}


def _layer_from(values: Mapping[str, Any]) -> IntegerLayer:
    return IntegerLayer(**{name: np.array(values[name], dtype=np.int64) for name in LAYER_FIELDS})


def json_text(value: object) -> str:
    """Return JSON with one line for each row of numbers; the same value, the same text."""
    return _text(value, "") + "\n"


def _text(value: object, indent: str) -> str:
    deeper = indent + "  "
    if isinstance(value, Mapping) and value:
        rows = [f"{deeper}{json.dumps(str(key))}: {_text(item, deeper)}" for key, item in value.items()]
        return "{\n" + ",\n".join(rows) + f"\n{indent}}}"
    if isinstance(value, list | tuple) and any(isinstance(item, Mapping | list | tuple) for item in value):
        return "[\n" + ",\n".join(deeper + _text(item, deeper) for item in value) + f"\n{indent}]"
    return json.dumps(value, allow_nan=False, ensure_ascii=False)
