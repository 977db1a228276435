"""The console script `softcal`: parse, run one command, map errors to exit codes. Heavy imports stay in commands."""

import argparse
import importlib
import sys
from importlib.metadata import version

from softcal.core.errors import DeviceError, InputError, RegistryError, SoftcalError

DONE, SOME_UNIT_NOT_PASSED, WRONG_USE, RIG_FAILED, REGISTRY_FAILED = 0, 1, 2, 3, 4

COMMANDS = (
    "demo",
    "import_",
    "train",
    "batch",
    "estimate",
    "adapt",
    "station",
    "export",
    "inspect_",
    "registry",
    "lot",
    "quality",
    "gap",
    "ui",
    "doctor",
)
"""Modules of `softcal.app.commands`, in the order of `softcal --help`; each has `add_parser` and sets `run`."""


def main(arguments: list[str] | None = None) -> int:
    """Run one command and return its exit code (0 done, 1 some unit did not pass, 2 use, 3 rig, 4 registry).

    A defect of softcal itself is one line for the person, too; its traceback goes to the log.
    """
    options = _parser().parse_args(arguments)
    try:
        return int(options.run(options))
    except InputError as error:
        return _say(error, WRONG_USE)
    except DeviceError as error:
        return _say(error, RIG_FAILED)
    except RegistryError as error:
        return _say(error, REGISTRY_FAILED)
    except SoftcalError as error:
        return _say(error, WRONG_USE)
    except KeyboardInterrupt:
        return _say("stopped by the keyboard; what was finished is kept, run the same command to go on", WRONG_USE)
    except BrokenPipeError:
        sys.stderr.close()
        return DONE
    except Exception as error:
        from softcal.app.logs import log_crash

        return _say(log_crash(error, str(options.run.__module__)), WRONG_USE)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="softcal",
        description="Calibrate soft sensors: one shared network, one optimal-transport map per unit.",
        epilog="Start with: softcal demo",
    )
    parser.add_argument("--version", action="version", version=f"softcal {version('softcal')}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name in COMMANDS:
        importlib.import_module(f"softcal.app.commands.{name}").add_parser(commands)
    return parser


def _say(message: object, code: int) -> int:
    print(f"softcal: {message}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
