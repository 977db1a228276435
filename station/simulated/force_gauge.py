"""Load cells with their own electronics at the far end of a serial line: Mark-10, Loadstar, a weighing indicator."""

from collections.abc import Callable

from softcal.station.simulated.wire import Wire

PER_NEWTON = {"N": ("N", 1.0), "LBF": ("lbF", 0.2248089), "KGF": ("kgF", 0.1019716)}


class SimulatedMark10:
    """A gauge that answers GCL2; a successful command gets no answer.

    Faults are switches: `unit`, `mode`, `is_numeric_only` as somebody set them by hand.

    Args:
        wire: the serial line.
        force_N: (true time) -> force.
    """

    def __init__(self, wire: Wire, force_N: Callable[[float], float]) -> None:
        self.wire, self._force_N = wire, force_N
        self.unit, self.mode, self.is_numeric_only = "LBF", "PC", False
        self._zero_N = 0.0
        self._received = b""

    def receive(self, now_s: float) -> None:
        *lines, self._received = (self._received + self.wire.receive()).split(b"\r")
        for line in lines:
            answer = self.answer(line.strip().decode("ascii", "replace"), now_s)
            if answer:
                self.wire.send(answer.encode() + b"\r\n", now_s)

    def next_event_s(self) -> float:
        return self.wire.next_arrival_s()

    def advance(self, now_s: float) -> None:
        self.wire.deliver(now_s)

    def answer(self, command: str, now_s: float) -> str:
        """Return what the gauge says to one command, "" where it says nothing."""
        if command in ("?", "?C"):
            name, factor = PER_NEWTON[self.unit]
            reading = f"{(self._force_N(now_s) - self._zero_N) * factor:.3f}"
            return reading if self.is_numeric_only else f"{reading} {name}"
        if command == "LIST":
            kind = "NUM" if self.is_numeric_only else "FULL"
            return f"V1.00;{self.unit};{self.mode};FLTC8;FLTP1;AOUT00;AOFF5;{kind};MIT;POL;B0"
        if command in ("LB", "N", "KG"):
            self.unit = {"LB": "LBF", "N": "N", "KG": "KGF"}[command]
        elif command in ("CUR", "PT", "PC"):
            self.mode = command
        elif command == "Z":
            self._zero_N = self._force_N(now_s)
        else:
            return "*10"
        return ""


class SimulatedIndicator:
    """An indicator that prints its reading in kg. A fault switch: `capacity_N`, beyond which it shows OL.

    Args:
        wire: the serial line.
        force_N: (true time) -> force.
        rate_Hz: lines per second.
        capacity_N: above it, it prints OL.
    """

    def __init__(
        self, wire: Wire, force_N: Callable[[float], float], rate_Hz: float = 50.0, capacity_N: float = 20.0
    ) -> None:
        self.wire, self._force_N, self._period_s, self.capacity_N = wire, force_N, 1.0 / rate_Hz, capacity_N
        self._due_s = 0.003

    def receive(self, now_s: float) -> None:
        self.wire.receive()

    def next_event_s(self) -> float:
        return min(self._due_s, self.wire.next_arrival_s())

    def advance(self, now_s: float) -> None:
        while self._due_s <= now_s:
            force_N = self._force_N(self._due_s)
            state = "OL" if abs(force_N) > self.capacity_N else "US"
            sign = "-" if force_N < 0 else "+"
            self.wire.send(f"{state},GS,{sign}{abs(force_N) / 9.80665:7.4f}kg\r\n".encode(), self._due_s)
            self._due_s += self._period_s
        self.wire.deliver(now_s)


class SimulatedLoadstar:
    """A DI-1000 that streams in pounds once it is asked to.

    Args:
        wire: the serial line.
        force_N: (true time) -> force.
        rate_Hz: lines per second.
    """

    def __init__(self, wire: Wire, force_N: Callable[[float], float], rate_Hz: float = 80.0) -> None:
        self.wire, self._force_N, self._period_s = wire, force_N, 1.0 / rate_Hz
        self.model, self.unit, self.is_faulty = "FCM DI-1000", "lb", False
        self._due_s = float("inf")
        self._received = b""

    def receive(self, now_s: float) -> None:
        *lines, self._received = (self._received + self.wire.receive()).split(b"\r")
        for line in lines:
            self._due_s = now_s + self._period_s if line == b"WC" else float("inf")
            answer = {b"": "A", b"MODEL": self.model, b"UNITS": self.unit, b"WC": ""}.get(line, "E")
            if answer:
                self.wire.send(answer.encode() + b"\r\n", now_s)

    def next_event_s(self) -> float:
        return min(self._due_s, self.wire.next_arrival_s())

    def advance(self, now_s: float) -> None:
        while self._due_s <= now_s:
            value = "E" if self.is_faulty else f"{self._force_N(self._due_s) / 4.4482216152605:.6f}"
            self.wire.send(value.encode() + b"\r\n", self._due_s)
            self._due_s += self._period_s
        self.wire.deliver(now_s)
