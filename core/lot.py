"""What a lot is: the facts of `lot.toml`, and how a serial may look."""

import hashlib
import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass

from softcal.core.errors import InputError
from softcal.core.messages.reason import reason

MAX_CHARACTERS, MAX_ESCAPED = 64, 215
"""Of a serial, and of its escaped form: the name of any file with it stays below the 255 bytes of file systems."""

RESERVED = re.compile(r"(?:con|prn|aux|nul|com[0-9]|lpt[0-9])(?:\..*)?", re.IGNORECASE)
"""Devices on Windows, whatever their suffix (Microsoft, Naming Files, Paths, and Namespaces)."""

INVISIBLE = frozenset("\u115f\u1160\u3164\uffa0")
"""Fillers of Hangul: letters without a glyph (Unicode, Default_Ignorable_Code_Point)."""

ESCAPED, NO_FILE_NAME = "~", frozenset('<>:"/\\|?*%')
"""What marks an escaped serial, and what no file name holds on one system or another."""


def check_serial(serial: str) -> str:
    """Return the serial in NFC; `InputError` says which character is not allowed.

    Serials become file names and bar codes: letters and digits of any script, dot, dash, underscore.
    """
    serial, serial_text = unicodedata.normalize("NFC", serial), repr(serial[:80])
    for character in serial:
        if not (_is_alphanumeric(character) or character in "._-"):
            name = f"U+{ord(character):04X} {unicodedata.name(character, '')}".strip()
            raise InputError(reason("name.character", serial=serial_text, character=name))
    if RESERVED.fullmatch(serial) or serial.endswith("."):
        raise InputError(reason("name.windows", serial=serial_text))
    lengths = {"count": len(serial), "length": len(escape_serial(serial))}
    if lengths["count"] > MAX_CHARACTERS or lengths["length"] > MAX_ESCAPED:
        raise InputError(reason("name.long", serial=serial_text, max_length=MAX_ESCAPED, **lengths))
    if not _is_alphanumeric(serial[:1]) or ".." in serial:
        raise InputError(reason("name.serial", serial=serial_text))
    return serial


def propose_serial(name: str) -> str | None:
    """Return a serial like a name: `_` stands for what no serial has. None where that is no serial either."""
    allowed = (c if _is_alphanumeric(c) or c in "._-" else "_" for c in unicodedata.normalize("NFC", name))
    proposed = re.sub(r"_{2,}", "_", "".join(allowed)).strip("._-")
    try:
        return check_serial(proposed)
    except InputError:
        return None


def _is_alphanumeric(character: str) -> bool:
    category = unicodedata.category(character) if character else ""
    return (category.startswith("L") or category == "Nd") and character not in INVISIBLE


def serial_key(serial: str) -> str:
    """Return what two serials share that nobody can tell apart on every file system: NFC, whatever the case."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", serial).casefold())


def escape_serial(serial: str) -> str:
    """Return a serial in ASCII, for file names and devices: itself, or `~` and its Punycode (RFC 3492)."""
    return serial if serial.isascii() else ESCAPED + serial.encode("punycode").decode("ascii")


def unescape_serial(escaped: str) -> str:
    """Return the serial of `escape_serial`; `ValueError`: there is none."""
    if not escaped.startswith(ESCAPED):
        return escaped
    serial = escaped[1:].encode("ascii").decode("punycode")
    if escape_serial(serial) != escaped:
        raise ValueError(f"{escaped!r} is no escaped serial")
    return serial


def row_name(name: str) -> str:
    """Return a name that is no serial as a row of a table shows it: visible, and short enough."""
    visible = "".join(c if c.isprintable() else _percent(c) for c in unicodedata.normalize("NFC", name))
    if len(visible) > MAX_CHARACTERS:
        digest = hashlib.sha256(visible.encode()).hexdigest()[:8]
        visible = f"{visible[: MAX_CHARACTERS - 9]}~{digest}"
    return visible


def file_stem(name: str) -> str:
    """Return a name that is no serial as the stem of a file on every system: what none may hold is percent-encoded."""
    stem = "".join(_percent(c) if c in NO_FILE_NAME else c for c in row_name(name))
    if RESERVED.fullmatch(stem) or stem.startswith("."):
        stem = _percent(stem[0]) + stem[1:]
    return stem[:-1] + _percent(stem[-1]) if stem.endswith((".", " ")) else stem


def _percent(character: str) -> str:
    return "".join(f"%{byte:02X}" for byte in character.encode("utf-8", "surrogatepass"))


LOT_ID = re.compile(r"[\w][\w .+-]{0,63}")


@dataclass(frozen=True, order=True)
class UnitKey:
    """What names a unit: a serial is unique within its lot alone. Its text is `LOT/SERIAL`; neither holds a slash."""

    lot_id: str
    serial: str

    def __str__(self) -> str:
        return f"{self.lot_id}/{self.serial}"

    @classmethod
    def parse(cls, text: str) -> "UnitKey":
        """Return the key of its text (`InputError`: it is none)."""
        lot_id, slash, serial = text.partition("/")
        if not slash or not LOT_ID.fullmatch(lot_id):
            raise InputError(f"{text[:160]!r} names no unit; LOT/SERIAL was expected")
        return cls(lot_id, check_serial(serial))


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
        object.__setattr__(self, "source", check_serial(self.source))
        if not LOT_ID.fullmatch(self.id):
            raise InputError(reason("name.lot", lot=repr(self.id[:80])))
        for name, value in (("sample_rate_Hz", self.sample_rate_Hz), ("limit rmse", self.limit_rmse)):
            if value is not None and not 0 < value < float("inf"):
                raise InputError(f"{name} is {value}; a positive number was expected")

    def settings(self) -> dict[str, float | str | None]:
        return {key: value for key, value in vars(self).items() if key != "id"}

    @classmethod
    def from_settings(cls, lot_id: str, settings: Mapping[str, object]) -> "Lot":
        text_fields = ("sensor_model", "reference_quantity", "reference_unit", "output_unit")
        limit, rate_Hz = settings.get("limit_rmse"), float(str(settings["sample_rate_Hz"]))
        return cls(
            lot_id,
            str(settings["source"]),
            rate_Hz,
            **{name: str(settings[name]) for name in text_fields},
            limit_rmse=None if limit is None else float(str(limit)),
        )
