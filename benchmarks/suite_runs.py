"""The fast layer again and again: does it say the same every time, in any order, on a busy machine?

    python benchmarks/suite_runs.py --mode plain --runs 5        as `make test` runs it
    python benchmarks/suite_runs.py --mode shuffled --runs 5     another order of the tests in every run
    python benchmarks/suite_runs.py --mode busy --runs 5         both cores busy with something else
    python benchmarks/suite_runs.py --mode files --runs 1        every file in a process of its own

Prints a row a run: what failed, seconds of the wall and of the processor. Exit code 1 where any test failed.
"""

import argparse
import os
import re
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[1]
MODES = ("plain", "shuffled", "busy", "files")
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


def tested(words: list[str]) -> tuple[int, list[str]]:
    """Run pytest; return how many passed and the names of those that did not."""
    done = subprocess.run([*PYTEST, *words], cwd=ROOT, capture_output=True, text=True)
    failed = re.findall(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
    if done.returncode not in (0, 5) and not failed:
        failed = [f"exit code {done.returncode}: {' '.join(words)}"]
    return sum(map(int, re.findall(r"(\d+) passed", done.stdout))), failed


def one_run(mode: str, number: int) -> tuple[int, list[str]]:
    if mode == "files":
        passed = 0
        failed: list[str] = []
        for path in sorted((ROOT / "tests").glob("*/test_*.py")):
            count, names = tested([str(path)])
            passed, failed = passed + count, failed + names
        return passed, failed
    words = [*TWO_AT_ONCE, "--shuffle", str(number)] if mode == "shuffled" else TWO_AT_ONCE
    with busy(2 if mode == "busy" else 0):
        return tested(words)


def cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mode", choices=MODES, default="plain")
    parser.add_argument("--runs", type=int, default=5)
    options = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    print("| mode | run | passed | failed | wall [s] | CPU [s] |\n|---|---|---|---|---|---|")
    every: list[str] = []
    for number in range(1, options.runs + 1):
        began_s, before_s = time.monotonic(), cpu_s()
        passed, failed = one_run(options.mode, number)
        wall_s, used_s = time.monotonic() - began_s, cpu_s() - before_s
        told = ", ".join(failed) or "0"
        print(f"| {options.mode} | {number} | {passed} | {told} | {wall_s:.0f} | {used_s:.0f} |", flush=True)
        every += failed
    sys.exit(1 if every else 0)


if __name__ == "__main__":
    main()
