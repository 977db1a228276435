"""A motor on a drive: torque in, speed out, J·ω̇ = T − b·ω; six effects that it may be missing.

softcal gap diagnose rig --simulator motor_drive:SIMULATOR
"""

from collections.abc import Mapping

import numba
import numpy as np

from softcal.core.gap.simulator import Columns, Experiment, Simulator, candidate
from softcal.core.twin.effects import Parameter

SUBSTEPS = 8
TURN_rad_s = 1.0
"""Speed at which dry friction has turned round."""


@numba.njit
def _spin(t_s: np.ndarray, torque: np.ndarray, own: np.ndarray, dry: np.ndarray, more: np.ndarray) -> np.ndarray:
    inertia, viscous = own
    quadratic, falling, falls_within, lag_s = more
    out, speed, acts = np.zeros(len(t_s)), 0.0, 0.0
    for n in range(len(t_s) - 1):
        step = (t_s[n + 1] - t_s[n]) / SUBSTEPS
        for _ in range(SUBSTEPS):
            acts += (torque[n] - acts) * (1.0 - np.exp(-step / lag_s)) if lag_s > 1e-6 else torque[n] - acts
            size = abs(speed)
            rubs = (dry[0] if speed > 0.0 else dry[1]) + quadratic * size**2
            # Implicit in what brakes: a stiff friction does not swing.
            brakes = viscous + falling * np.exp(-size / falls_within) + rubs / max(size, TURN_rad_s)
            speed = (speed + step * acts / inertia) / (1.0 + step * brakes / inertia)
        out[n + 1] = speed
    return out


def simulate(inputs: Columns, p: Mapping[str, float]) -> Columns:
    """Return the speed in rad/s under a torque in N·m; it starts at rest."""
    own = np.array([p["inertia"], p["viscous"]]) * 1e-3
    both, sided, side = p["dry_friction.torque"], p["two_sided_friction.torque"], p["two_sided_friction.side"]
    dry = np.array([both + sided * (1.0 + side), both + sided * (1.0 - side)]) * 1e-3
    more = np.array(
        [1e-6 * p["air_drag.c2"], 1e-3 * p["falling_drag.viscous"], p["falling_drag.within"], p["slow_torque.lag"]]
    )
    speed = _spin(
        inputs["t_s"], inputs["torque_Nm"] * (1.0 - p["weak_motor.share"] * np.abs(inputs["torque_Nm"])), own, dry, more
    )
    return {"speed_rad_s": speed}


def _driven(size_Nm: float, both_ways: bool) -> Experiment:
    t_s = np.arange(0.0, 20.0, 0.02)
    stairs = 1.0 + np.floor(t_s / 4.0) / 2.0
    return Experiment(
        {"t_s": t_s, "torque_Nm": size_Nm * stairs * (np.sign(np.sin(2 * np.pi * t_s / 8.0)) if both_ways else 1.0)}
    )


SIMULATOR = Simulator(
    name="motor on a drive",
    run=simulate,
    inputs=("torque_Nm",),
    channels=("speed_rad_s",),
    base=(
        Parameter("inertia", "g·m²", 1e-3, 10.0, 0.1, scale="log"),
        Parameter("viscous", "mN·m·s", 1e-4, 10.0, 0.1, scale="log"),
    ),
    candidates=(
        candidate("dry_friction", "bearing", Parameter("torque", "mN·m", 0.0, 200.0, 10.0, neutral=0.0)),
        candidate(
            "two_sided_friction",
            "bearing",
            Parameter("torque", "mN·m", 0.0, 200.0, 10.0, neutral=0.0),
            Parameter("side", "1", -1.0, 1.0, 0.2),
        ),
        candidate("air_drag", "fan", Parameter("c2", "µN·m·s²", 0.0, 50.0, 0.5, neutral=0.0)),
        candidate(
            "falling_drag",
            "bearing",
            Parameter("viscous", "mN·m·s", 0.0, 10.0, 0.1, neutral=0.0),
            Parameter("within", "rad/s", 1.0, 1000.0, 50.0, scale="log"),
        ),
        candidate("slow_torque", "drive", Parameter("lag", "s", 0.0, 1.0, 0.05, neutral=0.0)),
        candidate("weak_motor", "motor", Parameter("share", "1/(N·m)", 0.0, 5.0, 0.5, neutral=0.0)),
    ),
    experiments={"one way": _driven(0.05, False), "to and fro": _driven(0.05, True)},
)
