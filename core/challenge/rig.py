"""What a sealed rig is: base parameters, and the causes that make it differ from the base model."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from softcal.core.recording import Array

PRESS, RIGID_BLOCK, DUMMY_RESISTOR, DEAD_WEIGHTS, REST = (
    "press",
    "rigid_block",
    "dummy_resistor",
    "dead_weights",
    "rest",
)
"""Kinds of runs, as `kind` in recording.json."""


@dataclass(frozen=True)
class Rig:
    """Base parameters and metadata of one unit on one rig (TWIN.md, base model).

    `kappa_per_N` is in 1/N, or in 1/mm where `sensor_type` is `strain`. Beside the white noise, each channel may have
    noise that fades with `coloured_s`, of this standard deviation.
    """

    u0_mm: float
    k1_N_mm: float
    k3_N_mm3: float
    r0_ohm: float
    kappa_per_N: float
    noise_V: float
    noise_N: float
    vref_V: float
    r_series_ohm: float
    adc_bits: int
    sample_rate_Hz: float
    sensor_type: str = "pressure"
    coloured_V: float = 0.0
    coloured_N: float = 0.0
    coloured_s: float = 1.0

    def without_noise(self) -> "Rig":
        """Return the same rig with channels that do not scatter."""
        return replace(self, noise_V=0.0, noise_N=0.0, coloured_V=0.0, coloured_N=0.0)

    @property
    def lsb_V(self) -> float:
        """Step of the ADC, q = Vref/(2ⁿ − 1)."""
        return float(self.vref_V / (2**self.adc_bits - 1))

    @property
    def floor_V(self) -> float:
        """Noise of the output with the rounding of the ADC in it, RMS."""
        return float(np.hypot(self.noise_V, self.lsb_V / np.sqrt(12.0)))

    def pad_force_N(self, compression_mm: Array) -> Array:
        """F = k1·δ + k3·δ³."""
        return self.k1_N_mm * compression_mm + self.k3_N_mm3 * compression_mm**3


@dataclass(frozen=True)
class Cause:
    """One effect at work: its identifier, the equation that realises it, and that equation's values.

    Args:
        effect: an identifier of TWIN.md's catalogue, or the name of an effect outside it.
        form: `catalogue`, or the name of another equation of the same cause.
        values: the equation's parameters by name, units in the names.
    """

    effect: str
    form: str
    values: Mapping[str, float]

    def to_record(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> "Cause":
        return cls(record["effect"], record["form"], {name: float(v) for name, v in record["values"].items()})


@dataclass(frozen=True, eq=False)
class Path:
    """A stage path: straight lines between corners; before and after them it stands still."""

    name: str
    corner_s: Array
    corner_mm: Array

    def position_mm(self, t_s: Array) -> Array:
        """Stage position at the given times."""
        return np.asarray(np.interp(t_s, self.corner_s, self.corner_mm))

    @property
    def duration_s(self) -> float:
        """Time of the last corner."""
        return float(self.corner_s[-1])


@dataclass(frozen=True, eq=False)
class Measured:
    """What one run of a sealed rig recorded; `columns` lack what the run does not have."""

    kind: str
    profile: str
    columns: Mapping[str, Array]
    dummy_ohm: float | None = None
