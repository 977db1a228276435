"""Options that several commands share, and what they mean."""

import argparse
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING

from softcal.app.output import ProgressLine, say

if TYPE_CHECKING:
    from softcal.app.batch.lot_work import Watch
    from softcal.app.batch.report import UnitResult
    from softcal.app.files.recording_file import ColumnNames
    from softcal.core.network.config import EpochReport, NetworkConfig
    from softcal.db.registry import Registry

REGISTRY_HELP = (
    "SQLAlchemy URL of the registry; default: $SOFTCAL_REGISTRY, else an SQLite file in the user's data folder"
)
JSON_HELP = "machine-readable result; - for standard output"


def add_action(
    actions: "argparse._SubParsersAction[argparse.ArgumentParser]",
    shared: Iterable[Callable[[argparse.ArgumentParser], None]],
    name: str,
    summary: str,
    run: Callable[[argparse.Namespace], int],
) -> argparse.ArgumentParser:
    """Add an action of a command, described by its summary, with the options that `shared` adds."""
    parser = actions.add_parser(name, help=summary, description=f"{summary[0].upper()}{summary[1:]}.")
    for add in shared:
        add(parser)
    parser.set_defaults(run=run)
    return parser


def add_registry(parser: argparse.ArgumentParser) -> None:
    """Add `--registry URL`."""
    parser.add_argument("--registry", metavar="URL", help=REGISTRY_HELP)


def add_lot_of_serial(parser: argparse.ArgumentParser) -> None:
    """Add `--lot ID`, which says what unit a serial means that stands in several lots."""
    parser.add_argument("--lot", metavar="ID", help="lot of the unit; needed where the serial stands in several")


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add `--json FILE`."""
    parser.add_argument("--json", metavar="FILE", help=JSON_HELP)


def add_csv(parser: argparse.ArgumentParser) -> None:
    """Add `--csv FILE`, for a command whose answer is one table."""
    parser.add_argument("--csv", metavar="FILE", help="write the table as .csv or .xlsx; - for CSV on standard output")


def add_columns(parser: argparse.ArgumentParser) -> None:
    """Add what `import` calls the columns of a table: for tables as an instrument wrote them."""
    group = parser.add_argument_group("columns of IN, where they are not t_s and output")
    group.add_argument("--output-column", metavar="NAME", help="column of the output")
    group.add_argument("--time-column", metavar="NAME", help="column of the time in s")
    group.add_argument(
        "--sample-rate", type=positive, metavar="HZ", help="without a column of time: samples a second make the time"
    )


def column_names(options: argparse.Namespace) -> "ColumnNames":
    """Return the columns that the options name."""
    from softcal.app.files.recording_file import PLAIN, ColumnNames

    is_timed = options.time_column is not None or options.sample_rate is None
    time = (options.time_column or PLAIN.time) if is_timed else None
    return ColumnNames(options.output_column or PLAIN.output, time, options.sample_rate)


def add_network(parser: argparse.ArgumentParser) -> None:
    """Add the options of f's training."""
    group = parser.add_argument_group("shared network")
    group.add_argument("--hidden", type=_widths, default=(120, 70, 35), metavar="N,N,..", help="default 120,70,35")
    group.add_argument("--seed", type=int, default=0, help="drives initial weights and batch order (default 0)")
    group.add_argument("--members", type=int, default=1, metavar="N", help="networks averaged into one (default 1)")


def positive(text: str) -> float:
    """Return a number above 0, for argparse."""
    value = float(text)
    if not 0 < value < 1e5:
        raise argparse.ArgumentTypeError(f"{text}: a number above 0 was expected")
    return value


def _widths(text: str) -> tuple[int, ...]:
    try:
        widths = tuple(int(part) for part in text.split(","))
    except ValueError:
        widths = ()
    if not widths or min(widths) < 1:
        raise argparse.ArgumentTypeError(f"{text!r}: positive layer widths such as 120,70,35 were expected")
    return widths


def network_config(options: argparse.Namespace) -> "NetworkConfig":
    """Return the training configuration that the options give."""
    from softcal.core.network.config import NetworkConfig

    return NetworkConfig(hidden=options.hidden, seed=options.seed, members=options.members)


def registry_of(options: argparse.Namespace, *, create: bool = True) -> "AbstractContextManager[Registry]":
    """Open the registry the options name, and close it after the block; a new one is made only where `create`."""
    return registry_at(options.registry, create=create)


@contextmanager
def registry_at(url: str | None, *, create: bool = True) -> "Iterator[Registry]":
    """Open the registry behind a URL, None for the usual one; say which it is once something was written to it."""
    from softcal.app.bootstrap import open_chosen_registry, registry_url

    with open_chosen_registry(url, create=create) as registry:
        registry.database.on_first_write = lambda: say_written(registry_url(url))
        yield registry


def say_written(url: str) -> None:
    """Say which registry was written to, without its password."""
    from sqlalchemy import make_url

    from softcal.db.schema.database import shown_url

    say(f"written to the registry {shown_url(make_url(url))}")


def say_caution(registry: "Registry", unit: "tuple[str, int | None, str | None]", action: str) -> None:
    """Warn in one line, and record in the audit trail, where the unit that is used did not pass.

    Args:
        unit: serial, revision and lot as they were asked for.
    """
    from softcal.app.registry.standing import caution

    serial, revision, lot_id = unit
    if warning := caution(registry, registry.calibrations.get(serial, revision, lot_id=lot_id), action):
        say(warning)


def say_epoch(report: "EpochReport", unit: str) -> None:
    """Print every 20th epoch of a training as one line of progress."""
    if report.epoch % 20 == 0:
        say(
            f"training f: epoch {report.epoch}/{report.max_epochs}, validation {report.validation_rmse:.4g} {unit}, "
            f"best {report.best_validation_rmse:.4g} {unit}"
        )


def batch_watch(unit: str) -> "Watch":
    """Return a watch that prints the progress of a batch; errors are in `unit`."""
    from softcal.app.batch.lot_work import Watch

    return _BatchProgress(unit).watch(Watch)


class _BatchProgress:
    """Progress of a lot that other batches may work at, too."""

    def __init__(self, unit: str) -> None:
        self._unit, self._total, self._note = unit, 0, ""
        self._progress: ProgressLine | None = None

    def watch(self, kind: "type[Watch]") -> "Watch":
        return kind(
            on_epoch=lambda report: say_epoch(report, self._unit),
            on_start=self._start,
            on_unit=self._told,
            on_done=self._reached,
            on_wait=lambda held: say(f"waiting for {held} units that other batches hold"),
        )

    def _start(self, total: int) -> None:
        self._total = total

    def _told(self, result: "UnitResult") -> None:
        self._note = f"{result.serial} {result.verdict}"

    def _reached(self, done: int) -> None:
        if self._progress is None:
            self._progress = ProgressLine("units", self._total, done)
        else:
            self._progress.reach(done, self._note)
