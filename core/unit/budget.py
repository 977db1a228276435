"""What an estimate is traced to and how uncertain it is (GUM, JCGM 100:2008): reference, f, map, quantisation."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from datetime import date
from enum import StrEnum

import numpy as np

from softcal.core.errors import InputError
from softcal.core.messages.reason import Reason, reason
from softcal.core.recording import Array
from softcal.core.unit.correspondence import Correspondence

COVERAGE = 2.0
"""k of every expanded uncertainty that is stated: 95 % of a normal distribution."""


class Traceability(StrEnum):
    """What can be traced to a reference."""

    VALID = "valid"
    SIMULATED = "simulated"
    EXPIRED = "expired"
    MISSING = "missing"


@dataclass(frozen=True)
class Reference:
    """The instrument that the source of a lot was compared with, and what is known of its uncertainty.

    Every uncertainty is in the reference unit of the lot. What is None was not stated and is left out of the budget,
    except the drift. Nobody knows it to be smaller than U, so U stands for it.

    Args:
        certificate, laboratory: number of its calibration certificate, and who issued it.
        issued_on, due_on: first day the certificate holds, first day it no longer holds.
        used_on: day the source was recorded with it.
        uncertainty: expanded uncertainty U of the certificate.
        coverage_factor: k of U.
        capacity: largest value the certificate covers.
        drift: largest change since its calibration (half-width, rectangular).
        temperature_per_K: largest change of the reading per K, as a share of the reading.
        temperature_K: largest departure from the temperature of its calibration (half-width, rectangular).
        contact: standard uncertainty of how the load is brought in: position, angle, friction.
        repeatability: standard uncertainty of one reading, repeated.
        bandwidth: standard uncertainty of how slowly it follows: RMS error of the source's labels; 0 for none.
        is_simulated: no instrument at all; the simulation gives the true load.

    Raises:
        InputError: a number that is not finite or below zero, or days in the wrong order.
    """

    cell: str = ""
    certificate: str = ""
    laboratory: str = ""
    issued_on: date | None = None
    due_on: date | None = None
    used_on: date | None = None
    uncertainty: float | None = None
    coverage_factor: float = COVERAGE
    capacity: float | None = None
    drift: float | None = None
    temperature_per_K: float | None = None
    temperature_K: float | None = None
    contact: float | None = None
    repeatability: float | None = None
    bandwidth: float | None = None
    is_simulated: bool = False

    def __post_init__(self) -> None:
        for name in NUMBERS:
            value = getattr(self, name)
            if value is not None and not 0 <= value < float("inf"):
                raise InputError(f"reference {name} is {value}; a number from 0 was expected")
        if not self.coverage_factor or self.uncertainty == 0 or self.capacity == 0:
            raise InputError("reference: coverage_factor, uncertainty and capacity must be above 0")
        if self.issued_on and self.due_on and not self.due_on > self.issued_on:
            raise InputError(f"reference: due_on {self.due_on} is not after issued_on {self.issued_on}")

    @property
    def traceability(self) -> Traceability:
        if self.is_simulated:
            return Traceability.SIMULATED
        if not self.certificate or self.uncertainty is None or self.due_on is None or self.used_on is None:
            return Traceability.MISSING
        is_early = self.issued_on is not None and self.used_on < self.issued_on
        return Traceability.EXPIRED if is_early or self.used_on >= self.due_on else Traceability.VALID

    def blocking_reasons(self, highest: float) -> tuple[Reason, ...]:
        """Return what keeps every unit of a lot from passing; `highest` is the largest value that was read for it.

        What nobody stated bars nothing: a named instrument without a certificate does.
        """
        if self.cell and not self.certificate:
            return (reason("reference_missing", cell=self.cell),)
        if self.traceability is Traceability.EXPIRED:
            days = {name: str(getattr(self, name)) for name in ("issued_on", "due_on", "used_on")}
            return (reason("reference_expired", number=self.certificate, cell=self.cell or "?", **days),)
        if self.capacity is not None and highest > self.capacity:
            return (reason("reference_range", number=self.certificate, capacity=self.capacity, highest=highest),)
        return ()

    def contributions(self, load: float) -> tuple["Contribution", ...]:
        """Return what the reference adds to the budget of an estimate at a load in the reference unit."""
        if self.is_simulated:
            return ()
        terms = []
        if self.uncertainty is not None:
            terms.append(Contribution("reference calibration", self.uncertainty, "normal", self.coverage_factor))
        drift = self.uncertainty if self.drift is None else self.drift
        if drift is not None:
            terms.append(Contribution("reference drift", drift, "rectangular"))
        if self.temperature_per_K is not None and self.temperature_K is not None:
            by_load = abs(load) * self.temperature_per_K
            terms.append(Contribution("reference temperature", self.temperature_K, "rectangular", sensitivity=by_load))
        for name, value in (("contact", self.contact), ("repeatability", self.repeatability)):
            if value is not None:
                terms.append(Contribution(name, value, "normal"))
        if self.bandwidth:
            terms.append(Contribution("reference bandwidth", self.bandwidth, "normal"))
        return tuple(terms)

    def variance(self, loads: Array) -> Array:
        """Return the squared standard uncertainty of the reference at each load, in the reference unit squared."""
        squares = [sum(each.standard**2 for each in self.contributions(float(load))) for load in np.ravel(loads)]
        return np.reshape(np.array(squares, dtype=np.float64), np.shape(loads))

    def expanded(self, load: float, factor: float = COVERAGE) -> float | None:
        """Return U of the reference at a load, in the reference unit, with this coverage factor.

        None where nobody stated any of it; 0 in a simulation, which gives the true load.
        """
        if not self.is_simulated and not self.contributions(load):
            return None
        return factor * float(np.sqrt(self.variance(np.array(load))))

    def to_json(self) -> dict[str, object]:
        return {key: value.isoformat() if isinstance(value, date) else value for key, value in vars(self).items()}


NUMBERS = tuple(one.name for one in fields(Reference) if one.type in (float, float | None))
SIMULATED = Reference(is_simulated=True)

DIVISORS = {"normal": 1.0, "rectangular": float(np.sqrt(3))}


@dataclass(frozen=True)
class Contribution:
    """One line of a budget.

    Args:
        value: standard deviation or half-width, in the unit of the quantity.
        distribution: normal or rectangular.
        factor: coverage factor of `value` where it is an expanded uncertainty.
        sensitivity: change of the estimate, in the reference unit, per unit of the quantity.
    """

    name: str
    value: float
    distribution: str
    factor: float = 1.0
    sensitivity: float = 1.0

    @property
    def divisor(self) -> float:
        """What `value` is divided by to become a standard uncertainty."""
        return self.factor * DIVISORS[self.distribution]

    @property
    def standard(self) -> float:
        """Standard uncertainty of the estimate that it causes, in the reference unit."""
        return abs(self.sensitivity) * self.value / self.divisor


@dataclass(frozen=True)
class Budget:
    """The uncertainty of an estimate: u_c^2 = sum (c_i u_i)^2 over independent contributions (GUM, equation 10)."""

    load: float
    contributions: tuple[Contribution, ...]

    @property
    def standard(self) -> float:
        """Combined standard uncertainty, in the reference unit."""
        return float(np.sqrt(sum(each.standard**2 for each in self.contributions)))

    @property
    def expanded(self) -> float:
        """U at k = 2, in the reference unit."""
        return COVERAGE * self.standard


def forecast_budget(
    terms: Mapping[str, float], correspondence: Correspondence, rmse: float, reference: Reference | None, load: float
) -> Budget:
    """Return the budget at a load of a unit whose error was forecast: f, map and quantisation share it among them."""
    network = min(terms["model"], rmse)
    step = correspondence.sensitivity.get("resolution", 0.0) * terms.get("resolution", 0.0)
    quantisation = min(step, float(np.sqrt(rmse**2 - network**2)))
    unit_map = float(np.sqrt(max(rmse**2 - network**2 - quantisation**2, 0.0)))
    unit_terms = {"shared network f": network, "map": unit_map, "quantisation": quantisation}
    return _budget(unit_terms, reference, load)


def measured_budget(rmse: float, reference: Reference | None, load: float) -> Budget:
    """Return the budget of a unit whose error was measured: f, map and quantisation were measured together."""
    return _budget({"f, map and quantisation, measured": rmse}, reference, load)


def _budget(unit_terms: Mapping[str, float], reference: Reference | None, load: float) -> Budget:
    reference_terms = () if reference is None else reference.contributions(load)
    return Budget(
        load, (*reference_terms, *(Contribution(name, value, "normal") for name, value in unit_terms.items()))
    )
