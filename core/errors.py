"""Everything softcal raises on purpose.

SoftcalError
├── InputError          the caller's file, row, column, option or value; the command ends with exit code 2
├── DeviceError         the rig or another device; exit code 3
│   ├── CommandRefused  we asked for something the device does not allow; nothing moved
│   ├── BadReply        the device answered something we cannot trust
│   ├── NoReply         the device did not answer in time, or its port is gone
│   └── SafetyStop      a safety bound was met and the stage was stopped
├── RegistryError       the registry cannot be opened, read or written; exit code 4
└── UnitRefused         this unit cannot be calibrated from this recording; kept with the unit, the lot goes on

Wrong arguments inside the program stay ValueError.
"""

from softcal.core.reason import Reason


class SoftcalError(Exception):
    """Something a person can act on; its text is one clear line.

    What it quotes may come from a file or a device: a control character in it is shown by its code, never obeyed.
    """

    def __str__(self) -> str:
        return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in super().__str__())


class InputError(SoftcalError):
    """A file, row, column, option or value the caller gave cannot be used."""


class DeviceError(SoftcalError):
    """The rig or another device failed."""


class CommandRefused(DeviceError):
    """The device refused a command of ours; nothing moved."""


class BadReply(DeviceError):
    """The device answered something that cannot be trusted."""


class NoReply(DeviceError):
    """The device did not answer in time, or its port is gone."""


class SafetyStop(DeviceError):
    """A safety bound was met and the stage was stopped."""


class RegistryError(SoftcalError):
    """The registry cannot be opened, read or written."""


class UnitRefused(SoftcalError):
    """This unit cannot be calibrated from this recording; the lot goes on without it.

    Args:
        why: the reason, with its code and values; a plain sentence where it is about a file of one export.
    """

    def __init__(self, why: Reason | str) -> None:
        self.reason = Reason.of(why)
        super().__init__(str(self.reason))
