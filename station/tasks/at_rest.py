"""Reading of the sensor at rest under a load that a person applied. No commands to the stage."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from softcal.core.errors import BadReply, CommandRefused
from softcal.core.messages.reason import Reason
from softcal.core.recording import Array
from softcal.station.bench.bench import Bench
from softcal.station.motion.monitored_bench import BOOT_S
from softcal.station.motion.monitors import StreamMonitor
from softcal.station.motion.motion import TICK_S


@dataclass(frozen=True, eq=False)
class RestReading:
    """A reading at rest: output (n, channels) in its unit."""

    serial: str
    output: Array
    output_unit: str


def read_at_rest(
    bench: Bench, serial: str, settle_s: float, reading_s: float, on_look: Callable[[float, float], None]
) -> RestReading:
    """Wait until a unit has settled, then read its output.

    Args:
        on_look: called at every poll with the completed fraction and the remaining seconds; an exception ends
            the reading.
    """
    if bench.stage.is_moving:
        raise CommandRefused(Reason("rig.moves"))
    clock, readout, total_s = bench.clock, bench.readout, settle_s + reading_s
    readout.start()
    began_s = clock.now_s()
    # A board that is still booting says nothing for a while.
    bounds = replace(bench.config.safety, silence_s=max(bench.config.safety.silence_s, BOOT_S))
    monitor = StreamMonitor(readout, bounds, began_s, readout.range)
    readings: list[tuple[float, ...]] = []
    while (elapsed_s := clock.now_s() - began_s) < total_s:
        clock.sleep_s(TICK_S)
        for sample in readout.poll():
            monitor.check(sample)
            if elapsed_s >= settle_s:
                readings.append(sample.values)
        monitor.check_silence(clock.now_s())
        # Nothing old may wait in the lines of stage and load cell.
        bench.stage.poll()
        if bench.force is not None:
            try:
                bench.force.poll()
            except BadReply:
                bench.force.start()  # A hand at the unit may saturate the cell; no load is read from it here.
        on_look(min(elapsed_s / total_s, 1.0), max(0.0, total_s - elapsed_s))
    if not readings:
        monitor.check_silence(float("inf"))
    return RestReading(serial, np.array(readings, np.float64), readout.unit)
