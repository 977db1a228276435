"""A finger on a hinge, driven by a torque and simulated by MuJoCo (Todorov, Erez and Tassa 2012).

pip install mujoco
softcal gap diagnose rig --simulator mujoco_finger:SIMULATOR
"""

from collections.abc import Mapping

import mujoco
import numpy as np

from softcal.core.gap.simulator import Columns, Experiment, Simulator, candidate
from softcal.core.twin.effects import Parameter

RATE_Hz = 100.0
STEPS = 5
"""Integration steps between two samples."""

MODEL = """
<mujoco>
  <option integrator="implicitfast" cone="elliptic"/>
  <worldbody>
    <body>
      <joint name="knuckle" type="hinge" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.1" size="0.008" mass="0.05"/>
    </body>
  </worldbody>
  <actuator><motor joint="knuckle"/></actuator>
</mujoco>
"""


def simulate(inputs: Columns, p: Mapping[str, float], steps: int = STEPS) -> Columns:
    """Return the angle of the finger in rad under a torque in mN·m; it starts hanging at rest."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    model.opt.timestep = float(np.median(np.diff(inputs["t_s"]))) / steps
    share = p["mass_g"] / 1000.0 / model.body_mass[1]
    model.body_mass[1] *= share
    model.body_inertia[1] *= share
    model.dof_damping[0] = p["damping"] * 1e-3
    model.dof_armature[0] = p["rotor.inertia"] * 1e-6
    model.jnt_stiffness[0] = p["tendon.stiffness"] * 1e-3
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    angle = np.empty(len(inputs["t_s"]))
    for k, torque in enumerate(inputs["torque_mNm"]):
        angle[k] = data.qpos[0]
        data.ctrl[0] = 1e-3 * torque * (1.0 + p["weak_motor.fade"] * abs(data.qpos[0]))
        for _ in range(steps):
            data.qfrc_applied[0] = -1e-3 * p["dry_joint.torque"] * np.tanh(data.qvel[0] / 0.05)
            mujoco.mj_step(model, data)
    return {"angle_rad": angle}


def _torque(shape: str) -> Experiment:
    t_s = np.arange(int(5 * RATE_Hz)) / RATE_Hz
    waves = {
        "sweep": 12.0 * np.sin(2 * np.pi * (0.3 + 0.25 * t_s) * t_s),
        "steps": 15.0 * np.sign(np.sin(2 * np.pi * t_s / 2.5)) * np.minimum(1.0, t_s),
        "slow": 18.0 * np.sin(2 * np.pi * t_s / 5.0),
    }
    return Experiment({"t_s": t_s, "torque_mNm": waves[shape]}, minutes=0.5)


SIMULATOR = Simulator(
    name="finger on a hinge (MuJoCo)",
    run=simulate,
    inputs=("torque_mNm",),
    channels=("angle_rad",),
    base=(
        Parameter("mass_g", "g", 5.0, 500.0, 50.0, scale="log"),
        Parameter("damping", "mN·m·s", 0.01, 20.0, 1.0, scale="log"),
    ),
    candidates=(
        candidate("rotor", "motor", Parameter("inertia", "g·mm²·1000", 0.0, 2000.0, 50.0, neutral=0.0)),
        candidate("weak_motor", "motor", Parameter("fade", "1/rad", -0.5, 0.5, 0.05, neutral=0.0)),
        candidate("tendon", "tendon", Parameter("stiffness", "mN·m/rad", 0.0, 100.0, 5.0, neutral=0.0)),
        candidate("dry_joint", "joint", Parameter("torque", "mN·m", 0.0, 10.0, 0.5, neutral=0.0)),
    ),
    experiments={shape: _torque(shape) for shape in ("sweep", "steps", "slow")},
)
