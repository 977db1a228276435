"""Options that several commands share, with their meaning."""

import argparse
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from softcal.app.output import ProgressLine, echo, write_json

if TYPE_CHECKING:
    from softcal.app.batch.lot_work import Callbacks
    from softcal.app.files.recording_file import ColumnNames
    from softcal.app.files.unused_input import UnusedInput
    from softcal.app.tables.options import TableOptions
    from softcal.core.messages.reason import Reason
    from softcal.core.network.config import EpochReport, NetworkConfig
    from softcal.db.entries import UnitResult
    from softcal.db.registry import Registry

T = TypeVar("T")


def positive(text: str) -> float:
    """Return a number above 0, for argparse."""
    value = float(text)
    if not 0 < value < 1e5:
        raise argparse.ArgumentTypeError(f"{text}: a number above 0 was expected")
    return value


def converted(convert: Callable[[str], T], expected: str) -> Callable[[str], T]:
    """Return a converter for argparse whose error names the expected value; `{!r}` is the given text."""

    def converter(text: str) -> T:
        try:
            return convert(text)
        except ValueError as error:
            raise argparse.ArgumentTypeError(expected.format(text)) from error

    return converter


FILE: dict[str, Any] = {"type": Path, "metavar": "FILE"}
DIR: dict[str, Any] = {"type": Path, "metavar": "DIR"}
COUNT: dict[str, Any] = {"type": int, "metavar": "N"}
"""What options of a file, a folder and a whole number take."""

SHARED: dict[str, dict[str, Any]] = {
    "registry": {
        "metavar": "URL",
        "help": "SQLAlchemy URL of the registry; default: $SOFTCAL_REGISTRY, else an SQLite file in the user's data "
        "folder",
    },
    "json": {"metavar": "FILE", "help": "machine-readable result; - for standard output"},
    "csv": {"metavar": "FILE", "help": "write the table as .csv or .xlsx; - for CSV on standard output"},
    "lot": {"metavar": "ID", "help": "lot of the unit; needed where the serial stands in several"},
    "serial": {"required": True, "metavar": "S"},
    "reason": {"required": True, "help": "lands in the audit trail"},
    "release": {
        "choices": ("pass", "conditional"),
        "default": "pass",
        "help": "which verdicts release files: pass (default), or conditional too, whose error is within the limit",
    },
    "yes": {"action": "store_true", "help": "do it without asking; needed where there is no terminal"},
    "depth": {"type": positive, "default": 3.5, "metavar": "MM", "help": "deepest press (default 3.5 mm)"},
    "profile-seed": {"type": int, "default": 0, "help": "draws the random presses (default 0)"},
    "spool": {**DIR, "help": "where samples go as they come; default: the user's data folder"},
}
"""Options of several commands, without dashes. `csv` is of those that answer with one table."""


def add_shared(parser: argparse._ActionsContainer, *names: str) -> None:
    """Add options of `SHARED` to a command."""
    for name in names:
        parser.add_argument(f"--{name}", **SHARED[name])


Action = Callable[..., argparse.ArgumentParser]
"""Adds an action to a command: name, summary, what runs it (its docstring describes it), other facts."""


def actions_of(
    parser: argparse.ArgumentParser,
    title: str = "actions",
    metavar: str = "ACTION",
    *,
    shared: Sequence[str] = (),
    is_described: bool = False,
) -> Action:
    """Add actions to a command, and return a function that adds one.

    Args:
        shared: options of `SHARED` that every action begins with.
        is_described: whether a summary is the description, too.
    """
    actions = parser.add_subparsers(title=title, metavar=metavar, required=True)

    def add(
        name: str,
        summary: str,
        run: Callable[[argparse.Namespace], int | None] | None,
        description: str | None = None,
        **parser_options: Any,
    ) -> argparse.ArgumentParser:
        if is_described:
            description = f"{summary[0].upper()}{summary[1:]}."
        elif run is not None and run.__doc__:
            description = description or " ".join(run.__doc__.split())
        action = actions.add_parser(name, help=summary, description=description, **parser_options)
        add_shared(action, *shared)
        action.set_defaults(run=run)
        return action

    return add


def add_columns(parser: argparse.ArgumentParser) -> None:
    """Add what `import` calls the columns of a table: for tables as an instrument wrote them."""
    group = parser.add_argument_group("columns of IN, where they are not t_s and output")
    group.add_argument("--output-column", metavar="NAME", help="column of the output")
    group.add_argument("--time-column", metavar="NAME", help=TIME_COLUMN_HELP)
    group.add_argument("--sample-rate", type=positive, metavar="HZ", help=SAMPLE_RATE_HELP)
    add_layout(parser)


TIME_COLUMN_HELP = "column of the time; default: t_s, time, timestamp or the like"
SAMPLE_RATE_HELP = "samples a second: a check of the time stamps; a file without any gets stamps by it"


def add_layout(parser: argparse.ArgumentParser) -> None:
    """Add the options for the layout of tables, which replace detection."""
    group = parser.add_argument_group("layout of the tables, which is detected where nothing is stated")
    group.add_argument("--delimiter", metavar="MARK", help="between cells: one character, tab or blanks")
    group.add_argument("--decimal", choices=(".", ","), help="decimal mark")
    group.add_argument("--encoding", metavar="NAME", help="of a text file, such as utf-16 or latin-1")
    group.add_argument("--header-row", metavar="LINE", type=int, help="line with the names of the columns; 0: none")
    group.add_argument("--sheet", metavar="NAME", help="sheet of a workbook, group or variable of a binary file")
    group.add_argument(
        "--time-format",
        metavar="FORMAT",
        help="s, ms, us, ns, min, iso, excel, or a pattern such as '%%d/%%m/%%Y %%H:%%M:%%S.%%f'",
    )
    group.add_argument(
        "--missing", metavar="TEXT", action="append", default=[],
        help="text that stands for a missing sample, beside an empty cell and NaN; again for further ones",
    )  # fmt: skip


def table_options(options: argparse.Namespace) -> "TableOptions":
    """Return the layout that the options state."""
    from softcal.app.tables.options import TableOptions

    names = ("delimiter", "decimal", "encoding", "header_row", "sheet", "time_format")
    declared = {name: value for name in names if (value := getattr(options, name)) is not None}
    cells = getattr(options, "most_cells", None)
    return TableOptions(missing=tuple(options.missing), **declared, **({} if cells is None else {"max_cells": cells}))


def echo_layout(name: str, layout: str, remarks: Sequence[str] = ()) -> None:
    """Print the layout of a file that differs from the plain form."""
    for line in (layout, *remarks):
        if line:
            echo(f"{name}: {line}")


def echo_layouts(layouts: Mapping[str, str]) -> None:
    """Report how files were read, a line for each layout but the plain one."""
    by_layout: dict[str, list[str]] = {}
    for name, layout in layouts.items():
        by_layout.setdefault(layout, []).append(name)
    for layout, names in by_layout.items():
        echo_layout(names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more", layout)


def column_names(options: argparse.Namespace) -> "ColumnNames":
    """Return the columns that the options name."""
    from softcal.app.files.recording_file import PLAIN, ColumnNames

    output = options.output_column or PLAIN.output
    return ColumnNames(output, options.time_column, rate_Hz=options.sample_rate, table=table_options(options))


def _widths(text: str) -> tuple[int, ...]:
    widths = tuple(int(part) for part in text.split(","))
    if min(widths) < 1:
        raise ValueError(text)
    return widths


def add_station(parser: argparse.ArgumentParser, simulated: str = "the simulated rig, faster than real time") -> None:
    """Add `--station FILE` and `--simulated`, of which one may be given."""
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--station", type=Path, metavar="FILE", help="station file (TOML)")
    where.add_argument("--simulated", nargs="?", type=int, const=0, metavar="SEED", help=simulated)


def add_network(parser: argparse.ArgumentParser) -> None:
    """Add the options of f's training."""
    group = parser.add_argument_group("shared network")
    widths = converted(_widths, "{!r}: positive layer widths such as 120,70,35 were expected")
    group.add_argument("--hidden", type=widths, default=(120, 70, 35), metavar="N,N,..", help="default 120,70,35")
    group.add_argument("--seed", type=int, default=0, help="drives initial weights and batch order (default 0)")
    group.add_argument("--members", type=int, default=1, metavar="N", help="networks averaged into one (default 1)")


def network_config(options: argparse.Namespace) -> "NetworkConfig":
    """Return the training configuration that the options give."""
    from softcal.core.network.config import NetworkConfig

    return NetworkConfig(hidden=options.hidden, seed=options.seed, members=options.members)


def registry_of(options: argparse.Namespace, *, create: bool = False) -> "AbstractContextManager[Registry]":
    """Open the registry of the options for a block; `create` makes a new one."""
    return registry_at(options.registry, create=create)


@contextmanager
def registry_at(url: str | None, *, create: bool = True) -> "Iterator[Registry]":
    """Open a registry, None for the default one; print its URL after the first write."""
    from softcal.app.bootstrap import open_chosen_registry, registry_url

    with open_chosen_registry(url, create=create) as registry:
        registry.database.on_first_write = lambda: echo_written_url(registry_url(url))
        yield registry


def echo_written_url(url: str) -> None:
    """Print the URL of the registry after a write, without its password."""
    from sqlalchemy import make_url

    from softcal.db.schema.database import redacted_url

    echo(f"written to the registry {redacted_url(make_url(url))}")


def answer(options: argparse.Namespace, schema: str, content: Mapping[str, object]) -> bool:
    """Write the JSON answer where one is asked for; return whether people read on, too."""
    write_json(options.json, {"schema": f"softcal.{schema}", **content})
    return options.json != "-" or getattr(options, "csv", None) is not None


def echo_unused_input(not_used: "Iterable[UnusedInput]", remarks: "Iterable[Reason | str]") -> None:
    """Print the irregularities and unused inputs at the end of a command."""
    from softcal.app.files.unused_input import unused_input_lines

    for line in (*(f"note: {remark}" for remark in remarks), *unused_input_lines(not_used)):
        echo(line)


def unused_json(not_used: "Iterable[UnusedInput]", remarks: "Iterable[Reason | str]") -> dict[str, object]:
    """Return the same as keys of a JSON answer."""
    return {"not_used": [item.to_json() for item in not_used], "remarks": list(map(str, remarks))}


def lot_id_of(lot: str) -> str:
    """Return the lot's id, given itself or its folder."""
    from softcal.app.files.lot_folder import open_lot_folder

    folder = Path(lot)
    return open_lot_folder(folder).lot.id if (folder / "lot.toml").is_file() else lot


def echo_caution(registry: "Registry", unit: "tuple[str, int | None, str | None]", action: str) -> None:
    """Warn in one line, and record in the audit trail, where the unit that is used did not pass."""
    from softcal.app.registry.unit_status import caution

    serial, revision, lot_id = unit
    if warning := caution(registry, registry.calibrations.get(serial, revision, lot_id=lot_id), action):
        echo(warning)


def echo_epoch(report: "EpochReport", unit: str) -> None:
    """Print every 20th epoch of a training as one line of progress."""
    if report.epoch % 20 == 0:
        echo(
            f"training f: epoch {report.epoch}/{report.max_epochs}, validation {report.validation_rmse:.4g} {unit}, "
            f"best {report.best_validation_rmse:.4g} {unit}"
        )


def batch_callbacks(unit: str) -> "Callbacks":
    """Return a watch that prints the progress of a lot; errors are in `unit`."""
    from softcal.app.batch.lot_work import Callbacks

    progress: ProgressLine | None = None
    note = ""

    def on_unit(result: "UnitResult") -> None:
        nonlocal note
        note = f"{result.serial} {result.verdict}"

    def on_done(done: int, units: int) -> None:
        nonlocal progress
        if progress is None:
            progress = ProgressLine("units", units, done)
        else:
            progress.show_progress(done, note)

    return Callbacks(
        on_epoch=lambda report: echo_epoch(report, unit),
        on_unit=on_unit,
        on_done=on_done,
        on_wait=lambda count: echo(f"waiting for {count} units that other batches hold"),
    )
