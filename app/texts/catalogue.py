"""The words of the screens, from one catalogue file."""

import tomllib
from functools import cache
from pathlib import Path

LANGUAGES = {"en": "English", "ko": "한국어"}


@cache
def catalogue() -> dict[str, dict[str, str]]:
    """Return every text by language and key."""
    return tomllib.loads(Path(__file__).with_name("texts.toml").read_text(encoding="utf-8"))


def text(language: str, key: str, **values: object) -> str:
    """Return one text with its values filled in; an unknown language gives English."""
    return catalogue().get(language, catalogue()["en"])[key].format(**values)
