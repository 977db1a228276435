"""The console script `softcal`: parse, run one command, map errors to exit codes."""

import argparse
import gc
import importlib
import os
import sys
from collections.abc import Collection
from functools import partial
from unicodedata import normalize

from softcal.app.bootstrap import ONE_THREAD
from softcal.app.cli.configuration import configure, files_in_use
from softcal.app.cli.parser import Parser
from softcal.app.extras import missing_extra
from softcal.app.output import answering, printing
from softcal.core.errors import InputError, SoftcalError

DONE, USAGE_ERROR = 0, InputError.exit_code

COMMANDS = {
    "demo": "the main job from end to end on a simulated station",
    "init": "make a lot folder or a station file by questions",
    "import_": "make a lot folder out of the files that loggers and laboratories write",
    "train": "train the shared network f on the source unit",
    "batch": "calibrate a lot: f, every map (--map exact, joint: the paper's transport), verdicts, registry, exports",
    "compare": "map families side by side on a lot: forecasts, and errors where units have audits",
    "estimate": "estimate the reference from a unit's output",
    "explain": "why the verdict of a unit is what it is: reasons, error budget, one figure",
    "trim": "two or more known loads at the place of use re-anchor a unit's map",
    "adapt": "estimate over long use, the map following the drift",
    "paper": "Tables 1 to 3 and Figures 8 and 9 of the paper, by its own method and by the default",
    "station": "the rig: find devices, self-test, press and record a unit",
    "export": "write calibration files for devices, PCs and auditors",
    "inspect_": "show what a table or a calibration file holds, and what is wrong with it",
    "registry": "the database: list, history, verify, backup, restore, sync, rollback, upgrade",
    "lot": "watch a lot folder; set the limit of a lot; plan and judge its audit",
    "quality": "gauge R&R, capability, yields, golden-unit trends",
    "gap": "diagnose the sim-to-real gap: where, which cause, how far it shrinks",
    "report": "one HTML page of a lot: verdicts, errors, process, every unit",
    "ui": "the operator's screen and the engineer's desk",
    "account": "people and programs, their roles and PINs",
    "api": "the REST interface for other programs, and their tokens",
    "connect": "send verdicts and alerts: webhooks, mail, MQTT, OPC UA",
    "doctor": "look the installation over; collect what support needs",
    "completion": "print what a shell needs to complete commands and options",
}
"""Modules of `softcal.app.cli`, in the order of `softcal --help`, and what each command is for.

Each has `EXAMPLES`, `arguments`, and `run` or actions that set it, and is imported when its command is called.
"""

LOGGED = ("demo", "import_", "train", "batch", "trim", "adapt", "station", "lot", "ui", "account", "api", "connect")
"""Commands whose runs are in the log: with what they were called, what they did, how they ended."""


def main(arguments: list[str] | None = None) -> int:
    """Run one command and return its exit code (0 done, 1 some unit did not pass, 2 use, 3 rig, 4 registry).

    A defect of softcal itself is one line for the person, too; its traceback goes to the log.
    """
    argv = sys.argv[1:] if arguments is None else arguments
    # Nearly all that a command makes stays until its end: to look through it for garbage costs a tenth of its start.
    gc.set_threshold(50_000, 20, 50)
    # Libraries read it when they are imported, which is later.
    os.environ.update(ONE_THREAD | os.environ)
    # A configuration file is checked whole, with the options of every command.
    parser = command_parser(COMMANDS if files_in_use() else ())
    try:
        configure(parser)
    except InputError as error:
        print(f"softcal: {error}", file=sys.stderr)
        return USAGE_ERROR
    options = parser.parse_args(argv)
    # A keyboard or a file name of a Mac gives letters in parts.
    if serial := getattr(options, "serial", None):
        normal = partial(normalize, "NFC")
        options.serial = normal(serial) if isinstance(serial, str) else list(map(normal, serial))
    log, command = None, str(options.run.__module__).rpartition(".")[2]
    if command in LOGGED:
        from softcal.app.logs import begin_run, end_run

        values = {name: getattr(options, name, None) for name in ("lot", "serial", "station", "actor")}
        context = {name: str(value) for name, value in values.items() if value is not None}
        log = begin_run(command.strip("_"), argv, **context)
    with printing():
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
    except SoftcalError as error:
        return error.exit_code, str(error)
    except KeyboardInterrupt:
        return USAGE_ERROR, "stopped by the keyboard; what was finished is kept, run the same command to go on"
    except BrokenPipeError:
        return DONE, ""
    except Exception as error:
        from softcal.app.logs import log_crash

        lacking = missing_extra(error) if isinstance(error, ModuleNotFoundError) else None
        return USAGE_ERROR, lacking or log_crash(error, str(options.run.__module__))


def command_parser(loaded: Collection[str] = COMMANDS) -> argparse.ArgumentParser:
    """Return the parser of all commands; of those in `loaded` the options are there, of others once they are called."""
    parser = Parser(
        prog="softcal",
        description="Calibrate soft sensors: one shared network, and one map per unit: from pairs, equal quantiles, "
        "or the exact plan of optimal transport.",
        epilog="Start with: softcal demo",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show program's version number and exit")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name, purpose in COMMANDS.items():
        command = commands.add_parser(name.rstrip("_"), help=purpose, load=partial(_load, name))
        if name in loaded:
            command.load()
    return parser


def _load(name: str, parser: Parser) -> None:
    """Import the module of a command and add its arguments to its parser."""
    module = importlib.import_module(f"softcal.app.cli.{name}")
    parser.description = " ".join((module.arguments.__doc__ or "").split())
    parser.epilog = module.EXAMPLES
    module.arguments(parser)
    parser.set_defaults(run=getattr(module, "run", None))


class _Version(argparse.Action):
    """Prints the version; only then is the metadata of the package read, which takes longer than any help."""

    def __call__(self, parser: argparse.ArgumentParser, *arguments: object) -> None:
        from importlib.metadata import version

        print(f"{parser.prog} {version('softcal')}")
        parser.exit()


if __name__ == "__main__":
    sys.exit(main())
