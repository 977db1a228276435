"""The console script `softcal`: parse, run one command, map errors to exit codes."""

import argparse
import importlib
import sys
from collections.abc import Sequence
from importlib.metadata import version

from softcal.app.cli.configuration import configure, files_in_use
from softcal.app.cli.parser import Parser
from softcal.app.extras import missing_extra
from softcal.app.output import answering
from softcal.core.errors import DeviceError, InputError, RegistryError, SoftcalError

DONE, SOME_UNIT_NOT_PASSED, WRONG_USE, RIG_FAILED, REGISTRY_FAILED = 0, 1, 2, 3, 4

COMMANDS = tuple(
    "demo init import_ train batch estimate explain trim adapt station export inspect_ registry lot quality gap report "
    "ui account api connect doctor completion".split()
)
"""Modules of `softcal.app.cli`, in the order of `softcal --help`; each has `HELP`, `EXAMPLES`, `arguments` and
`run`, or actions that set it."""

LOGGED = ("demo", "import_", "train", "batch", "trim", "adapt", "station", "lot", "ui", "account", "api", "connect")
"""Commands whose runs are in the log: with what they were called, what they did, how they ended."""


def main(arguments: list[str] | None = None) -> int:
    """Run one command and return its exit code (0 done, 1 some unit did not pass, 2 use, 3 rig, 4 registry).

    A defect of softcal itself is one line for the person, too; its traceback goes to the log.
    """
    given = sys.argv[1:] if arguments is None else arguments
    # The modules of the commands that can matter: the one that is named, else all
    named = [name for name in COMMANDS if name.rstrip("_") in given[:1]]
    # A configuration file is checked whole, with the options of every command.
    parser = command_parser(COMMANDS if not named or files_in_use() else named)
    try:
        configure(parser)
    except InputError as error:
        print(f"softcal: {error}", file=sys.stderr)
        return WRONG_USE
    options = parser.parse_args(given)
    log, command = None, str(options.run.__module__).rpartition(".")[2]
    if command in LOGGED:
        from softcal.app.logs import begin_run, end_run

        facts = {name: getattr(options, name, None) for name in ("lot", "serial", "station", "actor")}
        context = {name: str(value) for name, value in facts.items() if value is not None}
        log = begin_run(command.strip("_"), given, **context)
    code, message = _outcome(options)
    if log is not None:
        end_run(log, code, message)
    if message:
        print(f"softcal: {message}", file=sys.stderr)
    return code


def _outcome(options: argparse.Namespace) -> tuple[int, str]:
    try:
        csv = getattr(options, "csv", None)
        with answering(getattr(options, "json", None), None if csv is None else str(csv)):
            return options.run(options) or DONE, ""
    except DeviceError as error:
        return RIG_FAILED, str(error)
    except RegistryError as error:
        return REGISTRY_FAILED, str(error)
    except SoftcalError as error:
        return WRONG_USE, str(error)
    except KeyboardInterrupt:
        return WRONG_USE, "stopped by the keyboard; what was finished is kept, run the same command to go on"
    except BrokenPipeError:
        sys.stderr.close()
        return DONE, ""
    except Exception as error:
        from softcal.app.logs import log_crash

        lacking = missing_extra(error) if isinstance(error, ModuleNotFoundError) else None
        return WRONG_USE, lacking or log_crash(error, str(options.run.__module__))


def command_parser(modules: Sequence[str] = COMMANDS) -> argparse.ArgumentParser:
    """Return the parser of the commands in these modules."""
    parser = Parser(
        prog="softcal",
        description="Calibrate soft sensors: one shared network, one optimal-transport map per unit.",
        epilog="Start with: softcal demo",
    )
    parser.add_argument("--version", action="version", version=f"softcal {version('softcal')}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name in modules:
        module = importlib.import_module(f"softcal.app.cli.{name}")
        what = " ".join((module.arguments.__doc__ or "").split())
        command = commands.add_parser(name.rstrip("_"), help=module.HELP, description=what, epilog=module.EXAMPLES)
        module.arguments(command)
        command.set_defaults(run=getattr(module, "run", None))
    return parser


if __name__ == "__main__":
    sys.exit(main())
