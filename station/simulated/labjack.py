"""Simulated LabJack, and the substitute for the LJM library in front of it."""

import socket
from collections.abc import Callable
from contextlib import suppress

from softcal.station.simulated.far_end import SimulatedAnswers
from softcal.station.simulated.wire import Wire

TIMEOUT_S = 3.0
REGISTERS = {"_RANGE": 10.0, "_RESOLUTION_INDEX": 0.0}


class SimulatedLabjack(SimulatedAnswers):
    """Answers `number NAME[=value] …` with `number value … checksum`, as Modbus does."""

    def __init__(self, wire: Wire, inputs_V: Callable[[float], tuple[float, ...]]) -> None:
        super().__init__(wire, self._reply)
        self._inputs_V = inputs_V
        self.registers: dict[str, float] = {}

    def _reply(self, instruction: str, now_s: float) -> str:
        number, *names = instruction.split()
        values = [f"{self._value(name, now_s):.6f}" for name in names]
        content = " ".join([number, *values])
        return f"{content} {sum(content.encode())}"

    def _value(self, name: str, now_s: float) -> float:
        name, _, value = name.partition("=")
        if name.endswith(tuple(REGISTERS)):
            if value:
                self.registers[name] = float(value)
            return self.registers.get(name, 0.0)
        return self._inputs_V(now_s)[int(name.removeprefix("AIN"))]


class SimulatedLjm:
    """The functions of `labjack.ljm` that softcal uses, in front of a simulated LabJack."""

    class LJMError(Exception):
        """The library's only kind of error."""

    def __init__(self) -> None:
        self._sockets: dict[int, socket.socket] = {}
        self._number = 0

    def openS(self, deviceType: str = "ANY", connectionType: str = "ANY", identifier: str = "ANY") -> int:  # noqa: V107
        host, _, port = identifier.removeprefix("tcp://").rpartition(":")
        try:
            line = socket.create_connection((host, int(port)), TIMEOUT_S)
        except (OSError, ValueError) as error:
            raise self.LJMError("LJME_DEVICE_NOT_FOUND") from error
        handle = len(self._sockets) + 1
        self._sockets[handle] = line
        try:
            self._ask(handle, [])
        except BaseException:
            self.close(handle)
            raise
        return handle

    def close(self, handle: int) -> None:
        with self._sockets.pop(handle) as line, suppress(OSError):
            line.shutdown(socket.SHUT_RDWR)  # A call of another thread ends.

    def eReadName(self, handle: int, name: str) -> float:
        return self._ask(handle, [name])[0]

    def eReadNames(self, handle: int, numFrames: int, aNames: list[str]) -> list[float]:
        return self._ask(handle, aNames[:numFrames])

    def eWriteName(self, handle: int, name: str, value: float) -> None:
        self._ask(handle, [f"{name}={value}"])

    def _ask(self, handle: int, instruction: list[str]) -> list[float]:
        self._number += 1
        line = self._sockets.get(handle)
        if line is None:
            raise self.LJMError("LJME_DEVICE_NOT_OPEN")
        try:
            line.sendall(" ".join([str(self._number), *instruction]).encode() + b"\n")
            return self._answer(line, len(instruction))
        except OSError as error:
            raise self.LJMError("LJME_RECONNECT_FAILED") from error

    def _answer(self, line: socket.socket, count: int) -> list[float]:
        received = b""
        while True:
            piece = line.recv(4096)
            if not piece:
                raise ConnectionResetError
            *answers, received = (received + piece).split(b"\n")
            for answer in answers:
                content, _, checksum = answer.rpartition(b" ")
                number, *values = content.split() or [b""]
                if checksum == str(sum(content)).encode() and number == str(self._number).encode():
                    if len(values) != count:
                        raise self.LJMError("LJME_INVALID_RESPONSE")
                    return [float(value) for value in values]
