"""The picture of the architecture, drawn from the imports: a box for each top folder, its rooms, and who uses whom.

`make proof` writes docs/images/architecture.svg.
"""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[1]
PICTURE = ROOT / "docs/images/architecture.svg"
CAPTIONS = {
    "app": "commands, screens, files, services",
    "db": "the registry: lots, units, maps, audit trail",
    "station": "stage, load cell, readout: all that has a wire",
    "core": "numbers in, numbers out: no file, port or clock",
}
BOXES = {
    "app": (20, 20, 920, 120),
    "db": (20, 200, 440, 90),
    "station": (500, 200, 440, 90),
    "core": (20, 350, 920, 90),
}
ARROWS = {
    ("app", "db"): (240, 140, 240, 200),
    ("app", "station"): (720, 140, 720, 200),
    ("app", "core"): (480, 140, 480, 350),
    ("db", "core"): (240, 290, 240, 350),
    ("station", "core"): (720, 290, 720, 350),
}
"""Where the arrow of each allowed use runs."""


def packages_of(folder: str) -> list[str]:
    """Return the packages of a top folder."""
    return sorted(path.parent.name for path in (ROOT / folder).glob("*/__init__.py"))


def find_imports() -> set[tuple[str, str]]:
    """Return which top folder imports another: (from, to)."""
    imports = set()
    for folder in CAPTIONS:
        for path in (ROOT / folder).rglob("*.py"):
            modules = [n for node in ast.walk(ast.parse(path.read_text("utf-8"))) for n in _imported(node)]
            imports |= {(folder, n.split(".")[1]) for n in modules if n.startswith("softcal.")}
    return {(folder, to) for folder, to in imports if to in CAPTIONS and to != folder}


def _imported(node: ast.AST) -> list[str]:
    if isinstance(node, ast.ImportFrom):
        return [f"{node.module}."]
    return [f"{alias.name}." for alias in node.names] if isinstance(node, ast.Import) else []


def picture() -> str:
    """Return the picture as SVG.

    Raises:
        KeyError: the code has a use for which no arrow is drawn.
    """
    parts = [_arrow(*ARROWS[pair]) for pair in sorted(find_imports())]
    parts += [_box(folder, *box) for folder, box in BOXES.items()]
    style = "font-family='sans-serif' fill='#1a1a1a'"
    return f"<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 960 460' {style}>\n{''.join(parts)}</svg>\n"


def _arrow(x: int, y: int, to_x: int, to_y: int) -> str:
    line = f"<line x1='{x}' y1='{y}' x2='{to_x}' y2='{to_y - 8}' stroke='#557' stroke-width='2'/>"
    head = f"<path d='M{to_x - 6},{to_y - 10} L{to_x + 6},{to_y - 10} L{to_x},{to_y} z' fill='#557'/>"
    return f"{line}{head}<text x='{x + 8}' y='{to_y - 24}' font-size='13' fill='#557'>uses</text>\n"


def _box(folder: str, x: int, y: int, width: int, height: int) -> str:
    rows, line = [], ""
    for name in packages_of(folder):
        if len(line) + len(name) > width / 7:
            rows.append(line)
            line = ""
        line += f"{name} · " if name != packages_of(folder)[-1] else name
    text = "".join(
        f"<text x='{x + 14}' y='{y + 70 + 20 * k}' font-size='13' fill='#445'>{row}</text>"
        for k, row in enumerate([*rows, line])
    )
    return (
        f"<rect x='{x}' y='{y}' width='{width}' height='{height}' rx='8' fill='#eef1f6' stroke='#557'/>"
        f"<text x='{x + 14}' y='{y + 28}' font-size='18' font-weight='bold'>{folder}</text>"
        f"<text x='{x + 14}' y='{y + 48}' font-size='14'>{CAPTIONS[folder]}</text>{text}\n"
    )
