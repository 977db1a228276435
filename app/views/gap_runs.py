"""The runs of a diagnosis as pages show them: measured, and predicted before and after."""

from collections.abc import Mapping
from dataclasses import dataclass

from softcal.core.recording import Array


@dataclass(frozen=True, eq=False)
class ChannelView:
    """One channel of one run: (n,) measured, of the refitted base, and of the base with the causes.

    `noise` is the standard deviation of the noise, in the channel's unit as all of them.
    """

    measured: Array
    base: Array
    explained: Array
    noise: float


@dataclass(frozen=True, eq=False)
class RunView:
    """What the page shows of one run.

    Args:
        t_s: (n,) time since the start of the run.
        drive: (n,) what moved it, in the unit of the column `drive_name`: the stage's position, else the force; of a
            simulator its first input. Its slope tells the direction.
        load_N: (n,) force for the bands; measured where there is a load cell, else predicted.
    """

    name: str
    profile: str
    drive_name: str
    t_s: Array
    drive: Array
    load_N: Array
    channels: Mapping[str, ChannelView]
