"""A pure tone in what a fit leaves: it sums up to nothing over a fifth of a second, so that block sums overlook it."""

import math
from dataclasses import dataclass

import numpy as np

from softcal.core.gap.fit import Fit
from softcal.core.gap.problem import Block

CHANCE = 1e-6
"""How seldom white noise may show a tone in one run."""

FAINTEST = 0.3
"""Root mean square of a tone, in units of the noise, below which it is no matter: it hides nothing."""

FEWEST = 20
"""Ordinates below which nothing stands out of the others."""

SLOWEST_HZ = 2.0
"""Below, block sums see it; and what is slow is a shape more often than a tone."""


@dataclass(frozen=True)
class Tone:
    """The strongest tone of a channel.

    Args:
        rms: in units of the noise.
        width_Hz: distance of two ordinates of its periodogram.
    """

    channel: str
    frequency_Hz: float
    rms: float
    width_Hz: float

    def is_same(self, other: "Tone") -> bool:
        """Whether another tone, of another run for example, is this one."""
        distance_Hz = abs(self.frequency_Hz - other.frequency_Hz)
        return self.channel == other.channel and distance_Hz < self.width_Hz + other.width_Hz


def strongest_tone(found: Fit) -> Tone | None:
    """Return the strongest tone of one frequency in the residuals of a channel; None where there is none.

    A ripple over the travel has another frequency at every speed: of several runs two must show the same one.
    """
    tones = [t for block in found.problem.blocks if (t := _tone(found, block)) is not None]
    alone = len(found.problem.case.presses) == 1
    kept = [t for t in tones if alone or sum(t.is_same(other) for other in tones) > 1]
    return max(kept, key=lambda tone: tone.rms, default=None)


def _tone(found: Fit, block: Block) -> Tone | None:
    """Return the strongest tone of one channel of one run.

    The largest of m ordinates of a periodogram of white noise exceeds g times their mean with a chance of about
    m·exp(−g) (R. A. Fisher, Proc. R. Soc. A 125, 54, 1929).
    """
    run = found.problem.case.runs[block.run]
    residual = found.residual[block.place]
    if run.kind != "press":
        return None
    step_s = float(np.median(run.step_s))
    frequency_Hz = np.fft.rfftfreq(len(residual), step_s)
    is_fast = frequency_Hz > SLOWEST_HZ
    power = (np.abs(np.fft.rfft(residual - residual.mean())) ** 2 / len(residual))[is_fast]
    if len(power) < FEWEST:
        return None
    at = int(np.argmax(power))
    # The median of exponential ordinates is ln 2 of their mean; a strong tone would raise the mean itself.
    level = float(np.median(power)) / math.log(2.0)
    rms = math.sqrt(2.0 * max(power[at] - level, 0.0) / len(residual))
    if rms < FAINTEST or power[at] < level * math.log(len(power) / CHANCE):
        return None
    return Tone(block.channel, float(frequency_Hz[is_fast][at]), rms, 1.0 / (step_s * len(residual)))
