"""Dropouts of an output: two opposite jumps by a loose cable, at a station and in a file."""

from dataclasses import dataclass

import numpy as np

from softcal.core.inspection.config import DropoutConfig
from softcal.core.metrics import quantile
from softcal.core.recording import Array, Indices

THIRD_DIFFERENCE = 0.6745 * np.sqrt(20.0)
"""Median size of the third differences of white noise by its standard deviation; motion hardly has any."""


@dataclass(frozen=True)
class Dropout:
    """One dropout.

    Args:
        begin, end: its samples, the end excluded.
        level: the output where it is furthest off.
        expected: output that the neighbouring samples predict.
    """

    begin: int
    end: int
    level: float
    expected: float


def find_dropouts(output: Array, stage_mm: Array | None, config: DropoutConfig) -> list[Dropout]:
    """Return the dropouts of an output, first ones first; none overlap.

    Args:
        output: (n,) in any unit.
        stage_mm: (n,) position of the stage; None where it is unknown.
    """
    guard = config.neighbours + 1
    if len(output) < 2 * guard:
        return []
    # At the ends the first and the last sample go on: sample i is padded[i + guard + 1].
    padded = np.pad(output, guard + 1, mode="edge")
    begins, ends = _edges(output, np.diff(padded), stage_mm is not None, config)
    max_samples = max(1, round(config.max_share * len(output)))
    dropouts: list[Dropout] = []
    for begin in begins:
        if dropouts and begin - guard < dropouts[-1].end:
            continue
        for end in ends[(ends > begin) & (ends <= begin + max_samples)]:
            dropout = _measure_dropout(padded, int(begin), int(end), config)
            if dropout and (stage_mm is None or not _is_press(output, stage_mm, dropout, config)):
                dropouts.append(dropout)
                break
    return dropouts


def _edges(output: Array, steps: Array, has_stage: bool, config: DropoutConfig) -> tuple[Indices, Indices]:
    """Return the steps at which a dropout may begin and end: far larger than those before, or after."""
    sizes, guard = np.abs(steps), config.neighbours + 1
    noise = float(np.median(np.abs(np.diff(output, 3)))) / THIRD_DIFFERENCE
    changes = np.abs(np.diff(output))
    count = float(np.min(changes[changes > 0.0], initial=np.inf))
    low, lower, higher, high = quantile(output, (0.01, config.max_share, 1.0 - config.max_share, 0.99)).tolist()
    usual = max(higher - lower, config.edge_steps * float(quantile(changes, 0.99)))
    by_range = config.range_share * (high - low) if has_stage else usual
    min_step = max(by_range, config.noises * noise, config.counts * count)
    neighbours = np.max(np.lib.stride_tricks.sliding_window_view(sizes, config.neighbours), axis=1)
    inner = np.arange(guard, len(steps) - guard)
    is_large = sizes[inner] > min_step
    before, after = neighbours[inner - guard], neighbours[inner + 2]
    return inner[is_large & (sizes[inner] > config.edge_steps * before)], inner[
        is_large & (sizes[inner] > config.edge_steps * after)
    ]


def _measure_dropout(padded: Array, begin: int, end: int, config: DropoutConfig) -> Dropout | None:
    """Return the dropout between two steps; None where they are not its edges."""
    inside = np.arange(begin + 1, end + 1)
    expected = np.interp(inside, (begin - 1, end + 2), (padded[begin - 1], padded[end + 2]))
    off = np.abs(padded[inside] - expected)
    furthest = int(np.argmax(off))
    begin_step, end_step = padded[begin + 1] - padded[begin], padded[end + 1] - padded[end]
    sizes = abs(begin_step), abs(end_step)
    if begin_step * end_step >= 0.0 or min(sizes) < config.edge_share * max(off[furthest], *sizes):
        return None
    first = begin - config.neighbours - 1
    return Dropout(first, first + end - begin, float(padded[inside[furthest]]), float(expected[furthest]))


def _is_press(output: Array, stage_mm: Array, dropout: Dropout, config: DropoutConfig) -> bool:
    """Return whether the stage moved down and up, or up and down, in between."""
    neighbours = max(0, dropout.begin - 2), min(len(stage_mm) - 1, dropout.end + 1)
    inside = np.arange(dropout.begin, dropout.end)
    off_mm = np.abs(stage_mm[inside] - np.interp(inside, neighbours, stage_mm[list(neighbours)]))
    off_share = abs(dropout.level - dropout.expected) / float(np.ptp(output))
    return bool(np.max(off_mm) > config.stage_share * off_share * float(np.ptp(stage_mm)))
