"""From `stop` to the stop command at the device: softcal's own Zaber driver, and the maker's library.

    python benchmarks/station_zaber_library.py

Both speak to the same simulated device over a pseudo terminal in real time, while the position is asked as in a run:
on a healthy line, and on one that has just fallen silent. The library waits for each answer in turn; the stop is
given from another thread, as a program would that must not wait.
"""

import threading
import time
from collections.abc import Callable

import numpy as np
from zaber_motion import Units
from zaber_motion.ascii import Connection

from softcal.core.errors import DeviceError
from softcal.station.clock import HostClock
from softcal.station.drivers.zaber import ZaberStage
from softcal.station.interfaces import Move
from softcal.station.link import Link
from softcal.station.simulated.motion import Axis
from softcal.station.simulated.wire import Wire
from softcal.station.simulated.world import World
from softcal.station.simulated.zaber import SimulatedZaber

RUNS = 20
MOVING_S = 0.3


class Watched(SimulatedZaber):
    """Notes when a stop arrives."""

    stopped_s = float("nan")

    def _do(self, words: str) -> tuple[bool, str]:
        if words == "stop":
            self.stopped_s = time.monotonic()
        return super()._do(words)


def _far_end(seed: int) -> tuple[World, Watched]:
    world, wire = World(), Wire(np.random.default_rng(seed))
    far_end = Watched(wire, Axis(200.0))
    world.add(far_end)
    return world, far_end


def _own(far_end: Watched, is_silent: bool) -> float:
    stage = ZaberStage(Link(far_end.wire.port, HostClock()), 0.0001905)
    stage.home()
    stage.begin(Move(30.0, 5.0))
    end_s = time.monotonic() + MOVING_S
    while time.monotonic() < end_s:
        time.sleep(0.005)
        stage.poll()
    far_end.wire.is_silent = is_silent
    time.sleep(0.005)
    stage.poll()
    asked_s = time.monotonic()
    try:
        stage.stop()
    except DeviceError:
        pass  # On a silent line: it was told.
    stage.close()
    return far_end.stopped_s - asked_s


def _library(far_end: Watched, is_silent: bool) -> float:
    with Connection.open_serial_port(far_end.wire.port) as connection:
        axis = connection.get_device(1).get_axis(1)
        axis.home()
        axis.move_absolute(100_000, Units.NATIVE, wait_until_idle=False)
        goes_on = threading.Event()

        def poll() -> None:
            while not goes_on.wait(0.04):
                try:
                    axis.get_position(Units.NATIVE)
                except Exception:
                    return

        thread = threading.Thread(target=poll)
        thread.start()
        time.sleep(MOVING_S)
        far_end.wire.is_silent = is_silent
        time.sleep(0.05)
        asked_s = time.monotonic()
        try:
            axis.stop(wait_until_idle=False)
        except Exception as error:
            print(f"    the library: {type(error).__name__} after {time.monotonic() - asked_s:.2f} s")
        goes_on.set()
        thread.join()
    return far_end.stopped_s - asked_s


def _measure(stop: Callable[[Watched, bool], float], is_silent: bool, runs: int) -> str:
    latencies_ms = []
    for seed in range(runs):
        world, far_end = _far_end(seed)
        with world.in_background(0.0005):
            latencies_ms.append(1e3 * stop(far_end, is_silent))
        far_end.wire.close()
    return f"median {np.median(latencies_ms):6.1f} ms, largest {np.max(latencies_ms):7.1f} ms"


def main() -> None:
    """Print the table."""
    for is_silent, runs in ((False, RUNS), (True, 3)):
        line = "silent line" if is_silent else "healthy line"
        print(f"{line}: own frames    {_measure(_own, is_silent, runs)}")
        print(f"{line}: zaber-motion  {_measure(_library, is_silent, runs)}")


if __name__ == "__main__":
    main()
