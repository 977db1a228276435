"""Texts of dates and times of day, as programs write them, in one way of writing."""

import re
from datetime import datetime
from functools import lru_cache
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

CLOCK = r"\d{1,3}:\d{2}(?::\d{2}(?:[.,:]\d+)?)?(?: ?[AaPp][Mm])?"
STAMP = re.compile(
    rf"(?:\d{{4}}|\d{{1,2}})[-/.]\d{{1,2}}[-/.]\d{{1,4}}\.?(?:[ T]+{CLOCK}(?: ?(?:Z|UTC|[+-]\d{{2}}:?\d{{2}}))?)?"
    rf"|\d{{8}}T\d{{4,6}}(?:[.,]\d+)?(?:Z|[+-]\d{{2}}:?\d{{2}})?|{CLOCK}|\d+ days? {CLOCK}"
)
"""Dates, times of day and both, as loggers write them."""

DURATION = re.compile(r"P(?=.*\d)(?:(\d+)D)?(?:T(?:(\d+)H)?(?:(\d+)M)?(?:(\d+)(?:[.,](\d+))?S)?)?")
"""`PT1M0.02S`, a duration of ISO 8601."""

OFFSETS = {
    "UTC": 0, "GMT": 0, "WET": 0, "WEST": 1, "CET": 1, "MEZ": 1, "CEST": 2, "MESZ": 2, "EET": 2, "EEST": 3, "MSK": 3,
    "SGT": 8, "HKT": 8, "KST": 9, "JST": 9, "AEST": 10, "AEDT": 11, "NZST": 12, "EDT": -4, "MDT": -6, "PDT": -7,
}  # fmt: skip
"""Short names of zones that mean one offset from UTC only, in hours; CST, EST, IST, BST, PST have several meanings."""

ZONE_NAME = re.compile(
    r"(?P<stamp>\d.*?\d)(?P<offset>Z|[+-]\d{2}:?\d{2})? ?\[?"
    r"(?P<zone>(?!(?:AM|PM|Z)\b)[A-Z][A-Za-z]+(?:[/_][A-Za-z_]+)*)(?P<hours>[+-]\d{1,2})?(?::?(?P<minutes>\d{2}))?\]?"
)
ELAPSED_DAYS = re.compile(r"\d+ days? .*")
CLOCK_TIME = re.compile(r"(\d{1,3}):(\d{2})(?::(\d{2}))?(?:[.,:](\d+))? ?([AaPp][Mm])?")
YEAR_FIRST = re.compile(r"\d{4}-?\d{2}")
ZONE = re.compile(r"(?:Z|[+-]\d{2}:?\d{2})$")
DAY_MONTH = re.compile(
    r"(\d{1,2})([-/.])(\d{1,2})[-/.](\d{4}|\d{2})(?:[ T]+(\d{1,2}:\d{2}(?::\d{2}(?:[.,:]\d+)?)?(?: ?[AaPp][Mm])?))?"
)
MONTHS = "jan feb mar apr may jun jul aug sep oct nov dec".split()
MONTH = r"(?P<month>[A-Za-z]{3})[a-z]*\.?"
CLOCK_SUFFIX = rf"(?:[ T]+(?P<clock>{CLOCK}))?"
MONTH_NAME_DATES = (
    re.compile(rf"(?P<day>\d{{1,2}})[- /]{MONTH}[- /](?P<year>\d{{4}}|\d{{2}}){CLOCK_SUFFIX}"),
    re.compile(rf"{MONTH} +(?P<day>\d{{1,2}}),? +(?P<year>\d{{4}}){CLOCK_SUFFIX}"),
    re.compile(rf"(?:[A-Z][a-z]{{2}} +)?{MONTH} +(?P<day>\d{{1,2}}) +(?P<clock>{CLOCK}) +(?P<year>\d{{4}})"),
)
"""`27-Oct-2024 02:59:56.000` (MATLAB), `Oct 27, 2024 02:59:56`, `Sun Oct 27 02:59:56 2024` (C)."""

HALVES = {"오전": "AM", "오후": "PM", "上午": "AM", "下午": "PM", "午前": "AM", "午後": "PM"}
"""Halves of a day, which stand before the hour."""

HALF = re.compile(rf"(?P<half>{'|'.join(HALVES)}) ?(?P<clock>\d{{1,2}}:[\d:.,]+)")
DOTTED_HALF = re.compile(r"([AaPp])\.[ \u00a0]?[Mm]\.$")
"""`p.m.`, `p. m.`"""

DOTTED_DATE = re.compile(r"(\d{4})(?:\.|년|年) ?(\d{1,2})(?:\.|월|月) ?(\d{1,2})(?:\.|일|日)?(?= |$)")
SHORT_PART = re.compile(r":(\d)(?!\d)")
"""A minute or a second below ten of which the zero is not written."""

TIME_SPAN = re.compile(r"(\d+)\.(\d{2}:\d{2}:\d{2}(?:\.\d+)?)")
YEAR_AND_HALF = re.compile(r"(?P<date>\d{4}\S+ +)(?P<hour>\d{1,2})(?P<rest>:[\d:.,]+) ?(?P<half>[AaPp])[Mm]")


def normalize_stamp(text: str) -> str:
    """Return a time stamp in digits, without brackets, names of months, or halves of a day."""
    text = text.strip()
    if text[:1] == "P" and (match := DURATION.fullmatch(text)):
        days, hours, minutes, seconds, fraction = (part or "0" for part in match.groups())
        count = (int(hours) * 60 + int(minutes)) * 60 + int(seconds)
        return f"{days} days {count // 3600}:{count // 60 % 60:02}:{count % 60:02}.{fraction}"
    text = SHORT_PART.sub(r":0\1", DOTTED_HALF.sub(r"\1M", text))
    if text[:1].isdigit() and (match := ZONE_NAME.fullmatch(text)):
        text = f"{match['stamp']}{match['offset'] or _offset(match) or ' ' + match['zone']}"
    if text[:1] in "[(" and text[-1:] in "])":
        text = text[1:-1].strip()
    if text.isascii() and (text.isdigit() or not (text[:1].isalpha() or " " in text or "-" in text or "." in text)):
        return text
    text = HALF.sub(lambda m: f"{m['clock']} {HALVES[m['half']]}", text)
    text = DOTTED_DATE.sub(r"\1-\2-\3", text)
    if match := TIME_SPAN.fullmatch(text):
        return f"{match[1]} days {match[2]}"
    for pattern in MONTH_NAME_DATES:
        match = pattern.fullmatch(text)
        if match is not None and match["month"].lower() in MONTHS:
            month = MONTHS.index(match["month"].lower()) + 1
            century = "20" if len(match["year"]) == 2 else ""
            text = f"{century}{match['year']}-{month:02}-{int(match['day']):02} {match['clock'] or ''}".strip()
    if match := YEAR_AND_HALF.fullmatch(text):
        hour = int(match["hour"]) % 12 + (12 if match["half"] in "pP" else 0)
        text = f"{match['date']}{hour:02}{match['rest']}"
    return text


def _offset(match: re.Match[str]) -> str:
    """Return the UTC offset of the zone in a stamp, such as `+09:00`; "" if it is not certain."""
    if match["hours"] and match["zone"] in ("UTC", "GMT"):
        return f"{match['hours'][0]}{int(match['hours'][1:]):02}:{match['minutes'] or '00'}"
    if match["zone"] in OFFSETS:
        return f"{OFFSETS[match['zone']]:+03}:00"
    try:
        at = datetime.fromisoformat(to_iso_stamp(normalize_stamp(match["stamp"]))[:19])
        return f"{at.replace(tzinfo=ZoneInfo(match['zone'])):%z}" if "/" in match["zone"] else ""
    except (ValueError, ZoneInfoNotFoundError):
        return ""


def find_zone(text: str) -> str:
    """Return the name of an ambiguous zone in a stamp; "" without one."""
    match = ZONE_NAME.fullmatch(text.strip())
    return "" if match is None or is_stamp(text) or not is_stamp(match["stamp"]) else match["zone"]


@lru_cache(maxsize=1 << 14)
def is_stamp(text: str) -> bool:
    """Whether a text is a date, a time of day, or both."""
    return STAMP.fullmatch(normalize_stamp(text)) is not None


def point_fraction(clock: str) -> str:
    """Return a time of day with a point before the parts of its second."""
    return re.sub(r"^(\d+:\d+:\d+)[:,]", r"\1.", clock)


def to_iso_stamp(text: str) -> str:
    """Return a stamp with dashes in its date, two digits a number, and a point before the parts of a second."""
    text = re.sub(r"^(\d{4})[-/.](\d{1,2})[-/.](\d{1,2})", lambda m: f"{m[1]}-{int(m[2]):02}-{int(m[3]):02}", text)
    text = re.sub(r"(?<=[ T])(\d):", r"0\1:", text)
    return re.sub(r",(\d+)", r".\1", text, count=1).replace(" +", "+").replace(" Z", "Z").replace(" UTC", "Z")
