"""Driver of a Zaber stage over the ASCII protocol, firmware 6 and 7 (Zaber ASCII manual)."""

from dataclasses import dataclass

from softcal.core.errors import BadReply, CommandRefused, DeviceError, NoReply
from softcal.core.messages.reason import reason
from softcal.station.device_names import device_label
from softcal.station.devices.config import StageConfig, check_positive
from softcal.station.devices.driver import Driver, Simulated, make_opener
from softcal.station.drivers.admission import admit
from softcal.station.interfaces import Move, OnWait, StagePosition, ignore_wait
from softcal.station.messages import PAGES
from softcal.station.simulated.zaber import SimulatedZaber
from softcal.station.wire.frames import zaber
from softcal.station.wire.frames.zaber import ACCELERATION_UNIT, SPEED_UNIT
from softcal.station.wire.link import POLL_S, Link

ANSWER_S = 0.5
SILENCE_S = 0.25
STATUS_S = 0.04
HOMING_S = 60.0

STAGE = device_label("stage")
SPEEDS = (1.0, 1e9)
"""Settings of the speed that may be sent."""


@dataclass(frozen=True)
class ZaberConfig(StageConfig):
    """A Zaber device.

    Args:
        baud_rate: of its port.
        microstep_mm: travel per microstep, from the data sheet.
        device, axis: its address in the chain, and which of its axes presses.
    """

    kind: str = "zaber"
    baud_rate: int = 115200
    microstep_mm: float = 0.0001905
    device: int = 1
    axis: int = 1

    def __post_init__(self) -> None:
        check_positive("stage.microstep_mm", self.microstep_mm)


class ZaberStage:
    """One axis of a Zaber device, positive when it compresses, 0 at its home."""

    name = "stage"

    def __init__(self, link: Link, microstep_mm: float, device: int = 1, axis: int = 1) -> None:
        self._link, self._microstep_mm, self._device, self._axis = link, microstep_mm, device, axis
        self._next_id = 1
        self.is_position_known = self.is_moving = False
        self._pending_query: tuple[int, float] | None = None
        self._next_status_s = 0.0
        self.travel_mm = self._read("limit.max", "limit_max") * microstep_mm
        self.max_speed_mm_s = self._read("maxspeed", "speed") / SPEED_UNIT * microstep_mm
        self.acceleration_mm_s2 = self._read("accel", "acceleration") / ACCELERATION_UNIT * microstep_mm
        self.position_mm = self._read("pos", "position") * microstep_mm

    def home(self, on_wait: OnWait = ignore_wait) -> None:
        self.is_position_known = False
        self._clear_motion()
        self._command("home")
        end_s = self._link.clock.now_s() + HOMING_S
        while (reply := self._command("")).is_busy:
            if self._link.clock.now_s() > end_s:
                raise NoReply(reason("rig.not_home", seconds=HOMING_S))
            self._link.clock.sleep_s(STATUS_S)
            on_wait()
        self._check(reply)
        self.position_mm = self._read("pos", "position") * self._microstep_mm
        self.is_position_known = True

    def begin(self, move: Move) -> None:
        admit(self, move)
        self._clear_motion()
        speed, (low, high) = max(1.0, move.speed_mm_s / self._microstep_mm * SPEED_UNIT), SPEEDS
        if not low <= speed <= high:
            about = reason(
                "rig.outside.quantity", device=STAGE, quantity="speed", value=speed, unit="settings", low=low, high=high
            )
            raise CommandRefused(about)
        self._command(f"set maxspeed {speed:.0f}")
        self._command(f"move abs {round(move.to_mm / self._microstep_mm)}")
        self.is_moving = True
        self._next_status_s = 0.0

    def poll(self) -> list[StagePosition]:
        positions = []
        for line in self._link.read_lines():
            reply = zaber.parse_reply(line.text)
            if reply is None or self._pending_query is None or reply.message_id != self._pending_query[0]:
                continue
            query_s, self._pending_query = self._pending_query[1], None
            self._check(reply)
            try:
                self.position_mm = float(reply.data) * self._microstep_mm
            except ValueError as error:
                raise BadReply(reason("zaber.position", answer=repr(reply.data[:40]))) from error
            positions.append(StagePosition((query_s + line.host_s) / 2, self.position_mm))
            self.is_moving = reply.is_busy
        now_s = self._link.clock.now_s()
        if self._pending_query is not None and now_s - self._pending_query[1] > SILENCE_S:
            self.is_position_known = False
            raise NoReply(reason("zaber.no_status", seconds=SILENCE_S))
        if self._pending_query is None and now_s >= self._next_status_s:
            self._pending_query = (self._send("get pos"), now_s)
            self._next_status_s = now_s + STATUS_S
        return positions

    def stop(self) -> None:
        self._clear_motion()
        reply = self._command("stop")
        end_s = self._link.clock.now_s() + 2 * ANSWER_S
        while reply.is_busy and self._link.clock.now_s() < end_s:
            self._link.clock.sleep_s(POLL_S)
            reply = self._command("")
        self.is_position_known = self.is_position_known and not reply.is_busy and not reply.warning.startswith("F")
        self.position_mm = self._read("pos", "position") * self._microstep_mm

    def close(self) -> None:
        self._link.close()

    def _read(self, setting: str, quantity: str) -> float:
        answer = self._command(f"get {setting}").data
        try:
            return float(answer)
        except ValueError as error:
            about = {"quantity": quantity, "answer": repr(answer[:40])}
            raise BadReply(reason("rig.number.reads", device=STAGE, **about)) from error

    def _command(self, instruction: str) -> zaber.Reply:
        message_id = self._send(instruction)
        end_s = self._link.clock.now_s() + ANSWER_S
        while True:
            line = self._link.next_line(max(0.0, end_s - self._link.clock.now_s()))
            reply = zaber.parse_reply(line.text)
            if reply is not None and reply.message_id == message_id:
                break
        if not reply.is_ok:
            raise CommandRefused(reason("zaber.rejected", words=repr(instruction), why=reply.data))
        return reply

    def _send(self, instruction: str) -> int:
        message_id, self._next_id = self._next_id, self._next_id % 98 + 1
        self._link.write(zaber.format_command(zaber.Command(self._device, self._axis, message_id, instruction)))
        return message_id

    def _check(self, reply: zaber.Reply) -> None:
        if not reply.is_fault and not (self.is_position_known and reply.warning in zaber.NOT_HOMED):
            return
        self.is_position_known = self.is_moving = False
        cause = zaber.WARNINGS.get(reply.warning, reply.warning)
        raise DeviceError(reason("zaber.warning", code=reply.warning, why=cause))

    def _clear_motion(self) -> None:
        self.is_moving, self._pending_query = False, None


DRIVERS = (
    Driver(
        "zaber",
        "Zaber stages, ASCII protocol, firmware 6 and 7",
        ZaberConfig,
        make_opener("stage", lambda link, config: ZaberStage(link, config.microstep_mm, config.device, config.axis)),
        lambda around: Simulated(ZaberConfig(around.wire.port), SimulatedZaber(around.wire, around.axis)),
        messages=PAGES["zaber"],
    ),
)
