"""A steam heat exchanger: the flow of the liquid cools its outlet, a wall follows slowly. Five effects.

    softcal gap diagnose rig --simulator heat_exchanger:SIMULATOR

A run does not begin at rest: the wall begins where the first sample of the temperature has it.
"""

from collections.abc import Mapping

import numba
import numpy as np

from softcal.core.gap.simulator import Columns, Experiment, Simulator, candidate
from softcal.core.twin.effects import Parameter

STRETCH = 0.3
"""A flow in the middle of the range."""


@numba.njit
def _lag(values: np.ndarray, t_s: np.ndarray, tau_s: np.ndarray, start: float) -> np.ndarray:
    out, state = np.empty(len(values)), start
    for n in range(len(values)):
        out[n] = state
        if n < len(values) - 1:
            state += (values[n] - state) * (1.0 - np.exp(-(t_s[n + 1] - t_s[n]) / max(tau_s[n], 1e-9)))
    return out


def simulate(inputs: Columns, p: Mapping[str, float]) -> Columns:
    """Return the temperature of the outlet in °C under a flow."""
    t_s, flow, first_C = inputs["t_s"], inputs["flow"], inputs["temperature_C"][0]
    late = np.interp(t_s - p["dead_time.delay"], t_s, flow)
    target_C = p["level"] - p["cooling"] * ((late - STRETCH) + p["curved_cooling.bend"] * (late - STRETCH) ** 2)
    within_s = p["wall"] * np.maximum(late / STRETCH, 0.05) ** -p["quick_flow.power"]
    out = _lag(target_C, t_s, within_s, first_C)
    out = _lag(out, t_s, np.full(len(t_s), p["second_wall.within"]), first_C)
    return {"temperature_C": out + p["slow_steam.rate"] * t_s}


def _flowing(hold_s: float) -> Experiment:
    t_s = np.arange(0.0, 1500.0, 1.0)
    flow = np.random.default_rng(int(hold_s)).uniform(0.1, 0.7, 1 + int(1500.0 / hold_s))[(t_s / hold_s).astype(int)]
    return Experiment({"t_s": t_s, "flow": flow, "temperature_C": np.full(len(t_s), 97.0)}, minutes=25.0)


SIMULATOR = Simulator(
    name="heat exchanger",
    run=simulate,
    inputs=("flow", "temperature_C"),
    channels=("temperature_C",),
    base=(
        Parameter("level", "°C", 20.0, 150.0, 97.0),
        Parameter("cooling", "°C", 0.1, 100.0, 8.0, scale="log"),
        Parameter("wall", "s", 0.3, 300.0, 20.0, scale="log"),
    ),
    candidates=(
        candidate("curved_cooling", "wall", Parameter("bend", "1", -3.0, 3.0, 0.5, neutral=0.0)),
        candidate("second_wall", "wall", Parameter("within", "s", 0.0, 100.0, 5.0, neutral=0.0)),
        candidate("dead_time", "pipe", Parameter("delay", "s", 0.0, 30.0, 2.0, neutral=0.0)),
        candidate("quick_flow", "liquid", Parameter("power", "1", -2.0, 2.0, 0.3, neutral=0.0)),
        candidate("slow_steam", "steam", Parameter("rate", "°C/s", -0.01, 0.01, 0.001, neutral=0.0)),
    ),
    experiments={f"steps of {hold:g} s": _flowing(hold) for hold in (15.0, 100.0)},
)
