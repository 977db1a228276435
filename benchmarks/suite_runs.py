"""The fast layer again and again: does it say the same every time, in any order, alone, on a busy machine?

    python benchmarks/suite_runs.py --runs 5                     as `make test` runs it
    python benchmarks/suite_runs.py --runs 5 --shuffled --busy   another order in every run, both cores busy otherwise
    python benchmarks/suite_runs.py --alone file                 every file in a process of its own
    python benchmarks/suite_runs.py --alone test --count 300     drawn tests, each in a process of its own

Prints a row a run: what failed, seconds of the wall and of the processor. Exit code 1 where any test failed.
"""

import argparse
import os
import random
import re
import resource
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[1]
PYTEST = [sys.executable, "-m", "pytest", "-q", "-m", "not long", "-p", "no:cacheprovider"]
TWO_AT_ONCE = ["-n", "2", "--dist", "loadfile", "--no-loadscope-reorder"]


@contextmanager
def busy(cores: int) -> Iterator[None]:
    """Keep so many cores busy."""
    spinning = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(cores)]
    try:
        yield
    finally:
        for process in spinning:
            process.kill()
            process.wait()


def pytest(words: Sequence[str]) -> str:
    return subprocess.run([*PYTEST, *words], cwd=ROOT, capture_output=True, text=True).stdout


def tested(runs: Sequence[Sequence[str]]) -> tuple[int, list[str]]:
    """Run pytest once with each of these words; return how many passed and the names of those that did not."""
    passed, failed = 0, []
    for words in runs:
        printed = pytest(words)
        names = re.findall(r"^(?:FAILED|ERROR) (\S+)", printed, re.MULTILINE)
        counts = re.findall(r"(\d+) (?:passed|deselected)", printed)
        failed += names or ([] if counts else [f"nothing told: {' '.join(words)}"])
        passed += sum(map(int, re.findall(r"(\d+) passed", printed)))
    return passed, failed


def alone(what: str, count: int, seed: int) -> list[list[str]]:
    """Return the words of pytest for every file, or for so many drawn tests."""
    if what == "file":
        return [[str(path)] for path in sorted((ROOT / "tests").glob("*/test_*.py"))]
    names = [line for line in pytest(["--collect-only"]).splitlines() if "::" in line]
    return [[name] for name in random.Random(seed).sample(names, count)]


def cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1)
    parser.add_argument("--shuffled", action="store_true", help="another order of the tests of each file in every run")
    parser.add_argument("--busy", action="store_true", help="keep two cores busy with something else")
    parser.add_argument("--alone", choices=("file", "test"), help="one process for each")
    parser.add_argument("--count", type=int, default=300, help="how many tests are drawn with `--alone test`")
    parser.add_argument("--seed", type=int, default=20201900178)
    options = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    print("| run | passed | failed | wall [s] | CPU [s] |\n|---|---|---|---|---|")
    every: list[str] = []
    for number in range(1, options.runs + 1):
        runs = [[*TWO_AT_ONCE, *(["--shuffle", str(number)] if options.shuffled else [])]]
        if options.alone:
            runs = alone(options.alone, options.count, options.seed)
        began_s, before_s = time.monotonic(), cpu_s()
        with busy(2 if options.busy else 0):
            passed, failed = tested(runs)
        wall_s, used_s = time.monotonic() - began_s, cpu_s() - before_s
        told = ", ".join(failed) or "0"
        print(f"| {number} | {passed} | {told} | {wall_s:.0f} | {used_s:.0f} |", flush=True)
        every += failed
    sys.exit(1 if every else 0)


if __name__ == "__main__":
    main()
