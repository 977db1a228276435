"""One gain and one offset for every sample: the form of several families, and of the identity."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softcal.core.identity import Settings
from softcal.core.recording import Array
from softcal.core.windows import windows


@dataclass(frozen=True)
class AffineMap:
    """source sample = offset + gain * target sample, for every tap alike.

    Args:
        gain: source output unit per target output unit.
        offset: in the source's output unit.
        family: name under which the catalogue rebuilds it.
    """

    gain: float
    offset: float
    family: str = "affine"

    def apply(self, windows: Array) -> Array:
        return self.offset + self.gain * windows

    def apply_signal(self, signal: Array) -> Array:
        return windows(self.offset + self.gain * signal)

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        return {"gain": np.array(self.gain), "offset": np.array(self.offset)}

    def settings(self) -> Settings:
        return {}
