"""A rule: at rest a unit's output lies within a band, because the amplifier behind it takes no other."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from softcal.core.unit.rules import Objection, RuleInput


@dataclass(frozen=True)
class RestBand:
    """The output at rest is within `lowest` to `highest`, in the unit of the output."""

    lowest: float
    highest: float
    name: str = "rest band"
    version: str = "1"

    def look(self, rule_input: RuleInput) -> Iterator[Objection]:
        """Object where the median output under the least twentieth of the loads lies outside the band."""
        recording, estimate = rule_input.recording, rule_input.estimate
        last = recording.windows[:, -1]
        rest = float(np.median(last[estimate <= np.quantile(estimate, 0.05)]))
        if not self.lowest <= rest <= self.highest:
            unit = recording.output_unit
            yield Objection(
                f"at rest its output is {rest:.3g} {unit}, outside {self.lowest:g} to {self.highest:g} {unit}: put it "
                "into the box for the other amplifier"
            )


REST_BAND = RestBand(0.3, 0.62)
