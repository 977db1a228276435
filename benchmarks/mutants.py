"""How much of what is broken on purpose the tests notice: one small fault at a time, and the tests that run that line.

    python benchmarks/mutants.py map                          which fast tests run which line (coverage, two processes)
    python benchmarks/mutants.py try --layer fast             break, test; what is done is kept and not done again
    python benchmarks/mutants.py try --layer long --most 60   of what the fast layer has not noticed, so many drawn
    python benchmarks/mutants.py table                        count

A fault is drawn by a seed over the rooms that decide: a comparison, an arithmetic or logical operator, a constant, a
missing `not`. It is tried in a copy of the tree. The fast tests that run the broken line run, the nearest and quickest
first, until one fails that does not fail without the fault. Of the long layer the tests run whose file names the broken
module or something public of it, then those of the same room. A fault that no test of a layer noticed within
`--longest` seconds of the processor counts as not noticed by it.
"""

import argparse
import ast
import gc
import json
import multiprocessing
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
PUBLIC = ROOT / "app/public"
PACKAGES = {
    "core/unit": "core/unit/*.py",
    "core/maps": "core/maps/*.py",
    "core/gap": "core/gap/*.py",
    "core/quality": "core/quality/*.py",
    "station": "station/motion/*.py",
    "db": "db/*/*.py",
    "app/batch": "app/batch/*.py",
    "app/calibration": "app/calibration/*.py",
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

    package: str
    path: str
    line: int
    column: int
    was: str
    text: str

    @property
    def name(self) -> str:
        return f"{self.path}:{self.line}:{self.column} {self.was} -> {self.text}"


@dataclass(frozen=True)
class MutationPoint:
    """Where a fault can be made, and what would stand there."""

    path: Path
    node: ast.expr
    changed: ast.expr

    def mutant(self, package: str) -> Mutant:
        was = ast.get_source_segment(self.path.read_text("utf-8"), self.node) or ""
        path, text = self.path.relative_to(ROOT).as_posix(), f"({ast.unparse(self.changed)})"
        return Mutant(package, path, self.node.lineno, self.node.col_offset, was, text)


def points_of(path: Path) -> Iterator[MutationPoint]:
    """Yield every fault that can be made in a file."""
    tree = ast.parse(path.read_text("utf-8"))
    skipped = {id(inner) for node in ast.walk(tree) for quiet in _quiet(node) for inner in ast.walk(quiet)}
    for node in ast.walk(tree):
        if id(node) not in skipped and isinstance(node, ast.expr):
            yield from (MutationPoint(path, node, changed) for changed in _changes(node))


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


def draw_mutants(count: int, seed: int) -> list[Mutant]:
    """Return so many faults, as many of every room as of the others."""
    rng = random.Random(seed)
    chosen: list[Mutant] = []
    for k, (package, pattern) in enumerate(PACKAGES.items()):
        every = [location for path in sorted(ROOT.glob(pattern)) for location in points_of(path)]
        share = count * (k + 1) // len(PACKAGES) - count * k // len(PACKAGES)
        chosen += [location.mutant(package) for location in rng.sample(every, share)]
    return chosen


def broken(mutant: Mutant) -> str:
    """Return the text of its file with the fault in it."""
    lines = (ROOT / mutant.path).read_text("utf-8").encode().splitlines(keepends=True)
    start = sum(map(len, lines[: mutant.line - 1])) + mutant.column
    whole = b"".join(lines)
    return (whole[:start] + mutant.text.encode() + whole[start + len(mutant.was.encode()) :]).decode()


# Which tests run which line.

LAYERS = {"fast": "not long", "long": "long"}
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


def make_map(out_folder: Path) -> None:
    """Run the fast layer under coverage and keep which test runs which line."""
    database = out_folder / "fast"
    shutil.rmtree(database, ignore_errors=True)
    database.mkdir(parents=True)
    (database / "recorder.py").write_text(RECORDER)
    source = json.dumps([str(ROOT / folder) for folder in ("core", "db", "station", "app")])
    environment = os.environ | {
        "MUTANTS_MAP": str(database), "MUTANTS_SOURCE": source, "PYTHONPATH": str(database), "COVERAGE_CORE": "ctrace",
    }  # fmt: skip
    command = [sys.executable, "-m", "pytest", "-q", "-n", "2", "--dist", "loadfile", "-m", LAYERS["fast"]]
    subprocess.run([*command, "-p", "recorder", "--timeout", "3000"], cwd=ROOT, env=environment, check=False)


class LineMap:
    """Which fast tests run a line, the nearest and quickest first."""

    def __init__(self, database: Path) -> None:
        import coverage

        self.seconds: dict[str, float] = {}
        for row in (database / "seconds.tsv").read_text().splitlines():
            name, seconds, outcome = row.split("\t")
            if outcome == "passed":
                self.seconds[name] = float(seconds)
        self._data = []
        for path in sorted(database.glob("coverage.*")):
            data = coverage.CoverageData(str(path))
            data.read()
            self._data.append(data)
        self._of_file: dict[str, dict[int, set[str]]] = {}
        self._texts: dict[str, str] = {}

    def tests(self, mutant: Mutant) -> list[str]:
        """Return the tests that run its line, or any line of its file where an import runs it; the nearest first."""
        if mutant.path not in self._of_file:
            table: dict[int, set[str]] = {}
            for data in self._data:
                for line, contexts in data.contexts_by_lineno(str(ROOT / mutant.path)).items():
                    table.setdefault(line, set()).update(contexts)
            self._of_file[mutant.path] = table
        table = self._of_file[mutant.path]
        tests_of_line = {name for name in table.get(mutant.line, set()) if name in self.seconds}
        tests_of_line = tests_of_line or {name for names in table.values() for name in names if name in self.seconds}
        return sorted(tests_of_line, key=lambda name: (self._distance(name, mutant.path), self.seconds[name]))

    def _distance(self, name: str, path: str) -> int:
        """Return 0 where the test file names the module, 1 where it lies in its folder, else 2."""
        file = name.partition("::")[0]
        if file not in self._texts:
            self._texts[file] = (ROOT / file).read_text("utf-8")
        return 0 if module_of(path) in self._texts[file] else 1 if file.split("/")[1] == path.split("/")[0] else 2


class NamedTests:
    """Which long tests are about a module: those whose file names it most, then those whose own name shares words."""

    def __init__(self) -> None:
        arguments = ["-q", "--collect-only", "-m", LAYERS["long"], "-p", "no:cacheprovider"]
        listed = [sys.executable, "-m", "pytest", *arguments]
        printed = subprocess.run(listed, cwd=ROOT, capture_output=True, text=True, check=True).stdout
        self._of_file: dict[str, list[str]] = {}
        for name in printed.splitlines():
            if "::" in name:
                self._of_file.setdefault(name.partition("::")[0], []).append(name)
        self._texts = {file: (ROOT / file).read_text("utf-8") for file in self._of_file}
        # How long each takes is not known beforehand.
        self.seconds = {name: 2.0 for names in self._of_file.values() for name in names}

    def tests(self, mutant: Mutant) -> list[str]:
        """Return the tests of the files that name its module or something public of it, then those of its room."""
        tree = ast.parse((ROOT / mutant.path).read_text("utf-8"))
        kinds = (ast.FunctionDef, ast.ClassDef)
        public = [n.name for n in ast.walk(tree) if isinstance(n, kinds) and not n.name.startswith("_")]
        pattern = re.compile(rf"\b(?:{'|'.join(map(re.escape, [module_of(mutant.path), *public]))})\b")
        path_parts = set(re.split(r"[/_.]", mutant.path))
        files = []
        for file, text in self._texts.items():
            hits = len(pattern.findall(text)), len(path_parts & set(re.split(r"[/_.]", file)) - {"py"})
            if hits[0] or hits[1]:
                files.append((hits, file))
        return [name for _, file in sorted(files, reverse=True) for name in self._of_file[file]]


def module_of(path: str) -> str:
    return "softcal." + path.removesuffix(".py").replace("/", ".")


# Break, test, count.

RESULTS_FILE = "tried.jsonl"


class Tree:
    """A copy of the repository in which one fault stands at a time."""

    def __init__(self, seconds: Mapping[str, float]) -> None:
        self._seconds = seconds
        self.folder = Path(tempfile.mkdtemp(prefix="mutants-"))
        self.root = self.folder / "softcal"
        listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True)
        for name in listed.stdout.split("\0"):
            if name and (ROOT / name).is_file():
                (self.root / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(ROOT / name, self.root / name)
        self._sure: set[str] = set()
        self._written_s = int(time.time())
        # Found before the installed package, in every process that a test starts.
        links = self.folder / "links/softcal"
        links.mkdir(parents=True)
        for path in (self.root / "app/public").iterdir():
            (links / path.name).symlink_to(path)
        for name in ("app", "core", "db", "station"):
            (links / name).symlink_to(self.root / name)
        self.environment = os.environ | {
            "PYTHONPATH": str(links.parent), "PYTHONDONTWRITEBYTECODE": "",
            "SOFTCAL_DATA": os.environ.get("SOFTCAL_DATA", str(ROOT.parent / "shared/data")),
        }  # fmt: skip

    def notices(self, mutant: Mutant, tests: Sequence[str], longest_s: float) -> tuple[str, float]:
        """Return the first test that fails with the fault and not without it, "" for none, and the seconds it took."""
        path, began_s = self.root / mutant.path, time.monotonic()
        whole, remaining_tests = path.read_text("utf-8"), list(tests)
        while remaining_tests:
            self._write(path, broken(mutant))
            failed = self.first_failure(remaining_tests, longest_s)
            self._write(path, whole)
            is_expected = failed not in remaining_tests or failed in self._sure
            if is_expected or not self.first_failure([failed], longest_s):
                # A test passes without the fault once and for all.
                self._sure.add(failed)
                return failed, round(time.monotonic() - began_s, 1)
            remaining_tests.remove(failed)
        return "", round(time.monotonic() - began_s, 1)

    def _write(self, path: Path, text: str) -> None:
        """Write a file at a time of its own: what was compiled of it before is never taken for it."""
        path.write_text(text, "utf-8")
        self._written_s += 10
        os.utime(path, (self._written_s, self._written_s))

    def first_failure(self, tests: Sequence[str], longest_s: float) -> str:
        """Return the first test that fails, "" for none within so many seconds of the processor."""
        printed, cpu_s = self.folder / "printed.txt", FORKED.Value("d", 0.0)
        for batch in _batches(tests, self._seconds):
            left_s = longest_s - cpu_s.value
            if left_s < 1.0:
                return ""
            child = FORKED.Process(target=run_tests, args=(self.root, self.environment, batch, left_s, printed, cpu_s))
            child.start()
            child.join(40 * longest_s)
            if child.exitcode != 0:
                child.kill()
                child.join()
                if child.exitcode in (-signal.SIGXCPU, -signal.SIGKILL):
                    return ""
                failed = re.search(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", printed.read_text(), re.MULTILINE)
                # Where nothing can be collected any more, no test has a name.
                return failed[1] if failed else f"exit code {child.exitcode}"
        return ""


FORKED = multiprocessing.get_context("forkserver")
PRELOADED = (
    "hypothesis.stateful", "xdist.plugin", "playwright.sync_api", "alembic.command", "streamlit.testing.v1", "numpy",
    "pandas", "ot", "torch", "sqlalchemy", "scipy.stats", "scipy.optimize", "plotly", "serial", "pytest",
)  # fmt: skip
"""What a trial finds imported already; softcal is not among it."""


def run_tests(
    root: Path, environment: dict[str, str], tests: Sequence[str], longest_s: float, printed: Path, cpu_s: Any
) -> None:
    """Run tests in a copy of the tree, as a process of its own behind other work; add the processor's seconds it took.

    Args:
        used_s: shared number of seconds.
    """
    import pytest

    # What was imported before the fork is not looked at by every collection.
    gc.freeze()
    os.nice(5)
    resource.setrlimit(resource.RLIMIT_CPU, (int(longest_s) + 1, int(longest_s) + 2))
    os.environ.update(environment)
    os.chdir(root)
    sys.path[:0] = [environment["PYTHONPATH"]]
    sys.dont_write_bytecode = False
    file = printed.open("w")
    os.dup2(file.fileno(), 1)
    os.dup2(file.fileno(), 2)
    quiet = ["-p", "no:cacheprovider", "-W", "ignore::pytest.PytestAssertRewriteWarning"]
    code = pytest.main(["-q", "-x", *quiet, "--timeout", f"{40 * longest_s:.0f}", *tests])
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    cpu_s.value += sum(one.ru_utime + one.ru_stime for one in usages)
    sys.exit(int(code))


def _batches(tests: Sequence[str], seconds: Mapping[str, float]) -> Iterator[Sequence[str]]:
    """Yield tests in pieces of three times the length: most faults are noticed before the long tests are read."""
    batch: list[str] = []
    margin_s = 3.0
    for name in tests:
        if batch and sum(seconds[one] for one in batch) + seconds[name] > margin_s:
            yield batch
            batch, margin_s = [], 3.0 * margin_s
        batch.append(name)
    yield batch


def try_all(mutants: Sequence[Mutant], layer: str, folder: Path, longest_s: float, max_count: int | None) -> None:
    """Try faults that no layer has noticed and this one has not tried; append a line each to the file kept.

    Args:
        most: so many, drawn; None: all.
    """
    rows = [json.loads(line) for line in _lines(folder / RESULTS_FILE)]
    finished = {row["mutant"] for row in rows if row["test"] or row["layer"] == layer}
    remaining = [mutant for mutant in mutants if mutant.name not in finished]
    # All rooms at once: where it is stopped early, every room has been tried alike.
    random.Random(0).shuffle(remaining)
    remaining = remaining[:max_count]
    chosen = LineMap(folder / layer) if layer == "fast" else NamedTests()
    trees = [Tree(chosen.seconds), Tree(chosen.seconds)]

    for tree in trees:
        # What fails without a fault in this way would count as noticed.
        if failed := tree.first_failure([min(chosen.seconds, key=lambda name: chosen.seconds[name])], longest_s):
            raise RuntimeError(f"{failed} fails without a fault; {tree.folder}/printed.txt says why")

    def work(which: int) -> None:
        for mutant in remaining[which :: len(trees)]:
            tests = chosen.tests(mutant)
            test, seconds = trees[which].notices(mutant, tests, longest_s) if tests else ("", 0.0)
            row = {"mutant": mutant.name, "room": mutant.package, "layer": layer, "test": test, "seconds": seconds}
            with (folder / RESULTS_FILE).open("a") as file:
                file.write(json.dumps(row | {"tests": len(tests)}) + "\n")

    with ThreadPoolExecutor(len(trees)) as pool:
        list(pool.map(work, range(len(trees))))
    for tree in trees:
        shutil.rmtree(tree.folder)


def _lines(path: Path) -> list[str]:
    return path.read_text().splitlines() if path.exists() else []


def print_table(mutants: Sequence[Mutant], folder: Path) -> None:
    """Print how many faults of each room were noticed, and by which layer."""
    rows = [json.loads(line) for line in _lines(folder / RESULTS_FILE)]
    noticed = {row["mutant"]: row["layer"] for row in rows if row["test"]}
    by_long = {row["mutant"]: bool(row["test"]) for row in rows if row["layer"] == "long"}
    package_of = {row["mutant"]: row["room"] for row in rows}
    mine = [mutant.name for mutant in mutants if mutant.name in package_of]
    print("| room | tried | noticed by the fast layer | of the others tried with the long one | noticed by it |")
    print("|---|---|---|---|---|")
    for package in [*PACKAGES, "all"]:
        of_package = [name for name in mine if package in (package_of[name], "all")]
        fast, long = (
            [noticed.get(name) == "fast" for name in of_package],
            [by_long[n] for n in of_package if n in by_long],
        )
        print(f"| {package} | {len(fast)} | {sum(fast)} | {len(long)} | {sum(long)} |")
    if by_long:
        from softcal.core.metrics import wilson

        fast = sum(noticed.get(name) == "fast" for name in mine)
        low, high = (share * (len(mine) - fast) for share in wilson(sum(by_long.values()), len(by_long)))
        mean = sum(by_long.values()) / len(by_long) * (len(mine) - fast)
        print(f"\nOf what any test notices the fast layer notices {fast / (fast + mean):.1%}", end="")
        print(f" (95 % {fast / (fast + high):.1%} to {fast / (fast + low):.1%}).")
    else:
        print("\nThe long layer has not been tried: what share the fast one has is not known.")
    print(f"Median {np.median([row['seconds'] for row in rows]):.1f} s a trial.")
    for name in mine:
        if noticed.get(name) != "fast":
            print(f"- {noticed.get(name, 'none')}: `{name}`")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("map", "try", "table"))
    parser.add_argument("--layer", choices=tuple(LAYERS), default="fast")
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=20201900178)
    parser.add_argument("--longest", type=float, default=240.0, help="processor seconds for a fault")
    parser.add_argument("--most", type=int, help="try so many, drawn of those that are left; without it all")
    parser.add_argument("--keep", type=Path, default=ROOT / "build/mutants", help="where maps and results lie")
    options = parser.parse_args()
    if options.what == "map":
        make_map(options.keep)
        return
    FORKED.set_forkserver_preload(list(PRELOADED))
    mutants = draw_mutants(options.count, options.seed)
    if options.what == "try":
        try_all(mutants, options.layer, options.keep, options.longest, options.most)
    print_table(mutants, options.keep)


if __name__ == "__main__":
    main()
