"""Every shipped driver passes the kit for drivers, and the kit fails drivers that do something else."""

import threading
from dataclasses import dataclass, replace

import pytest

from softcal.core.errors import DeviceError
from softcal.station.bench.catalogue import driver_of, list_drivers
from softcal.station.drivers.arduino import ArduinoConfig
from softcal.station.interfaces import Move
from softcal.station.testing import Nonconformity, checks

SHIPPED = [offer.driver for offer in list_drivers() if offer.package == "softcal" and offer.driver is not None]


# A reader behind a thread keeps real time: its checks wait.
CHECKS = [(check, driver.kind == "labjack") for driver in SHIPPED for check in checks(driver)]


@pytest.mark.parametrize(
    "check", [pytest.param(check, marks=[pytest.mark.long] * waits) for check, waits in CHECKS], ids=str
)
def test_shipped_driver(check):
    check()


class Wrapped:
    """A good device with one thing wrong."""

    def __init__(self, device, opening):
        self.__dict__["device"], self.__dict__["opening"] = device, opening

    def __getattr__(self, name):
        return getattr(self.device, name)

    def __setattr__(self, name, value):
        self.__dict__[name] = value


class TwoPercentOff(Wrapped):
    def poll(self):
        return [replace(s, values=tuple(1.02 * value for value in s.values)) for s in self.device.poll()]


class GivesTheLastReadingAgain(Wrapped):
    last = None

    def poll(self):
        samples = self.device.poll()
        if samples:
            self.last = samples[-1]
        elif self.last is not None:
            samples = [replace(self.last, host_s=self.opening.clock.now_s())]
        return samples


class SwallowsErrors(Wrapped):
    def poll(self):
        try:
            return self.device.poll()
        except DeviceError:
            return []


class HalfASecondLate(Wrapped):
    def start(self):
        self.held = []
        self.device.start()

    def poll(self):
        now_s = self.opening.clock.now_s()
        self.held += self.device.poll()
        due = [s for s in self.held if s.host_s < now_s - 0.5]
        self.held = [s for s in self.held if s.host_s >= now_s - 0.5]
        return [replace(s, host_s=now_s) for s in due]


class EverySecondSample(Wrapped):
    count = 0

    def poll(self):
        samples = self.device.poll()
        self.count += len(samples)
        return samples if self.count % 2 else []


class StartsWithOldReadings(Wrapped):
    is_started = False

    def start(self):
        if not self.is_started:
            self.is_started = True
            self.device.start()


class LeavesPortOpen(Wrapped):
    def close(self):
        pass


class LeavesAThread(Wrapped):
    def start(self):
        self.device.start()

    def close(self):
        self.device.close()
        threading.Thread(target=threading.Event().wait, args=(2.0,), name="left behind", daemon=True).start()


class IgnoresStop(Wrapped):
    def stop(self):
        pass


class ReportsWrongPosition(Wrapped):
    @property
    def position_mm(self):
        return self.device.position_mm + 0.1


class TakesAnything(Wrapped):
    def begin(self, move):
        if self.device.is_position_known and not self.device.is_moving:
            speed_mm_s = min(max(move.speed_mm_s, 0.1), self.device.max_speed_mm_s)
            self.device.begin(Move(min(max(move.to_mm, 0.0), self.device.travel_mm), speed_mm_s))


class CannotBeBrokenOff(Wrapped):
    def home(self, on_wait=None):
        self.device.home()


@pytest.mark.parametrize(
    ("role", "kind", "wrong", "sentences"),
    [
        ("readout", "scpi_dmm", TwoPercentOff, ["every level"]),
        ("cell", "hx711", TwoPercentOff, ["every level"]),
        ("readout", "scpi_dmm", GivesTheLastReadingAgain, ["keeps its rate", "silent device"]),
        ("cell", "mark10", SwallowsErrors, ["gone is said"]),
        ("readout", "arduino", HalfASecondLate, ["in time"]),
        ("cell", "hx711", EverySecondSample, ["keeps its rate"]),
        ("readout", "arduino", StartsWithOldReadings, ["start() throws away"]),
        ("cell", "mark10", LeavesPortOpen, ["opens again"]),
        ("readout", "scpi_lcr", LeavesAThread, ["leaves no thread"]),
        ("stage", "grbl", IgnoresStop, ["stops at once"]),
        ("stage", "zaber", IgnoresStop, ["stops at once", "silent controller", "noise is said"]),
        ("stage", "zaber", ReportsWrongPosition, ["goes where it is told"]),
        ("stage", "zaber", TakesAnything, ["only when it is homed", "refuses what it cannot do"]),
        ("stage", "grbl", CannotBeBrokenOff, ["homing can be broken off", "lets itself be watched"]),
        ("stage", "zaber", SwallowsErrors, ["silent controller", "gone is said"]),
    ],
)
def test_a_driver_with_one_thing_wrong_fails(role, kind, wrong, sentences):
    good = driver_of(role, kind)
    driver = replace(good, open=lambda config, opening: wrong(good.open(config, opening), opening))
    failed = []
    for check in checks(driver):
        try:
            check()
        except (Nonconformity, DeviceError):
            failed.append(check.sentence)
    assert [part for part in sentences if not any(part in sentence for sentence in failed)] == []


def test_a_driver_without_explained_keys_fails():
    @dataclass(frozen=True)
    class Silent(ArduinoConfig):
        """No word on its key."""

        gain: float = 1.0

    (keys,) = [
        check for check in checks(replace(driver_of("readout", "arduino"), config=Silent)) if "keys" in str(check)
    ]
    with pytest.raises(Nonconformity, match="gain"):
        keys()
