"""A device that answers lines of text at the far end of a line: enough for most instruments of a laboratory."""

from collections.abc import Callable

from softcal.station.simulated.wire import Wire


class SimulatedAnswers:
    """Answers every line it gets.

    Args:
        wire: the line; its fault switches are this device's.
        answer: (words, simulated time in s) -> answer; "" for none.
        line_end: ends what the host writes and what it reads.
    """

    def __init__(self, wire: Wire, answer: Callable[[str, float], str], line_end: bytes = b"\n") -> None:
        self.wire, self._answer, self._line_end = wire, answer, line_end
        self._received = b""

    def receive(self, now_s: float) -> None:
        *lines, self._received = (self._received + self.wire.receive()).split(self._line_end)
        for line in lines:
            text = self._answer(line.decode("ascii", "replace").strip(), now_s)
            if text:
                self.wire.send(text.encode() + self._line_end, now_s)

    def next_event_s(self) -> float:
        return self.wire.next_arrival_s()

    def advance(self, now_s: float) -> None:
        self.wire.deliver(now_s)
