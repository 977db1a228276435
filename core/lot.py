"""What a lot is: the facts of `lot.toml`, and how a serial may look."""

import re
from collections.abc import Mapping
from dataclasses import dataclass

from softcal.core.errors import InputError
from softcal.core.words.reason import reason

SERIAL = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
"""Serials become file names and bar codes: letters, digits, dot, dash, underscore, at most 64."""


RESERVED = re.compile(r"(?:con|prn|aux|nul|com[0-9]|lpt[0-9])(?:\..*)?", re.IGNORECASE)
"""Devices on Windows, whatever their suffix (Microsoft, Naming Files, Paths, and Namespaces)."""


def check_serial(serial: str) -> str:
    """Return the serial, or raise `InputError` saying which characters are allowed."""
    if RESERVED.fullmatch(serial) or serial.endswith("."):
        raise InputError(reason("name.windows", serial=repr(serial[:80])))
    if not SERIAL.fullmatch(serial) or ".." in serial:
        raise InputError(reason("name.serial", serial=repr(serial[:80])))
    return serial


@dataclass(frozen=True)
class Lot:
    """The units made together, calibrated against a source unit or several.

    Args:
        source: serial of the first source unit.
        reference_quantity, reference_unit: of the source's reference, for example force in N.
        limit_rmse: largest error of a unit in `reference_unit`; None: by the source's own error.
    """

    id: str
    source: str
    sample_rate_Hz: float
    sensor_model: str = ""
    reference_quantity: str = "force"
    reference_unit: str = "N"
    output_unit: str = "V"
    limit_rmse: float | None = None

    def __post_init__(self) -> None:
        check_serial(self.source)
        if not re.fullmatch(r"[\w][\w .+-]{0,63}", self.id):
            raise InputError(reason("name.lot", lot=repr(self.id[:80])))
        for name, value in (("sample_rate_Hz", self.sample_rate_Hz), ("limit rmse", self.limit_rmse)):
            if value is not None and not 0 < value < float("inf"):
                raise InputError(f"{name} is {value}; a positive number was expected")

    def settings(self) -> dict[str, float | str | None]:
        return {key: value for key, value in vars(self).items() if key != "id"}

    @classmethod
    def from_settings(cls, lot_id: str, settings: Mapping[str, object]) -> "Lot":
        words = ("sensor_model", "reference_quantity", "reference_unit", "output_unit")
        limit, rate_Hz = settings.get("limit_rmse"), float(str(settings["sample_rate_Hz"]))
        return cls(
            lot_id,
            str(settings["source"]),
            rate_Hz,
            **{name: str(settings[name]) for name in words},
            limit_rmse=None if limit is None else float(str(limit)),
        )
