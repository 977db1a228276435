"""LabVIEW's .tdms files: the channels of a group, with the time that their properties state."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from softcal.app.tables.arrays import Channel, choose_group, read_channels, refuse_large, unreadable_channel
from softcal.app.tables.headings import IsRequested
from softcal.app.tables.options import TableOptions
from softcal.app.tables.table import Table
from softcal.core.errors import InputError

DAMAGE_REMARK = "the file is damaged or ends early; what it holds up to there was read"
TIME = "t_s"
"""Name of the column of time that is made from the step between samples of a waveform."""


def read_tdms(file: BinaryIO, path: Path, options: TableOptions, is_requested: IsRequested) -> Table:
    """Return the requested channels of the declared group, or of the group with samples.

    Raises:
        InputError: several groups hold samples and none is declared, waveforms of different steps, too many cells.
    """
    from nptdms import TdmsFile

    with _collect_warnings() as warnings, TdmsFile.open(file) as tdms_file:
        groups = {}
        for group in tdms_file.groups():
            channels = [_channel(path, each, options) for each in group.channels() if len(each)]
            if channels:
                groups[group.name] = channels + _time(path, group.channels())
        name = choose_group(path, groups, options, is_requested, "group")
        try:
            table = read_channels(path, groups[name], options, is_requested, f"group {name!r}")
        except InputError as error:
            raise InputError(
                f"{error}; the file is damaged or ends early: copy it again" if warnings else str(error)
            ) from error
    return replace(table, remarks=(*table.remarks, DAMAGE_REMARK)) if warnings else table


@contextmanager
def _collect_warnings() -> Iterator[list[str]]:
    """Collect what npTDMS would print on standard error, such as that a file ends early."""
    warnings: list[str] = []
    collector = logging.Handler()
    collector.emit = lambda record: warnings.append(record.getMessage())  # type: ignore[method-assign]
    loggers = [logging.getLogger(f"nptdms.{module}") for module in ("reader", "tdms_segment", "types", "tdms")]
    handlers = [logger.handlers for logger in loggers]
    try:
        for logger in loggers:
            logger.handlers = [collector]
        yield warnings
    finally:
        for logger, previous_handlers in zip(loggers, handlers, strict=True):
            logger.handlers = previous_handlers


def _channel(path: Path, channel: Any, options: TableOptions) -> Channel:
    def read() -> NDArray[Any]:
        refuse_large(path, len(channel), options.max_cells)
        values: NDArray[Any] = channel[:]
        return values

    unit = channel.properties.get("unit_string") or channel.properties.get("NI_UnitDescription") or ""
    return Channel(str(channel.name), len(channel), read, str(unit))


def _time(path: Path, channels: list[Any]) -> list[Channel]:
    """Return the time of the waveforms as a channel; none where no step is stated or a channel has its name."""
    steps = {}
    for channel in channels:
        step_s = float(channel.properties.get("wf_increment") or 0.0)
        if step_s > 0 and len(channel):
            steps[channel.name] = (step_s, float(channel.properties.get("wf_start_offset") or 0.0), len(channel))
    if not steps or any(channel.name == TIME for channel in channels):
        return []
    rows = max(count for _, _, count in steps.values())
    longest = {(step_s, offset_s) for step_s, offset_s, count in steps.values() if count == rows}
    if len(longest) > 1:
        step_texts = ", ".join(f"{name!r} {step_s:g} s" for name, (step_s, _, _) in list(steps.items())[:4])
        refusal = (
            f"{path}: its waveforms have different steps or starts ({step_texts}); export those of one rate together"
        )
        return [unreadable_channel(TIME, refusal, rows)]
    step_s, offset_s = longest.pop()
    return [Channel(TIME, rows, lambda: offset_s + step_s * np.arange(rows), "s")]
