"""How large the product is and how its parts hang together, counted in the source alone.

    python benchmarks/size.py                    this working copy
    python benchmarks/size.py --against HEAD~20  a commit and this working copy side by side
    python benchmarks/size.py --way              the way of one simulated unit through core/unit/calibrate.py

Prints a row a measure. Without `--way` nothing is imported and nothing is run; a commit is read by `git archive`.
"""

import argparse
import ast
import io
import subprocess
import sys
import tarfile
import tempfile
from collections import Counter
from collections.abc import Iterable, Mapping
from itertools import groupby
from pathlib import Path
from types import FrameType

ROOT = Path(__file__).parents[1]
PACKAGES = ("core", "db", "station", "app")
ONE_LINE = 100
SMALL_MODULE = 25
FITTED = "core/unit/calibrate.py"
DECLARED = ("setting", "table")
"""Functions of `core.settings` that declare a number of a method with its origin."""

Rows = dict[str, str]
Arrows = dict[str, set[str]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", metavar="REF", help="a commit to print before this working copy")
    parser.add_argument("--way", action="store_true", help="calibrate one unit and print the modules it walks")
    options = parser.parse_args()
    if options.way:
        print_way()
        return
    ref = options.against
    columns = [measured(ROOT)]
    if ref is not None:
        with tempfile.TemporaryDirectory() as folder:
            archive = subprocess.run(["git", "archive", ref], cwd=ROOT, check=True, capture_output=True).stdout
            tarfile.open(fileobj=io.BytesIO(archive)).extractall(folder, filter="data")
            columns.insert(0, measured(Path(folder)))
    for name, now in columns[-1].items():
        print(f"{name:58}" + " → ".join(f"{column.get(name, '-'):>24}" for column in columns[:-1] + [{name: now}]))


def measured(root: Path) -> Rows:
    """Return every measure of a checkout by its name."""
    paths = {package: sorted((root / package).rglob("*.py")) for package in PACKAGES}
    trees = {
        path.relative_to(root).as_posix(): ast.parse(path.read_text("utf-8"))
        for files in paths.values()
        for path in files
    }
    texts = {package: [*files, *sorted((root / package).rglob("*.toml"))] for package, files in paths.items()}
    rows = {f"lines of {package}, every begun 100 characters one": str(counted(texts[package])) for package in PACKAGES}
    all_texts = [path for files in texts.values() for path in files]
    rows["lines of the product, every begun 100 characters one"] = str(counted(all_texts))
    rows["lines of the product as they stand"] = str(sum(len(lines_of(path)) for path in all_texts))
    rows |= functions(trees)
    modules = [path for files in paths.values() for path in files if path.name != "__init__.py"]
    rows["modules"] = str(len(modules))
    rows[f"modules under {SMALL_MODULE} lines"] = str(sum(len(lines_of(path)) < SMALL_MODULE for path in modules))
    rows[f"modules that {FITTED} imports"] = str(len({module for module, _ in imported(trees[FITTED])}))
    rows |= numbers({name: tree for name, tree in trees.items() if name.startswith(("core/", "station/"))})
    for package in PACKAGES:
        rows[f"{package}: rooms, floors, arrows, back arrows, circles"] = shape(package, trees)
    tests = sorted((root / "tests").rglob("*.py"))
    rows["lines of tests, every begun 100 characters one"] = str(counted(tests))
    rows["benchmark files"] = str(len(list((root / "benchmarks").glob("*.py"))))
    return rows


def lines_of(path: Path) -> list[str]:
    return path.read_text("utf-8").splitlines()


def counted(paths: Iterable[Path]) -> int:
    """Return lines of files as if none could be longer than 100 characters: a long line hides no code."""
    return sum(max(1, -(-len(line) // ONE_LINE)) for path in paths for line in lines_of(path))


def functions(trees: Mapping[str, ast.Module]) -> Rows:
    """Return how many functions there are, and how many of the private ones their module calls at one place only."""
    total = private = once = 0
    for tree in trees.values():
        call_targets = [node.func for node in ast.walk(tree) if isinstance(node, ast.Call)]
        calls = Counter(node.id if isinstance(node, ast.Name) else getattr(node, "attr", "") for node in call_targets)
        names = [node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
        hidden = [name for name in names if name.startswith("_") and not name.startswith("__")]
        total, private = total + len(names), private + len(hidden)
        once += sum(calls[name] == 1 for name in hidden)
    return {
        "functions": str(total),
        "private functions": f"{private} ({private / total:.0%})",
        "private functions called once": f"{once} ({once / private:.0%})",
    }


def imported(tree: ast.Module) -> set[tuple[str, str]]:
    """Return module and name of everything that is imported from the product, wherever in a module."""
    return {
        (node.module, alias.name)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("softcal.")
        for alias in node.names
    }


def numbers(trees: Mapping[str, ast.Module]) -> Rows:
    """Return how many numbers were chosen: those declared with an origin in a method, and constants of modules."""
    declared = Counter[bool]()
    for name, tree in trees.items():
        calls = [node.func for node in ast.walk(tree) if isinstance(node, ast.Call)]
        if name != "core/settings.py":
            about_a_unit = not name.startswith(("core/gap/", "station/"))
            declared[about_a_unit] += sum(isinstance(call, ast.Name) and call.id in DECLARED for call in calls)
    constants = sum(is_given_number(node) for tree in trees.values() for node in tree.body)
    return {
        "numbers that decide about a unit: fields of methods": str(declared[True]),
        "numbers of the diagnosis and of proof: fields of methods": str(declared[False]),
        "numbers that decide: constants of core and station": str(constants),
    }


def is_given_number(node: ast.stmt) -> bool:
    """Whether a statement gives a name a number, or something made of numbers alone."""
    if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
        return False
    constants = [part.value for part in ast.walk(node.value) if isinstance(part, ast.Constant)]
    is_number = [isinstance(value, int | float) and not isinstance(value, bool) for value in constants]
    return bool(is_number) and all(is_number)


def shape(package: str, trees: Mapping[str, ast.Module]) -> str:
    """Return the rooms of a package (its folders, and its modules beside them) and how they import one another."""
    arrows: Arrows = {}
    homes = {}
    for name, tree in trees.items():
        parts = name.removesuffix(".py").split("/")
        if parts[0] == package and (len(parts) > 2 or tree.body) and parts[1] != "__init__":
            homes[name] = parts[1]
            arrows.setdefault(parts[1], set())
    for name, home in homes.items():
        for module, what in imported(trees[name]):
            _, other_package, inner_package, *_ = f"{module}.{what}".split(".")
            if other_package == package and inner_package in arrows and inner_package != home:
                arrows[home].add(inner_package)
    circles = [circle for circle in components(arrows) if len(circle) > 1]
    layer_of: dict[frozenset[str], int] = {}
    for circle in components(arrows):
        below = [
            layer_of[other] for other in layer_of if any(arrows[inner_package] & other for inner_package in circle)
        ]
        layer_of[circle] = 1 + max(below, default=0)
    back = sum(closing(circle, arrows) for circle in circles)
    count = sum(map(len, arrows.values()))
    return f"{len(arrows)}, {max(layer_of.values())}, {count}, {back}, {len(circles)}"


def components(arrows: Arrows) -> list[frozenset[str]]:
    """Return groups of rooms that reach one another, those that the others stand on first."""
    reached = {package: {package} for package in arrows}
    for _ in arrows:
        reached = {package: {package}.union(*(reached[other] for other in arrows[package])) for package in arrows}
    groups = {frozenset(o for o in reached[package] if package in reached[o]) for package in arrows}
    return sorted(groups, key=lambda group: (len(reached[min(group)]), min(group)))


def closing(circle: frozenset[str], arrows: Arrows) -> int:
    """Return how many arrows of a circle point back when its rooms stand in a good order (Eades and others 1993)."""
    order: list[str] = []
    remaining = set(circle)
    while remaining:
        package = max(
            sorted(remaining),
            key=lambda package: len(arrows[package] & remaining) - sum(package in arrows[o] for o in remaining),
        )
        order.append(package)
        remaining.remove(package)
    return sum(order.index(other) < order.index(package) for package in circle for other in arrows[package] & circle)


def print_way() -> None:
    """Print which modules `calibrate` calls for one audited unit, in order, and how often it comes back to one."""
    from softcal.core.network.config import NetworkConfig
    from softcal.core.network.training import fit_network
    from softcal.core.simulated_lot import LotDesign, simulate_lot
    from softcal.core.unit.calibrate import calibrate
    from softcal.core.unit.method import Method
    from softcal.core.unit.source_model import make_source_model
    from softcal.core.unit.unit_problem import UnitProblem

    lot = simulate_lot(3, LotDesign(good=1))
    network = fit_network(lot.source, NetworkConfig(hidden=(20,), max_epochs=5)).network
    problem = UnitProblem(
        make_source_model(lot.source, network, method=Method()), lot.units[0].recording, audit=lot.units[0].audit
    )
    call_chain: list[str] = []

    def note(frame: FrameType, event: str, _: object) -> None:
        file, caller = frame.f_code.co_filename, frame.f_back
        is_direct = caller is not None and caller.f_code.co_filename.endswith(FITTED) and not file.endswith(FITTED)
        if event == "call" and is_direct and "/core/" in file:
            call_chain.append(file.split("/core/")[1])

    sys.setprofile(note)
    calibrate(problem)
    sys.setprofile(None)
    way = [name for name, _ in groupby(call_chain)]
    print(f"{len(set(way))} modules, {len(way) - len(set(way))} returns: {', '.join(dict.fromkeys(way))}")


if __name__ == "__main__":
    main()
