"""A unit of a plain force law over a hard stop, for trials of safety: what it feels is known in closed form."""

from dataclasses import dataclass

import numpy as np

from softcal.core.recording import Array


@dataclass(frozen=True)
class ForceLaw:
    """F = coefficient·x^power + stop_N_mm·max(0, x − stop_mm), x the depth below the surface in mm, F in N."""

    coefficient: float = 1.2
    power: float = 1.4
    stop_mm: float = 100.0
    stop_N_mm: float = 0.0

    def force_N(self, depth_mm: Array | float) -> Array:
        """Return the force at depths in mm; 0 above the surface."""
        x = np.maximum(0.0, depth_mm)
        return np.asarray(self.coefficient * x**self.power + self.stop_N_mm * np.maximum(0.0, x - self.stop_mm))


class LawUnit:
    """A unit under the simulated stage whose output follows its force; a `simulated.rig.Physics`.

    Args:
        law: its force law; u = 0 of the rig is its surface.
        rng: of the noise.
        noise_N, noise_V: standard deviation of load cell and output.
    """

    def __init__(self, law: ForceLaw, rng: np.random.Generator, noise_N: float = 0.004, noise_V: float = 0.002) -> None:
        self.law, self._rng, self._noise_N, self._noise_V = law, rng, noise_N, noise_V

    def advance(self, t_s: Array, stage_mm: Array) -> tuple[Array, Array]:
        """Return (force_N, output_V) at these stage positions, noise included."""
        force_N = self.law.force_N(stage_mm)
        output_V = 0.5 + 4.0 * force_N / (force_N + 8.0)
        noise_N = self._rng.normal(0, self._noise_N, len(stage_mm))
        return force_N + noise_N, output_V + self._rng.normal(0, self._noise_V, len(stage_mm))
