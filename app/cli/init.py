"""`softcal init`: the first file of a lot or of a station, by questions."""

import argparse
import sys
from collections.abc import Callable
from dataclasses import MISSING, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_type_hints

from softcal.app.cli.limit import LIMIT, limit_rmse
from softcal.app.cli.options import FILE, actions_of, positive
from softcal.app.output import echo
from softcal.core.errors import InputError

if TYPE_CHECKING:
    from softcal.station.devices.config import DeviceConfig, Role

EXAMPLES = """examples:
  softcal init lot lot-1               # asks; Enter takes the value in brackets
  softcal init lot lot-1 --source S1 --sample-rate 50 --limit 0.3 --yes
  softcal init station station.toml    # asks for stage, load cell, readout, limits
then: softcal station check --station station.toml; softcal batch lot-1
"""

NO_CELL = "none"
T = TypeVar("T")


def arguments(parser: argparse.ArgumentParser) -> None:
    """Ask what a lot or a station is, and write it down. Nothing that exists is written over."""
    action = actions_of(parser, "what to make", "WHAT")
    lot = action("lot", "a folder with lot.toml, for recordings that are still to come", _make_lot)
    add = lot.add_argument
    add("folder", type=Path, metavar="FOLDER", help="lot folder to make")
    add("--lot-id", help="default: the name of the folder")
    add("--source", metavar="SERIAL", help="unit with the reference that trains f")
    add("--sample-rate", type=positive, metavar="HZ", help="samples a second of every recording")
    add("--sensor-model", help="what kind of sensor it is; audits of earlier lots count by it")
    add("--reference-quantity", help="default force")
    add("--reference-unit", help="default N")
    add("--output-unit", help="default V")
    add("--limit", **LIMIT)
    add("--yes", action="store_true", help="ask nothing: take the defaults of what is not given")
    station = action(
        "station", "a station file; `softcal station check --write` finds USB devices itself", _make_station
    )
    station.add_argument("file", **FILE, help="station file to make")


def _make_lot(options: argparse.Namespace) -> int:
    from softcal.app.files.lot_toml import write_lot_toml
    from softcal.core.lot import Lot

    folder = options.folder
    _refuse_existing(folder / "lot.toml")

    def answer(value: T | None, question: str, kind: Callable[[str], T], default: str | None) -> T:
        return value if value is not None else ask_value(question, kind, default, options.yes)

    lot = Lot(
        id=answer(options.lot_id, "id of the lot", str, folder.resolve().name),
        source=answer(options.source, "serial of the source unit (the one with the load cell)", str, None),
        sample_rate_Hz=answer(options.sample_rate, "samples a second", positive, "50"),
        sensor_model=answer(options.sensor_model, "sensor model (empty: none)", str, ""),
        reference_quantity=answer(options.reference_quantity, "what the reference measures", str, "force"),
        reference_unit=answer(options.reference_unit, "unit of the reference", str, "N"),
        output_unit=answer(options.output_unit, "unit of the output", str, "V"),
    )
    # The recordings are still to come: a share needs the largest load, and a number of it is proposed.
    largest = None
    if options.limit is None or options.limit.is_percent:
        largest = answer(None, f"largest load, in {lot.reference_unit} (empty: not known)", _load, "")
    limit = limit_rmse(options.limit, lot.reference_unit, largest, folder / "lot.toml", may_ask=not options.yes)
    lot = replace(lot, limit_rmse=limit)
    for part in ("source", "units", "audit"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    write_lot_toml(folder, lot)
    echo(f"{folder / 'lot.toml'}: lot {lot.id!r}, source {lot.source}, {lot.sample_rate_Hz:g} Hz")
    echo(f"put the source's t_s, output, reference into {folder / 'source' / lot.source}.csv,")
    echo(f"t_s, output of every other unit into {folder / 'units'}/SERIAL.csv; then: softcal batch {folder}")
    return 0


def _make_station(options: argparse.Namespace) -> None:
    from softcal.app.files.atomic import write_text
    from softcal.station.bench.catalogue import SECTIONS
    from softcal.station.bench.station_file import station_from_table, station_toml
    from softcal.station.devices.config import SafetyConfig

    _refuse_existing(options.file)
    table: dict[str, Any] = {"name": ask_value("name of the station", str, "station")}
    for role, section in SECTIONS.items():
        if device := _device(section, role):
            table[section] = device
    limits = (
        {"force_N", "deepest_mm", "speed_mm_s"} if "force" in table else {"without_cell", "deepest_mm", "speed_mm_s"}
    )
    table["safety"] = _answers("safety", SafetyConfig, limits)
    write_text(options.file, station_toml(station_from_table(table)))
    echo(f"{options.file}: every key is in it with its meaning; read it once")
    echo(f"then: softcal station check --station {options.file}")


def _device(section: str, role: "Role") -> dict[str, Any]:
    from softcal.station.bench.catalogue import driver_of, list_drivers

    none = [NO_CELL] if role == "cell" else []
    kinds = none + sorted(offer.kind for offer in list_drivers() if offer.role == role and offer.driver is not None)
    echo(f"[{section}] kinds: {', '.join(kinds)}")

    def parse_kind(text: str) -> str:
        return text if text in none else str(driver_of(role, text).kind)

    kind = ask_value(f"{section}: kind", parse_kind, None)
    if kind in none:
        return {}
    config: type[DeviceConfig] = driver_of(role, kind).config
    return {"kind": kind, **_answers(section, config, {f.name for f in fields(config)} - {"kind"})}


READERS: dict[object, Callable[[str], Any]] = {
    bool: {"true": True, "false": False}.__getitem__,
    float: float,
    int: int,
}
"""What reads the answer for a key of a type; every other is text."""


def _answers(section: str, config: type[Any], names: set[str]) -> dict[str, Any]:
    """Ask for the keys of a section, in the order and with the meaning of their declaration."""
    from softcal.station.bench.station_file import meanings

    for line in meanings(config):
        if line.strip().partition(":")[0].partition(",")[0] in names or line.startswith(" " * 8):
            echo(f"    {line.strip()}")
    types = get_type_hints(config)
    answers = {}
    for each in (each for each in fields(config) if each.name in names):
        usual = None if each.default is MISSING else str(each.default)
        if isinstance(each.default, bool):
            usual = str(each.default).lower()
        answers[each.name] = ask_value(f"{section}: {each.name}", READERS.get(types[each.name], str), usual)
    return answers


def ask_value(question: str, kind: Callable[[str], T], default: str | None, is_silent: bool = False) -> T:
    """Ask until the answer can be used; Enter takes the default.

    Raises:
        InputError: nobody to ask, and no default.
    """
    while True:
        if is_silent and default is not None:
            return kind(default)
        print(f"{question}{'' if default is None else f' [{default}]'}: ", end="", file=sys.stderr, flush=True)
        line = "" if is_silent else sys.stdin.readline()
        if not line:
            raise InputError(f"no answer to {question!r}; nothing was written; give it as an option, or answer it")
        text = line.strip() or default
        try:
            if text is not None:
                return kind(text)
        except (InputError, argparse.ArgumentTypeError) as error:
            echo(str(error))
        except (ValueError, KeyError):
            echo(f"{text!r} cannot be used here")


def _load(text: str) -> float | None:
    return positive(text) if text else None


def _refuse_existing(path: Path) -> None:
    if path.exists():
        raise InputError(f"{path} exists; it was left as it is")
