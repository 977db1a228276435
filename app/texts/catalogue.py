"""The words of the screens, from one catalogue file."""

import tomllib
from functools import cache
from pathlib import Path

from softcal.core.reason import ENGLISH, filled

LANGUAGES = {"en": "English", "ko": "한국어"}


@cache
def catalogue() -> dict[str, dict[str, str]]:
    """Return every text by language and key; what softcal's reasons say is English in `core.reason`."""
    texts: dict[str, dict[str, str]] = tomllib.loads(Path(__file__).with_name("texts.toml").read_text(encoding="utf-8"))
    texts["en"] |= {f"reason.{code}": sentence for code, sentence in ENGLISH.items()}
    return texts


def text(language: str, key: str, /, **values: object) -> str:
    """Return one text with its values filled in; an unknown language gives English."""
    return filled(catalogue().get(language, catalogue()["en"])[key], values)
