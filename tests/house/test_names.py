"""One meaning per name: no two public classes share a name, and a module's name says one thing in core."""

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDERS = ("core", "db", "station", "app")
ONE_MEANING_IN_MANY_ROOMS = {
    "catalogue.py": "the one list of what a room holds",
    "config.py": "the configuration of a room",
    "method.py": "every number that decides, with its origin: of a calibration (unit), of long use (use)",
}
"""Modules of core that share a name, with what it means in each of their rooms."""


def modules(folder: str) -> Iterator[Path]:
    yield from (path for path in sorted((ROOT / folder).rglob("*.py")) if path.name != "__init__.py")


def public_classes(path: Path) -> Iterator[str]:
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield node.name


def shared(homes: dict[str, list[str]]) -> dict[str, list[str]]:
    return {name: places for name, places in homes.items() if len(places) > 1}


def test_no_two_public_classes_share_a_name() -> None:
    homes: dict[str, list[str]] = defaultdict(list)
    for folder in FOLDERS:
        for path in modules(folder):
            for name in public_classes(path):
                homes[name].append(path.relative_to(ROOT).as_posix())
    assert len(homes) > 500
    assert shared(homes) == {}


def test_a_module_of_core_has_a_name_of_its_own_or_one_meaning() -> None:
    homes: dict[str, list[str]] = defaultdict(list)
    for path in modules("core"):
        homes[path.name].append(path.relative_to(ROOT).as_posix())
    assert set(shared(homes)) == set(ONE_MEANING_IN_MANY_ROOMS), shared(homes)
