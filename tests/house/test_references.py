"""Documents, docstrings and comments name only files, modules, commands and options that exist."""

import argparse
import ast
import importlib.util
import io
import re
import tokenize
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from softcal.app.cli.main import command_parser

ROOT = Path(__file__).parents[2]
FOLDERS = ("app", "core", "db", "station")
CODE = [path for folder in (*FOLDERS, "benchmarks") for path in sorted((ROOT / folder).rglob("*.py"))]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
HOMES = "app|core|db|station|benchmarks|tests|firmware|examples|deploy|docs"
FILES = "py|md|c|h|cpp|ino|toml|yaml|txt|service|json|csv|db|pub|pem|sig|svg|html|js|xsd|lock|ssc|secret|ini"
OF_OTHER_PROGRAMS = {"--addon=misra", "--std=c99", "--to", "--shuffle"}
"""Options that a page names of a program beside softcal."""
EVENTS = {"softcal.alert.raised", "softcal.alert.cleared"}
"""Types of events, which look like names of modules."""


@dataclass
class Module:
    """What a module says about itself, what it defines or imports, and every name it uses."""

    texts: list[str] = field(default_factory=list)
    defined: set[str] = field(default_factory=set)
    names_used: set[str] = field(default_factory=set)


@cache
def _read(path: Path) -> Module:
    module = Module()
    text = path.read_text("utf-8")
    if "#" in text:
        tokens = tokenize.generate_tokens(io.StringIO(text).readline)
        module.texts += [token.string for token in tokens if token.type == tokenize.COMMENT]
    for node in ast.walk(ast.parse(text)):
        match node:
            case ast.Expr(value=ast.Constant(value=str(text))):
                module.texts.append(text)
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                module.defined.add(name)
            case ast.Name(id=name):
                (module.defined if isinstance(node.ctx, ast.Store) else module.names_used).add(name)
            case ast.Attribute(attr=name) | ast.arg(arg=name):
                module.names_used.add(name)
            case ast.alias(name=name, asname=asname):
                module.defined.add((asname or name).split(".")[-1])
    return module


@cache
def _texts() -> tuple[tuple[str, str], ...]:
    """Return each page, docstring and comment of the product with where it stands."""
    pages = [(page.name, page.read_text("utf-8")) for page in PAGES]
    return (*pages, *((p.relative_to(ROOT).as_posix(), text) for p in CODE for text in _read(p).texts))


def _quoted(text: str) -> list[str]:
    return re.findall(r"`([^`\n]+)`", re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL))


def test_every_file_that_is_named_exists() -> None:
    name = re.compile(rf"(?<![\w./-])((?:{HOMES})/[a-z0-9_./-]*[a-z0-9_-]\.(?:py|md|c|h|cpp|ino|toml|yaml|service))\b")
    missing = [(where, one) for where, text in _texts() for one in name.findall(text) if not (ROOT / one).exists()]
    assert missing == []


def test_every_python_file_that_is_named_alone_exists() -> None:
    there = {path.name for folder in HOMES.split("|") for path in (ROOT / folder).rglob("*.py")}
    there |= {path.name for path in ROOT.glob("*.py")}
    name = re.compile(r"(?<![\w./-])([a-z_]\w*\.py)\b")
    script_names = {one for _, text in _texts() for one in re.findall(r"(?:^`|--out )(\w+\.py)", text, re.MULTILINE)}
    assert [
        (where, one) for where, text in _texts() for one in name.findall(text) if one not in there | script_names
    ] == []


@cache
def _modules() -> dict[str, list[Path]]:
    """Return the modules and packages of softcal by their own name."""
    modules: dict[str, list[Path]] = defaultdict(list)
    for folder in FOLDERS:
        modules[folder].append(ROOT / folder)
        for path in (ROOT / folder).rglob("*"):
            if path.suffix == ".py" and path.name != "__init__.py":
                modules[path.stem].append(path)
            elif (path / "__init__.py").is_file():
                modules[path.name].append(path)
    return modules


def _holds(home: Path, name: str) -> bool:
    """Whether a module defines or uses a name, or a package has a module of that name."""
    if home.is_dir():
        package_file = home / "__init__.py"
        return any(child.stem == name for child in home.iterdir()) or (
            package_file.is_file() and _holds(package_file, name)
        )
    return name in _read(home).defined | _read(home).names_used


@cache
def _spoken() -> frozenset[str]:
    return frozenset(name for path in CODE for name in _read(path).names_used | _read(path).defined)


def _is_there(name: str) -> bool:
    """Whether a dotted name leads somewhere: from a module of softcal, another library, a variable, or a text."""
    first, *rest = name.removeprefix("softcal.").split(".")
    homes = _modules().get(first, [])
    if rest and homes and any(_holds(home, rest[0]) for home in homes):
        return True
    if (not homes or name == f"softcal.{first}") and (
        {first, *rest} <= _spoken() or importlib.util.find_spec(first) is not None
    ):
        return True
    return any(
        path.read_text("utf-8").count(name) > sum(text.count(name) for text in _read(path).texts) for path in CODE
    )


def test_every_module_that_is_named_exists() -> None:
    missing = [
        (where, name)
        for where, text in _texts()
        for name in (quoted.removesuffix("()") for quoted in _quoted(text))
        if re.fullmatch(r"[a-z_]+(?:\.[A-Za-z]*[a-z_]+)+", name)
        and name.rpartition(".")[2] not in FILES.split("|")
        and name not in EVENTS
        and not _is_there(name)
    ]
    assert missing == []


def _parsers(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    yield parser
    for below in _below(parser).values():
        yield from _parsers(below)


def test_every_option_that_is_named_exists() -> None:
    options = {option for parser in _parsers(command_parser()) for option in parser._option_string_actions}
    options |= {
        o for path in CODE for o in re.findall(r'"(--[a-z][\w-]*)"', path.read_text("utf-8"))
    } | OF_OTHER_PROGRAMS
    missing = [
        (where, option)
        for where, text in _texts()
        for quoted in _quoted(text)
        if quoted.startswith("--")
        for option in re.findall(r"(?<!\S)--[a-z][\w=-]*", quoted)
        if option not in options and option.partition("=")[0] not in options
    ]
    assert missing == []


def test_every_command_that_is_named_exists_and_takes_the_options_said() -> None:
    unknown, whole = [], command_parser()
    for where, text in _texts():
        for quoted in re.findall(r"`softcal ([a-z][^`]*)`", text):
            parser, arguments = whole, quoted.split()
            while arguments and (below := _below(parser)) and arguments[0] in below:
                parser = below[arguments.pop(0)]
            known_options = {option for one in _parsers(parser) for option in one._option_string_actions}
            options = {word.partition("=")[0] for word in arguments if word.startswith("--")}
            is_unknown = bool(_below(parser) and arguments and re.fullmatch(r"[a-z-]+", arguments[0]))
            if parser is whole or is_unknown or not options <= known_options:
                unknown.append((where, quoted))
    assert unknown == []


def _below(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    return {k: v for a in parser._actions if isinstance(a, argparse._SubParsersAction) for k, v in a.choices.items()}
