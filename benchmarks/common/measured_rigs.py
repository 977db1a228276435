"""Seven measured systems that are no soft sensor, each with a simulator and the effects it may be missing."""

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from softcal.core.gap.simulator import Columns, Simulator, SimulatorRun, candidate, recorded
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Parameter

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples" / "simulators"


def data_folder() -> Path:
    """Return the folder of measured data: `SOFTCAL_DATA`, or the one beside the project."""
    return Path(os.environ.get("SOFTCAL_DATA", ROOT.parent / "shared" / "data"))


@dataclass(frozen=True)
class MeasuredRig:
    """A measured system, its simulator, and which runs a fit may see.

    Args:
        fitted, held_out: names of runs; a system of one run is cut in parts, its last one held out.
        parts: into how many parts the record is cut.
    """

    simulator: Simulator
    fitted: tuple[str, ...]
    held_out: tuple[str, ...]
    parts: int = 1

    def runs(self, folder: Path, names: tuple[str, ...]) -> list[SimulatorRun]:
        """Return the recorded runs of these names, read below the folder of the system."""
        out = {}
        for path in sorted(folder.glob("runs/*/recording.csv")):
            table = np.genfromtxt(path, delimiter=",", names=True)
            for k, rows in enumerate(np.array_split(np.arange(len(table)), self.parts), start=1):
                columns = {name: table[name][rows] for name in table.dtype.names or ()}
                name = path.parent.name if self.parts == 1 else str(k)
                out[name] = recorded(self.simulator, name, columns)
        return [out[name] for name in names]


def _one(name: str, channel: str, unit: str, limit: float, usual: float) -> Effect:
    return candidate(name, channel, Parameter("size", unit, -limit, limit, usual, neutral=0.0))


def _friction(v: Array, a: Array, p: Mapping[str, float]) -> Array:
    way, fastest = np.sign(v), float(np.max(np.abs(v)))
    stribeck = p["stribeck.size"] * way * np.exp(-((v / (p["stribeck.speed"] * fastest)) ** 2))
    return np.asarray(
        p["inertia"] * a
        + p["viscous"] * v
        + p["dry_friction.size"] * way
        + p["offset.size"]
        + p["one_sided.size"] * (v > 0.0)
        + p["drag.size"] * v * np.abs(v)
        + stribeck
    )


def _axis(inputs: Columns, p: Mapping[str, float]) -> Columns:
    return {"F_N": _friction(inputs["v_m_s"], inputs["a_m_s2"], p) + p["spring.size"] * inputs["q_m"]}


def _joint(inputs: Columns, p: Mapping[str, float]) -> Columns:
    q, v = inputs["q"], inputs["dq_rad_s"]
    free = {**p, "offset.size": p["zero"], "one_sided.size": 0.0}
    return {"tau_Nm": _friction(v, inputs["ddq"], free) + p["gravity.size"] * np.sin(q) + p["spring.size"] * q}


STRIBECK = (Parameter("speed", "1", 0.01, 0.5, 0.1, scale="log"),)

AXIS = Simulator(
    name="positioning axis",
    run=_axis,
    inputs=("q_m", "v_m_s", "a_m_s2"),
    channels=("F_N",),
    base=(Parameter("inertia", "kg", 0.0, 1e3, 80.0), Parameter("viscous", "N·s/m", 0.0, 5e3, 200.0)),
    candidates=(
        _one("dry_friction", "guide", "N", 500.0, 10.0),
        _one("offset", "drive", "N", 100.0, 2.0),
        _one("one_sided", "guide", "N", 200.0, 5.0),
        _one("drag", "guide", "N·s²/m²", 1e4, 50.0),
        candidate("stribeck", "guide", Parameter("size", "N", -200.0, 200.0, 5.0, neutral=0.0), *STRIBECK),
        _one("spring", "cable", "N/m", 1e4, 10.0),
    ),
)

JOINT = Simulator(
    name="joint of a robot",
    run=_joint,
    inputs=("q", "dq_rad_s", "ddq"),
    channels=("tau_Nm",),
    base=(
        Parameter("inertia", "kg·m²", 0.0, 100.0, 1.0),
        Parameter("viscous", "N·m·s", 0.0, 1e3, 10.0),
        Parameter("zero", "N·m", -100.0, 100.0, 1.0),
    ),
    candidates=(
        _one("dry_friction", "gear", "N·m", 100.0, 3.0),
        _one("drag", "gear", "N·m·s²", 1e3, 5.0),
        candidate("stribeck", "gear", Parameter("size", "N·m", -50.0, 50.0, 1.0, neutral=0.0), *STRIBECK),
        _one("gravity", "link", "N·m", 200.0, 3.0),
        _one("spring", "cable", "N·m", 200.0, 3.0),
    ),
)


def _beam(inputs: Columns, p: Mapping[str, float]) -> Columns:
    t_s, angle, position = inputs["t_s"], inputs["angle_rad"], inputs["position"]
    out, x, v = np.empty(len(t_s)), float(position[0]), p["start_speed"]
    for n in range(len(t_s)):
        out[n] = x
        h = 0.05
        for _ in range(2):
            tilt = angle[n] + p["tilt_zero.size"]
            pull = p["gain"] * tilt - p["damping"] * v - p["spring.size"] * x - p["cubic.size"] * x**3
            pull -= p["rolling.size"] * np.tanh(v / 0.01)
            v += h * pull
            x += h * v
            if abs(x) > 1e3:
                return {"position": np.full(len(t_s), np.nan)}
    return {"position": out}


BEAM = Simulator(
    name="ball on a beam",
    run=_beam,
    inputs=("angle_rad", "position"),
    channels=("position",),
    base=(
        Parameter("gain", "1/s²", 0.1, 100.0, 5.0),
        Parameter("damping", "1/s", 0.0, 10.0, 0.2),
        Parameter("start_speed", "1/s", -1.0, 1.0, 0.05),
    ),
    candidates=(
        _one("tilt_zero", "beam", "rad", 0.05, 0.001),
        candidate("spring", "beam", Parameter("size", "1/s²", -2.0, 10.0, 0.1, neutral=0.0)),
        candidate("cubic", "beam", Parameter("size", "1/s²", -10.0, 100.0, 2.0, neutral=0.0)),
        _one("rolling", "ball", "1/s²", 1.0, 0.005),
    ),
)


def _arm(inputs: Columns, p: Mapping[str, float]) -> Columns:
    torque = inputs["torque"]
    drive = np.concatenate([[0.0], torque[:-1]]) + p["cubic_drive.size"] * np.concatenate([[0.0], torque[:-1]]) ** 3

    def mode(gain: float, turn: float, damping: float) -> Array:
        pole = np.exp(-damping)
        return np.asarray(lfilter([gain, -gain], [1.0, -2.0 * pole * np.cos(turn), pole**2], drive))

    out = mode(p["gain"], p["turn"], p["damping"])
    if p["second_mode.gain"]:
        out = out + mode(p["second_mode.gain"], p["second_mode.turn"], p["second_mode.damping"])
    return {"acceleration": out + p["rigid.size"] * torque + p["zero.size"]}


ARM = Simulator(
    name="flexible arm",
    run=_arm,
    inputs=("torque",),
    channels=("acceleration",),
    base=(
        Parameter("gain", "1", -10.0, 10.0, 0.5),
        Parameter("turn", "rad", 0.01, 3.0, 0.3),
        Parameter("damping", "1", 1e-3, 2.0, 0.05, scale="log"),
    ),
    candidates=(
        candidate(
            "second_mode",
            "arm",
            Parameter("gain", "1", -10.0, 10.0, 0.3, neutral=0.0),
            Parameter("turn", "rad", 0.01, 3.0, 1.0),
            Parameter("damping", "1", 1e-3, 2.0, 0.05, scale="log"),
        ),
        _one("rigid", "hub", "1", 10.0, 0.2),
        _one("cubic_drive", "motor", "1", 20.0, 0.5),
        _one("zero", "sensor", "1", 1.0, 0.02),
    ),
)


def _heater(inputs: Columns, p: Mapping[str, float]) -> Columns:
    t_s, power, first_C = inputs["t_s"], inputs["Q1_pct"], inputs["T1_C"][0]
    late = np.interp(t_s - p["dead_time.delay"], t_s, power)
    out, hot, board, probe = np.empty(len(t_s)), first_C, first_C, first_C
    for n in range(len(t_s)):
        out[n] = probe
        step = (t_s[n + 1] - t_s[n]) if n + 1 < len(t_s) else 0.0
        rise = hot - p["ambient"]
        loss = p["loss"] * rise * (1.0 + p["radiation.size"] * rise) + p["board.rate"] * (hot - board)
        board += step * p["board.rate"] * p["board.share"] * (hot - board)
        hot += step * (p["heating"] * late[n] - loss)
        probe += (hot - probe) * (1.0 - np.exp(-step / p["probe.lag"])) if p["probe.lag"] > 1e-6 else hot - probe
    return {"T1_C": out}


HEATER = Simulator(
    name="heater board",
    run=_heater,
    inputs=("Q1_pct", "T1_C"),
    channels=("T1_C",),
    base=(
        Parameter("heating", "°C/(s·%)", 1e-4, 1.0, 0.005, scale="log"),
        Parameter("loss", "1/s", 1e-4, 0.1, 0.006, scale="log"),
        Parameter("ambient", "°C", 10.0, 35.0, 21.0),
    ),
    candidates=(
        candidate("probe", "thermometer", Parameter("lag", "s", 0.0, 100.0, 15.0, neutral=0.0)),
        candidate("dead_time", "wiring", Parameter("delay", "s", 0.0, 60.0, 8.0, neutral=0.0)),
        candidate("radiation", "board", Parameter("size", "1/°C", -0.01, 0.1, 0.005, neutral=0.0)),
        candidate(
            "board",
            "board",
            Parameter("rate", "1/s", 0.0, 0.1, 0.003, neutral=0.0),
            Parameter("share", "1", 0.01, 5.0, 0.3, scale="log"),
        ),
    ),
)


def example(module: str) -> Simulator:
    """Return the simulator of a shipped example."""
    sys.path.insert(0, str(EXAMPLES))
    simulator: Simulator = import_module(module).SIMULATOR
    return simulator


def measured_rigs() -> dict[str, MeasuredRig]:
    """Return the measured systems by the name of their folder."""
    return {
        "motor": MeasuredRig(example("motor_drive"), ("1", "2", "4", "5"), ("3", "6")),
        "exchanger": MeasuredRig(example("heat_exchanger"), ("1", "2"), ("3",)),
        "axis": MeasuredRig(AXIS, ("1", "2"), ("3",)),
        "joint": MeasuredRig(JOINT, ("1",), ("2",)),
        "beam": MeasuredRig(BEAM, ("1",), ("2",)),
        "arm": MeasuredRig(ARM, ("1",), ("2",)),
        "heater": MeasuredRig(HEATER, ("1", "2"), ("3",), parts=3),
    }
