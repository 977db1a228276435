"""A mass on a spring as a problem of mujoco.sysid: three of its parameters may be switched off, and are the candidates.

pip install 'mujoco[sysid]'
python mujoco_slide.py
"""

from typing import Any

import mujoco
import numpy as np
from mujoco import rollout, sysid

from softcal.app.gap.mujoco_sysid import SysidProblem, from_sysid

MODEL = """
<mujoco>
  <option timestep="0.002"><flag contact="disable"/></option>
  <worldbody>
    <body name="ball">
      <inertial pos="0 0 0" mass="1" diaginertia="0.001 0.001 0.001"/>
      <joint name="slide" type="slide" axis="1 0 0" stiffness="100" damping="5" frictionloss="{friction_N}"/>
      <geom type="sphere" size="0.05"/>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="slide"/></actuator>
  <sensor><jointpos name="position_m" joint="slide"/><jointvel name="speed_m_s" joint="slide"/></sensor>
</mujoco>
"""
NOISE = 0.02
"""Share of a signal's spread."""


def parameters() -> Any:
    """Return mass and damping, and what may be missing: dry friction, a rotor, a weaker motor."""
    out = sysid.ParameterDict()

    def add(name: str, nominal: float, low: float, high: float, write: Any) -> None:
        out.add(sysid.Parameter(name, nominal, low, high, modifier=lambda spec, p: write(spec, float(p.value[0]))))

    add("mass_kg", 1.5, 0.3, 3.0, lambda spec, v: setattr(spec.body("ball"), "mass", v))
    add("damping", 3.0, 0.1, 30.0, lambda spec, v: setattr(spec.joint("slide"), "damping", np.array([v, 0.0, 0.0])))
    add("dry_friction_N", 0.0, 0.0, 3.0, lambda spec, v: setattr(spec.joint("slide"), "frictionloss", v))
    add("rotor_kg", 0.0, 0.0, 1.0, lambda spec, v: setattr(spec.joint("slide"), "armature", v))
    add("motor", 1.0, 0.5, 1.5, lambda spec, v: setattr(spec.actuator("push"), "gear", np.array([v, 0, 0, 0, 0, 0.0])))
    return out


NEUTRAL = {"dry_friction_N": 0.0, "rotor_kg": 0.0, "motor": 1.0}


def sequences(friction_N: float, seed: int = 0) -> Any:
    """Return two noisy recordings of a rig with dry friction, with the model that knows nothing of it."""
    rng, runs = np.random.default_rng(seed), []
    for fast_Hz, slow_Hz in ((3.7, 1.5), (2.9, 0.8)):
        model = mujoco.MjSpec.from_string(MODEL.format(friction_N=friction_N)).compile()
        data, t_s = mujoco.MjData(model), np.arange(1500) * model.opt.timestep
        push_N = 3.0 * np.sin(2 * np.pi * fast_Hz * t_s) + 5.0 * np.sin(2 * np.pi * slow_Hz * t_s)
        start = sysid.create_initial_state(model, data.qpos, data.qvel, data.act)
        state, signals = (np.squeeze(v, 0) for v in rollout.rollout(model, data, start, push_N[:-1, np.newaxis]))
        noisy = signals + NOISE * signals.std(axis=0) * rng.normal(size=signals.shape)
        control = sysid.TimeSeries(t_s, push_N[:, np.newaxis])
        runs.append((start, control, sysid.TimeSeries.from_names(state[:, 0], noisy, model)))
    spec = mujoco.MjSpec.from_string(MODEL.format(friction_N=0.0))
    return [sysid.ModelSequences("slide", spec, ["fast", "slow"], *(list(each) for each in zip(*runs, strict=True)))]


def problem(friction_N: float = 0.4) -> SysidProblem:
    """Return the problem as softcal diagnoses it."""
    return from_sysid(parameters(), sequences(friction_N), NEUTRAL, name="a mass on a spring")


if __name__ == "__main__":
    from softcal.core.gap.simulator_model import diagnose_simulator

    diagnosis = diagnose_simulator(problem().simulator, problem().runs)
    likely = [(c.effect, c.parameters["change"]) for c in diagnosis.causes if c.probability > 0.5]
    print(diagnosis.verdict, likely, diagnosis.explained_fraction)
