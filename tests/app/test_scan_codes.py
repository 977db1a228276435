"""What scanners send is understood: prefixes, GS1 labels, lower case, control characters, commands, lots, badges."""

import pytest

from softcal.app.line.scan_codes import Scan, read_scan


@pytest.mark.parametrize(
    ("typed", "understood"),
    [
        ("A1", Scan("serial", "A1")),
        ("  A1\r\n", Scan("serial", "A1")),
        ("]C0A1", Scan("serial", "A1")),
        ("\x02A1\x03", Scan("serial", "A1")),
        # GS1 General Specifications, figure 7.8.6-1 in spirit: GTIN (fixed), then serial, FNC1, lot.
        ("]d2010950110153000321A1\x1d10lot-1", Scan("serial", "A1", "lot-1")),
        ("]C121A1", Scan("serial", "A1")),
        ("\x1d17261231" + "10lot-1\x1d21A1", Scan("serial", "A1", "lot-1")),
        ("(01)09501101530003(21)A1", Scan("serial", "A1")),
        ("]d210lot-1", Scan("lot", "lot-1")),
        ("LOT:lot-1", Scan("lot", "lot-1")),
        ("lot: lot-1 ", Scan("lot", "lot-1")),
        ("CMD:STOP", Scan("command", "STOP")),
        ("cmd:repeat", Scan("command", "REPEAT")),
        ("BADGE:Kim, Ji-woo", Scan("badge", "Kim, Ji-woo")),
        ("BADGE:", Scan("badge", "")),
        ("CMD:DELETE", Scan("unreadable", "CMD:DELETE")),
        ("https://example.org", Scan("unreadable", "https://example.org")),
        ("", Scan("unreadable", "")),
        ("]d20109501101530003", Scan("unreadable", "0109501101530003")),
    ],
)
def test_a_scan_is_understood(typed, understood):
    assert read_scan(typed) == understood
