"""The words of the screens: one catalogue, from the files beside this one."""

import tomllib
from functools import cache
from pathlib import Path

from softcal.core.words.reason import ENGLISH, filled

LANGUAGES = {"en": "English", "ko": "한국어"}


@cache
def catalogue() -> dict[str, dict[str, str]]:
    """Return every text by language and key; what softcal's reasons say is English in `core.words.reason`.

    Raises:
        ValueError: a text stands in two files.
    """
    texts: dict[str, dict[str, str]] = {language: {} for language in LANGUAGES}
    for file in sorted(Path(__file__).parent.glob("*.toml")):
        for language, said in tomllib.loads(file.read_text(encoding="utf-8")).items():
            if twice := texts[language].keys() & said.keys():
                raise ValueError(f"{file.name} says again what another file says: {', '.join(sorted(twice))}")
            texts[language] |= said
    texts["en"] |= {f"reason.{code}": sentence for code, sentence in ENGLISH.items()}
    return texts


def text(language: str, key: str, /, **values: object) -> str:
    """Return one text with its values filled in; an unknown language gives English."""
    return filled(catalogue().get(language, catalogue()["en"])[key], values)
