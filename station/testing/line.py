"""Simulated station of a service: every order has its unit, and faults are injected on demand."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

from softcal.core.errors import InputError
from softcal.core.messages.reason import Reason, reason
from softcal.core.twin.simulate import Twin
from softcal.station.bench.bench import Bench, open_simulated_bench
from softcal.station.bench.simulated_station import SimulatedStation
from softcal.station.testing.faults import FAULTS, Fault

NAMES = {f.name: f for f in FAULTS if (f.stage_kind, f.force_kind, f.has_cell) == ("grbl", "hx711", True)}
"""Faults of the devices that this line has."""


class SimulatedLine:
    """Opens simulated stations one after the other, as a real one is opened again after a fault.

    Args:
        time_factor: simulated seconds per real second at most; None runs as fast as the computer can.
    """

    def __init__(self, unit_of: Callable[[str], Twin], seed: int = 0, time_factor: float | None = None) -> None:
        self._unit_of, self._seed, self._time_factor = unit_of, seed, time_factor
        self._station: SimulatedStation | None = None
        self._armed: list[Fault] = []
        self._phase = ""

    @property
    def station(self) -> SimulatedStation | None:
        """The station that is open; None before the first time."""
        return self._station

    @contextmanager
    def open(self) -> Iterator[Bench]:
        """Open the station, with earlier faults repaired."""
        self._seed += 1
        with open_simulated_bench(None, self._seed, self._time_factor) as (bench, self._station):
            self._armed.clear()
            yield bench

    def mount(self, serial: str) -> None:
        self._phase = ""
        if self._station is not None and serial:
            self._station.mount(self._unit_of(serial))
        self._release("")

    def put_on(self, load: float) -> None:
        if self._station is not None:
            self._station.rig.weight_N = load
        self._release("")

    def follow(self, phase: str) -> None:
        """Receive the phase of a run, and inject the faults that wait for it."""
        if phase != self._phase:
            self._phase = phase
            self._release(phase)

    def inject(self, name: str) -> Reason:
        """Break something in the phase of its name, now or in the next run; return what will happen."""
        fault = NAMES.get(name)
        if fault is None:
            raise InputError(reason("fault.unknown", name=repr(name), known=", ".join(NAMES)))
        self._armed.append(fault)
        if fault.phase and fault.phase == self._phase:
            self._release(fault.phase)
        if fault.phase:
            return reason("fault.in_phase", name=name, phase=fault.phase)
        return reason("fault.next", name=name)

    def _release(self, phase: str) -> None:
        station = self._station
        if station is None:
            return
        due = [fault for fault in self._armed if fault.phase == phase]
        self._armed = [fault for fault in self._armed if fault.phase != phase]
        for fault in due:
            station.world.at(station.world.now_s() + fault.after_s, partial(fault.inject, station))
