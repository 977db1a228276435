"""A Zaber stage with one axis at the far end of a serial line (Zaber ASCII manual)."""

from softcal.core.errors import BadReply
from softcal.station.simulated.far_end import FarEnd
from softcal.station.simulated.motion import Axis, QueuedMove
from softcal.station.simulated.wire import Wire
from softcal.station.wire.frames import zaber
from softcal.station.wire.frames.zaber import ACCELERATION_UNIT, SPEED_UNIT

HOMING_MM_S = 10.0


class SimulatedZaber(FarEnd):
    """A device with address 1 and one axis, whose position counts from home.

    Faults are switches: `warning` (sent with every reply), `stall()`, `turn_knob()`, and all the wire can do.
    """

    def __init__(self, wire: Wire, axis: Axis, travel_mm: float = 40.0, microstep_mm: float = 0.0001905) -> None:
        super().__init__(wire, axis=axis)
        self.microstep_mm = microstep_mm
        self.warning = ""
        self._is_homed = self._is_homing = False
        self.settings: dict[str, float] = {
            "deviceid": 50081,
            "system.serial": 81234,
            "system.axiscount": 1,
            "version": 7.38,
            "version.build": 16000,
            "device.hw.modified": 0,
            "comm.command.packets.max": 1,
            "comm.packet.size.max": 80,
            "comm.word.size.max": 50,
            "get.settings.max": 10,
            "resolution": 64,
            "peripheralid": 0,
            "limit.min": 0,
            "limit.max": round(travel_mm / microstep_mm),
            "maxspeed": round(25.0 / microstep_mm * SPEED_UNIT),
            "accel": round(axis.acceleration_mm_s2 / microstep_mm * ACCELERATION_UNIT),
        }

    def take_line(self, line: bytes, now_s: float) -> None:
        try:
            command, has_checksum = zaber.parse_command(line.rstrip())
        except BadReply:
            return  # A device does not answer what it cannot read.
        if command.device not in (0, 1):
            return
        is_ok, data = self._do(command.instruction)
        warning = self.warning or ("--" if self._is_homed else "WR")
        reply = zaber.Reply(1, command.axis, command.message_id, is_ok, self.axis.is_moving, warning, data)
        self.wire.send(zaber.format_reply(reply, has_checksum), now_s)

    def advance(self, now_s: float) -> None:
        super().advance(now_s)
        if self._is_homing and not self.axis.is_moving:
            self._is_homed, self._is_homing = True, False

    def stall(self) -> None:
        """Block the carriage; the device stops and reports the stall."""
        self.axis.flush()
        self.warning = "FS"

    def turn_knob(self) -> None:
        self.axis.flush()
        self.warning = "NC"

    def _do(self, instruction: str) -> tuple[bool, str]:
        match instruction.split():
            case []:
                return True, "0"
            case ["get", "pos"]:
                return True, str(round(self.reported_mm / self.microstep_mm))
            case ["get", name] if name in self.settings:
                return True, f"{self.settings[name]:.10g}"
            case ["set", name, value] if name in self.settings:
                self.settings[name] = float(value)
                return True, "0"
            case ["move", ("abs" | "rel") as kind, value]:
                start_mm = self.axis.position_mm if kind == "rel" else 0.0
                to_mm = start_mm + float(value) * self.microstep_mm
                if not -1e-9 <= to_mm <= self.settings["limit.max"] * self.microstep_mm + 1e-9:
                    return False, "BADDATA"
                self.axis.flush()
                self.axis.add(QueuedMove(to_mm, self.settings["maxspeed"] / SPEED_UNIT * self.microstep_mm))
                return True, "0"
            case ["home"]:
                self.warning, self._is_homing = "", True
                self.axis.flush()
                self.axis.add(QueuedMove(0.0, HOMING_MM_S))
                self._is_homed = not self.axis.is_moving
                return True, "0"
            case ["stop"]:
                self.axis.brake()
                self._is_homing = False
                return True, "0"
            case ["estop"]:
                self.axis.flush()
                return True, "0"
            case ["warnings", *_]:
                return True, "00"
        return False, "BADCOMMAND"
