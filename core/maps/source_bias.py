"""What the networks of several sources read of one lot, held against each other."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from softcal.core.maps.common_load import LoadGroup
from softcal.core.maps.config import SharedLoadConfig
from softcal.core.messages.reason import Reason, reason
from softcal.core.metrics import rms


@dataclass(frozen=True)
class SourceBias:
    """What the network of one source reads beyond those of the others, of a load that units share.

    Args:
        bias: mean of its common load less that of another source; the middle one of these, in the reference unit.
        rmse: RMS of that difference; the middle one, too.
        uncertainty: what two of the other sources differ by: what their common loads are uncertain by, as one
            observation, and what they were seen to differ by, as one for each two of them.
        others: how many sources it is held against.
        is_apart: whether it differs by more than they do.
    """

    bias: float
    rmse: float
    uncertainty: float
    others: int
    is_apart: bool

    @property
    def is_bad(self) -> bool:
        """Whether it reads another load than the others do; with one other nobody can say which of the two errs."""
        return self.others > 1 and self.is_apart

    @property
    def common_rmse(self) -> float:
        """What its common load errs by, as the others see it: they err, too."""
        return self.rmse * float(np.sqrt(self.others / (self.others + 1)))

    def to_reason(self, serial: str, unit: str) -> Reason | None:
        """Say how the network of a source reads the lot beside the others; None where it reads as they do."""
        if not self.is_apart:
            return None
        code = "lot_fit.source.low" if self.bias < 0 else "lot_fit.source.high"
        code = "lot_fit.source.two" if self.others == 1 else code
        return reason(code, serial=serial, bias=abs(self.bias), rmse=self.rmse, unit=unit, count=self.others)


def compare_sources(groups: Mapping[str, Sequence[LoadGroup]], config: SharedLoadConfig) -> Mapping[str, SourceBias]:
    """Hold the common loads that the networks of several sources read of one lot against each other.

    The units agree on the course of a load, and each source's network gives it a level: what a network misreads of all
    units alike shows in no fit of its own, and beside those of other sources it does. How far the units miss the
    hardest presses is no part of it: all sources see them alike.

    Args:
        groups: common loads of the same recordings, by source.

    Returns:
        By source; without those that found no load that another has, too.
    """
    apart = {pair: one for pair in permutations(groups, 2) if (one := _difference(*(groups[s] for s in pair)))}
    biases = {}
    for source in groups:
        # The middle one: another source that errs must not make a good one look bad.
        of = [one for pair, one in apart.items() if pair[0] == source]
        among = [one for pair, one in apart.items() if source not in pair]
        if of:
            squared_errors = np.mean([one[2] ** 2 for one in among or of])
            variance = (squared_errors + sum(one[1] ** 2 for one in among) / 2) / (1 + len(among) / 2)
            bias, rmse, _ = np.median(of, axis=0)
            error = float(np.sqrt(variance))
            biases[source] = SourceBias(
                float(bias), float(rmse), error, len(of), bool(rmse > config.source_apart * error)
            )
    return biases


def _difference(groups: Sequence[LoadGroup], others: Sequence[LoadGroup]) -> tuple[float, float, float] | None:
    """Return mean, RMS and standard uncertainty of what one source reads beyond another; None without a common load."""
    for group, other in product(groups, others):
        _, rows, other_rows = np.intersect1d(group.t_s, other.t_s, return_indices=True)
        if set(group.members) & set(other.members) and len(rows):
            apart = group.load[rows] - other.load[other_rows]
            return float(np.mean(apart)), rms(apart), float(np.hypot(group.shape_rmse, other.shape_rmse))
    return None
