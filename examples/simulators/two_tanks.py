"""Two tanks, one above the other, filled by a pump; the level of the lower one is measured. Four effects.

softcal gap diagnose rig --simulator two_tanks:SIMULATOR
"""

from collections.abc import Mapping

import numba
import numpy as np

from softcal.core.gap.simulator import Columns, Experiment, Simulator, candidate
from softcal.core.twin.effects import Parameter

SUBSTEPS = 4


@numba.njit
def _fill(
    pumped: np.ndarray, t_s: np.ndarray, valves: np.ndarray, start: np.ndarray, brim: float, leak: float
) -> np.ndarray:
    out = np.empty(len(t_s))
    upper, lower = max(start[0], 0.0), max(start[1], 0.0)
    for n in range(len(t_s)):
        out[n] = lower
        if n == len(t_s) - 1:
            break
        step = (t_s[n + 1] - t_s[n]) / SUBSTEPS
        for _ in range(SUBSTEPS):
            falls = valves[0] * np.sqrt(upper)
            upper += step * (pumped[n] - falls - leak * upper)
            over = max(upper - brim, 0.0)
            upper = max(upper - over, 0.0)
            # What runs over the brim falls into the lower tank.
            lower = max(lower + step * (falls - valves[1] * np.sqrt(lower)) + over, 0.0)
    return out


def simulate(inputs: Columns, p: Mapping[str, float]) -> Columns:
    """Return the level of the lower tank in V under the voltage of the pump in V."""
    pump_V = inputs["pump_V"]
    pumped = np.maximum(p["pump"] * pump_V * (1.0 + p["pump_curve.bend"] * pump_V), 0.0)
    valves, start = np.array([p["upper_valve"], p["lower_valve"]]), np.array([p["upper_start"], p["lower_start"]])
    level = _fill(pumped, inputs["t_s"], valves, start, p["overflow.brim"], p["leak.rate"])
    return {"level_V": level + p["sensor_curve.bend"] * level**2}


def _pumped(size_V: float, seed: int) -> Experiment:
    t_s = np.arange(0.0, 2000.0, 4.0)
    waves = [np.sin(2 * np.pi * k * t_s / 2000.0 + seed * k * k) for k in range(1, 12)]
    return Experiment(
        {"t_s": t_s, "pump_V": np.clip(2.5 + size_V * np.sum(waves, axis=0) / 3.0, 0.0, 7.0)}, minutes=33.0
    )


SIMULATOR = Simulator(
    name="two tanks",
    run=simulate,
    inputs=("pump_V",),
    channels=("level_V",),
    base=(
        Parameter("pump", "1/s", 0.001, 1.0, 0.05, scale="log"),
        Parameter("upper_valve", "√V/s", 0.001, 1.0, 0.05, scale="log"),
        Parameter("lower_valve", "√V/s", 0.001, 1.0, 0.05, scale="log"),
    ),
    run_parameters=(
        Parameter("upper_start", "V", 0.0, 12.0, 4.0),
        Parameter("lower_start", "V", 0.0, 12.0, 4.0),
    ),
    candidates=(
        candidate(
            "overflow", "upper tank", Parameter("brim", "V", 1.0, 30.0, 8.0, neutral=np.inf, scale="inverse_square")
        ),
        candidate("leak", "upper tank", Parameter("rate", "1/s", 0.0, 0.05, 0.002, neutral=0.0)),
        candidate("pump_curve", "pump", Parameter("bend", "1/V", -0.14, 0.2, 0.03, neutral=0.0)),
        candidate("sensor_curve", "sensor", Parameter("bend", "1/V", -0.04, 0.1, 0.01, neutral=0.0)),
    ),
    experiments={f"{size:g}_V": _pumped(size, 1) for size in (1.0, 2.5)},
)
