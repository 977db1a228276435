"""Defaults of options from configuration files: `softcal.toml` in the working folder, and one file of the user.

An option on the command line outranks an environment variable, that outranks the file of the working folder, and that
the file of the user. Flags are not taken: what moves a stage or overwrites something is said each time.
"""

import argparse
import os
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path

from softcal.app.cli.parser import suggestion
from softcal.core.errors import InputError

LOCAL_FILE = Path("softcal.toml")


def user_file() -> Path:
    """Return the path of the user's configuration file, whether it exists or not."""
    import platformdirs

    return Path(platformdirs.user_config_dir("softcal", appauthor=False)) / "softcal.toml"


def files_in_use() -> list[Path]:
    """Return the existing configuration files, in rising order of precedence."""
    return [path for path in (user_file(), LOCAL_FILE) if path.is_file()]


def configure(parser: argparse.ArgumentParser) -> None:
    """Set the defaults of options from the configuration files.

    A key outside every table is the option of that name of every command that has it. A key in `[batch]` or
    `[station.check]` is an option of that command.

    Raises:
        InputError: a file cannot be read, no command has an option of that name, or it does not take that value.
    """
    for path in files_in_use():
        try:
            table = tomllib.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror}); mend it or move it away") from error
        except ValueError as error:
            raise InputError(f"{path}: is not TOML ({error}); mend it or move it away") from error
        _apply(path, table, parser)


def _apply(path: Path, table: Mapping[str, object], parser: argparse.ArgumentParser, command: str = "") -> None:
    from softcal.app.bootstrap import REGISTRY_VARIABLE

    below = _commands(parser)
    for key, value in table.items():
        if isinstance(value, Mapping):
            if key not in below:
                hint = suggestion(key, below)
                raise InputError(f"{path}: [{f'{command}.{key}'.lstrip('.')}] is no command{hint}")
            _apply(path, value, below[key], f"{command}.{key}".lstrip("."))
            continue
        owners = [(each, action) for each in _leaves(parser) if (action := _options(each).get(key)) is not None]
        if not owners:
            hint = suggestion(key, {name for each in _leaves(parser) for name in _options(each)})
            raise InputError(f"{path}: no option --{key} of {command or 'any command'} takes a value{hint}")
        if key != "registry" or not os.environ.get(REGISTRY_VARIABLE):
            for owner, action in owners:
                _set(path, owner, action, value)


def _set(path: Path, owner: argparse.ArgumentParser, action: argparse.Action, value: object) -> None:
    """Set the default of an option, converted and checked like a typed value."""
    values = value if isinstance(value, list) else [value]
    if isinstance(value, list) == (action.nargs is None) or any(
        isinstance(each, (bool, dict, list)) for each in values
    ):
        expected = "text or a number" if action.nargs is None else "a list of texts or numbers"
        raise InputError(f"{path}: {_name(action)} = {value!r}: {expected} was expected")
    try:
        parsed_values = [owner._get_value(action, str(each)) for each in values]
        for each in parsed_values:
            owner._check_value(action, each)
    except argparse.ArgumentError as error:
        raise InputError(f"{path}: {_name(action)} = {value!r}: {error.message}") from None
    action.default = parsed_values[0] if action.nargs is None else parsed_values
    action.required = False


def _commands(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    return {
        name: below
        for action in parser._actions
        if isinstance(action, argparse._SubParsersAction)
        for name, below in action.choices.items()
    }


def _leaves(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    yield parser
    for below in _commands(parser).values():
        yield from _leaves(below)


def _options(parser: argparse.ArgumentParser) -> dict[str, argparse.Action]:
    """Return the options that take a value once, by name without dashes."""
    return {
        name.removeprefix("--"): action
        for action in parser._actions
        if action.nargs != 0 and not isinstance(action, argparse._AppendAction)
        for name in action.option_strings
        if name.startswith("--")
    }


def _name(action: argparse.Action) -> str:
    return max(action.option_strings, key=len).removeprefix("--")
