"""A mass on a spring with a damper, integrated by SciPy: m·ẍ + c·ẋ + k·x = F(t), with four effects it may be missing.

softcal gap diagnose rig --simulator mass_spring_damper:SIMULATOR
"""

from collections.abc import Mapping

import numba
import numpy as np
from scipy.integrate import odeint

from softcal.core.gap.simulator import Columns, Experiment, Simulator, candidate
from softcal.core.twin.effects import Parameter

RATE_Hz = 100.0
TURN_mm_s = 2.0
"""Speed at which dry friction has turned round; below it the integrator would stand still."""


@numba.njit
def _slope(
    state: np.ndarray, at_s: float, push_N: np.ndarray, step_s: float, values: tuple[float, ...]
) -> tuple[float, float]:
    m, c, k, k3, c2, friction_N = values
    place, speed = state[0], state[1]
    before = min(int(at_s / step_s), len(push_N) - 2)
    force = push_N[before] + (push_N[before + 1] - push_N[before]) * (at_s / step_s - before)
    force -= (k + k3 * place * place) * place + (c + c2 * abs(speed)) * speed
    force -= friction_N * np.tanh(speed / TURN_mm_s)
    return speed, 1000.0 * force / m


def simulate(inputs: Columns, p: Mapping[str, float]) -> Columns:
    """Return the position of the mass in mm under a push in N, sampled evenly; it starts at rest."""
    t_s = inputs["t_s"]
    values = tuple(p[n] for n in ("m", "c", "k", "hardening_spring.k3", "air_drag.c2", "dry_friction.Fc"))
    inside = (inputs["push_N"], float(t_s[1] - t_s[0]), values)
    place_mm = odeint(_slope, [0.0, 0.0], t_s, args=inside, rtol=1e-8, atol=1e-8, mxstep=5000)[:, 0]
    return {"place_mm": np.interp(t_s - p["late_sensor.delay"], t_s, place_mm)}


def _push(shape: str, size_N: float) -> Experiment:
    t_s = np.arange(int(6 * RATE_Hz)) / RATE_Hz
    waves = {
        "sweep": np.sin(2 * np.pi * (0.3 + 0.35 * t_s) * t_s),
        "steps": np.sign(np.sin(2 * np.pi * t_s / 3.0)) * np.floor(1 + t_s / 3.0) / 2.0,
        "slow": np.sin(2 * np.pi * t_s / 6.0),
    }
    return Experiment({"t_s": t_s, "push_N": size_N * waves[shape]}, minutes=0.5)


SIMULATOR = Simulator(
    name="mass on a spring",
    run=simulate,
    inputs=("push_N",),
    channels=("place_mm",),
    base=(
        Parameter("m", "kg", 0.1, 20.0, 1.0, scale="log"),
        Parameter("c", "N·s/mm", 1e-4, 1.0, 0.005, scale="log"),
        Parameter("k", "N/mm", 0.05, 20.0, 0.5, scale="log"),
    ),
    candidates=(
        candidate("hardening_spring", "spring", Parameter("k3", "N/mm³", -0.01, 0.01, 0.001, neutral=0.0)),
        candidate("air_drag", "damper", Parameter("c2", "N·s²/mm²", 0.0, 1e-3, 2e-5, neutral=0.0)),
        candidate("dry_friction", "guide", Parameter("Fc", "N", 0.0, 5.0, 0.3, neutral=0.0)),
        candidate("late_sensor", "sensor", Parameter("delay", "s", 0.0, 0.2, 0.02, neutral=0.0)),
    ),
    experiments={
        f"{shape}_{size_N:g}_N": _push(shape, size_N) for shape in ("sweep", "steps", "slow") for size_N in (2.0, 6.0)
    },
)
