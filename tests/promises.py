"""Which test proves which promise: the first line of every test file, with the layer that it runs in.

python tests/promises.py        writes the table into tests/README.md, and draws docs/images/architecture.svg
"""

import ast
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from tests.architecture import PICTURE, picture  # noqa: E402

PAGE = ROOT / "tests/README.md"
PACKAGES = {
    "core": "Numbers: maps, forecasts, verdicts, twin, gap, adaptation",
    "station": "The stage and what has a wire",
    "db": "The registry",
    "app": "Commands, pages, files, services",
    "firmware": "The device",
    "house": "The repository itself",
}


def render_table() -> str:
    """Return the table as Markdown."""
    parts = []
    for package, title in PACKAGES.items():
        rows = [_row(path) for path in sorted((ROOT / "tests" / package).glob("test_*.py"))]
        parts.append(f"### {title}\n\n| promise | tests | layer |\n|---|---|---|\n" + "\n".join(rows) + "\n")
    return "\n".join(parts)


def _row(path: Path) -> str:
    module = ast.parse(path.read_text("utf-8"))
    promise = " ".join((ast.get_docstring(module) or "").split("\n\n")[0].split()).replace("|", "\\|")
    return f"| {promise} | `{path.relative_to(ROOT).as_posix()}` | {_layer(module)} |"


def _layer(module: ast.Module) -> str:
    """Return fast, long, or both where single tests of a fast file are long."""
    marks = [
        node for node in module.body if isinstance(node, ast.Assign) and "pytestmark" in ast.unparse(node.targets[0])
    ]
    if any("mark.long" in ast.unparse(mark) for mark in marks):
        return "long"
    return "both" if "mark.long" in ast.unparse(module) else "fast"


def page() -> str:
    """Return the whole page."""
    heading = "# Which test proves which promise\n\nWritten by `make proof`. How to add one: docs/proof.md."
    return f"{heading}\n\n{render_table()}"


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
    PICTURE.write_text(picture(), "utf-8")
    sys.exit(0)
