"""Everything softcal raises on purpose, and the exit code of a command that ends so; wrong
arguments inside the program stay ValueError. One class for each thing a caller can handle:

    SoftcalError                 exit code 2
    ├── InputError               2
    │   ├── NotInRegistry        NoSuchLot, NoSuchUnit, NoSuchRevision, NoSuchNetwork, NoSuchRecording,
    │   │                        NoSuchOrder, NoSuchJob
    │   ├── AmbiguousUnit        it stands in several lots, or registries made the revision
    │   ├── MapsConflict         two registries put different maps into use
    │   ├── NotCalibrated        no unit of the lot is calibrated yet
    │   ├── ChangedMeanwhile     somebody else changed it first
    │   ├── StationBusy          a run is not over
    │   └── SignInRefused        name, PIN, or too many tries
    ├── DeviceError              3: CommandRefused, BadReply, NoReply, SafetyStop
    ├── RegistryError            4: NoRegistry, WrongSchema, RegistryBusy, RegistryReadOnly, RegistryDamaged
    └── UnitRefused              2
        └── NotReleased          no file of a unit that did not pass
"""

import errno
from typing import ClassVar

from softcal.core.messages.reason import Reason, plain


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
        cause: what happened, as a code with its values; a sentence where English is enough.
    """

    exit_code: ClassVar[int] = 2
    """Of a command that ends so."""

    def __init__(self, cause: Reason | str = "") -> None:
        self.reason = Reason.parse(cause)
        super().__init__(cause)

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


class NotInRegistry(InputError):
    """What was asked for by its name is not in the registry."""


class NoSuchLot(NotInRegistry):
    """No lot of this id."""


class NoSuchUnit(NotInRegistry):
    """No unit of this serial, or none in this lot."""


class NoSuchRevision(NotInRegistry):
    """The unit has no calibration, or none of this revision."""


class NoSuchNetwork(NotInRegistry):
    """No network of this id."""


class NoSuchRecording(NotInRegistry):
    """No recording of this hash."""


class NoSuchOrder(NotInRegistry):
    """No order of this id."""


class NoSuchJob(NotInRegistry):
    """No job of this id."""


class AmbiguousUnit(InputError):
    """A serial stands in several lots, or several registries made a revision: say which one is meant."""


class MapsConflict(InputError):
    """Two registries put different maps of a unit into use: a person decides."""


class NotCalibrated(InputError):
    """No unit of the lot is calibrated yet."""


class ChangedMeanwhile(InputError):
    """Somebody else changed it since it was looked at; nothing was changed: look again and decide."""


class StationBusy(InputError):
    """The station has a run that is not over."""


class SignInRefused(InputError):
    """Name or PIN is wrong, the account is not active, or there were too many tries."""


class DeviceError(SoftcalError):
    """The rig or another device failed; exit code 3."""

    exit_code = 3


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

    exit_code = 4


class NoRegistry(RegistryError):
    """There is no registry behind the URL yet."""


class WrongSchema(RegistryError):
    """The registry has a schema that this version does not know."""


class RegistryBusy(RegistryError):
    """Another program holds the registry for too long; nothing was changed: try again."""


class RegistryReadOnly(RegistryError):
    """File, folder or account lets nobody write here; nothing was changed."""


class RegistryDamaged(RegistryError):
    """The registry holds what softcal never wrote."""


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


class NotReleased(UnitRefused):
    """Files of a unit that did not pass were asked for; none was written."""


def reason_of(error: BaseException) -> Reason:
    """Return what an error says, as a value of another reason."""
    if isinstance(error, SoftcalError):
        return error.reason
    if isinstance(error, OSError) and error.strerror:
        return _OF_SYSTEM.get(error.errno or 0) or plain(error.strerror)
    return plain(str(error))


_OF_SYSTEM = {errno.ENOSPC: Reason("system.full"), errno.EACCES: Reason("system.denied")}
