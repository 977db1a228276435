"""Detection of the encoding of a text file."""

import codecs
import re
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from softcal.core.errors import InputError

NOT_UTF_8 = "not UTF-8"
"""How the remark on an encoding begins that was taken for the likeliest one."""

BLOCK_BYTES = 1 << 20
MARKS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF32_LE, "utf-32"), (codecs.BOM_UTF16_LE, "utf-16"),
         (codecs.BOM_UTF16_BE, "utf-16"))  # fmt: skip
"""Byte order marks; UTF-32's begins with UTF-16's."""

BINARY = (b"%PDF", b"PK\x03\x04", b"\xd0\xcf\x11\xe0", b"\x89HDF", b"PAR1", b"ARROW1", b"TDSm", b"\x1f\x8b")
"""How files of other formats begin: PDF, .xlsx, .xls, HDF5, Parquet, Arrow, TDMS, gzip."""

LATIN = re.compile(r"[\x00-\x7f°±²³µ·×÷ÄÖÜäöüßÅåØøÆæÀÂÇÈÉÊËÎÏÔÙÛàâçèéêëîïôùûÑñÁÍÓÚáíóúÃÕãõìòº\u00a0]*")

HANGUL = re.compile(r"[\x00-\x7f\u00b0-\u00b7×÷\u2000-\u33ff\uac00-\ud7a3]*")
"""Korean without Chinese characters: other texts of two bytes a character, read as EUC-KR, are no such text."""

EXTEND_ASCII = ["gb18030", "cp932", "big5", "cp1250", "cp1251", "cp1252", "cp1253", "cp1254", "cp1255"]
"""Other encodings of text files whose delimiters and numbers are bytes of ASCII."""

CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f\x7f-\x9f\ufffd]")


@dataclass(frozen=True)
class Encoding:
    """Name of an encoding, with a remark on its detection."""

    name: str
    remark: str = ""

    @property
    def bytes_per_character(self) -> int:
        return {"utf-16": 2, "utf-16-le": 2, "utf-16-be": 2, "utf-32": 4}.get(self.name, 1)


def is_text(head: bytes) -> bool:
    """Return whether the beginning of a file is plain text, whatever its name."""
    return b"\n" in head and not head.lstrip().startswith(b"<") and head.isascii() and b"\0" not in head


def detect_encoding(file: BinaryIO, path: Path, declared: str | None) -> Encoding:
    """Return the encoding of a text file; the file is left at its beginning.

    Raises:
        InputError: the declared encoding is none, or the file is no text.
    """
    head = file.read(4096)
    file.seek(0)
    if declared is not None:
        try:
            return Encoding(codecs.lookup(declared).name)
        except LookupError as error:
            raise InputError(
                f"--encoding {declared}: no such encoding; utf-8, utf-16, latin-1, cp949 are some"
            ) from error
    if head.startswith(BINARY):
        raise InputError(f"{path}: not a text file, whatever its name says; give it the suffix of its format")
    for mark, name in MARKS:
        if head.startswith(mark):
            return Encoding(name)
    if (zeros := head.count(0)) and zeros > 0.3 * len(head):
        even = head[::2].count(0)
        if even in (0, zeros):
            return Encoding("utf-16-be" if even else "utf-16-le")
    # Blocks of zeros stand where a logger lost its power while it wrote.
    if b"\n" not in head and b"\r" not in head and 0 in head:
        raise InputError(f"{path}: not a text file; export it as CSV again")
    decoder = codecs.getincrementaldecoder("utf-8")()
    try:
        while block := file.read(BLOCK_BYTES):
            decoder.decode(block)
        decoder.decode(b"", final=True)
    except UnicodeDecodeError:
        return _detect_legacy_encoding(file, path)
    finally:
        file.seek(0)
    return Encoding("utf-8")


def _detect_legacy_encoding(file: BinaryIO, path: Path) -> Encoding:
    import charset_normalizer

    file.seek(0)
    # Lines with other bytes than ASCII tell the most.
    lines = [line for line in file.read(BLOCK_BYTES).splitlines() if not line.isascii()]
    sample = b"\n".join(lines[:200])
    if any(byte < 9 for byte in sample):
        raise InputError(f"{path}: not a text file; export it as CSV again")
    name = "cp1252"
    if not LATIN.fullmatch(sample.decode("latin-1")):
        best = charset_normalizer.from_bytes(sample, cp_isolation=EXTEND_ASCII).best()
        name = best.encoding if best is not None else "cp1252"
        if HANGUL.fullmatch(sample.decode("euc_kr", errors="replace")):
            name = "cp949"
    if CONTROL.search(sample.decode(name, errors="replace")):
        name = "cp1252"
    if CONTROL.search(sample.decode(name, errors="replace")):
        raise InputError(f"{path}: not a text file, or one of an encoding that is to be named with --encoding")
    label = "Latin-1" if name in ("cp1252", "latin-1") else name
    return Encoding(name, f"{NOT_UTF_8}; read as {label} (--encoding states another)")
