"""How much of what is broken on purpose the tests notice: one small fault at a time, and the tests that run that line.

    python benchmarks/mutants.py map --layer fast      which tests run which line (coverage, two processes)
    python benchmarks/mutants.py try --layer fast      break, test; what is done is kept and not done again
    python benchmarks/mutants.py map --layer long
    python benchmarks/mutants.py try --layer long      what the fast layer has not noticed
    python benchmarks/mutants.py table                 count

A fault is drawn by a seed over the rooms that decide: a comparison, an arithmetic or logical operator, a constant, a
missing `not`. It is tried in a copy of the tree. The tests that run the broken line run, the quickest files first,
until one fails that does not fail without the fault. A fault that no test of a layer noticed within `--longest`
seconds of the processor counts as not noticed by it.
"""

import argparse
import ast
import json
import os
import random
import re
import shutil
import signal
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
    "station": "station/motion/*.py",
    "db": "db/*/*.py",
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
        every = [m for path in sorted(ROOT.glob(pattern)) for m in mutants_of(room, path)]
        share = count * (k + 1) // len(ROOMS) - count * k // len(ROOMS)
        chosen += rng.sample(every, share)
    return chosen


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
    """Which tests of a layer run a line, the quickest file first."""

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
        # Files stay together: what a file sets up is made once.
        of_file: dict[str, float] = {}
        for name in found:
            of_file[name.partition("::")[0]] = of_file.get(name.partition("::")[0], 0.0) + self._seconds[name]
        return sorted(found, key=lambda name: (of_file[name.partition("::")[0]], name.partition("::")[0]))


# Break, test, count.

TRIED = "tried.jsonl"


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
        self._sure: set[str] = set()
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
        """Return the first test that fails with the fault and not without it, "" for none, and the seconds it took."""
        path, began_s = self.root / mutant.path, time.monotonic()
        whole, left = path.read_text("utf-8"), list(tests)
        while left:
            path.write_text(broken(mutant), "utf-8")
            failed = self._first_failure(left, longest_s)
            path.write_text(whole, "utf-8")
            is_known = failed not in left or failed in self._sure
            if is_known or not self._first_failure([failed], longest_s):
                # A test passes without the fault once and for all.
                self._sure.add(failed)
                return failed, round(time.monotonic() - began_s, 1)
            left.remove(failed)
        return "", round(time.monotonic() - began_s, 1)

    def _first_failure(self, tests: Sequence[str], longest_s: float) -> str:
        names = self.folder / "tests.txt"
        names.write_text("\n".join(tests))
        # Time of the processor, behind other work: what runs beside it changes no answer.
        command = ["prlimit", f"--cpu={longest_s:.0f}", "nice", "-n", "5", sys.executable, "-m", "pytest", "-q", "-x"]
        command += ["-p", "no:cacheprovider", "--timeout", f"{30 * longest_s:.0f}", f"@{names}"]
        try:
            done = subprocess.run(
                command, cwd=self.root, env=self.environment, capture_output=True, text=True, timeout=40 * longest_s
            )
        except subprocess.TimeoutExpired:
            return ""
        if done.returncode in (0, -signal.SIGXCPU, -signal.SIGKILL):
            return ""
        failed = re.search(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", done.stdout, re.MULTILINE)
        return failed[1] if failed else f"exit code {done.returncode}"


def try_all(mutants: Sequence[Mutant], layer: str, keep: Path, longest_s: float) -> None:
    """Try every fault that no layer has noticed and this one has not tried; append a line each to the file kept."""
    rows = [json.loads(line) for line in _lines(keep / TRIED)]
    done = {row["mutant"] for row in rows if row["test"] or row["layer"] == layer}
    left = [mutant for mutant in mutants if mutant.name not in done]
    # All rooms at once: where it is stopped early, every room has been tried alike.
    random.Random(0).shuffle(left)
    line_map, trees = LineMap(keep / layer), [Tree(), Tree()]

    def work(which: int) -> None:
        for mutant in left[which :: len(trees)]:
            tests = line_map.tests(mutant)
            test, seconds = trees[which].notices(mutant, tests, longest_s) if tests else ("", 0.0)
            row = {"mutant": mutant.name, "room": mutant.room, "layer": layer, "test": test, "seconds": seconds}
            with (keep / TRIED).open("a") as file:
                file.write(json.dumps(row | {"tests": len(tests)}) + "\n")

    with ThreadPoolExecutor(len(trees)) as pool:
        list(pool.map(work, range(len(trees))))
    for tree in trees:
        shutil.rmtree(tree.folder)


def _lines(path: Path) -> list[str]:
    return path.read_text().splitlines() if path.exists() else []


def print_table(mutants: Sequence[Mutant], keep: Path) -> None:
    """Print how many faults of each room were noticed, and by which layer."""
    rows = [json.loads(line) for line in _lines(keep / TRIED)]
    noticed = {row["mutant"]: row["layer"] for row in rows if row["test"]}
    room_of = {row["mutant"]: row["room"] for row in rows}
    mine = [mutant.name for mutant in mutants if mutant.name in room_of]
    print("| room | tried | noticed by the fast layer | by the long one alone | by none |\n|---|---|---|---|---|")
    for room in [*ROOMS, "all"]:
        counts = Counter(noticed.get(name, "") for name in mine if room in (room_of[name], "all"))
        print(f"| {room} | {counts.total()} | {counts['fast']} | {counts['long']} | {counts['']} |")
    fast, every = sum(noticed.get(name) == "fast" for name in mine), sum(name in noticed for name in mine)
    low, high = wilson(fast, every)
    print(f"\nOf {every} that any test noticed the fast layer notices {fast}: {fast / max(1, every):.1%}", end="")
    print(f" (95 % {low:.1%} to {high:.1%}). Median {np.median([row['seconds'] for row in rows]):.1f} s a trial.")
    for name in mine:
        if noticed.get(name) != "fast":
            print(f"- {noticed.get(name, 'none')}: `{name}`")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("map", "try", "table"))
    parser.add_argument("--layer", choices=tuple(MARKS), default="fast")
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=20201900178)
    parser.add_argument("--longest", type=float, default=240.0, help="processor seconds for a fault")
    parser.add_argument("--keep", type=Path, default=ROOT / "build/mutants", help="where maps and results lie")
    options = parser.parse_args()
    if options.what == "map":
        make_map(options.layer, options.keep)
        return
    mutants = drawn(options.count, options.seed)
    if options.what == "try":
        try_all(mutants, options.layer, options.keep, options.longest)
    print_table(mutants, options.keep)


if __name__ == "__main__":
    main()
