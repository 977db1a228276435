"""Driver of a Mark-10 ESM301 or ESM303 stand and its gauge, both on one port (frames/esm.py)."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from softcal.core.errors import BadReply, DeviceError, NoReply
from softcal.core.messages.reason import Reason, reason
from softcal.station.device_names import CELL
from softcal.station.devices.config import ForceConfig, StageConfig
from softcal.station.devices.driver import Driver, Opening, Simulated, Surroundings, make_opener
from softcal.station.drivers.admission import admit
from softcal.station.interfaces import Move, OnWait, Sample, StagePosition, ignore_wait
from softcal.station.messages import PAGES
from softcal.station.simulated.esm import SimulatedEsm
from softcal.station.simulated.force_gauge import SimulatedMark10
from softcal.station.wire.frames import esm, gcl2
from softcal.station.wire.link import POLL_S, Line, Link
from softcal.station.wire.query_reader import next_query_s

STOPS_WITHIN_S = 1.0
SILENCE_S = 0.25
STATUS_S = 0.05
HOMING_S, HOMING_MM_S = 60.0, 5.0

AT_MM = 0.02
"""The stand's limits are set in steps of 0.01 mm."""

STARTS_WITHIN_S = 0.2


@dataclass(frozen=True)
class EsmConfig(StageConfig):
    """Section of the station file for a Mark-10 stand.

    Args:
        baud_rate: of its port.
        travel_mm: what may be used below the upper limit switch.
        acceleration_mm_s2: how the crosshead accelerates.
    """

    kind: str = "esm"
    baud_rate: int = 115200
    travel_mm: float = 100.0
    acceleration_mm_s2: float = 200.0

    shares_port = True


@dataclass(frozen=True)
class EsmGaugeConfig(ForceConfig):
    """Section of the station file for the gauge on a Mark-10 stand, with the port of [stage].

    Args:
        sign: 1 where compression reads positive, −1 otherwise.
    """

    kind: str = "esm"
    rate_Hz: float = 50.0
    sign: float = 1.0

    shares_port = True


class SharedPort:
    """Queries of stage and gauge on one port, answered by the stand in order."""

    def __init__(self, link: Link) -> None:
        self.link = link
        self._open: deque[tuple[float, Callable[[Line, float], None]]] = deque()

    def ask(self, question: bytes, take: Callable[[Line, float], None]) -> None:
        """Send a query; `take` receives its answer and the time of the query."""
        self._open.append((self.link.clock.now_s(), take))
        self.link.write(question)

    def read(self) -> None:
        """Hand out what has arrived; `NoReply` where a question was not answered in time."""
        for line in self.link.read_lines():
            if self._open:
                query_s, take = self._open.popleft()
                take(line, query_s)
        if self._open and self.link.clock.now_s() - self._open[0][0] > SILENCE_S:
            raise NoReply(reason("esm.no_answer", seconds=SILENCE_S))

    def resynchronise(self) -> None:
        """Discard pending queries after a lost answer, which would shift all later answers."""
        self._open.clear()
        self.link.clock.sleep_s(SILENCE_S)
        self.link.discard()

    def answer(self, question: bytes) -> bytes:
        """Ask and wait for the answer; older ones are handed out on the way."""
        answers: list[bytes] = []
        self.ask(question, lambda line, query_s: answers.append(line.text))
        while not answers:
            self.link.clock.sleep_s(POLL_S)
            self.read()
        return answers[0]


class EsmStage:
    """The stand's crosshead, positive downward, 0 at its upper limit switch.

    A move is a travel limit in limit mode: the stand itself stops there, even after a loss of the host.

    Args:
        link: the stand's port; PC control must be installed and the console chosen in its menu.

    Raises:
        NoReply: no stand answers.
    """

    name = "stage"

    def __init__(self, link: Link, travel_mm: float = 100.0, acceleration_mm_s2: float = 200.0) -> None:
        self.port = SharedPort(link)
        self.travel_mm, self.acceleration_mm_s2 = min(travel_mm, esm.LIMIT_MM), acceleration_mm_s2
        self.max_speed_mm_s = esm.SPEED_MM_MIN[1] / 60.0
        self.position_mm = self._target_mm = 0.0
        self.is_position_known = self.is_moving = False
        self._began_s = self._next_status_s = 0.0
        self._positions: list[StagePosition] = []
        link.write(esm.STOP + esm.MILLIMETRES)
        esm.parse_status(self.port.answer(esm.STATUS))

    def home(self, on_wait: OnWait = ignore_wait) -> None:
        """Drive up to the upper limit switch, and call that 0."""
        self.is_position_known = self.is_moving = False
        self._send(esm.STOP, esm.MANUAL_MODE, esm.speed(HOMING_MM_S), esm.PROGRAMMED_SPEED, esm.UP)
        end_s = self.port.link.clock.now_s() + HOMING_S
        status = self._status()
        while status.limit != "UL":
            self.port.link.clock.sleep_s(STATUS_S)
            on_wait()
            if status.motion != "U" or self.port.link.clock.now_s() > end_s:
                self._send(esm.STOP)
                raise DeviceError(Reason("esm.no_upper_limit"))
            status = self._status()
        self._send(esm.STOP, esm.ZERO_TRAVEL)
        self.position_mm = -esm.parse_travel_mm(self.port.answer(esm.TRAVEL))
        if abs(self.position_mm) > AT_MM:
            raise BadReply(reason("esm.travel", travel_mm=-self.position_mm))
        self.is_position_known = True

    def begin(self, move: Move) -> None:
        admit(self, move, esm.SPEED_MM_MIN[0] / 60.0)
        to_mm = round(move.to_mm, 2)
        self._target_mm, self._began_s = to_mm, self.port.link.clock.now_s()
        if abs(to_mm - self.position_mm) < AT_MM / 2:
            return
        is_down = to_mm > self.position_mm
        lower_mm, upper_mm = (-to_mm, 0.0) if is_down else (-self.travel_mm, -to_mm)
        self.port.link.write(
            esm.LIMIT_MODE
            + esm.lower_limit(lower_mm)
            + esm.upper_limit(upper_mm)
            + esm.speed(move.speed_mm_s)
            + esm.PROGRAMMED_SPEED
            + (esm.DOWN if is_down else esm.UP)
        )
        self.is_moving = True

    def poll(self) -> list[StagePosition]:
        self.port.read()
        now_s = self.port.link.clock.now_s()
        if now_s >= self._next_status_s:
            self._next_status_s = now_s + STATUS_S
            self.port.ask(esm.TRAVEL, self._take_travel)
            self.port.ask(esm.STATUS, self._take_status)
        positions, self._positions = self._positions, []
        return positions

    def stop(self) -> None:
        self.is_moving = False
        self._send(esm.STOP)
        try:
            self._await_standstill()
        except DeviceError:
            self.port.resynchronise()
            self.is_position_known, was_homed = False, self.is_position_known
            self._await_standstill()
            self.is_position_known = was_homed

    def close(self) -> None:
        self.port.link.close()

    def _await_standstill(self) -> None:
        end_s = self.port.link.clock.now_s() + STOPS_WITHIN_S
        while self._status().motion != "S" and self.port.link.clock.now_s() < end_s:
            self.port.link.clock.sleep_s(POLL_S)
        self.position_mm = -esm.parse_travel_mm(self.port.answer(esm.TRAVEL))

    def _send(self, *commands: bytes) -> None:
        for command in commands:
            self.port.link.write(command)

    def _status(self) -> esm.StandStatus:
        return esm.parse_status(self.port.answer(esm.STATUS))

    def _take_travel(self, line: Line, query_s: float) -> None:
        self.position_mm = -esm.parse_travel_mm(line.text)
        self._positions.append(StagePosition((query_s + line.host_s) / 2, self.position_mm))

    def _take_status(self, line: Line, query_s: float) -> None:
        status = esm.parse_status(line.text)
        if not self.is_moving or status.motion != "S" or query_s <= self._began_s:
            return
        if abs(self.position_mm - self._target_mm) <= AT_MM:
            self.is_moving = False
        elif query_s > self._began_s + STARTS_WITHIN_S:
            self.is_moving = False
            raise DeviceError(reason("esm.stopped_at", position_mm=self.position_mm, target_mm=self._target_mm))


class EsmGauge:
    """The gauge on the stand, read through the stand's port; it has no clock.

    Args:
        sign: 1 where compression reads positive, −1 where the polarity is inverted.

    Raises:
        NoReply: no gauge answers behind the stand.
        CommandRefused: peak mode, or readings without unit or sign, which its menu must change.
    """

    name = CELL
    unit = "N"

    def __init__(self, port: SharedPort, capacity_N: float, sign: float = 1.0, rate_Hz: float = 50.0) -> None:
        self._port, self.capacity_N, self._sign, self.rate_Hz = port, capacity_N, sign, rate_Hz
        self._samples: list[Sample] = []
        self._next_s = 0.0
        for command in ("CUR", "N"):
            port.link.write(esm.to_gauge(command))
        gcl2.check_settings(port.answer(esm.to_gauge("LIST")))

    def start(self) -> None:
        self._port.read()
        self._samples.clear()
        self._next_s = 0.0

    def poll(self) -> list[Sample]:
        self._port.read()
        now_s = self._port.link.clock.now_s()
        if now_s >= self._next_s:
            self._next_s = next_query_s(self._next_s, now_s, self.rate_Hz)
            self._port.ask(esm.GAUGE_READING, self._take)
        samples, self._samples = self._samples, []
        return samples

    def close(self) -> None:
        """Do nothing: the stage owns the port and closes it."""

    def _take(self, line: Line, query_s: float) -> None:
        force_N = self._sign * gcl2.parse_reading_N(line.text)
        self._samples.append(Sample((query_s + line.host_s) / 2, None, (force_N,)))


def _open(link: Link, config: EsmConfig) -> EsmStage:
    return EsmStage(link, config.travel_mm, config.acceleration_mm_s2)


def _open_gauge(config: EsmGaugeConfig, opening: Opening) -> EsmGauge:
    if not isinstance(opening.stage, EsmStage) or opening.stage.port.link.port != config.port:
        raise NoReply(reason("esm.no_stand", port=config.port))
    return EsmGauge(opening.stage.port, config.capacity_N, config.sign, config.rate_Hz)


def _simulate(around: Surroundings) -> Simulated[EsmConfig]:
    gauge = SimulatedMark10(around.wire, around.force_N)
    return Simulated(EsmConfig(around.wire.port), SimulatedEsm(around.wire, around.axis, gauge))


DRIVERS = (
    Driver(
        "esm",
        "Mark-10 ESM301 and ESM303 stands under PC control",
        EsmConfig,
        make_opener("stage", _open),
        _simulate,
        messages=PAGES["esm"],
    ),
    Driver(
        "esm",
        "the gauge on a Mark-10 stand",
        EsmGaugeConfig,
        _open_gauge,
        lambda around: Simulated(EsmGaugeConfig(around.stage_port), None),
        messages={**PAGES["esm"], **PAGES["mark10"]},
    ),
)
