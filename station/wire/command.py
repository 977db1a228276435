"""One declared quantity of an instrument: how to ask, how to tell, its unit and its range."""

from typing import Any, Protocol, overload

from softcal.core.errors import BadReply, CommandRefused
from softcal.core.words.reason import reason
from softcal.station.named import named


class Instrument(Protocol):
    """Something that answers text with text."""

    name: str

    def ask(self, words: str) -> str:
        """Return the answer to a question."""

    def tell(self, words: str) -> None:
        """Give a command."""


class Measurement:
    """A number that can only be read; what it is in one sentence that begins with Get or Measure."""

    def __init__(self, question: str, unit: str, doc: str) -> None:
        self.question, self.unit, self.__doc__ = question, unit, doc

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, device: None, owner: type) -> "Measurement": ...
    @overload
    def __get__(self, device: Instrument, owner: type) -> float: ...
    def __get__(self, device: Instrument | None, owner: type) -> Any:
        if device is None:
            return self
        answer = device.ask(self.question)
        try:
            return float(answer)
        except ValueError as error:
            raise BadReply(
                reason("rig.number.reads", device=named(device.name), quantity=self.name, answer=repr(answer[:40]))
            ) from error


class Control(Measurement):
    """A number that can be read and set, within limits; outside of them nothing is sent.

    Args:
        command: what is told, with one format field.
    """

    def __init__(self, question: str, command: str, unit: str, limits: tuple[float, float], doc: str) -> None:
        super().__init__(question, unit, doc)
        self.command, self.limits = command, limits

    def __set__(self, device: Instrument, value: float) -> None:
        low, high = self.limits
        if not low <= value <= high:
            raise CommandRefused(
                reason(
                    "rig.outside.quantity",
                    device=named(device.name),
                    quantity=self.name,
                    value=value,
                    unit=self.unit,
                    low=low,
                    high=high,
                )
            )
        device.tell(self.command.format(value))
