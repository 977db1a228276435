"""`softcal export`: calibration files for devices, PCs and auditors."""

import argparse
import sys
from collections.abc import Mapping, Sequence
from datetime import date
from functools import partial
from getpass import getpass
from pathlib import Path

from softcal.app.cli.options import COUNT, DIR, FILE, add_shared, converted, echo_caution, registry_of
from softcal.app.export.names import formats
from softcal.app.output import ProgressLine, echo, print_table, write_json

EXAMPLES = """examples:
  softcal export --serial A1 --format blob --adc-bits 10 --adc-full-scale 5 --out files --check
  softcal export --serial A1 --serial A2 --format c --format pdf --out files
  softcal export --lot lot-1 --format blob --format json --out files --sign factory.pem
  softcal export --check --out files --public-key factory.pub

formats:
  json  lossless, for people and databases: map, interval, hashes and the device files as numbers
  c     C headers and softsensor.h, for firmware          blob  network-<id>.ssc and unit-<serial>.ssc
  hex   the same two as Intel HEX at an address           onnx  f and map in one model, for PCs
  pdf   calibration certificate                           dcc   Digital Calibration Certificate (PTB, XML)

A unit that did not pass gets pdf and dcc, which say so, but no device file: a conditional one only with
--release conditional, a failed one only with --failed-too, for the laboratory.
Every folder has a manifest.json with the SHA-256 of every file. --check answers three questions: is the folder complete
(nothing more, nothing less), is every file unchanged and opened by its self-tests, and whose is the signature; without
--public-key the last is not checked, and the answer says so. The passphrase of an encrypted --sign key is read from
--passphrase-file or SOFTCAL_SIGNING_PASSPHRASE, else asked for. Certificates get a signature of their own (.sig).
A unit file takes the least of 256, 512 and 1024 bytes that keeps the device within 0.1 % of the unit's span;
--unit-bytes holds all units to one size. The table shows what the device form changes: `map` by its small curve,
`error` in all, both as changes of the estimate on the unit's own recording.
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Write calibration files of units, or read an export folder back and check it."""
    units = parser.add_argument_group("which units")
    add = units.add_argument
    add("--serial", action="append", default=[], metavar="S", help="a unit; may be repeated")
    add("--lot", metavar="ID", help="every unit of a lot that is released; with --serial: its lot")
    add("--revision", **COUNT, help="an older calibration; default: the one in use")
    add_shared(units, "release")
    add("--failed-too", action="store_true", help="device files of every unit, for the laboratory")
    add = parser.add_argument
    add("--format", action="append", default=[], choices=formats(), help="may be repeated")
    add("--out", required=True, **DIR, help="folder to write into or to check")
    add("--check", action="store_true", help="read back: complete, unchanged, signed by whom?")
    device = parser.add_argument_group("devices")
    add = device.add_argument
    add("--adc-bits", **COUNT, help="the converter's bits; its codes go left-aligned")
    add("--adc-full-scale", type=float, metavar="X", help="output at the converter's highest code")
    add("--max-deviation", type=float, default=0.25, metavar="SHARE", help="of the predicted error, default 0.25")
    add(
        "--unit-bytes", type=int, choices=(256, 512, 1024), help="most a unit file may take; default: as little as does"
    )
    address = converted(partial(int, base=0), "{!r} is no address such as 0x3ff00")
    add("--unit-address", type=address, default=0x3FF00, metavar="ADDR", help="for hex: 0x3ff00")
    add("--network-address", type=address, default=0x38000, metavar="ADDR", help="for hex: 0x38000")
    paper = parser.add_argument_group("certificates and signatures")
    add = paper.add_argument
    add("--laboratory", type=Path, metavar="TOML", help="laboratory, person, customer and load cell")
    add(
        "--issued-on",
        type=converted(date.fromisoformat, "{!r} is no date such as 2026-01-31"),
        metavar="DATE",
        help="date of issue of certificates; default: the file's, else today",
    )
    add("--sign", type=Path, metavar="PEM", help="Ed25519 key, encrypted or not: signs the manifest and certificates")
    add("--passphrase-file", **FILE, help="its first line opens the key of --sign")
    add(
        "--public-key",
        action="append",
        default=[],
        **FILE,
        help="with --check: a key (PEM) or a ring of keys with their validity (TOML); may be repeated",
    )
    add_shared(parser, "registry", "json", "csv")


def run(options: argparse.Namespace) -> int:
    """Export, or check a folder, or both."""
    from softcal.core.errors import InputError

    result: dict[str, object] = {"schema": "softcal.export-report/1"}
    code = 0
    if options.serial or options.lot:
        result["units"], code = _export(options)
    elif not options.check:
        raise InputError("nothing to do: give --serial or --lot with --format, or --check to check a folder")
    if options.check:
        from softcal.app.export.check import check_folder
        from softcal.app.export.signature import read_trusted_keys

        check = check_folder(options.out, read_trusted_keys(options.public_key))
        for problem in check.problems:
            echo(f"problem: {problem}")
        print_table(("question", "answer"), check.answers)
        result["check"] = {**vars(check), "problems": check.problems, "answers": dict(check.answers)}
        code = 2 if check.problems else code
    write_json(options.json, result)
    return code


def _export(options: argparse.Namespace) -> tuple[list[dict[str, object]], int]:
    from softcal.app.export.calibrated_unit import ExportOptions
    from softcal.app.export.export import export_units, lot_serials
    from softcal.app.export.signature import open_signing_key
    from softcal.core.errors import InputError, UnitRefused
    from softcal.core.export.device import DeviceOptions
    from softcal.core.unit.verdict import Release

    with registry_of(options) as registry:
        if not 0 <= options.max_deviation <= 0.5:
            raise InputError(f"--max-deviation {options.max_deviation}: 0 ... 0.5 is allowed")
        signing_key = None
        if options.sign is not None:
            ask = getpass if sys.stdin.isatty() else None
            signing_key = open_signing_key(options.sign, options.passphrase_file, ask)
        choices = ExportOptions(
            adc_bits=options.adc_bits,
            adc_full_scale=options.adc_full_scale,
            device=DeviceOptions(None, options.max_deviation, options.unit_bytes),
            unit_address=options.unit_address,
            network_address=options.network_address,
            release=Release(options.release),
            failed_too=options.failed_too,
            revision=options.revision,
            lot_id=options.lot,
            signing_key=signing_key,
            laboratory=options.laboratory,
            issued_on=options.issued_on,
        )
        serials = options.serial or lot_serials(registry, options.lot, choices)
        progress = ProgressLine("units exported", len(serials))
        formats = options.format or ["json"]
        units = export_units(registry, serials, formats, options.out, choices, lambda unit: progress.step(unit.serial))
        for unit in units:
            if unit.files:
                echo_caution(registry, (unit.serial, options.revision, options.lot), "export")
    refused = [unit for unit in units if unit.refusal]
    if len(units) == 1 and refused:
        raise UnitRefused(f"{refused[0].refusal}; written: {', '.join(refused[0].files) or 'nothing'}")
    header = ("serial", "revision", "verdict", "bytes", "map rms", "error rms", "error max", "unit", "files")
    names, rows = ("unit_bytes", "map_rms_deviation", "rms_error", "max_error", "unit"), []
    for unit in units:
        numbers = [(unit.device or {}).get(name) for name in names]
        rows.append([unit.serial, unit.revision, unit.verdict, *numbers, len(unit.files)])
    print_table(header, rows)
    _echo_cost([unit.device for unit in units if unit.device])
    for unit in refused:
        echo(f"refused: {unit.refusal}")
    return [vars(unit) for unit in units], 1 if refused else 0


def _echo_cost(devices: Sequence[Mapping[str, object]]) -> None:
    if not devices:
        return
    dearest = max(devices, key=lambda device: float(str(device["cortex_m0_ms"])))
    ms = float(str(dearest["cortex_m0_ms"]))
    echo(
        f"on a Cortex-M0+ at 48 MHz: network {dearest['network_bytes']} B, code 1.9 KB, RAM {dearest['ram_bytes']} B, "
        f"about {ms:.2f} ms per estimate (at most {1000 / ms:.0f} Hz)"
    )
