"""Simulated load cells with their own electronics on a serial line: Mark-10, Loadstar, a weighing indicator."""

import math
from collections.abc import Callable

from softcal.station.simulated.far_end import FarEnd
from softcal.station.simulated.wire import Wire

PER_NEWTON = {"N": ("N", 1.0), "LBF": ("lbF", 0.2248089), "KGF": ("kgF", 0.1019716)}


class SimulatedGauge(FarEnd):
    """A gauge that feels (true time) -> force in N."""

    def __init__(self, wire: Wire, force_N: Callable[[float], float]) -> None:
        super().__init__(wire, b"\r")
        self._force_N = force_N


class SimulatedMark10(SimulatedGauge):
    """A gauge that answers GCL2; a successful command gets no answer.

    Faults are switches: `unit`, `mode`, `is_numeric_only` as set at the gauge.
    """

    def __init__(self, wire: Wire, force_N: Callable[[float], float]) -> None:
        super().__init__(wire, force_N)
        self.unit, self.mode, self.is_numeric_only = "LBF", "PC", False
        self._zero_N = 0.0

    def answer(self, request: str, now_s: float) -> str:
        if request in ("?", "?C"):
            name, factor = PER_NEWTON[self.unit]
            reading = f"{(self._force_N(now_s) - self._zero_N) * factor:.3f}"
            return reading if self.is_numeric_only else f"{reading} {name}"
        if request == "LIST":
            kind = "NUM" if self.is_numeric_only else "FULL"
            return f"V1.00;{self.unit};{self.mode};FLTC8;FLTP1;AOUT00;AOFF5;{kind};MIT;POL;B0"
        if request in ("LB", "N", "KG"):
            self.unit = {"LB": "LBF", "N": "N", "KG": "KGF"}[request]
        elif request in ("CUR", "PT", "PC"):
            self.mode = request
        elif request == "Z":
            self._zero_N = self._force_N(now_s)
        else:
            return "*10"
        return ""


class SimulatedIndicator(SimulatedGauge):
    """An indicator that prints its reading in kg 50 times a second.

    Faults are switches: `capacity_N`, beyond which it shows OL.
    """

    def __init__(self, wire: Wire, force_N: Callable[[float], float]) -> None:
        super().__init__(wire, force_N)
        self.capacity_N, self.due_s, self.period_s = 20.0, 0.003, 1.0 / 50.0

    def do_due(self) -> None:
        force_N = self._force_N(self.due_s)
        state = "OL" if abs(force_N) > self.capacity_N else "US"
        sign = "-" if force_N < 0 else "+"
        self.send_line(f"{state},GS,{sign}{abs(force_N) / 9.80665:7.4f}kg", self.due_s)
        super().do_due()


class SimulatedLoadstar(SimulatedGauge):
    """A DI-1000 that streams in pounds, 80 readings a second, after a start command.

    Faults are switches: `model`, `unit`, and `is_faulty`, where it answers E.
    """

    def __init__(self, wire: Wire, force_N: Callable[[float], float]) -> None:
        super().__init__(wire, force_N)
        self.model, self.unit, self.is_faulty = "FCM DI-1000", "lb", False
        self.period_s = 1.0 / 80.0

    def answer(self, request: str, now_s: float) -> str:
        self.due_s = now_s + self.period_s if request == "WC" else math.inf
        return {"": "A", "MODEL": self.model, "UNITS": self.unit, "WC": ""}.get(request, "E")

    def do_due(self) -> None:
        self.send_line("E" if self.is_faulty else f"{self._force_N(self.due_s) / 4.4482216152605:.6f}", self.due_s)
        super().do_due()
