"""Where live samples come from: a sensor readout, a simulated one, or standard input."""

import sys
import threading
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from queue import Empty, Queue
from typing import IO, TypeAlias

import numpy as np

from softcal.app.output import echo
from softcal.core.errors import BadReply, InputError, NoReply
from softcal.station.bench.bench import open_readout, open_simulated_bench
from softcal.station.bench.station_file import read_station_file
from softcal.station.clock import HostClock
from softcal.station.devices.config import ReadoutConfig
from softcal.station.interfaces import Clock, Move, Readout, Stage

Sample: TypeAlias = tuple[float, float]
"""Time in s and output; NaN where a line could not be read."""

Samples: TypeAlias = Iterator[list[Sample]]
"""What has come since the last call, often nothing."""

WAIT_S = 0.005
SILENCE_S = 10.0
"""A sensor that says nothing for so long has stopped."""

RECONNECT_TIMEOUT_S, REOPEN_S = 60.0, 0.5
"""A sensor that stopped or whose port is gone is waited for so long, and tried again so often."""

PRESS_MM, PRESS_MM_S = 3.0, 4.0
"""Depth below contact height and speed of the simulated presses."""


@contextmanager
def open_source(source: str, station_file: Path | None, output_unit: str) -> Iterator[Samples]:
    """Open `-`, `serial:PORT`, `simulated` or `simulated:FACTOR` (times real speed).

    Raises:
        InputError: no such kind of source, or it gives another unit than the calibration expects.
        NoReply: the port cannot be opened.
    """
    if source == "-":
        yield lines_of(sys.stdin)
        return
    if source.startswith("serial:"):
        port = source.removeprefix("serial:")
        config = ReadoutConfig(port) if station_file is None else read_station_file(station_file).readout
        config = replace(config, port=port or config.port)
        clock = HostClock()

        def connect() -> Readout:
            readout = open_readout(config, clock)
            if readout.unit != output_unit:
                readout.close()
                raise InputError(f"the unit was calibrated in {output_unit}; this sensor readout gives {readout.unit}")
            return readout

        with closing(reconnecting_samples(connect, clock)) as samples:
            # The first step opens the port: one that is not there is refused before anything is written.
            next(samples)
            yield on_one_clock(samples, clock)
        return
    if output_unit != "V":
        raise InputError(f"the unit was calibrated in {output_unit}; the simulated sensor readout gives V")
    try:
        factor = float(source.removeprefix("simulated").removeprefix(":") or "1")
    except ValueError:
        factor = -1.0
    if not 0 < factor < float("inf"):
        raise InputError(f"{source}: `simulated` or `simulated:20` for 20 times real speed was expected")
    with open_simulated_bench(time_factor=factor) as (bench, _):
        yield _press_samples(bench.stage, bench.readout, bench.clock, bench.config.fixture.approach_mm)


def reconnecting_samples(open_readout: Callable[[], Readout], clock: Clock) -> Generator[list[Sample], None, None]:
    """Yield what a readout sends, first nothing; when it goes, wait for it to come back.

    Raises:
        NoReply: it is not there at the start, or was away for `RECONNECT_TIMEOUT_S`.
    """
    readout, last_sample_s = open_readout(), clock.now_s()
    yield []
    while True:
        try:
            with closing(readout):
                for piece in readings(readout, clock):
                    last_sample_s = clock.now_s() if piece else last_sample_s
                    yield piece
        except NoReply as error:
            failure = error
        echo(f"{failure}; waiting for it until it was away for {RECONNECT_TIMEOUT_S:g} s")
        while True:
            if clock.now_s() - last_sample_s > RECONNECT_TIMEOUT_S:
                raise failure
            yield []
            clock.sleep_s(REOPEN_S)
            with suppress(NoReply):
                readout = open_readout()
                break


def on_one_clock(pieces: Samples, clock: Clock) -> Samples:
    """Yield samples whose times go on by the host's clock where the device's began anew."""
    shift_s, last_s, last_sample_s = 0.0, -np.inf, clock.now_s()
    for piece in pieces:
        if piece:
            now_s = clock.now_s()
            if piece[0][0] + shift_s <= last_s:
                shift_s = last_s + max(now_s - last_sample_s, WAIT_S) - piece[0][0]
            last_s, last_sample_s = piece[-1][0] + shift_s, now_s
        yield [(t_s + shift_s, output) for t_s, output in piece]


def readings(readout: Readout, clock: Clock) -> Samples:
    """Yield what a readout sends, by its own clock.

    Raises:
        NoReply: the port is gone, or nothing came for `SILENCE_S`.
    """
    readout.start()
    last_sample_s = clock.now_s()
    while True:
        try:
            samples = readout.poll()
        except BadReply:
            # A device that started again, or noise: the stream takes it for an interruption and goes on.
            readout.start()
            samples = []
        if samples:
            last_sample_s = clock.now_s()
        elif clock.now_s() - last_sample_s > SILENCE_S:
            raise NoReply(
                f"{readout.name}: no sample for {SILENCE_S:g} s; the map is held and its state kept; check sensor and "
                "cable, and run the same command with --resume should it have ended"
            )
        else:
            clock.sleep_s(WAIT_S)
        yield [(s.host_s if s.device_s is None else s.device_s, s.values[0]) for s in samples]


def _press_samples(stage: Stage, readout: Readout, clock: Clock, free_mm: float) -> Samples:
    """Yield what a readout sends while the stage presses the unit again and again."""
    stage.home()
    stage.begin(Move(free_mm, stage.max_speed_mm_s))
    is_down = False
    for samples in readings(readout, clock):
        stage.poll()
        if not stage.is_moving:
            is_down = not is_down
            stage.begin(Move(free_mm + is_down * (1.0 + PRESS_MM), min(PRESS_MM_S, stage.max_speed_mm_s)))
        yield samples


def lines_of(file: IO[str]) -> Samples:
    """Yield `t_s,output` lines as they come; a line that cannot be read is NaN.

    Other columns are skipped by a header; without one the first two columns are taken.
    """
    queue: Queue[str | None] = Queue(maxsize=100_000)

    def read() -> None:
        for line in file:
            queue.put(line)
        queue.put(None)

    threading.Thread(target=read, name="standard input", daemon=True).start()
    columns = (0, 1)
    is_first = True
    while True:
        try:
            line = queue.get(timeout=WAIT_S)
        except Empty:
            yield []
            continue
        if line is None:
            return
        cells = [cell.strip() for cell in line.split(",")]
        if is_first and "t_s" in cells and "output" in cells:
            columns = (cells.index("t_s"), cells.index("output"))
        elif line.strip():
            yield [(_number(cells, columns[0]), _number(cells, columns[1]))]
        is_first = False


def _number(cells: list[str], column: int) -> float:
    try:
        return float(cells[column])
    except (ValueError, IndexError):
        return float(np.nan)
