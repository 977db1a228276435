"""Serials: which ones may be, by Python's own Unicode data, and their escaped forms there and back."""

import re
import unicodedata
from collections import Counter

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from softcal.core.errors import InputError
from softcal.core.export import blob
from softcal.core.export.c_text import c_name
from softcal.core.lot import Lot, check_serial, escape_serial, file_stem, row_name, serial_key, unescape_serial

ALLOWED = st.characters(categories=["Lu", "Ll", "Lt", "Lm", "Lo", "Nd"]) | st.sampled_from("._-")
HANGUL = st.characters(min_codepoint=0xAC00, max_codepoint=0xD7A3)


def is_serial(text: str) -> bool:
    try:
        check_serial(text)
    except InputError:
        return False
    return True


serials = st.text(ALLOWED | HANGUL | st.characters(max_codepoint=127), min_size=1, max_size=64).filter(is_serial)


@given(st.text(max_size=70))
@example("센서-001")
@example("A1")
@example("가" * 64)
@example("\u115f1")
@example("a\u202eb")
def test_a_serial_is_letters_and_digits_of_any_script_in_nfc(text: str) -> None:
    if not is_serial(text):
        return
    serial = check_serial(text)
    assert serial == unicodedata.normalize("NFC", text) == check_serial(serial)
    assert {unicodedata.category(c)[0] for c in serial if c not in "._-"} <= {"L", "N"}
    assert unicodedata.category(serial[0]) == "Nd" or serial[0].isalpha()
    assert serial.isprintable() and 1 <= len(serial) <= 64


@pytest.mark.parametrize(
    "serial",
    [
        "A1",
        "EG-0017",
        "a.b_c-d",
        "센서-001",
        "압력센서12",
        "Gerät7",
        "датчик-3",
        "传感器_9",
        "センサー1",
        "٣٤",
        "가" * 64,
    ],
)
def test_serials_of_any_script_may_be(serial: str) -> None:
    assert check_serial(serial) == serial
    assert check_serial(unicodedata.normalize("NFD", serial)) == serial


@pytest.mark.parametrize(
    ("serial", "message"),
    [
        ("A 1", "U+0020 SPACE"),
        ("A/1", "U+002F SOLIDUS"),
        ("A\\1", "U+005C REVERSE SOLIDUS"),
        ("A:1", "U+003A COLON"),
        ("A~1", "U+007E TILDE"),
        ("A%1", "U+0025 PERCENT SIGN"),
        ("A\n1", "U+000A"),
        ("A\x00", "U+0000"),
        ("A\u202e1", "U+202E RIGHT-TO-LEFT OVERRIDE"),
        ("A\u200b1", "U+200B ZERO WIDTH SPACE"),
        ("A\u20661", "U+2066 LEFT-TO-RIGHT ISOLATE"),
        ("A\ufeff", "U+FEFF ZERO WIDTH NO-BREAK SPACE"),
        ("A\u3164", "U+3164 HANGUL FILLER"),
        ("A\u2028", "U+2028 LINE SEPARATOR"),
        ("A½", "U+00BD VULGAR FRACTION ONE HALF"),
        ("A\u0301\u0327\u0301", "U+0327 COMBINING CEDILLA"),
        ("A😀", "U+1F600 GRINNING FACE"),
        ("A\udcff", "U+DCFF"),
        ("센서 1", "U+0020 SPACE"),
    ],
)
def test_what_is_no_letter_or_digit_is_named(serial: str, message: str) -> None:
    with pytest.raises(InputError) as bad:
        check_serial(serial)
    assert message in str(bad.value) and str(bad.value).isprintable()


@pytest.mark.parametrize("serial", ["", "-1", ".1", "_1", "a..b", "A1.", "CON", "nul.v2", "가" * 65, "A" * 65])
def test_a_serial_that_no_file_could_have_is_refused(serial: str) -> None:
    with pytest.raises(InputError):
        check_serial(serial)


@given(serials)
@example("센서-001")
@example("가" * 64)
def test_an_escaped_serial_turns_back_and_names_a_file_everywhere(serial: str) -> None:
    serial = check_serial(serial)
    escaped = escape_serial(serial)
    assert unescape_serial(escaped) == serial
    assert re.fullmatch(r"~?[A-Za-z0-9._-]+", escaped)
    assert len(f".certificate-{escaped}.xml.sig.12345678.part") <= 255 and len(f"{serial}.parquet".encode()) < 255
    assert (escaped == serial) == serial.isascii()


@given(st.lists(serials, min_size=2, max_size=6))
def test_no_two_serials_have_one_name(several: list[str]) -> None:
    several = [check_serial(serial) for serial in several]
    different = len(set(several))
    for encode in (escape_serial, c_name):
        assert len({encode(serial) for serial in several}) == different


@given(serials)
@example("A-1")
@example("A.1")
def test_a_serial_in_c_is_an_identifier(serial: str) -> None:
    assert re.fullmatch(r"[A-Za-z0-9_]+", c_name(check_serial(serial)))
    assert "__" not in c_name(check_serial(serial))


@given(serials)
@example("센서-001")
def test_the_field_of_a_device_turns_back_where_it_is_whole(serial: str) -> None:
    serial = check_serial(serial)
    field = blob.serial_field(serial)
    assert len(field) == 20 and field.isascii()
    decoded = blob.decode_serial(field)
    # What was shortened keeps its own field: both name the same unit.
    assert blob.serial_field(decoded) == field
    if len(escape_serial(serial)) <= 20:
        assert decoded == serial


@pytest.mark.parametrize("escaped", ["~é", "~A1", "~!!", "~-", "~a\x80"])
def test_what_was_never_escaped_does_not_turn_back(escaped: str) -> None:
    with pytest.raises(ValueError):
        unescape_serial(escaped)


@given(st.text(min_size=1, max_size=90).filter(lambda text: "\x00" not in text))
@example("a\u202eb")
@example("CON")
@example("../x")
@example(".hidden")
def test_a_name_that_is_no_serial_has_a_row_and_a_file(name: str) -> None:
    row, stem = row_name(name), file_stem(name)
    assert row.isprintable() and 1 <= len(row) <= 64
    assert not set(stem) & set('<>:"/\\|?*') and not stem.startswith(".") and not stem.endswith((".", " "))
    if name.isprintable() and len(name) <= 64 and unicodedata.is_normalized("NFC", name):
        assert row == name
    row.encode()


def test_rows_of_long_names_stay_apart() -> None:
    names = [f"{'x' * 80}{k}" for k in range(50)]
    assert Counter(map(row_name, names)).most_common(1)[0][1] == 1


def test_case_and_normal_form_do_not_tell_serials_apart() -> None:
    for one, other in (("a1", "A1"), ("Gerät", unicodedata.normalize("NFD", "GERÄT")), ("STRASSE", "straße")):
        assert serial_key(one) == serial_key(other)
    assert serial_key("A1") != serial_key("A2")


def test_a_lot_has_its_source_in_nfc() -> None:
    assert Lot("x", unicodedata.normalize("NFD", "센서-1"), 50.0).source == "센서-1"
