"""Readings through a blocking library, which a separate thread calls."""

import math
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from softcal.core.errors import DeviceError, NoReply
from softcal.core.messages.reason import reason
from softcal.station.device_names import device_label
from softcal.station.interfaces import Clock, Sample
from softcal.station.wire.query_reader import next_query_s


@dataclass(frozen=True)
class Reading:
    """Result of one call of a library.

    Args:
        values: one number per channel, in the unit the reader declares.
        device_s: when the device took it, by the device's own clock; None where it has none. The same time again is
            the same reading again: libraries that keep the newest value hand it out until there is another.
    """

    values: tuple[float, ...]
    device_s: float | None = None


class ThreadedReader:
    """Calls a blocking function at a constant rate; `poll` returns its results and never blocks.

    A call that does not return, and a library that goes on giving the same reading, are stale data: `poll` raises.

    Args:
        read: one reading; blocks as long as it must. Any error it raises ends the readings.
        close_library: gives the device back; called once, from the thread that closes.
        stale_s: no new reading for so long is an error.
        channels: numbers per reading.
        limits: of a readout: lowest and highest reading; one that stays there is saturated.
    """

    def __init__(
        self,
        name: str,
        unit: str,
        rate_Hz: float,
        clock: Clock,
        read: Callable[[], Reading],
        close_library: Callable[[], None],
        stale_s: float = 0.5,
        channels: int = 1,
        limits: tuple[float, float] = (-math.inf, math.inf),
    ) -> None:
        self.name, self.unit, self.rate_Hz = name, unit, rate_Hz
        self.channels, self.range = channels, limits
        self._clock, self._read, self._close_library, self._stale_s = clock, read, close_library, stale_s
        self._lock = threading.Lock()
        self._samples: deque[Sample] = deque()
        self._fault: Exception | None = None
        self._discard_before_s = self._newest_s = clock.now_s()
        self._device_s: float | None = None
        self._ends = threading.Event()
        self._is_closed = False
        self._thread = threading.Thread(target=self._read_repeatedly, name=name, daemon=True)
        self._thread.start()

    def start(self) -> None:
        """Discard earlier readings; only later readings count."""
        with self._lock:
            self._samples.clear()
            self._discard_before_s = self._newest_s = self._clock.now_s()

    def poll(self) -> list[Sample]:
        """Return the readings since the last call, oldest first; each from the middle of its call.

        Raises:
            NoReply: nothing new for `stale_s`, or the library's own error.
            DeviceError: whatever `read` raised of this kind.
        """
        with self._lock:
            samples = list(self._samples)
            self._samples.clear()
            fault, newest_s = self._fault, self._newest_s
        if samples:
            return samples
        if isinstance(fault, DeviceError):
            raise fault
        if fault is not None:
            error_text = f"{type(fault).__name__}: {fault}" if str(fault) else type(fault).__name__
            raise NoReply(reason("rig.library.ended", device=device_label(self.name), what=error_text)) from fault
        silent_s = self._clock.now_s() - newest_s
        if silent_s > self._stale_s:
            raise NoReply(reason("rig.library.silent", device=device_label(self.name), seconds=silent_s))
        return []

    def close(self) -> None:
        """End the thread and give the device back; a call that hangs is left behind."""
        if self._is_closed:
            return
        self._is_closed = True
        self._ends.set()
        self._thread.join(self._stale_s + 1.0)
        with suppress(Exception):  # Libraries complain about a device that is gone already.
            self._close_library()
        self._thread.join(self._stale_s)  # Closing ends the call of most libraries.

    def _read_repeatedly(self) -> None:
        next_s = self._clock.now_s()
        while not self._ends.is_set():
            call_s = self._clock.now_s()
            try:
                reading = self._read()
            except Exception as error:  # What a library raises is its own choice; poll says it.
                with self._lock:
                    self._fault = error
                return
            now_s = self._clock.now_s()
            is_new = reading.device_s is None or self._device_s is None or reading.device_s > self._device_s
            with self._lock:
                if is_new and call_s >= self._discard_before_s:
                    self._device_s, self._newest_s = reading.device_s, now_s
                    self._samples.append(Sample((call_s + now_s) / 2, reading.device_s, reading.values))
            next_s = next_query_s(next_s, call_s, self.rate_Hz)
            self._clock.wait(self._ends, next_s - now_s)
