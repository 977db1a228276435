"""Drivers: found in softcal's own folder and in installed packages, with their keys, and what a broken one costs."""

import re
import subprocess
import sys
import tomllib
from dataclasses import dataclass, fields
from pathlib import Path

import pytest

from softcal.core.errors import InputError
from softcal.station.bench import catalogue
from softcal.station.bench.catalogue import SECTIONS, driver_of, list_drivers
from softcal.station.bench.station_file import station_from_table, station_toml
from softcal.station.devices.config import ReadoutConfig, StageConfig, StationConfig
from softcal.station.devices.driver import Driver
from softcal.station.drivers.grbl import DRIVERS as GRBL
from softcal.station.drivers.hx711 import Hx711Config
from softcal.station.messages import PAGES

ROOT = Path(__file__).parents[2]


def package(tmp_path, name, entry_points, code):
    """Lay an installed distribution into a folder: what pip would write."""
    (tmp_path / f"{name}.py").write_text(code)
    info = tmp_path / f"{name}-1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.2\n")
    (info / "entry_points.txt").write_text(entry_points)


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """`installed(name, entry_points, code)` puts a package on the path."""
    monkeypatch.syspath_prepend(str(tmp_path))
    before = set(sys.modules)
    yield lambda *facts: package(tmp_path, *facts)
    for name in set(sys.modules) - before:
        if name.startswith("lab_"):
            del sys.modules[name]


GOOD = """
from softcal.station.drivers.arduino import DRIVERS
from dataclasses import dataclass, replace
from softcal.station.drivers.arduino import ArduinoConfig

@dataclass(frozen=True)
class Config(ArduinoConfig):
    '''A readout of ours.

    Args:
        gain: of its amplifier.
    '''
    kind: str = "ours"
    gain: float = 1.0

DRIVER = replace(DRIVERS[0], kind="ours", config=Config)
"""


def test_every_shipped_driver_is_listed_with_its_origin():
    listed = {(offer.role, offer.kind): offer for offer in list_drivers()}
    assert {("stage", "grbl"), ("stage", "zaber"), ("stage", "esm"), ("readout", "arduino")} <= set(listed)
    assert {("cell", kind) for kind in ("hx711", "mark10", "indicator", "loadstar", "esm")} <= set(listed)
    assert all(offer.package == "softcal" and offer.version != "unknown" for offer in listed.values())


@pytest.mark.parametrize(
    "module",
    [
        "bench/bench",
        "bench/catalogue",
        "devices/driver",
        "wire/link",
        "wire/transport",
        "bench/simulated_station",
    ],
)
def test_what_opens_devices_names_no_driver(module):
    # The default kind of a section stands in config.py, and nowhere else.
    text = (ROOT / "station" / f"{module}.py").read_text()
    assert [offer.kind for offer in list_drivers() if f'"{offer.kind}"' in text] == []
    assert "softcal.station.drivers." not in text


def test_a_driver_of_an_installed_package_is_used_like_a_shipped_one(installed):
    installed("lab_ours", "[softcal.readouts]\nours = lab_ours:DRIVER\n", GOOD)
    (offer,) = [offer for offer in list_drivers() if offer.kind == "ours"]
    assert (offer.package, offer.version, offer.fault) == ("lab_ours", "1.2", "")
    config = station_from_table(
        {"stage": {"port": "a"}, "force": {"port": "f"}, "readout": {"port": "b", "kind": "ours", "gain": 3}}
    )
    assert config.readout.gain == 3.0
    assert "# gain: of its amplifier." in station_toml(config)


@pytest.mark.parametrize(
    ("entry_point", "code", "fault"),
    [
        ("softcal.readouts", "import there_is_no_such_library", "ModuleNotFoundError"),
        ("softcal.readouts", "DRIVER = 7", "softcal.station.devices.driver.Driver"),
        ("softcal.stages", GOOD, "readout 'ours'"),
        ("softcal.readouts", "raise SystemError('no dongle')", "no dongle"),
    ],
)
def test_a_broken_package_is_named_and_harms_nobody_else(installed, entry_point, code, fault):
    installed("lab_broken", f"[{entry_point}]\nours = lab_broken:DRIVER\n", code)
    (offer,) = [offer for offer in list_drivers() if offer.package == "lab_broken"]
    assert fault in offer.fault
    assert driver_of("readout", "arduino").kind == "arduino"
    role = {group: role for role, group in catalogue.GROUPS.items()}[entry_point]
    with pytest.raises(InputError, match="lab_broken"):
        driver_of(role, "ours")


OWN_MESSAGES = GOOD.replace(
    "config=Config)", 'config=Config, messages={"ours.line": "our readout sent {line}; a number was expected"})'
)
READ_LATER = """
import sys
sys.path.insert(0, sys.argv[1])
import softcal.app
from softcal.app.texts.catalogue import text
from softcal.core.messages.reason import Reason
kept = Reason.parse({"code": "ours.line", "values": {"line": "'x'"}})
assert "softcal.station.drivers.grbl" in sys.modules
print(kept)
print(text("ko", "reason.ours.line", line="'y'"))
"""


def test_what_another_package_s_driver_says_is_read_where_the_driver_was_not_loaded(installed, tmp_path):
    installed("lab_ours", "[softcal.readouts]\nours = lab_ours:DRIVER\n", OWN_MESSAGES)
    process = subprocess.run([sys.executable, "-c", READ_LATER, str(tmp_path)], capture_output=True, text=True)
    messages = ["our readout sent 'x'; a number was expected", "our readout sent 'y'; a number was expected"]
    assert process.stdout.splitlines() == messages, process.stderr


def test_a_driver_that_says_another_s_code_in_other_words_is_named(installed):
    installed(
        "lab_ours", "[softcal.readouts]\nours = lab_ours:DRIVER\n", OWN_MESSAGES.replace("ours.line", "stream.line")
    )
    (offer,) = [offer for offer in list_drivers() if offer.package == "lab_ours"]
    assert "stream.line" in offer.fault


def test_the_sentences_of_every_shipped_driver_belong_to_one():
    owned = {code for offer in list_drivers() for code in offer.driver.messages}
    assert owned == {code for page in PAGES.values() for code in page}


def test_two_packages_with_one_kind_are_both_named(installed):
    installed("lab_arduino", "[softcal.readouts]\narduino = lab_arduino:DRIVER\n", GOOD.replace('"ours"', '"arduino"'))
    with pytest.raises(InputError, match=r"softcal .*lab_arduino 1\.2"):
        driver_of("readout", "arduino")


def test_an_unknown_kind_lists_the_known_ones_of_packages_too(installed):
    installed("lab_ours", "[softcal.readouts]\nours = lab_ours:DRIVER\n", GOOD)
    with pytest.raises(InputError, match=r"readout\.kind.*'theirs'.*arduino, .*ours"):
        driver_of("readout", "theirs")


@pytest.mark.parametrize("offer", list_drivers(), ids=lambda offer: f"{offer.role} {offer.kind}")
def test_the_section_of_every_driver_survives_its_own_file_and_explains_every_key(offer):
    other = {"stage": {"port": "/dev/a"}, "force": {"port": "/dev/f"}, "readout": {"port": "/dev/b"}}
    section = SECTIONS[offer.role]
    port = "tcp://127.0.0.1:5025" if "tcp" in offer.driver.wires else "/dev/c"
    if offer.driver.config.shares_port and offer.role == "cell":
        other["stage"] = {"port": port, "kind": offer.kind}
    config = station_from_table(other | {section: {"port": port, "kind": offer.kind}})
    text = station_toml(config)
    assert station_from_table(tomllib.loads(text)) == config
    explained = re.findall(r"\w+", " ".join(line for line in text.splitlines() if line.startswith("# ")))
    assert [f.name for f in fields(offer.driver.config) if f.name not in explained] == []


@pytest.mark.parametrize(
    ("table", "code", "message"),
    [
        ({"port": "/dev/a", "axiz": "Z"}, "unknown_key", r"\[stage\].*'axiz'.*port, kind, baud_rate, axis"),
        ({"port": "/dev/a", "axis": "W"}, "known", r"stage\.axis.*X, Y, Z"),
        ({"port": "/dev/a", "axis": 3}, "wrong_type", r"stage\.axis"),
        ({"port": "/dev/a", "kind": "zaber", "microstep_mm": 0}, "positive", r"stage\.microstep_mm"),
        ({"port": "/dev/a", "kind": "zaber", "axis": "Z"}, "wrong_type", r"stage\.axis"),
        ({"kind": "esm"}, "no_key", r"\[stage\] port"),
        ({"port": "USB0::1::2::3::INSTR"}, "wrong_wire", "visa.*'grbl'.*serial, tcp"),
        ({"port": "/dev/b"}, "same_port", "'/dev/b'"),
    ],
)
def test_what_a_driver_does_not_understand_is_refused_with_what_it_does(table, code, message):
    with pytest.raises(InputError, match=message) as refused:
        station_from_table({"stage": table, "force": {"port": "/dev/f"}, "readout": {"port": "/dev/b"}})
    assert refused.value.reason.code == f"station_file.{code}"


@pytest.mark.parametrize("name", ['the "long" one', "one\\two", "two\nlines", "\u7b2c\u4e00"])
def test_any_name_of_a_station_survives_its_file(name):
    config = StationConfig(StageConfig("/dev/a"), ReadoutConfig("/dev/b"), name=name)
    assert tomllib.loads(station_toml(config))["name"] == name


def test_a_scale_of_nothing_is_refused_when_the_file_is_read():
    with pytest.raises(InputError, match="calibrate-cell"):
        Hx711Config("/dev/a", counts_per_N=0.0)


def test_a_declaration_that_is_none_is_refused():
    @dataclass(frozen=True)
    class Other:
        port: str

    with pytest.raises(ValueError, match="StageConfig"):
        Driver("x", "x", Other, GRBL[0].open, GRBL[0].simulate)
    with pytest.raises(ValueError, match="wires"):
        Driver("x", "x", GRBL[0].config, GRBL[0].open, GRBL[0].simulate, wires=())


def test_listing_drivers_needs_neither_torch_nor_streamlit_nor_pyvisa():
    code = (
        "import sys; from softcal.station.bench.catalogue import list_drivers; list_drivers(); "
        "print([m for m in ('torch', 'streamlit', 'pyvisa', 'softcal.station.bench.simulated_station') "
        "if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
