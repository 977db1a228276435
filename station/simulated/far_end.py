"""Base class of simulated devices on a line, and a device that answers each line."""

import math
from collections.abc import Callable, Iterator

from softcal.station.simulated.motion import Axis
from softcal.station.simulated.wire import Wire


class FarEnd:
    """A device in simulated time: it receives bytes of the host and sends due messages.

    Args:
        wire: the line; its fault switches are this device's.
        line_end: ends the lines that the host writes.
        axis: the drive of a stage; at rest for good where the device has none.
    """

    def __init__(self, wire: Wire, line_end: bytes = b"\n", axis: Axis | None = None) -> None:
        self.wire, self.axis, self._line_end, self.reply_end = wire, axis or Axis(1.0), line_end, b"\r\n"
        self._received = b""
        self.frozen_mm: float | None = None
        """Fault switch: what a stage reports as its position, wherever it is; None for the truth."""
        self.due_s, self.period_s = math.inf, math.inf
        """When the device does something by itself, and after how long again."""

    @property
    def reported_mm(self) -> float:
        """The position that a stage reports."""
        return self.axis.position_mm if self.frozen_mm is None else self.frozen_mm

    def receive(self, now_s: float) -> None:
        """Receive the bytes that the host has written and act on them."""
        if content := self.wire.receive():
            self.axis.advance(now_s)
            self.take(content, now_s)

    def take(self, content: bytes, now_s: float) -> None:
        """Receive bytes on arrival and split them into lines."""
        *lines, self._received = (self._received + content).split(self._line_end)
        for line in lines:
            self.take_line(line, now_s)

    def take_line(self, line: bytes, now_s: float) -> None:
        """Receive one line without its end and answer it."""
        self.send_line(self.answer(line.decode("ascii", "replace").strip(), now_s), now_s)

    def answer(self, request: str, now_s: float) -> str:
        """Return the answer to one line, "" for none."""
        return ""

    def send_line(self, text: str, now_s: float) -> None:
        """Send a line to the host; nothing where there is no text."""
        if text:
            self.wire.send(text.encode() + self.reply_end, now_s)

    def coming_s(self) -> Iterator[float]:
        """Yield when the device does something by itself, now or later."""
        due_s = self.due_s
        while due_s < math.inf:
            yield due_s
            due_s += self.period_s

    def next_event_s(self) -> float:
        """Return the time of the next thing that happens by itself."""
        return min(self.due_s, self.axis.ends_s, self.wire.next_arrival_s)

    def advance(self, now_s: float) -> None:
        """Do everything that is due until now, including bytes that have reached the host."""
        self.axis.advance(now_s)
        while self.due_s <= now_s:
            self.do_due()
        if self.wire.next_arrival_s <= now_s:
            self.wire.deliver(now_s)

    def do_due(self) -> None:
        """Do the task that is due at `due_s`, and set its next time."""
        self.due_s += self.period_s


class SimulatedAnswers(FarEnd):
    """A device that answers every line.

    Args:
        answer: (words, simulated time in s) -> answer; "" for none.
    """

    def __init__(self, wire: Wire, answer: Callable[[str, float], str], line_end: bytes = b"\n") -> None:
        super().__init__(wire, line_end)
        self._answer, self.reply_end = answer, line_end

    def answer(self, request: str, now_s: float) -> str:
        return self._answer(request, now_s)
