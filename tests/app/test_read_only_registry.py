"""A registry that can only be read: every command that reads answers, every command that writes says so in one line."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from softcal.app.cli.main import main
from softcal.db.connection import open_registry
from softcal.db.registry import Registry

CHILD = """
import contextlib, io, json, sys
from softcal.app.cli.main import main
answers = []
for command in json.load(sys.stdin):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(command)
    answers.append([code, out.getvalue(), err.getvalue()])
json.dump(answers, sys.stdout)
"""
AS_ANYBODY = ["setpriv", "--bounding-set=-dac_override,-dac_read_search"] if os.geteuid() == 0 else []
"""Without these capabilities an administrator's program obeys the mode of files as anybody's does."""

READING = (
    "registry list",
    "registry history --serial A1",
    "explain --serial A1",
    "report small --out {out}/page.html",
    "export --serial A1 --format json --failed-too --out {out}/export",
    "estimate --serial A1 {lot}/units/A1.csv --out {out}/estimate.csv",
    "estimate --serial A2 {lot}/units/A2.csv --out {out}/estimate2.csv",
    "lot limit small",
    "lot network small",
    "lot rules small",
    "lot folder small --out {out}/folder",
    "lot audit-plan small",
    "quality yield --lot small",
    "registry backup {out}/backup.db",
    "registry verify",
)
WRITING = (
    "lot limit small --rmse 0.3 --reason customer",
    "lot rules small --target 5 --reason order",
    "registry rollback --serial A1 --to 1 --reason older",
    "adapt --serial A1 {lot}/units/A1.csv --out {out}/adapted.csv",
    "batch {lot} --hidden 16,8 --no-own",
)

Commands = Callable[[Path, list[list[str]]], list[tuple[int, str, str]]]


@pytest.fixture
def read_only() -> Iterator[Callable[[Path], None]]:
    """`read_only(folder)` takes every right to write from a folder and its files, until the test is over."""
    closed: list[Path] = []

    def close(folder: Path) -> None:
        for path in (*folder.iterdir(), folder):
            path.chmod(0o555 if path.is_dir() else 0o444)
        closed.append(folder)

    yield close
    for folder in closed:
        folder.chmod(0o755)


def answers_of(commands: list[list[str]]) -> list[tuple[int, str, str]]:
    """Return exit code, standard output and standard error of commands that run without an administrator's rights."""
    run = [*AS_ANYBODY, sys.executable, "-c", CHILD]
    process = subprocess.run(run, input=json.dumps(commands), capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr
    return [tuple(answer) for answer in json.loads(process.stdout)]


def cautioned(registry: Registry) -> int:
    return sum(row.action == "use" for row in registry.trail.rows())


@pytest.fixture
def folder(small_calibrated: Path, tmp_path: Path, separate_data_folder: None) -> Path:
    """A folder with the calibrated registry in it, its audits drawn and A2 beyond a limit."""
    folder = tmp_path / "archive"
    folder.mkdir()
    shutil.copy(small_calibrated, folder / "registry.db")
    url = f"sqlite:///{folder / 'registry.db'}"
    assert main(["lot", "audit-plan", "small", "--random", "1", "--registry", url]) in (0, 1)
    assert main(["lot", "limit", "small", "--rmse", "1e-6", "--reason", "strict", "--yes", "--registry", url]) == 0
    return folder


def commands(templates: tuple[str, ...], folder: Path, lot: Path, out: Path) -> list[list[str]]:
    out.mkdir(exist_ok=True)
    url = f"sqlite:///{folder / 'registry.db'}"
    return [[*text.format(out=out, lot=lot).split(), "--registry", url] for text in templates]


def test_who_reads_gets_the_same_answer_from_a_read_only_folder(folder, small_calibrated, tmp_path, read_only) -> None:
    lot = small_calibrated.parent / "lot"
    free = answers_of(commands(READING, folder, lot, tmp_path / "free"))
    with open_registry(f"sqlite:///{folder / 'registry.db'}") as registry:
        before = cautioned(registry)
    assert before > 1, "A1 and A2 were used although they did not pass"
    files = sorted(folder.iterdir())
    read_only(folder)
    closed = answers_of(commands(READING, folder, lot, tmp_path / "closed"))
    for text, (code, out, error), (code_closed, out_closed, error_closed) in zip(READING, free, closed, strict=True):
        assert code_closed == code in (0, 1), (text, error_closed)
        assert out_closed == out.replace(str(tmp_path / "free"), str(tmp_path / "closed")), text
        assert ("could not be recorded" in error_closed) == ("warning: unit" in error), text
    assert sorted(folder.iterdir()) == files
    assert sorted(p.name for p in (tmp_path / "closed").iterdir()) == sorted(
        p.name for p in (tmp_path / "free").iterdir()
    )


def test_who_writes_is_told_in_one_line_that_the_registry_is_read_only(
    folder, small_calibrated, tmp_path, read_only
) -> None:
    before = (folder / "registry.db").read_bytes()
    read_only(folder)
    out = tmp_path / "out"
    for code, _, error in answers_of(commands(WRITING, folder, small_calibrated.parent / "lot", out)):
        last = error.strip().splitlines()[-1]
        assert code == 4 and "read-only" in last and str(folder) in last, error
    assert (folder / "registry.db").read_bytes() == before and not list(out.iterdir())


@pytest.mark.parametrize("has_index", [True, False])
def test_what_a_left_over_log_holds_is_read(folder, tmp_path, read_only, has_index: bool) -> None:
    copied = tmp_path / "copied"
    copied.mkdir()
    with open_registry(f"sqlite:///{folder / 'registry.db'}") as registry:
        registry.lots.set_limit("small", 0.123, reason="stands in the log alone")
        for suffix in ("", "-wal", *(["-shm"] if has_index else [])):
            shutil.copy(folder / f"registry.db{suffix}", copied)
    files = {path: path.read_bytes() for path in copied.iterdir()}
    read_only(copied)
    commands = [["lot", "limit", "small", "--json", "-", "--registry", f"sqlite:///{copied / 'registry.db'}"]]
    ((code, out, error),) = answers_of(commands)
    assert code == 0 and json.loads(out)["versions"][-1]["rmse"] == 0.123, error
    assert {path: path.read_bytes() for path in copied.iterdir()} == files


def test_only_the_file_is_read_only(folder, read_only) -> None:
    (folder / "registry.db").chmod(0o444)
    url = f"sqlite:///{folder / 'registry.db'}"
    commands = [
        ["registry", "list", "--registry", url],
        ["lot", "limit", "small", "--rmse", "1", "--reason", "x", "--yes", "--registry", url],
    ]
    (code, out, _), (code_write, _, error) = answers_of(commands)
    assert code == 0 and "A1" in out and code_write == 4 and "read-only" in error
    assert [path.name for path in folder.iterdir()] == ["registry.db"]


def test_a_registry_nobody_may_read_is_one_line(folder) -> None:
    (folder / "registry.db").chmod(0)
    ((code, _, error),) = answers_of([["registry", "list", "--registry", f"sqlite:///{folder / 'registry.db'}"]])
    assert code == 4 and "cannot be read" in error and len(error.splitlines()) == 1
