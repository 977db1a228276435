"""What the shipped drivers say, in English: a page a driver, beside it. No driver is loaded for it."""

import tomllib
from collections.abc import Mapping
from pathlib import Path

from softcal.core.messages.reason import add_messages

PAGES: Mapping[str, Mapping[str, str]] = {
    path.stem: tomllib.loads(path.read_text(encoding="utf-8"))
    for path in sorted((Path(__file__).parent / "drivers").glob("*.toml"))
}
"""Code → sentence, by the name of the page."""

for _page in PAGES.values():
    add_messages(_page)
