"""A mass on a spring with a damper, m·ẍ + c·ẋ + k·x = F(t), by SciPy; four effects that it may be missing.

The linear part is carried from step to step exactly, by the matrix exponential; what is not linear is held for 0.5 ms.

    softcal gap diagnose rig --simulator mass_spring_damper:SIMULATOR
"""

from collections.abc import Mapping

import numba
import numpy as np
from scipy.linalg import expm

from softcal.core.gap.simulator import Columns, Experiment, Simulator, candidate
from softcal.core.twin.effects import Parameter

RATE_Hz = 50.0
SUBSTEPS = 40
TURN_mm_s = 5.0
"""Speed at which dry friction has turned round."""


@numba.njit
def _swing(push_N: np.ndarray, carry: np.ndarray, k3: float, c2: float, friction_N: float) -> np.ndarray:
    out = np.zeros(len(push_N))
    place, speed = 0.0, 0.0
    for n in range(len(push_N) - 1):
        for part in range(SUBSTEPS):
            force = push_N[n] + (push_N[n + 1] - push_N[n]) * (part + 0.5) / SUBSTEPS
            force -= k3 * place**3 + c2 * speed * abs(speed) + friction_N * np.tanh(speed / TURN_mm_s)
            place, speed = (
                carry[0, 0] * place + carry[0, 1] * speed + carry[0, 2] * force,
                carry[1, 0] * place + carry[1, 1] * speed + carry[1, 2] * force,
            )
        out[n + 1] = place
    return out


def simulate(inputs: Columns, p: Mapping[str, float]) -> Columns:
    """Return the position of the mass in mm under a push in N, sampled evenly; it starts at rest."""
    t_s = inputs["t_s"]
    per_kg = 1000.0 / p["m"]
    rates = np.array([[0.0, 1.0, 0.0], [-per_kg * p["k"], -per_kg * p["c"], per_kg], [0.0, 0.0, 0.0]])
    carry = expm(rates * (t_s[1] - t_s[0]) / SUBSTEPS)
    place_mm = _swing(inputs["push_N"], carry, p["hardening_spring.k3"], p["air_drag.c2"], p["dry_friction.Fc"])
    return {"place_mm": np.interp(t_s - p["late_sensor.delay"], t_s, place_mm)}


def _push(shape: str, size_N: float) -> Experiment:
    t_s = np.arange(int(6 * RATE_Hz)) / RATE_Hz
    waves = {
        "sweep": np.sin(2 * np.pi * (0.3 + 0.35 * t_s) * t_s),
        "steps": np.sign(np.sin(2 * np.pi * t_s / 3.0)) * np.floor(1 + t_s / 3.0) / 2.0,
        "slow": np.sin(2 * np.pi * t_s / 6.0),
    }
    return Experiment({"t_s": t_s, "push_N": size_N * waves[shape]}, minutes=0.5)


SHAPES, SIZES_N = ("sweep", "steps", "slow"), (2.0, 6.0)

SIMULATOR = Simulator(
    name="mass on a spring",
    run=simulate,
    inputs=("push_N",),
    channels=("place_mm",),
    base=(
        Parameter("m", "kg", 0.3, 20.0, 1.0, scale="log"),
        Parameter("c", "N·s/mm", 1e-4, 1.0, 0.005, scale="log"),
        Parameter("k", "N/mm", 0.05, 20.0, 0.5, scale="log"),
    ),
    candidates=(
        candidate("hardening_spring", "spring", Parameter("k3", "N/mm³", -0.001, 0.01, 0.0005, neutral=0.0)),
        candidate("air_drag", "damper", Parameter("c2", "N·s²/mm²", 0.0, 1e-3, 2e-5, neutral=0.0)),
        candidate("dry_friction", "guide", Parameter("Fc", "N", 0.0, 2.0, 0.3, neutral=0.0)),
        candidate("late_sensor", "sensor", Parameter("delay", "s", 0.0, 0.2, 0.02, neutral=0.0)),
    ),
    experiments={f"{shape}_{size_N:g}_N": _push(shape, size_N) for shape in SHAPES for size_N in SIZES_N},
)
