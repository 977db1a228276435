"""The live form of long-term adaptation: samples come, estimates go, the registry keeps all."""

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TypeAlias

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.table import Table

from softcal.app.operation.adapt import AdaptOptions, AdaptReport, Follower
from softcal.app.operation.sink import ExistingRows, lines_of, open_sink, read_existing
from softcal.app.operation.source import Sample, Samples, open_source
from softcal.app.registry.unit import UnitInUse, unit_in_use
from softcal.core.errors import InputError
from softcal.core.unit.estimate import Estimate
from softcal.db.registry import Registry

WIDTH = 48
"""Characters of the bar over the range of the source's reference."""

Show = Callable[[Estimate, AdaptReport], None]


def draw_level_bar(value: float, lower: float, upper: float, span: tuple[float, float]) -> str:
    """Return a line with the interval as dashes and the estimate as a block."""
    if not value == value:
        return " " * WIDTH
    low, high = span
    positions = [min(WIDTH - 1, max(0, int((v - low) / (high - low) * WIDTH))) for v in (lower, value, upper)]
    cells = ["-" if positions[0] <= k <= positions[2] else " " for k in range(WIDTH)]
    cells[positions[1]] = "█"
    return "".join(cells)


@dataclass(frozen=True)
class LiveOptions:
    """Where a live stream comes from and goes to.

    Args:
        source: `-`, `serial:PORT`, `simulated` or `simulated:FACTOR`.
        target: a CSV file, `-` or `tcp://HOST:PORT`.
        station_file: scale and rate of the readout; None takes those of the reference firmware.
        duration_s: stop after so much time of the stream; None goes on until the keyboard or the source ends it.
    """

    source: str
    target: str
    station_file: Path | None = None
    duration_s: float | None = None
    has_view: bool = False


def adapt_live(registry: Registry, serial: str, live: LiveOptions, options: AdaptOptions) -> AdaptReport:
    """Follow a live stream until it ends; whatever ends it, the state is in the registry.

    Raises:
        InputError: source, target or serial cannot be used.
        DeviceError: the sensor is gone; estimates up to then are written, the state is kept.
    """
    unit = unit_in_use(registry, serial, options.revision, options.lot_id)
    stream = options.stream or f"live {live.source} {options.config.name}"
    with ExitStack() as stack:
        samples = stack.enter_context(open_source(live.source, live.station_file, unit.lot.output_unit))
        existing = read_existing(live.target) if options.resume else ExistingRows()
        sink = stack.enter_context(open_sink(live.target, options.resume))
        writer = stack.enter_context(ThreadPoolExecutor(1))
        follower = Follower(registry, unit, stream, options, writer)
        samples = _limit_duration(samples, live.duration_s)
        # The state is kept however the stream ends; Ctrl-C is the usual way.
        try:
            with _view(unit, live.has_view) as show:
                pieces = _continue_stream(follower, samples, existing) if options.resume else _all_new(samples)
                for piece, is_written in pieces:
                    columns = np.array(piece)
                    rows = follower.advance(columns[:, 0], columns[:, 1])
                    if not is_written:
                        sink.write(lines_of(rows))
                    follower.store()
                    show(rows, follower.report)
        except KeyboardInterrupt:
            pass
        finally:
            follower.checkpoint()
            follower.settle()
    return follower.report


Pieces: TypeAlias = Iterator[tuple[list[Sample], bool]]
"""Samples, and whether their estimates are in the target already."""


def _all_new(samples: Samples) -> Pieces:
    for piece in samples:
        yield piece, False


def _continue_stream(follower: Follower, samples: Samples, existing: ExistingRows) -> Pieces:
    """Go on with a stream: a log sent again from where it broke off, else with what comes."""
    first = next(samples, None)
    if first is None:
        return
    samples = chain([first], samples)
    first_t_s = first[0][0]
    if not existing.rows or (repr(first_t_s) if np.isfinite(first_t_s) else "") != existing.first_t_s:
        follower.reconnect()
        yield from _all_new(samples)
        return
    input_rows = follower.rows_since_begin
    if input_rows is None or input_rows > existing.rows:
        raise InputError("IN begins with the first row of OUT, which is not its alone; give OUT another name")
    rows_read = 0
    for piece in samples:
        new = piece[max(0, input_rows - rows_read) :]
        rows_read += len(piece)
        # Rows after the last kept state are estimated again, for the state, but stand in the target.
        silent = max(0, len(new) - max(0, rows_read - existing.rows))
        yield from ((part, is_written) for part, is_written in ((new[:silent], True), (new[silent:], False)) if part)


@contextmanager
def _view(unit: UnitInUse, has_view: bool) -> Iterator[Show]:
    """Give what shows rows and map in the terminal, at most eight times a second."""
    if not has_view:
        yield lambda rows, report: None
        return
    interval, load = unit.state.interval, unit.lot.reference_unit
    span = (interval.low, interval.high)

    def draw(rows: Estimate, report: AdaptReport) -> None:
        value, lower, upper = (float(rows_read[-1]) for rows_read in (rows.estimate, rows.lower, rows.upper))
        now = report.current
        table = Table(title=f"unit {unit.state.serial}", show_header=False)
        line = f"{value:8.3f} {load}   [{lower:.3f}, {upper:.3f}]" if value == value else "no estimate"
        table.add_row("estimate", line)
        table.add_row(f"{span[0]:.3g} .. {span[1]:.3g} {load}", draw_level_bar(value, lower, upper, span))
        table.add_row("row", f"{report.rows} at {float(rows.t_s[-1]):.2f} s   {rows.flag[-1] or 'trusted'}")
        table.add_row("drift", f"shift {now.shift:+.3f} ± {now.shift_sd:.3f}, log gain {now.log_gain:+.3f}")
        table.add_row("map", f"{now.verdict}  {now.reason}")
        table.add_row("predicted error", f"{now.predicted_rmse:.3g} {load}")
        table.add_row("alarm", now.alarm or "none")
        live.update(table)

    with Live(console=Console(stderr=True), refresh_per_second=8, transient=False) as live:
        yield draw


def _limit_duration(samples: Samples, duration_s: float | None) -> Samples:
    """Yield the pieces with samples, for so much time of the stream, or of the clock."""
    first_s: float | None = None
    start_s = time.monotonic()
    for piece in samples:
        times = [t_s for t_s, _ in piece if np.isfinite(t_s)]
        if first_s is None and times:
            first_s = times[0]
        if piece:
            yield piece
        elapsed_s = times[-1] - first_s if times and first_s is not None else 0.0
        if first_s is None:
            elapsed_s = time.monotonic() - start_s
        if duration_s is not None and elapsed_s >= duration_s:
            return
