"""Parameters of one simulated unit: base parameters and electronics."""

import math
from dataclasses import dataclass, fields, replace
from typing import Literal

from softcal.core.errors import InputError

SensorType = Literal["pressure", "strain"]


@dataclass(frozen=True)
class BaseParameters:
    """The unknowns of the base twin; by default eGaIn in Ecoflex, about 7 N at 3.5 mm.

    Args:
        u0_mm: stage position of first contact.
        k1_N_mm, k3_N_mm3: stiffness, F = k1·δ + k3·δ³, both >= 0.
        r0_ohm: resistance of the unloaded channel.
        kappa_per_N: pressure sensitivity, R = R0/(1 − κ·F), >= 0; per mm for a strain sensor.
        sigma_output_V, sigma_force_N: standard deviation of the noise before ADC and of the cell.

    Raises:
        InputError: a value is not finite or outside its physical range.
    """

    u0_mm: float = 0.3
    k1_N_mm: float = 1.0
    k3_N_mm3: float = 0.12
    r0_ohm: float = 4.0
    kappa_per_N: float = 0.075
    sigma_output_V: float = 0.001
    sigma_force_N: float = 0.012

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not math.isfinite(value):
                raise InputError(f"{field.name} is {value}; a finite number was expected")
            if value < 0 and field.name != "u0_mm":
                raise InputError(f"{field.name} is {value:.4g}; it cannot be negative")
        if self.r0_ohm == 0:
            raise InputError("r0_ohm is 0; a resistance above 0 Ω was expected")

    def with_values(self, **values: float) -> "BaseParameters":
        return replace(self, **values)


@dataclass(frozen=True)
class ReadoutMetadata:
    """Electronics of a recording, from its metadata; no parameter of them is fitted.

    Args:
        vref_V: supply of the divider and full scale of the ADC.
        adc_bits: resolution; one step is vref_V/(2**adc_bits − 1).
        sensor_type: `pressure` (κ acts on the force) or `strain` (κ acts on the deformation).

    Raises:
        InputError: a value is outside its physical range.
    """

    vref_V: float = 5.0
    adc_bits: int = 10
    r_series_ohm: float = 10.0
    sample_rate_Hz: float = 50.0
    sensor_type: SensorType = "pressure"

    def __post_init__(self) -> None:
        for name in ("vref_V", "r_series_ohm", "sample_rate_Hz"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"{name} is {value}; a number above 0 was expected")
        if not 1 <= self.adc_bits <= 32:
            raise InputError(f"adc_bits is {self.adc_bits}; 1 to 32 bits were expected")
        if self.sensor_type not in ("pressure", "strain"):
            raise InputError(f"sensor_type is {self.sensor_type!r}; expected 'pressure' or 'strain'")

    @property
    def step_V(self) -> float:
        return float(self.vref_V / (2**self.adc_bits - 1))
