"""A lot pressed on a sealed rig: units made with the sealed one, with the same hidden causes."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from softcal.core.challenge.cases import RunPlan, SealedCase
from softcal.core.challenge.rig import Measured

SPREAD = {"u0_mm": 0.005, "k1_N_mm": 0.003, "k3_N_mm3": 0.003, "r0_ohm": 0.08, "kappa_per_N": 0.06}
"""Standard deviations from unit to unit: of the contact position in mm, of all else relative."""


@dataclass(frozen=True, eq=False)
class LotRun:
    """One recording of a lot: `source`, `units` or `audit`, and whose it is."""

    place: str
    serial: str
    measured: Measured


def press_lot(case: SealedCase, units: int) -> Iterator[LotRun]:
    """Press a source unit and target units, each with an audit, on the rig of a sealed case."""
    rng = np.random.default_rng([case.kept_back.seed, 40_009])
    for number in range(units + 1):
        unit, serial = sister(case, rng), f"R{number:02d}"
        seeds = [int(seed) for seed in rng.integers(2**31, size=2)]
        if number == 0:
            yield LotRun("source", serial, unit.measure(RunPlan("lot_source", seeds[0])))
        else:
            yield LotRun("units", serial, unit.measure(RunPlan("lot_unit", seeds[0])))
            yield LotRun("audit", serial, unit.measure(RunPlan("lot_unit", seeds[1])))


def sister(case: SealedCase, rng: np.random.Generator) -> SealedCase:
    """Return another unit of the same make on the same rig, with no channel withheld."""
    deviation = dict(zip(SPREAD, np.clip(rng.normal(size=len(SPREAD)), -2.0, 2.0).tolist(), strict=True))
    changed = {
        name: getattr(case.rig, name) + size * deviation[name] * (1.0 if name == "u0_mm" else getattr(case.rig, name))
        for name, size in SPREAD.items()
    }
    return replace(case, rig=replace(case.rig, **changed), withheld=())
