"""Everything softcal raises on purpose, and the exit code of a command that ends so; wrong
arguments inside the program stay ValueError."""

import errno

from softcal.core.words.reason import Reason, plain


def printable(text: str) -> str:
    """Return a text with its control characters shown by their codes."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


class SoftcalError(Exception):
    """Something a person can act on; its text is one clear line.

    Control characters of what it quotes are shown by their codes, never obeyed.

    >>> import softcal
    >>> try:
    ...     recording = softcal.Recording([0.5, 0.6], sample_rate_Hz=50)
    ... except softcal.SoftcalError as error:
    ...     print(error)
    2 samples; at least 15 are needed to fill one window

    Args:
        said: what happened, as a code with its values; a sentence where English is enough.
    """

    def __init__(self, said: Reason | str = "") -> None:
        self.reason = Reason.of(said)
        super().__init__(said)

    def __str__(self) -> str:
        return printable(str(self.reason))


class InputError(SoftcalError):
    """A file, row, column, option or value the caller gave cannot be used; exit code 2.

    >>> import softcal
    >>> softcal.Recording([0.5] * 20, sample_rate_Hz="50")
    Traceback (most recent call last):
    ...
    softcal.core.errors.InputError: sample_rate_Hz is '50' (str); a positive number of samples a second was expected
    """


class DeviceError(SoftcalError):
    """The rig or another device failed; exit code 3."""


class CommandRefused(DeviceError):
    """The device refused a command of ours; nothing moved."""


class BadReply(DeviceError):
    """The device answered something that cannot be trusted."""


class NoReply(DeviceError):
    """The device did not answer in time, or its port is gone."""


class SafetyStop(DeviceError):
    """A safety bound was met and the stage was stopped."""


class RegistryError(SoftcalError):
    """The registry cannot be opened, read or written; exit code 4."""


class UnitRefused(SoftcalError):
    """This unit cannot be calibrated from this recording; the lot goes on without it.

    >>> import softcal
    >>> source, target = softcal.simulate_recordings()
    >>> network = softcal.fit_network(source, hidden=(8,))
    >>> try:
    ...     unit = softcal.fit_map(network, [0.5] * 600)
    ... except softcal.UnitRefused as error:
    ...     print(str(error)[:43])
    dead channel: its output never changes; che
    """


def reason_of(error: BaseException) -> Reason:
    """Return what an error says, as a value of another reason."""
    if isinstance(error, SoftcalError):
        return error.reason
    if isinstance(error, OSError) and error.strerror:
        return _OF_SYSTEM.get(error.errno or 0) or plain(error.strerror)
    return plain(str(error))


_OF_SYSTEM = {errno.ENOSPC: Reason("system.full"), errno.EACCES: Reason("system.denied")}
