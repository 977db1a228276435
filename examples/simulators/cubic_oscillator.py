"""An electronic oscillator, m·ÿ + d·ẏ + k·y = u + zero, whose spring may be cubic; five effects it may be missing.

softcal gap diagnose rig --simulator cubic_oscillator:SIMULATOR
"""

from collections.abc import Mapping

import numba
import numpy as np

from softcal.core.gap.simulator import Columns, Experiment, Simulator, candidate
from softcal.core.twin.effects import Parameter

SUBSTEPS = 2


@numba.njit
def _acceleration(y: float, v: float, u: float, own: np.ndarray, missing: np.ndarray) -> float:
    stiffness, damping, gain, zero = own
    force = gain * (u + zero) - stiffness * y - damping * v
    return force - missing[0] * y**3 - missing[1] * y**2 - missing[2] * v * abs(v) - missing[3] * np.tanh(50.0 * v)


@numba.njit
def _swing(t: np.ndarray, u: np.ndarray, own: np.ndarray, missing: np.ndarray) -> np.ndarray:
    out, y, v = np.zeros(len(u)), 0.0, 0.0
    for n in range(len(u) - 1):
        step = (t[n + 1] - t[n]) / SUBSTEPS
        for part in range(SUBSTEPS):
            u0 = u[n] + (u[n + 1] - u[n]) * part / SUBSTEPS
            u1 = u[n] + (u[n + 1] - u[n]) * (part + 1) / SUBSTEPS
            middle = 0.5 * (u0 + u1)
            a1 = _acceleration(y, v, u0, own, missing)
            a2 = _acceleration(y + 0.5 * step * v, v + 0.5 * step * a1, middle, own, missing)
            a3 = _acceleration(y + 0.5 * step * (v + 0.5 * step * a1), v + 0.5 * step * a2, middle, own, missing)
            a4 = _acceleration(y + step * (v + 0.5 * step * a2), v + step * a3, u1, own, missing)
            y, v = y + step * v + step**2 * (a1 + a2 + a3) / 6.0, v + step * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0
        out[n + 1] = y
    return out


def simulate(inputs: Columns, p: Mapping[str, float]) -> Columns:
    """Return the position in V under a force in V; time in units of the natural frequency. It starts at rest."""
    own = np.array([p["stiffness"], p["damping"], p["gain"], p["zero"]])
    missing = np.array([p["cubic_spring.k3"], p["even_spring.k2"], p["air_damper.c2"], p["dry_damper.c0"]])
    y = _swing(inputs["t_s"], inputs["force_V"], own, missing)
    return {"place_V": y + p["sensor_curve.bend"] * y**2}


def _pushed(size_V: float) -> Experiment:
    t_s = np.arange(0.0, 120.0, 0.25)
    return Experiment({"t_s": t_s, "force_V": size_V * np.sin((0.3 + 0.008 * t_s) * t_s)})


SIMULATOR = Simulator(
    name="cubic oscillator",
    run=simulate,
    inputs=("force_V",),
    channels=("place_V",),
    base=(
        Parameter("stiffness", "1", 0.05, 20.0, 0.7, scale="log"),
        Parameter("damping", "1", 1e-3, 5.0, 0.2, scale="log"),
        Parameter("gain", "1", -10.0, 10.0, 0.8),
        Parameter("zero", "V", -1.0, 1.0, 0.01),
    ),
    candidates=(
        candidate("cubic_spring", "spring", Parameter("k3", "1/V²", -20.0, 50.0, 1.0, neutral=0.0)),
        candidate("even_spring", "spring", Parameter("k2", "1/V", -5.0, 5.0, 0.3, neutral=0.0)),
        candidate("air_damper", "damper", Parameter("c2", "1/V", 0.0, 5.0, 0.1, neutral=0.0)),
        candidate("dry_damper", "damper", Parameter("c0", "V", 0.0, 0.5, 0.01, neutral=0.0)),
        candidate("sensor_curve", "sensor", Parameter("bend", "1/V", -1.0, 1.0, 0.05, neutral=0.0)),
    ),
    experiments={f"{size:g}_V": _pushed(size) for size in (0.05, 0.15)},
)
