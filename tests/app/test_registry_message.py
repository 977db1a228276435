"""A command that writes to a registry says on standard error which one it was."""

import ast
import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from softcal.app import cli
from softcal.app.cli.main import main
from softcal.db.connection import open_registry

CLI = Path(cli.__file__).parent


@pytest.mark.parametrize(
    ("command", "writes"),
    [
        ("lot rules small --target 5 --reason order", True),
        ("lot rules small", False),
        ("lot limit small --rmse 0.2 --reason customer --yes", True),
        ("registry list --json -", False),
        ("registry history --serial A1", False),
        ("registry verify --quick", False),
        ("quality yield --lot small", False),
        ("report small --out page.html", False),
    ],
)
def test_who_writes_names_the_registry_and_who_reads_does_not(
    calibrated, tmp_path, monkeypatch, capsys, command: str, writes: bool
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([*command.split(), "--registry", calibrated]) in (0, 1)
    assert (calibrated in capsys.readouterr().err) is writes


def test_the_answer_stays_alone_on_standard_output(calibrated, capsys) -> None:
    main(["lot", "rules", "small", "--target", "7", "--reason", "order", "--registry", calibrated, "--json", "-"])
    printed = capsys.readouterr()
    assert json.loads(printed.out)["now"]["target"] == 7 and printed.err.count(calibrated) == 1


def test_both_sides_of_a_synchronisation_are_named(calibrated, tmp_path, capsys) -> None:
    other = f"sqlite:///{tmp_path / 'line.db'}"
    open_registry(other).close()
    assert main(["registry", "sync", "--registry", other, "--with", calibrated]) == 0
    assert other in capsys.readouterr().err
    back = f"sqlite:///{tmp_path / 'back.db'}"
    backup = tmp_path / "backup.db"
    assert main(["registry", "backup", str(backup), "--registry", calibrated]) == 0
    assert main(["registry", "restore", str(backup), "--registry", back]) == 0
    assert back in capsys.readouterr().err


@pytest.mark.parametrize("url", ["postgresql://kim:s3cret@db/softcal", "postgresql://kim@db/softcal?password=s3cret"])
def test_no_password_is_reported(url: str, capsys) -> None:
    from softcal.app.cli.options import echo_written_url

    echo_written_url(url)
    assert "db/softcal" in (stderr := capsys.readouterr().err) and "s3cret" not in stderr


def openings() -> Iterator[str]:
    for file in CLI.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and {name.name for name in node.names} & {
                "open_chosen_registry",
                "open_registry",
            }:
                yield file.name


def test_commands_open_their_registry_at_one_place() -> None:
    assert list(openings()) == ["options.py"]
