"""Draw a lot of sealed cases: units with the same hidden causes, each at a size and a noise of its own."""

from dataclasses import replace

import numpy as np

from softcal.core.challenge.case_generator import draw_case, draw_seed
from softcal.core.challenge.cases import RunPlan, SealedCase, draw_sister_unit
from softcal.core.challenge.rig import Cause

SIZE_SPREAD = 0.3
"""Standard deviation of the logarithm of a cause's size from unit to unit."""

SIZES_BY_UNIT = {
    "width_mm",
    "shift_mm",
    "compliance_mm_per_N",
    "length_mm",
    "share",
    "size",
    "size_per_N2",
    "coefficient_per_K",
    "tau_s",
    "wire_ohm",
    "rate_per_s",
    "amplitude_V",
    "rate_N_per_s",
    "delay_s",
    "skew",
    "step_ohm",
}
"""Values that differ from unit to unit; onsets, frequencies and rails are those of the rig."""


def draw_lot(seed: int, line: str, units: int) -> list[SealedCase]:
    """Draw one case per unit; the same seed and line give the same lot.

    The random presses come first: where only one run is fitted, it is the richest.

    Args:
        seed: seed of everything in the lot.
        line: a key of `draw.LINES`; it draws the causes that all units share.
        units: how many units.
    """
    first = draw_case(seed, "unit-01", line)
    rng = np.random.default_rng([seed, 50_021])
    lot = []
    for number in range(1, units + 1):
        sister_unit = draw_sister_unit(first, rng)
        # Every unit has its own noise: other electronics channels, another day.
        noise = replace(
            sister_unit.rig,
            noise_V=sister_unit.rig.noise_V * _near(rng, 0.2),
            noise_N=sister_unit.rig.noise_N * _near(rng, 0.2),
        )
        plans = tuple(RunPlan(p.protocol, draw_seed(rng)) for p in first.plans)
        lot.append(
            replace(
                sister_unit,
                name=f"unit-{number:02d}",
                rig=noise,
                causes=tuple(_resized(rng, cause) for cause in first.causes),
                plans=tuple(sorted(plans, key=lambda p: p.protocol != "random")),
                kept_back=RunPlan("kept_back", draw_seed(rng)),
                withheld=first.withheld,
            )
        )
    return lot


def _near(rng: np.random.Generator, spread: float) -> float:
    return float(np.exp(spread * np.clip(rng.normal(), -2.0, 2.0)))


def _resized(rng: np.random.Generator, cause: Cause) -> Cause:
    return replace(
        cause, values={n: v * (_near(rng, SIZE_SPREAD) if n in SIZES_BY_UNIT else 1.0) for n, v in cause.values.items()}
    )
