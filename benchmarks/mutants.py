"""How much of what is broken on purpose the tests notice: one small fault at a time, and the tests that run that line.

    python benchmarks/mutants.py map --layer fast      which tests run which line (coverage, two processes)
    python benchmarks/mutants.py map --layer long
    python benchmarks/mutants.py try --count 300       break, test, count; what is done is kept and not done again

A fault is drawn by a seed over the rooms that decide: a comparison, an arithmetic or logical operator, a constant, a
missing `not`. It is tried in a copy of the tree. The tests that run the broken line run in the order of their seconds
until one fails; those of the fast layer first, and the long ones where no fast one failed. A fault that nobody noticed
within `--longest` seconds of a layer counts as not noticed.
"""

import argparse
import ast
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from softcal.core.challenge.score import wilson

ROOT = Path(__file__).parents[1]
FACE = ROOT / "app/face"
ROOMS = {
    "core/unit": "core/unit/*.py",
    "core/maps": "core/maps/*.py",
    "core/gap": "core/gap/*.py",
    "core/quality": "core/quality/*.py",
    "station": "station/{safety,interlock,bounds,motion,watched,acquisition,contact,feeding,proof,steps}.py",
    "db": "db/*.py",
    "app/batch": "app/batch/*.py",
}
COMPARE = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
ARITHMETIC = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}
LOGIC = {ast.And: ast.Or, ast.Or: ast.And}


@dataclass(frozen=True)
class Mutant:
    """One fault: where it stands and what the file says then."""

    room: str
    path: str
    line: int
    column: int
    was: str
    text: str

    @property
    def name(self) -> str:
        return f"{self.path}:{self.line}:{self.column} {self.was} -> {self.text}"


def mutants_of(room: str, path: Path) -> Iterator[Mutant]:
    """Yield every fault that can be made in a file."""
    source = path.read_text("utf-8")
    tree = ast.parse(source)
    skipped = {id(inner) for node in ast.walk(tree) for quiet in _quiet(node) for inner in ast.walk(quiet)}
    for node in ast.walk(tree):
        if id(node) in skipped or not isinstance(node, ast.expr):
            continue
        was = ast.get_source_segment(source, node) or ""
        for changed in _changes(node):
            text = f"({ast.unparse(changed)})"
            yield Mutant(room, path.relative_to(ROOT).as_posix(), node.lineno, node.col_offset, was, text)


def _quiet(node: ast.AST) -> Iterator[ast.AST]:
    """Yield what stands in a node and decides nothing: annotations, texts of errors, docstrings."""
    if isinstance(node, ast.arg | ast.AnnAssign) and node.annotation is not None:
        yield node.annotation
    if isinstance(node, ast.FunctionDef):
        yield from node.decorator_list
        if node.returns is not None:
            yield node.returns
    if isinstance(node, ast.JoinedStr):
        yield node
    if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and node.targets[0].id == "__all__":
        yield node


def _changes(node: ast.expr) -> Iterator[ast.expr]:
    if isinstance(node, ast.Compare) and type(node.ops[0]) in COMPARE:
        yield ast.Compare(node.left, [COMPARE[type(node.ops[0])](), *node.ops[1:]], node.comparators)
    elif isinstance(node, ast.BinOp) and type(node.op) in ARITHMETIC:
        yield ast.BinOp(node.left, ARITHMETIC[type(node.op)](), node.right)
    elif isinstance(node, ast.BoolOp):
        yield ast.BoolOp(LOGIC[type(node.op)](), node.values)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield node.operand
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield ast.Constant(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int):
        yield ast.Constant(node.value + 1)
    elif isinstance(node, ast.Constant) and isinstance(node.value, float):
        yield ast.Constant(1.5 * node.value if node.value else 1.0)


def drawn(count: int, seed: int) -> list[Mutant]:
    """Return so many faults, as many of every room as of the others."""
    rng = random.Random(seed)
    chosen: list[Mutant] = []
    for k, (room, pattern) in enumerate(ROOMS.items()):
        every = [m for path in _matching(pattern) for m in mutants_of(room, path)]
        share = count * (k + 1) // len(ROOMS) - count * k // len(ROOMS)
        chosen += rng.sample(every, share)
    return chosen


def _matching(pattern: str) -> list[Path]:
    if "{" not in pattern:
        return sorted(ROOT.glob(pattern))
    before, _, rest = pattern.partition("{")
    names, _, after = rest.partition("}")
    return [ROOT / f"{before}{name}{after}" for name in names.split(",")]


def broken(mutant: Mutant) -> str:
    """Return the text of its file with the fault in it."""
    lines = (ROOT / mutant.path).read_text("utf-8").encode().splitlines(keepends=True)
    start = sum(map(len, lines[: mutant.line - 1])) + mutant.column
    whole = b"".join(lines)
    return (whole[:start] + mutant.text.encode() + whole[start + len(mutant.was.encode()) :]).decode()


# Which tests run which line.

MARKS = {"fast": "not long", "long": "long"}
RECORDER = """
import json, os
import coverage
import pytest

cover = None

def pytest_configure(config):
    global cover
    if os.environ.get("PYTEST_XDIST_WORKER") and cover is None:
        place = os.environ["MUTANTS_MAP"]
        data = os.path.join(place, "coverage." + os.environ["PYTEST_XDIST_WORKER"])
        cover = coverage.Coverage(data_file=data, source=json.loads(os.environ["MUTANTS_SOURCE"]), messages=False)
        cover.start()

@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_protocol(item):
    if cover is not None:
        cover.switch_context(item.nodeid)
    yield
    if cover is not None:
        cover.switch_context("")

def pytest_runtest_logreport(report):
    if cover is None and report.when == "call":
        with open(os.path.join(os.environ["MUTANTS_MAP"], "seconds.tsv"), "a") as file:
            print(report.nodeid, report.duration, report.outcome, sep="\\t", file=file)

def pytest_unconfigure(config):
    if cover is not None:
        cover.stop()
        cover.save()
"""


def make_map(layer: str, keep: Path) -> None:
    """Run a layer under coverage and keep which test runs which line."""
    place = keep / layer
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    (place / "recorder.py").write_text(RECORDER)
    source = json.dumps([str(ROOT / folder) for folder in ("core", "db", "station", "app")])
    environment = os.environ | {
        "MUTANTS_MAP": str(place), "MUTANTS_SOURCE": source, "PYTHONPATH": str(place), "COVERAGE_CORE": "ctrace",
    }  # fmt: skip
    command = [sys.executable, "-m", "pytest", "-q", "-n", "2", "--dist", "loadfile", "-m", MARKS[layer]]
    subprocess.run([*command, "-p", "recorder", "--timeout", "3000"], cwd=ROOT, env=environment, check=False)


class LineMap:
    """Which tests of a layer run a line, quickest first."""

    def __init__(self, place: Path) -> None:
        import coverage

        self._seconds: dict[str, float] = {}
        for row in (place / "seconds.tsv").read_text().splitlines():
            name, seconds, outcome = row.split("\t")
            if outcome == "passed":
                self._seconds[name] = float(seconds)
        self._data = []
        for path in sorted(place.glob("coverage.*")):
            data = coverage.CoverageData(str(path))
            data.read()
            self._data.append(data)
        self._of_file: dict[str, dict[int, set[str]]] = {}

    def tests(self, mutant: Mutant) -> list[str]:
        """Return the tests that run its line; where only an import runs it, those that run any line of its file."""
        if mutant.path not in self._of_file:
            table: dict[int, set[str]] = {}
            for data in self._data:
                for line, contexts in data.contexts_by_lineno(str(ROOT / mutant.path)).items():
                    table.setdefault(line, set()).update(contexts)
            self._of_file[mutant.path] = table
        table = self._of_file[mutant.path]
        found = {name for name in table.get(mutant.line, set()) if name in self._seconds}
        found = found or {name for names in table.values() for name in names if name in self._seconds}
        return sorted(found, key=self._seconds.__getitem__)


# Break, test, count.


class Tree:
    """A copy of the repository in which one fault stands at a time."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="mutants-"))
        self.root = self.folder / "softcal"
        listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True)
        for name in listed.stdout.split("\0"):
            if name and (ROOT / name).is_file():
                (self.root / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(ROOT / name, self.root / name)
        # Found before the installed package, in every process that a test starts.
        links = self.folder / "links/softcal"
        links.mkdir(parents=True)
        for path in (self.root / "app/face").iterdir():
            (links / path.name).symlink_to(path)
        for name in ("app", "core", "db", "station"):
            (links / name).symlink_to(self.root / name)
        self.environment = os.environ | {
            "PYTHONPATH": str(links.parent), "PYTHONDONTWRITEBYTECODE": "1",
            "SOFTCAL_DATA": os.environ.get("SOFTCAL_DATA", str(ROOT.parent / "shared/data")),
        }  # fmt: skip

    def notices(self, mutant: Mutant, tests: Sequence[str], longest_s: float) -> tuple[str, float]:
        """Return the test that failed, "" for none, and the seconds it took."""
        path = self.root / mutant.path
        whole = path.read_text("utf-8")
        path.write_text(broken(mutant), "utf-8")
        names = self.folder / "tests.txt"
        names.write_text("\n".join(tests))
        command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "--timeout", "120"]
        began_s = time.monotonic()
        try:
            done = subprocess.run(
                [*command, f"@{names}"], cwd=self.root, env=self.environment, capture_output=True, text=True,
                timeout=longest_s, start_new_session=True,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return "", time.monotonic() - began_s
        finally:
            path.write_text(whole, "utf-8")
        seconds = time.monotonic() - began_s
        if done.returncode == 0:
            return "", seconds
        failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
        return (failed[0].split()[1] if failed else f"exit code {done.returncode}"), seconds


def try_all(mutants: Sequence[Mutant], keep: Path, longest_s: float) -> None:
    """Try every fault that was not tried before, two at a time; append one line each to the file that is kept."""
    tried = {json.loads(line)["mutant"] for line in _lines(keep / "tried.jsonl")}
    maps = {layer: LineMap(keep / layer) for layer in MARKS if (keep / layer / "seconds.tsv").exists()}
    trees = [Tree(), Tree()]

    def work(which: int) -> None:
        for mutant in mutants[which :: len(trees)]:
            if mutant.name in tried:
                continue
            noticed_by, test, seconds = "", "", 0.0
            for layer, line_map in maps.items():
                if tests := line_map.tests(mutant):
                    test, took_s = trees[which].notices(mutant, tests, longest_s)
                    seconds += took_s
                    if test:
                        noticed_by = layer
                        break
            facts = {"layer": noticed_by, "test": test, "seconds": round(seconds, 1)}
            row = {"mutant": mutant.name, "room": mutant.room, **facts}
            with (keep / "tried.jsonl").open("a") as file:
                file.write(json.dumps(row) + "\n")

    with ThreadPoolExecutor(len(trees)) as pool:
        list(pool.map(work, range(len(trees))))
    for tree in trees:
        shutil.rmtree(tree.folder)


def _lines(path: Path) -> list[str]:
    return path.read_text().splitlines() if path.exists() else []


def print_table(mutants: Sequence[Mutant], keep: Path) -> None:
    """Print how many faults of each room were noticed, and by which layer."""
    rows = {row["mutant"]: row for row in map(json.loads, _lines(keep / "tried.jsonl"))}
    mine = [rows[m.name] for m in mutants if m.name in rows]
    print("| room | tried | noticed by the fast layer | by the long one alone | by none |\n|---|---|---|---|---|")
    for room in [*ROOMS, "all"]:
        here = [row for row in mine if room in (row["room"], "all")]
        counts = Counter(row["layer"] for row in here)
        print(f"| {room} | {len(here)} | {counts['fast']} | {counts['long']} | {counts['']} |")
    fast, every = (sum(row["layer"] in layers for row in mine) for layers in (("fast",), ("fast", "long")))
    low, high = wilson(fast, every)
    print(f"\nOf {every} that any test noticed the fast layer notices {fast}: {fast / max(1, every):.1%}", end="")
    print(f" (95 % {low:.1%} to {high:.1%}). Median {np.median([row['seconds'] for row in mine]):.1f} s a fault.")
    for row in mine:
        if row["layer"] != "fast":
            print(f"- {row['layer'] or 'none'}: `{row['mutant']}` {row['test']}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("map", "try", "table"))
    parser.add_argument("--layer", choices=tuple(MARKS), default="fast")
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=20201900178)
    parser.add_argument("--longest", type=float, default=240.0, help="seconds a fault may take in a layer")
    parser.add_argument("--keep", type=Path, default=ROOT / "build/mutants", help="where maps and results lie")
    options = parser.parse_args()
    if options.what == "map":
        make_map(options.layer, options.keep)
        return
    mutants = drawn(options.count, options.seed)
    if options.what == "try":
        try_all(mutants, options.keep, options.longest)
    print_table(mutants, options.keep)


if __name__ == "__main__":
    main()
