"""`softcal doctor`: look the installation over and collect what support needs, without secrets."""

import argparse
import json
from pathlib import Path

from softcal.app.cli.configuration import files_in_use
from softcal.app.cli.options import add_shared, answer
from softcal.app.output import echo, print_table

EXAMPLES = """examples:
  softcal doctor
  softcal doctor --registry postgresql://line@db/softcal --out support.zip

No password, PIN or recording goes into the report; logs go in with the passwords of URLs masked.
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Versions, folders, free space, the registry and its integrity: present state and faults."""
    add_shared(parser, "registry", "json", "csv")
    parser.add_argument("--out", type=Path, metavar="ZIP", help="write report and logs into one file for support")


def run(options: argparse.Namespace) -> None:
    """Print the facts, the problems on standard error."""
    from softcal.app.registry.doctor import collect, examine

    examined, problems = examine(options.registry)
    examined["configuration"] = [str(path) for path in files_in_use()] or "none"
    report = {**examined, "problems": problems}
    if options.out:
        logs = collect(options.out, json.dumps({"schema": "softcal.doctor/1", **report}, indent=2))
        echo(f"{options.out}: report and {logs} logs")
    if answer(options, "doctor/1", report):
        print_table(("what", "found"), [(name, _text(value)) for name, value in examined.items()])
        print(f"{len(problems)} problems" if problems else "no problems found")
    for problem in problems:
        echo(f"problem: {problem}")


def _text(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name} {_text(inner)}" for name, inner in value.items() if inner not in (None, [], {}))
    return str(value)
