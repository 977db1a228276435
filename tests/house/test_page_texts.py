"""No sentence that can reach a page tells anyone to type a command: texts, reasons, and what the use cases refuse."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

from softcal.app.texts.catalogue import LANGUAGES, catalogue

ROOT = Path(__file__).parents[2]
COMMANDS = [file.stem.rstrip("_") for file in (ROOT / "app/cli").glob("*.py")]
COMMAND = re.compile(rf"softcal ({'|'.join(COMMANDS)})\b|`softcal|(?<![\w-])--[a-z]")

AT_A_TERMINAL = {
    "app/cli": "the commands themselves",
    "app/output.py": "the commands' own output",
    "app/bootstrap.py": "a process that cannot begin: there is no page yet",
    "app/logs.py": "to whoever keeps the server, beside the place of its log",
    "app/ui/desktop.py": "the command that starts the screens",
    "app/gap/challenge.py": "options of the challenge, which a command draws",
    "app/gap/simulator.py": "simulators, which a command names",
    "app/operation": "streams, which a command follows",
    "app/connect": "programs that speak to a registry; a command serves them",
    "app/rest": "programs that ask a registry; a command serves them",
    "app/line/rig.py": "which station a command means; a page always names one",
    "app/line/serve.py": "the command that serves a station",
    "app/tables": "how a table is laid out, which a command declares; a page shows the same sentence",
    "app/files/importing.py": "serials and columns, which a command names; New lot has fields for them",
    "app/files/recording_file.py": "columns of a file, which a command names; New lot has fields for them",
    "app/files/stream_file.py": "streams, which a command follows",
    "app/files/lot_folder.py": "folders of lots, which a page writes itself",
    "app/files/lot_toml.py": "folders of lots, which a page writes itself",
    "app/files/profile_file.py": "files of profiles, which a command names",
    "app/files/atomic.py": "where a command writes to",
    "app/export/signature.py": "keys, which a page never takes",
    "app/export/check.py": "checks a command makes",
    "app/gap/diagnose.py": "reports a command keeps as files",
    "app/registry/quality.py": "a limit that a command may state; a page draws no capability without one",
    "app/gap/sealed_file.py": "an examiner that a command asks",
    "app/ui/components/line_card.py": "properties of a style sheet",
    "core/export/c_text.py": "the head of a file for a device",
    "core/unit/correspondence.py": "where a number of the method comes from",
    "core/operation/method.py": "where a number of the method comes from",
    "core/twin/simulate.py": "twins a command keeps as files",
    "db/maintenance/sync.py": "registries that a command exchanges",
    "db/access/tokens.py": "tokens, which a command makes and withdraws",
    "db/provenance.py": "options of git, which no person reads",
    "db/connection.py": "to whoever keeps the registry: it cannot be opened",
    "db/schema/database.py": "to whoever keeps the registry: it cannot be opened",
    "db/schema/engines.py": "to whoever keeps the registry: it cannot be opened",
    "db/schema/column_types.py": "to whoever keeps the registry: it is damaged",
    "db/repositories/calibrations.py": "to whoever names a serial in a command; pages name lot and serial",
    "db/repositories/lot_decisions.py": "registries that a command exchanges",
    "db/repositories/registry_base.py": "to whoever keeps the registry: it is damaged",
}
"""File or folder → why no person at a page is told so."""


def _spoken(file: Path) -> list[str]:
    """Return the sentences of a file: constants of what is raised, returned or given to a reason."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    statements = [node for node in ast.walk(tree) if isinstance(node, ast.Raise | ast.Return | ast.Assign)]
    texts = [leaf for statement in statements for leaf in ast.walk(statement) if isinstance(leaf, ast.Constant)]
    return [str(leaf.value) for leaf in texts if isinstance(leaf.value, str)]


@cache
def _files() -> dict[str, list[str]]:
    files = (file for package in ("app", "core", "db") for file in sorted((ROOT / package).rglob("*.py")))
    texts_by_file = {str(file.relative_to(ROOT)): [s for s in _spoken(file) if COMMAND.search(s)] for file in files}
    return {name: texts for name, texts in texts_by_file.items() if texts}


def _terminal_folder(name: str) -> str | None:
    return next((folder for folder in AT_A_TERMINAL if name == folder or name.startswith(f"{folder}/")), None)


def test_no_use_case_behind_a_page_names_a_command() -> None:
    assert {name: texts for name, texts in _files().items() if _terminal_folder(name) is None} == {}


def test_every_exception_is_still_one() -> None:
    assert set(AT_A_TERMINAL) - {_terminal_folder(name) for name in _files()} <= set()


@pytest.mark.parametrize("language", LANGUAGES)
def test_no_text_of_a_page_names_a_command(language: str) -> None:
    assert {key: texts for key, texts in catalogue()[language].items() if COMMAND.search(texts)} == {}
