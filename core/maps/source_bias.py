"""What the networks of several sources read of one lot, held against each other."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from softcal.core.maps.shared_load import LotFit


@dataclass(frozen=True)
class SourceBias:
    """What the network of one source reads beyond those of the others, of a load that units share.

    Args:
        bias: mean of its common load less that of another source; the middle one of these, in the reference unit.
        uncertainty: standard uncertainty of that, of the common loads on both sides.
        others: how many sources it is held against.
    """

    bias: float
    uncertainty: float
    others: int

    @property
    def is_bad(self) -> bool:
        """Whether it reads another load than the others do; with one other nobody can say which of the two errs."""
        return self.others > 1 and abs(self.bias) > 2.0 * self.uncertainty


def compare_sources(fits: Mapping[str, LotFit]) -> Mapping[str, SourceBias]:
    """Hold the common loads that the networks of several sources read of one lot against each other.

    The units agree on the course of a load, and each source's network gives it a level: what a network misreads of all
    units alike shows in no fit of its own, and beside those of other sources it does.

    Args:
        fits: of the same recordings, by the serial of the source.

    Returns:
        By source; without those whose fit found no load that another's has, too.
    """
    found: dict[str, list[tuple[float, float]]] = {serial: [] for serial in fits}
    for one, other in permutations(fits, 2):
        for group, against in product(fits[one].groups, fits[other].groups):
            if not set(group.members) & set(against.members):
                continue
            _, mine, theirs = np.intersect1d(group.t_s, against.t_s, return_indices=True)
            if len(mine):
                apart = float(np.mean(group.load[mine] - against.load[theirs]))
                found[one].append((apart, float(np.hypot(group.common_rmse, against.common_rmse))))
                break
    return {
        serial: SourceBias(
            # The middle one: another source that errs must not make a good one look bad.
            float(np.median([bias for bias, _ in apart])),
            float(np.median([error for _, error in apart])),
            len(apart),
        )
        for serial, apart in found.items()
        if apart
    }
