"""What every benchmark's command shares: its parser, a clock, an end to what hangs, and results kept between runs."""

import argparse
import json
import signal
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

Item = TypeVar("Item")


def parser_of(doc: str | None, quick: str = "", kept: bool = False) -> argparse.ArgumentParser:
    """Return a parser that describes itself by a module's docstring.

    Args:
        quick: what `--quick` leaves; "" for a benchmark without it.
        kept: whether there are `--kept FILE`, for `Kept`, and `--part K N`, for `part_of`.
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    if quick:
        parser.add_argument("--quick", action="store_true", help=quick)
    if kept:
        parser.add_argument("--kept", type=Path, metavar="FILE", help="results are kept here, one JSON line each")
        parser.add_argument("--part", type=int, nargs=2, default=(1, 1), metavar=("K", "N"), help="the K-th of N alone")
    return parser


class Commands:
    """A benchmark of several commands: one file, one command a table."""

    def __init__(self, doc: str | None) -> None:
        self._parser = parser_of(doc)
        self._below = self._parser.add_subparsers(required=True, metavar="COMMAND")

    def add(self, work: Callable[[argparse.Namespace], None], quick: str = "") -> argparse.ArgumentParser:
        """Add the command of a function's name, described by its docstring; return its parser for further options."""
        name, about = work.__name__.rstrip("_"), argparse.RawDescriptionHelpFormatter
        summary = str(work.__doc__).splitlines()[0]
        parser = self._below.add_parser(name, help=summary, description=work.__doc__, formatter_class=about)
        if quick:
            parser.add_argument("--quick", action="store_true", help=quick)
        parser.set_defaults(work=work)
        return parser

    def run(self) -> None:
        """Do what the command line asks for."""
        options = self._parser.parse_args()
        options.work(options)


def part_of(options: argparse.Namespace, items: Sequence[Item]) -> Sequence[Item]:
    """Return what `--part K N` leaves of some items."""
    k, n = options.part
    return items[k - 1 :: n]


class ResultCache:
    """Results by name, in a file where one is named: what was cut off goes on where it ended.

    Delete the file when the code has changed.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        lines = path.read_text().splitlines() if path is not None and path.exists() else []
        self._results: dict[str, Any] = dict(map(json.loads, lines))

    def has(self, name: str) -> bool:
        """Whether the result of a name is kept."""
        return name in self._results

    def get(self, name: str, make: Callable[[], Any]) -> Any:
        """Return the result of a name, made now where none is kept."""
        if name not in self._results:
            self._results[name] = make()
            if self._path is not None:
                self._path.parent.mkdir(parents=True, exist_ok=True)
                with self._path.open("a") as file:
                    file.write(json.dumps([name, self._results[name]]) + "\n")
        return self._results[name]


def median_s(work: Callable[[], object], times: int = 1) -> float:
    """Return the median wall time of a few runs."""
    seconds = []
    for _ in range(times):
        start_s = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start_s)
    return statistics.median(seconds)


@contextmanager
def no_longer_than(seconds: int, what: object) -> Iterator[None]:
    """Raise `TimeoutError` when the block takes more of the computer's time."""

    def hang(signal_number: int, frame: object) -> None:
        raise TimeoutError(f"{what} hangs")

    signal.signal(signal.SIGALRM, hang)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
