"""kill -9 in every command that writes: the registry is whole, and the command done again ends as if nothing had been.

    python benchmarks/kill_matrix.py [--quick] [--kills 8] [--seed N] [--minutes M] [--databases SQLite PostgreSQL]

Each command is done once without a kill, on a copy of one registry. Then, again and again on a fresh copy, it is killed
at a random moment and done again. Afterwards `verify` must find nothing, and every row and every file must be as
without a kill: rows without instants, durations, and ids drawn at random; files to the byte, but for those that two
undisturbed runs write differently.
"""

import contextlib
import hashlib
import io
import math
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from common.command import parser_of
from common.registries import DATABASES, fresh_url, make_lot
from common.tables import print_table
from sqlalchemy import create_engine, make_url, select

from softcal.app.cli.main import main as softcal
from softcal.core.errors import NoRegistry
from softcal.db.connection import open_registry
from softcal.db.schema.column_types import UtcTime
from softcal.db.schema.tables import metadata

SMALL = ("--hidden", "16,8", "--seed", "1")
UNITS = 4
PASSING = {"work_items", "heartbeats", "line_places", "jobs", "registry_info", "run_signals"}
"""Tables of work in progress."""

VARYING = {"hash", "prev_hash", "seq", "before", "after", "fit_s", "origin", "token_sha256", "pin_hash", "state_sha256",
         "made_by", "follows_origin"}  # fmt: skip
"""Columns that hold a chain, a duration, or what is drawn at random."""


@dataclass(frozen=True)
class Case:
    """One command.

    Args:
        argv: with {url}, {lot}, {id}, {root} (files of this trial) and {other} (a second registry) to be filled in.
        is_fresh: whether it begins with an empty registry, else with that of a lot that was calibrated.
    """

    name: str
    argv: tuple[str, ...]
    is_fresh: bool = False


def _case(arguments: str, *more: str, is_fresh: bool = False, has_registry: bool = True) -> Case:
    argv = (*arguments.split(), *more, *(("--registry", "{url}") if has_registry else ()))
    action = list(takewhile(lambda word: not word.startswith(("--", "{")), arguments.split()))
    options = [word for word in arguments.split()[len(action) :] if word in ("--out", "--refit", "--withdraw")]
    return Case(" ".join(action + options), argv, is_fresh)


WHY = ("--reason", "agreed with the customer")
CASES = (
    _case("lot rules {id} --target 7", *WHY),
    _case("lot audit-plan {id} --random 2 --seed 3"),
    _case("registry rollback --serial U000001 --to 1 --yes", *WHY),
    _case("account set kim --role operator --pin-file {pin}", *WHY),
    _case(
        "station certificate --cell 7 --number C1 --laboratory lab --issued 2026-01-02 --due 2027-01-02 "
        "--capacity 20 --uncertainty 0.02"
    ),
    _case("lot network {id} --withdraw {network}", *WHY),
    _case("lot limit {id} --rmse 0.31 --yes", *WHY),
    _case("trim --serial U000002 --loads {loads} --yes"),
    _case("lot audit {id} {audit}/U000000.csv {audit}/U000001.csv --yes"),
    _case("estimate {audit}/U000000.csv --serial U000000 --out {root}/estimate.csv"),
    _case("explain --serial U000000 --out {root}/why.html"),
    _case("import {lot}/source/S0.csv {lot}/units/U000000.csv --source S0 --out {root}/made", has_registry=False),
    _case("gap challenge --cases 2 --seed 4 --out {root}/sealed", has_registry=False),
    _case("station unit --simulated --serial A1 --out {root}/A1.csv --spool {root}/spool.part", has_registry=False),
    _case("registry upgrade", is_fresh=True),
    _case("registry backup {root}/backup.db"),
    _case("registry restore {backup}", is_fresh=True),
    _case("registry sync --with {other}"),
    _case("lot folder {id} --out {root}/folder"),
    _case("report {id} --out {root}/report.html"),
    _case("lot fit {id} --yes", *WHY),
    _case("export --lot {id} --format json --format pdf --failed-too --out {root}/files"),
    _case("adapt {audit}/U000000.csv --serial U000000 --out {root}/followed.csv --resume"),
    _case("train {lot}", *SMALL, is_fresh=True),
    _case("batch {lot}", *SMALL, is_fresh=True),
    _case("batch {lot} --refit", *SMALL),
    _case("batch {lot} --out {root}/out", *SMALL),
)
"""The cheapest first."""


def main() -> None:
    """Kill every command on both databases, and print what was left."""
    parser = parser_of(__doc__, "two kills a command")
    parser.add_argument("--kills", type=int, default=8, help="a command and a database")
    parser.add_argument("--seed", type=int, default=5000)
    parser.add_argument("--minutes", type=float, default=math.inf, help="begin no command after so long")
    parser.add_argument("--databases", nargs="+", choices=DATABASES, default=DATABASES)
    parser.add_argument("--only", default="", help="commands whose name begins so")
    options = parser.parse_args()
    kills, end_s = 2 if options.quick else options.kills, time.monotonic() + 60 * options.minutes
    head = "command | registry | kills | not whole | not as without a kill | twice"
    cases = [case for case in CASES if case.name.startswith(options.only)]
    print_table(head, _rows(cases, options.databases, kills, options.seed, end_s))


def _rows(cases: list[Case], kinds: list[str], kills: int, seed: int, end_s: float) -> Iterator[tuple[object, ...]]:
    with tempfile.TemporaryDirectory(prefix="softcal-bench-") as name, contextlib.ExitStack() as stack:
        world = _World(Path(name), stack)
        for case in cases:
            for kind in kinds:
                if time.monotonic() < end_s:
                    moments = random.Random(f"{seed} {case.name} {kind}")
                    try:
                        yield _killed(world, case, kind, kills, moments, end_s)
                    except CommandFailed as error:
                        print(f"{case.name} on {kind}: {error}", file=sys.stderr)


class _World:
    """A lot folder, its audits, and a registry in which it was calibrated, on either database when it is needed."""

    def __init__(self, root: Path, stack: contextlib.ExitStack) -> None:
        self.stack = stack
        self.root, self.lot = root, make_lot(root / "killed", UNITS, 60.0)
        self.audit, self.pin, self.base = root / "audit", root / "pin", root / "base.db"
        self.audit.mkdir()
        self.pin.write_text("2580\n")
        rng = np.random.default_rng(1)
        source = np.loadtxt(self.lot / "source/S0.csv", delimiter=",", skiprows=1)[:1250]
        for k in range(2):
            rows = source + [0.0, 0.01, 0.0] * rng.normal(size=source.shape)
            header = "t_s,output,reference"
            np.savetxt(self.audit / f"U{k:06d}.csv", rows, "%.7g", ",", header=header, comments="")
        url = f"sqlite:///{self.base}"
        _run(["batch", str(self.lot), "--registry", url, *SMALL])
        with open_registry(url, create=False) as registry:
            self.network = registry.networks.all()[-1].id
        # A second revision, so that there is one to go back from.
        _run(["trim", "--serial", "U000001", "--loads", str(self._loads("U000001", url)), "--yes", "--registry", url])
        self.loads = self._loads("U000002", url)
        self.backup = root / "backup.db"
        _run(["registry", "backup", str(self.backup), "--registry", url])
        # A byte copy would be the same registry, with which nothing is exchanged.
        self.other = root / "other.db"
        other = ["--registry", f"sqlite:///{self.other}"]
        _run(["registry", "restore", str(self.backup), *other])
        _run(["lot", "limit", self.lot.name, "--rmse", "0.33", "--yes", *WHY, *other])

    def _loads(self, serial: str, url: str) -> Path:
        """Write three known loads of a unit, as its own calibration reads them, a little off."""
        estimates, loads = self.root / f"{serial}-estimates.csv", self.root / f"{serial}-loads.csv"
        unit = self.lot / f"units/{serial}.csv"
        _run(["estimate", str(unit), "--serial", serial, "--registry", url, "--out", str(estimates)])
        table = pd.read_csv(unit).merge(pd.read_csv(estimates)[["t_s", "estimate"]]).dropna().sort_values("output")
        chosen = table.iloc[[int(share * len(table)) for share in (0.1, 0.5, 0.9)]]
        chosen.assign(reference=1.15 * chosen.estimate)[["output", "reference"]].to_csv(loads, index=False)
        return loads

    @contextlib.contextmanager
    def registry(self, kind: str, is_fresh: bool) -> Iterator[str]:
        """Give the URL of a copy of the registry, or of an empty one."""
        with fresh_url(kind, "" if is_fresh or kind == "SQLite" else self.template) as url:
            if not is_fresh and kind == "SQLite":
                shutil.copy(self.base, Path(make_url(url).database or ""))
            yield url

    @cached_property
    def template(self) -> str:
        """The database on the server that every trial there begins with a copy of; it goes with the world."""
        url = self.stack.enter_context(fresh_url("PostgreSQL"))
        _run(["registry", "restore", str(self.backup), "--registry", url])
        return str(make_url(url).database)

    def argv(self, case: Case, url: str, root: Path) -> list[str]:
        names = {
            "url": url,
            "lot": self.lot,
            "id": self.lot.name,
            "root": root,
            "audit": self.audit,
            "loads": self.loads,
            "pin": self.pin,
            "network": self.network[:12],
            "backup": self.backup,
            "other": f"sqlite:///{root / 'other.db'}",
        }
        return [word.format(**names) for word in case.argv]


def _run(argv: list[str]) -> int:
    """Run a command in this process; return its exit code."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as stderr:
        try:
            code = softcal(argv)
        except SystemExit as end:
            code = int(end.code or 0)
    if code not in (0, 1):
        _run.said = stderr.getvalue()  # type: ignore[attr-defined]
    return code


def _forked(argv: list[str], after_s: float) -> bool:
    """Run a command in a process of its own and kill it after so long; whether it was cut before its end."""
    child = os.fork()
    if not child:
        os.setsid()
        with contextlib.suppress(BaseException):
            _run(argv)
        os._exit(0)
    end_s = time.monotonic() + after_s
    while time.monotonic() < end_s:
        if os.waitpid(child, os.WNOHANG)[0]:
            return False
        time.sleep(0.002)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return True


class CommandFailed(Exception):
    """A command does not go through without a kill."""


Outcome = tuple[dict[str, list[str]], dict[str, str]]


def _undisturbed(world: _World, case: Case, kind: str) -> tuple[Outcome, float]:
    with world.registry(kind, case.is_fresh) as url, tempfile.TemporaryDirectory() as name:
        _prepare(case, world, Path(name))
        argv = world.argv(case, url, Path(name))
        began_s = time.monotonic()
        child = os.fork()
        if not child:
            os._exit(_run(argv))
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        seconds = time.monotonic() - began_s
        if code not in (0, 1):
            _run(argv)
            raise CommandFailed(f"exit {code}: {getattr(_run, 'said', '')[-300:]}")
        return (_dump(url, name), _files(Path(name))), seconds


def _prepare(case: Case, world: _World, root: Path) -> None:
    if "{other}" in case.argv:
        shutil.copy(world.other, root / "other.db")


def _killed(
    world: _World, case: Case, kind: str, kills: int, moments: random.Random, end_s: float
) -> tuple[object, ...]:
    (rows, files), first_s = _undisturbed(world, case, kind)
    (_, again), second_s = _undisturbed(world, case, kind)
    seconds = min(first_s, second_s)
    same = {path for path, sha256 in files.items() if again.get(path) == sha256}
    cut = broken = unlike = twice = completed = 0
    while cut < kills and completed < 3 * kills and (not completed or time.monotonic() < end_s):
        completed += 1
        with world.registry(kind, case.is_fresh) as url, tempfile.TemporaryDirectory() as name:
            root = Path(name)
            _prepare(case, world, root)
            argv = world.argv(case, url, root)
            if not _forked(argv, moments.uniform(0.0, seconds)):
                seconds *= 0.9
                continue
            cut += 1
            is_whole = True
            # A registry that the command was to make may not be there yet.
            with contextlib.suppress(NoRegistry), open_registry(url, create=False) as registry:
                is_whole = registry.verify() == []
            _run(argv)
            rows_after, files_after = _dump(url, name), _files(root)
            is_like = {t: set(r) for t, r in rows_after.items()} == {t: set(r) for t, r in rows.items()}
            is_like = (
                is_like and set(files_after) == set(files) and all(files_after[path] == files[path] for path in same)
            )
            broken, unlike = broken + (not is_whole), unlike + (not is_like)
            is_twice = sum(map(len, rows_after.values())) > sum(map(len, rows.values()))
            twice += is_twice
            if not is_like or not is_whole or is_twice:
                _classify(case, kind, rows, rows_after, files, files_after, same)
    return case.name, kind, cut, broken, unlike, twice


def _classify(case: Case, kind: str, rows: Any, rows_after: Any, files: Any, files_after: Any, same: set[str]) -> None:
    for table in rows:
        before, after = Counter(rows[table]), Counter(rows_after[table])
        for sign, one in (("-", before - after), ("+", after - before)):
            print(f"{case.name} {kind} {table} {sign} {sorted(one)[:3]}"[:600], file=sys.stderr) if one else None
    names = {path for path in same if files_after.get(path) != files[path]} | (set(files_after) ^ set(files))
    print(f"{case.name} {kind} files {sorted(names)[:8]}", file=sys.stderr) if names else None


def _dump(url: str, root: str) -> dict[str, list[str]]:
    """Return every row of every table as text, without what differs from run to run: the folder of the trial is one."""
    engine = create_engine(make_url(url))
    rows: dict[str, list[str]] = {}
    with engine.connect() as connection:
        for table in metadata.sorted_tables:
            if table.name in PASSING or table.name == "blobs":
                continue
            columns = [c for c in table.columns if not isinstance(c.type, UtcTime) and not {c.name, str(c)} & VARYING]
            if table.name == "audit":
                columns = [c for c in columns if c.name in ("action", "entity", "reason")]
            table_rows = connection.execute(select(*columns)).all()
            rows[table.name] = sorted(repr([_plain(value) for value in row]).replace(root, "") for row in table_rows)
    engine.dispose()
    return rows


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items() if not k.endswith(("_s", "_at", "sha256"))}
    if isinstance(value, list):
        return [_plain(one) for one in value]
    return value


def _files(root: Path) -> dict[str, str]:
    """Return the SHA-256 of every file by its name, but for registries and hidden parts that a kill leaves."""
    paths = [path for path in root.rglob("*") if path.is_file() and ".db" not in path.name]
    paths = [path for path in paths if ".part" not in str(path.relative_to(root))]
    return {str(path.relative_to(root)): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}


if __name__ == "__main__":
    main()
