"""English messages of the shipped drivers, one TOML file per driver, readable without loading a driver."""

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
