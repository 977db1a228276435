"""Press unit after unit for a simulated shift and print throughput, lost samples and memory.

python benchmarks/station_soak.py [--hours H] [--quick] [--faults N] [--seed K]

With --faults, N units drawn at random meet a fault drawn at random, and the resident service is watched: after
each stop a minute passes, an order without acknowledgement is tried, then somebody acknowledges.
"""

import resource
import tempfile
import time
from collections import Counter
from functools import partial
from pathlib import Path

import numpy as np
from common.command import no_longer_than, parser_of
from common.tables import print_table

from softcal.core.orders import Order, OrderKind, Progress, StationState
from softcal.core.profiles import unit_profile
from softcal.core.quality.gate import Gate
from softcal.core.simulated_lot import draw_lot, twin_of
from softcal.station.bench.bench import open_simulated_bench
from softcal.station.bench.simulated_station import SimulatedStation
from softcal.station.tasks.acquisition import record
from softcal.station.tasks.durations import HOMING
from softcal.station.tasks.service import Hooks, StationService
from softcal.station.testing.line import NAMES, SimulatedLine

UNITS_PER_H = 90
"""About so many are pressed; faults are drawn among them."""

MOVED_MM = 0.001

RUN_OUT_S = 2.0
"""What a controller without its cable was sent before runs out in less."""

HANG_S = 120
"""A run that takes this much of the computer's time hangs; the slowest takes about 10 s."""


def main() -> None:
    """Press until the shift is over."""
    parser = parser_of(__doc__, "a tenth of an hour")
    parser.add_argument("--hours", type=float, default=1.0, help="simulated hours (default 1)")
    parser.add_argument("--faults", type=int, metavar="N", help="break the station so often, at random")
    parser.add_argument("--seed", type=int, default=1, help="of the faults (default 1)")
    options = parser.parse_args()
    if options.faults:
        with tempfile.TemporaryDirectory() as folder:
            ShiftWithFaults(Path(folder), options.seed).run(0.1 if options.quick else options.hours, options.faults)
        return
    rng, began_s = np.random.default_rng(1), time.perf_counter()
    samples, lost, units, memory_MB = 0, 0, 0, []
    with open_simulated_bench(draw_lot(rng, 1)[0], seed=1) as (bench, station):
        while bench.clock.now_s() < 3600 * (0.1 if options.quick else options.hours):
            station.mount(draw_lot(rng, 1)[0])
            recording = record(bench, f"U{units}", unit_profile(rng), with_reference=False)
            samples, lost, units = samples + len(recording.t_s), lost + recording.lost, units + 1
            memory_MB.append(_resident_MB())
        hours = bench.clock.now_s() / 3600
    late_MB = memory_MB[-1] - memory_MB[len(memory_MB) // 5]
    pace, memory = (3600 * hours / units, units / hours), (f"{memory_MB[-1]:.1f}", f"{late_MB:+.1f}")
    head = "simulated h | units | s per unit | units per h | samples | lost | memory now, MB | grown since a fifth, MB"
    print_table(head, [(f"{hours:.2f}", units, f"{pace[0]:.1f}", f"{pace[1]:.0f}", samples, lost, *memory)])
    peak_MB = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"Took {time.perf_counter() - began_s:.0f} s of real time; peak memory {peak_MB:.0f} MB.")


class ShiftWithFaults:
    """A shift of a resident service on the simulated line, and what became of every fault."""

    def __init__(self, folder: Path, seed: int) -> None:
        self._rng, self._count, self._past_s = np.random.default_rng(seed), 0, 0.0
        self._line = SimulatedLine(partial(twin_of, seed), seed)
        self._stations: list[SimulatedStation] = []
        profile = unit_profile(np.random.default_rng(seed))
        hooks = Hooks(self._follow, lambda: False, lambda kind, rig: Gate())
        self._service = StationService(self._line.open, {OrderKind.UNIT: profile}, folder, hooks)
        self._counts: Counter[str] = Counter()

    def run(self, hours: float, faults: int) -> None:
        """Press for so long, break it so often, and print the table."""
        began_s = time.perf_counter()
        units = max(faults, round(UNITS_PER_H * hours))
        broken = set(self._rng.choice(units, faults, replace=False).tolist())
        self._service.start()
        while self._now_s < 3600 * hours or broken:
            self._press(is_broken=self._count in broken)
            broken.discard(self._count)
            self._count += 1
        self._service.close()
        print_table("what | times", sorted(self._counts.items()))
        took_s = time.perf_counter() - began_s
        print(f"{self._now_s / 3600:.2f} simulated h, {self._count} units, {took_s:.0f} s of the computer.")

    @property
    def _now_s(self) -> float:
        return self._past_s + self._station.world.now_s()

    @property
    def _station(self) -> SimulatedStation:
        station = self._line.station
        if station is None:
            raise ValueError("the line is not open")
        return station

    def _follow(self, progress: Progress) -> None:
        if progress.state.is_active:
            self._line.follow(progress.phase)

    def _order(self) -> bool:
        """Press a unit; return whether there is a recording of it."""
        order = Order(f"o{time.monotonic_ns()}", "s1", OrderKind.UNIT, f"U{self._count}", "L1", "benchmark")
        with no_longer_than(HANG_S, order):
            return self._service.perform(order) is not None

    def _press(self, is_broken: bool) -> None:
        fault = str(self._rng.choice(list(NAMES))) if is_broken else ""
        if HOMING in fault:
            self._open_anew()
        if fault:
            self._line.inject(fault)
        self._line.mount(f"U{self._count}")
        try:
            is_good = self._order()
        except TimeoutError:
            self._counts["hangs"] += 1
            return
        if not fault:
            self._counts["units pressed without a fault" if is_good else "units lost without a fault"] += 1
            if is_good:
                return
        else:
            self._counts["faults"] += 1
            self._counts["faults recorded as good"] += is_good
            self._counts["faults that stopped the station"] += self._service.state is StationState.STOPPED
            if is_good:
                print(f"recorded as good: {fault}")
        self._wait_and_acknowledge(fault)

    def _open_anew(self) -> None:
        """A stage homes in the first run after its station was opened, and in no other."""
        self._past_s += self._station.world.now_s()
        self._service.close()
        self._service.start()

    def _wait_and_acknowledge(self, fault: str) -> None:
        """A minute passes, an order comes that nobody may give, then somebody acknowledges."""
        station = self._station
        station.world.sleep_s(RUN_OUT_S)
        at_mm = station.axis.position_mm
        station.world.sleep_s(60.0)
        self._order()
        station.world.sleep_s(1.0)
        moved_mm = abs(station.axis.position_mm - at_mm)
        self._past_s += station.world.now_s()
        self._service.start()
        now_mm = self._station.axis.position_mm
        self._station.world.sleep_s(10.0)
        moved_mm = max(moved_mm, abs(self._station.axis.position_mm - now_mm))
        self._counts["stops after which it moved by itself"] += moved_mm > MOVED_MM
        if moved_mm > MOVED_MM:
            print(f"moved by {moved_mm:.3f} mm: {fault}")


def _resident_MB() -> float:
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize() / 2**20


if __name__ == "__main__":
    main()
