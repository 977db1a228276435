"""The spread of a lot: units made together differ from one another, each a little in everything."""

from dataclasses import dataclass

import numpy as np

from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin


@dataclass(frozen=True)
class LotSpread:
    """Standard deviations from unit to unit: of the contact in mm, relative for all else.

    The defaults keep every unit well below the collapse of its channel (κ·F < 0.75 at 3.5 mm) and give responses
    that differ by tens of per cent, as the printed sensors of Kim and others 2020 do.
    """

    u0_mm: float = 0.05
    k1: float = 0.05
    k3: float = 0.05
    r0: float = 0.08
    kappa: float = 0.06
    noise: float = 0.15


def draw_lot(
    rng: np.random.Generator,
    count: int,
    nominal: BaseParameters | None = None,
    metadata: ReadoutMetadata | None = None,
    effects: tuple[EffectSetting, ...] = (),
    spread: LotSpread | None = None,
) -> tuple[Twin, ...]:
    """Draw units of one lot around the nominal unit.

    Args:
        rng: source of the spread.
        count: number of units.
        effects: switched on in every unit, at the same size.

    Returns:
        (count,) twins; deviations are normal, cut at two standard deviations.
    """
    nominal, spread = nominal or BaseParameters(), spread or LotSpread()
    return tuple(Twin(_draw_unit(rng, nominal, spread), effects, metadata or ReadoutMetadata()) for _ in range(count))


def _draw_unit(rng: np.random.Generator, nominal: BaseParameters, spread: LotSpread) -> BaseParameters:
    def deviation() -> float:
        return float(np.clip(rng.normal(), -2.0, 2.0))

    return BaseParameters(
        u0_mm=nominal.u0_mm + spread.u0_mm * deviation(),
        k1_N_mm=nominal.k1_N_mm * (1 + spread.k1 * deviation()),
        k3_N_mm3=nominal.k3_N_mm3 * (1 + spread.k3 * deviation()),
        r0_ohm=nominal.r0_ohm * (1 + spread.r0 * deviation()),
        kappa_per_N=nominal.kappa_per_N * (1 + spread.kappa * deviation()),
        sigma_output_V=nominal.sigma_output_V * (1 + spread.noise * deviation()),
        sigma_force_N=nominal.sigma_force_N * (1 + spread.noise * deviation()),
    )
