"""Simulated bench instruments with SCPI on a socket: a multimeter and an LCR meter."""

import math
import re
from abc import abstractmethod
from collections import deque
from collections.abc import Callable

from softcal.station.simulated.far_end import FarEnd
from softcal.station.simulated.wire import Wire

OVERLOAD = "+9.90000000E+37"


class SimulatedScpi(FarEnd):
    """An instrument that needs a measuring time before it answers.

    Faults are switches: `is_overloaded`, `refuses` (a command it calls undefined), and all the wire can do.

    Args:
        settings: header -> value after a reset; other headers are undefined.
        measure: (simulated time) -> answer to one reading.
    """

    def __init__(
        self,
        wire: Wire,
        identity: str,
        settings: dict[str, str],
        measure: Callable[[float], str],
        measure_s: float,
    ) -> None:
        super().__init__(wire)
        self.reply_end = b"\n"
        self.identity, self._defaults, self._measure = identity, settings, measure
        self.measure_s, self.settings = measure_s, dict(settings)
        self.is_overloaded, self.refuses = False, ""
        self._errors: deque[str] = deque()
        self._triggered: deque[float] = deque()

    def take_line(self, line: bytes, now_s: float) -> None:
        for message in line.decode("ascii", "replace").strip().split(";"):
            header, _, value = message.strip().lstrip(":").partition(" ")
            if header == self.refuses and header:
                self._errors.append('-113,"Undefined header"')
            elif header == "*IDN?":
                self.send_line(self.identity, now_s)
            elif header == "SYST:ERR?":
                self.send_line(self._errors.popleft() if self._errors else '+0,"No error"', now_s)
            elif header == "*RST":
                self.settings = dict(self._defaults)
            elif header == "*CLS":
                self._errors.clear()
            elif not self.start_reading(header, now_s):
                header = re.sub(r"^CONF:(\w+(:DC)?)$", r"CONF", header)
                if header in self.settings:
                    self.settings[header] = value
                elif header:
                    self._errors.append('-113,"Undefined header"')

    def do_due(self) -> None:
        done_s = self._triggered.popleft()
        self.send_line(self._measure(done_s - self.measure_s / 2), done_s)
        self.due_s = self._triggered[0] if self._triggered else math.inf

    def trigger(self, now_s: float) -> None:
        """Start a reading; its answer follows at the end of the measuring time."""
        busy_until_s = self._triggered[-1] if self._triggered else now_s
        self._triggered.append(max(busy_until_s, now_s) + self.measure_s)
        self.due_s = self._triggered[0]

    @abstractmethod
    def start_reading(self, header: str, now_s: float) -> bool:
        """Return whether a header requests a reading, and start that reading."""


class SimulatedDmm(SimulatedScpi):
    """A 34461A: `READ?` triggers a reading and answers with a function of simulated time."""

    def __init__(self, wire: Wire, value: Callable[[float], float]) -> None:
        functions = ("RES", "FRES", "VOLT:DC")
        settings = {"CONF": "", "TRIG:SOUR": "IMM", "TRIG:DEL": "", "SAMP:COUN": "1"}
        settings |= {f"{function}:NPLC": "10" for function in functions}
        settings |= {"RES:ZERO:AUTO": "ON", "VOLT:DC:ZERO:AUTO": "ON"}
        identity = "Keysight Technologies,34461A,MY53200001,A.02.17-02.40-02.17-00.52-04-02"

        def measure(now_s: float) -> str:
            return OVERLOAD if self.is_overloaded else f"{value(now_s):+.8E}"

        super().__init__(wire, identity, settings, measure, 0.2 / 50.0 + 0.002)

    def start_reading(self, header: str, now_s: float) -> bool:
        if header == "READ?":
            self.trigger(now_s)
        return header == "READ?"


class SimulatedLcr(SimulatedScpi):
    """An E4980A: a trigger measures, `FETC?` answers; (simulated time) -> F or ohm."""

    def __init__(self, wire: Wire, value: Callable[[float], float]) -> None:
        settings = {"FORM": "ASC", "FUNC:IMP": "CPD", "FUNC:IMP:RANG:AUTO": "ON", "FUNC:IMP:RANG": "100"}
        settings |= {"FREQ": "1000", "VOLT": "1", "APER": "MED,1", "TRIG:SOUR": "INT", "INIT:CONT": "OFF"}
        self._is_triggered = False

        def measure(now_s: float) -> str:
            return "+9.90000E+37,+9.90000E+37,+1" if self.is_overloaded else f"{value(now_s):+.5E},+1.00342E-02,+0"

        super().__init__(wire, "Keysight Technologies,E4980A,MY54300001,B.07.03", settings, measure, 0.0056)

    def start_reading(self, header: str, now_s: float) -> bool:
        if header == "TRIG:IMM" and self.settings["TRIG:SOUR"] == "BUS" and self.settings["INIT:CONT"] == "ON":
            self._is_triggered = True
        elif header == "FETC?":
            if self._is_triggered:
                self.trigger(now_s)
            else:
                self.send_line("+9.90000E+37,+9.90000E+37,-1", now_s)
            self._is_triggered = False
        return header in ("TRIG:IMM", "FETC?")
