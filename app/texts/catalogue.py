"""The words of the screens: one catalogue, from the files beside this one."""

import tomllib
from collections.abc import Callable
from datetime import datetime, timedelta, timezone, tzinfo
from functools import cache
from pathlib import Path

from softcal.core.messages.reason import ENGLISH, fill_sentence, has_message
from softcal.station.messages import PAGES

LANGUAGES = {"en": "English", "ko": "한국어"}

REASON = "reason."
"""How the keys begin that say a reason."""

BUILTIN_MESSAGES = {**ENGLISH, **{code: sentence for page in PAGES.values() for code, sentence in page.items()}}
"""What core and the shipped drivers say in English. Drivers of other people may add theirs later."""


@cache
def catalogue() -> dict[str, dict[str, str]]:
    """Return every text by language and key; ValueError where one stands in two files."""
    texts: dict[str, dict[str, str]] = {language: {} for language in LANGUAGES}
    for file in sorted(Path(__file__).parent.glob("*.toml")):
        entries = tomllib.loads(file.read_text(encoding="utf-8"))
        korean = entries.pop("ko", {})
        if duplicates := texts["ko"].keys() & (entries.keys() | korean.keys()):
            raise ValueError(f"{file.name} says again what another file says: {', '.join(sorted(duplicates))}")
        for language, translations in zip(LANGUAGES, zip(*entries.values(), strict=True), strict=True):
            texts[language] |= zip(entries, translations, strict=True)
        texts["ko"] |= korean
    texts["en"] |= {f"{REASON}{code}": sentence for code, sentence in BUILTIN_MESSAGES.items()}
    return texts


def text(language: str, key: str, /, **values: object) -> str:
    """Return one text with its values filled in; an unknown language gives English."""
    formatted = {
        name: format_instant(value) if isinstance(value, datetime) else value for name, value in values.items()
    }
    return fill_sentence(_sentence(language, key), formatted)


def _sentence(language: str, key: str) -> str:
    """Return the text of a key; a reason that a language lacks, of a driver of somebody else, is said in English."""
    texts = catalogue().get(language, catalogue()["en"])
    code = key.removeprefix(REASON)
    return ENGLISH[code] if key not in texts and code != key and has_message(code) else texts[key]


def make_translator(language: str, zone: tzinfo | None) -> Callable[..., str]:
    """Return the texts of a language for a reader in a time zone; None is that of this machine."""

    def translate(key: str, /, **values: object) -> str:
        local_values = {name: v.astimezone(zone) if isinstance(v, datetime) else v for name, v in values.items()}
        return text(language, key, **local_values)

    return translate


def format_local_instant(at: datetime) -> str:
    """Return an instant in the time of this machine, for tables and letters."""
    return format_instant(at.astimezone())


def format_instant(at: datetime) -> str:
    """Return an instant to the second, with the difference of its zone from UTC."""
    return f"{at:%Y-%m-%d %H:%M:%S} {timezone(at.utcoffset() or timedelta())}"
