"""Which of several sources a unit is most like: how far its output is bent otherwise than theirs."""

import numpy as np

from softcal.core.maps.config import MapConfig
from softcal.core.maps.crossing import robust_range
from softcal.core.maps.ends import match_ends
from softcal.core.maps.monotone import between_steps
from softcal.core.recording import LabelledRecording, OutputRecording


def shape_distance(source: LabelledRecording, target: OutputRecording, config: MapConfig) -> float:
    """Return how far two outputs are from one another once rest and peak are matched, as a share of the source's range.

    The mean distance of equal quantiles (Wasserstein distance of order 1). It holds how the units are bent and how
    their time was spent. Sources that were pressed alike share the second, so the nearest of them is the one that is
    bent most like the unit.

    Raises:
        UnitRefused: the unit's output makes no swing that stands out of its noise.
    """
    match = match_ends(source, target, config)
    shares = np.linspace(*config.choice.shape_shares, config.curve.knots)
    mapped = match.offset + match.gain * between_steps(target.output, shares)
    known = source.unlabelled.output
    span = robust_range(known, config.crossing)
    return float(np.mean(np.abs(between_steps(known, shares) - mapped))) / span
