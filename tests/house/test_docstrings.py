"""Every module and every public class and function of softcal says in one sentence what it is."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDERS = ("app", "core", "db", "station")


Modules = dict[Path, ast.Module]


@pytest.fixture(scope="module")
def modules() -> Modules:
    paths = [path for top in FOLDERS for path in sorted((ROOT / top).rglob("*.py")) if path.read_text().strip()]
    return {path.relative_to(ROOT): ast.parse(path.read_text()) for path in paths}


def _public(body: list[ast.stmt]) -> Iterator[ast.FunctionDef | ast.ClassDef]:
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            yield node


def test_every_module_says_what_it_holds(modules: Modules) -> None:
    assert not [str(path) for path, module in modules.items() if not ast.get_docstring(module)]


def test_every_public_class_and_function_has_a_docstring(modules: Modules) -> None:
    # What the `render` of a page, or a tab with a module of its own, draws stands at the top of that.
    silent = [
        f"{path}:{node.lineno} {node.name}"
        for path, module in modules.items()
        for node in _public(module.body)
        if not ast.get_docstring(node)
        and (path.parent.name, node.name) != ("app_pages", "render")
        and not (path.parent.name == "tabs" and node.name == f"draw_{path.stem.partition('_')[2]}")
    ]
    assert not silent


def test_the_first_line_of_a_docstring_is_a_sentence(modules: Modules) -> None:
    unfinished = [
        f"{path}:{node.lineno} {node.name}"
        for path, module in modules.items()
        for node in _public(module.body)
        if (text := ast.get_docstring(node)) and not text.split("\n\n")[0].rstrip().endswith((".", ":", "?"))
    ]
    assert not unfinished


def test_physical_numbers_carry_their_unit(modules: Modules) -> None:
    bare = {"time", "force", "position", "speed", "duration", "timeout", "rate", "frequency", "voltage", "resistance"}
    missing = [
        f"{path}:{argument.lineno} {argument.arg}"
        for path, module in modules.items()
        for function in ast.walk(module)
        if isinstance(function, ast.FunctionDef)
        for argument in function.args.args
        if argument.arg in bare
    ]
    assert not missing
