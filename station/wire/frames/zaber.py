"""Zaber ASCII protocol: commands and replies with address, message id, checksum (Zaber ASCII manual). No I/O here."""

from dataclasses import dataclass

from softcal.core.errors import BadReply
from softcal.core.messages.reason import Reason, reason

_FLAGS = "FF FN FZ FH FV FO FC FM FD FQ FI FA FR FS FB FP FE FT WS WR WH NC NI"
WARNINGS = {flag: Reason(f"zaber.flag.{flag}") for flag in _FLAGS.split()}
"""Warning flags that matter here; a device reports its worst one in every reply."""

NOT_HOMED = ("WR", "WH")

SPEED_UNIT = 1.6384
"""A speed setting is microsteps per second times this; an acceleration setting is that per 10 000 s of second."""

ACCELERATION_UNIT = SPEED_UNIT / 10_000


@dataclass(frozen=True)
class Command:
    """One command of the Zaber protocol.

    Args:
        message_id: echoed by the device; None when it was not given.
        instruction: the command itself, "" asks only for the status.
    """

    device: int
    axis: int
    message_id: int | None
    instruction: str


@dataclass(frozen=True)
class Reply:
    """One reply of the Zaber protocol.

    Args:
        message_id: of the command, where it had one.
        is_ok: OK, or rejected (RJ): then `data` says why.
        is_busy: whether the axis moves.
        warning: worst warning flag, "--" for none.
    """

    device: int
    scope: int
    message_id: int | None
    is_ok: bool
    is_busy: bool
    warning: str
    data: str

    @property
    def is_fault(self) -> bool:
        """Whether the last move cannot be trusted: a fault, or an interruption."""
        return self.warning.startswith("F") or self.warning in ("WS", "NI", "NC")


def lrc(content: bytes) -> bytes:
    """Return the checksum of the characters between the first character and the colon."""
    return b"%02X" % (-sum(content) & 0xFF)


def format_command(command: Command) -> bytes:
    """Return a command with its checksum."""
    identity = "" if command.message_id is None else f" {command.message_id:02d}"
    instruction = f" {command.instruction}" if command.instruction else ""
    content = f"{command.device} {command.axis}{identity}{instruction}".encode()
    return b"/" + content + b":" + lrc(content) + b"\n"


def parse_command(line: bytes) -> tuple[Command, bool]:
    """Return a command and whether it has a checksum; raise `BadReply` for no command or a wrong checksum."""
    if not line.startswith(b"/"):
        raise BadReply(reason("zaber.no_command", line=repr(line[:40])))
    content, has_checksum = _without_checksum(line)
    numbers: list[int] = []
    tokens = content.decode("ascii", "replace").split()
    while tokens and len(numbers) < 3 and tokens[0].isdigit():
        numbers.append(int(tokens.pop(0)))
    device, axis = [*numbers, 0, 0][:2]
    return Command(device, axis, numbers[2] if len(numbers) == 3 else None, " ".join(tokens)), has_checksum


def format_reply(reply: Reply, has_checksum: bool) -> bytes:
    """Return a reply in the device's format."""
    identity = "" if reply.message_id is None else f" {reply.message_id:02d}"
    fields = ("OK" if reply.is_ok else "RJ", "BUSY" if reply.is_busy else "IDLE", reply.warning, reply.data)
    content = f"{reply.device:02d} {reply.scope}{identity} {' '.join(fields)}".encode()
    return b"@" + content + (b":" + lrc(content) if has_checksum else b"") + b"\r\n"


def parse_reply(line: bytes) -> Reply | None:
    """Return a reply; None for an info or alert line; `BadReply`: noise, or a wrong checksum."""
    if line[:1] in (b"#", b"!"):
        _without_checksum(line)
        return None
    try:
        content, _ = _without_checksum(line)
        tokens = content.decode("ascii").split(" ")
        device, scope = int(tokens[0]), int(tokens[1])
        message_id = int(tokens.pop(2)) if tokens[2].isdigit() else None
        verdict, state, warning, *data = tokens[2:]
    except (ValueError, IndexError) as error:
        raise BadReply(reason("zaber.noise", line=repr(line[:60]))) from error
    if line[:1] != b"@" or verdict not in ("OK", "RJ") or state not in ("BUSY", "IDLE"):
        raise BadReply(reason("zaber.noise", line=repr(line[:60])))
    return Reply(device, scope, message_id, verdict == "OK", state == "BUSY", warning, " ".join(data))


def _without_checksum(line: bytes) -> tuple[bytes, bool]:
    content, colon, checksum = line[1:].rstrip().partition(b":")
    if colon and checksum != lrc(content):
        raise BadReply(reason("zaber.checksum", line=repr(line[:60]), checksum=lrc(content).decode()))
    return content, bool(colon)
