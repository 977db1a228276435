"""Drawn simulators of a badly kept rig: each run has a zero, a gain, a delay and a drift of its own."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from softcal.core.gap.diagnosis import Diagnosis
from softcal.core.gap.simulator import Columns, Simulator, SimulatorRun, candidate, recorded
from softcal.core.gap.simulator_model import diagnose_simulator
from softcal.core.twin.effects import Parameter

STEP_s = 0.05
T = np.arange(400) * STEP_s
RUNS = 4
TUNED = range(4)
"""Plants on which the share was chosen from which an offset takes the shape of a cause; they test nothing here."""

ALIASES = {"late": "delay", "early_input": "delay", "bias": "zero", "scale": "gain", "walk": "drift"}
"""Candidates that all runs share of what each may have of its own."""


def size(name: str, unit: str, low: float, high: float, usual: float) -> Parameter:
    return Parameter(name, unit, low, high, usual, neutral=0.0)


CANDIDATES = (
    candidate("cubic", "drive", size("a", "1", -3.0, 3.0, 0.1)),
    candidate("slow_part", "body", size("share", "1", 0.0, 0.9, 0.1)),
    candidate("dead_band", "drive", size("width", "1", 0.0, 1.0, 0.05)),
    candidate("late", "sensor", size("delay", "s", 0.0, 1.0, 0.03)),
    candidate("early_input", "drive", size("delay", "s", 0.0, 1.0, 0.03)),
    candidate("bias", "sensor", size("level", "1", -3.0, 3.0, 0.1)),
    candidate("scale", "sensor", size("more", "1", -0.5, 1.0, 0.05)),
    candidate("walk", "sensor", size("rate", "1/s", -1.0, 1.0, 0.01)),
)


@dataclass(frozen=True)
class Plant:
    """A drawn simulator: how fast it follows, how far it rings, what its base has besides."""

    seed: int

    @property
    def rng(self) -> np.random.Generator:
        return np.random.default_rng(100 + self.seed)

    def run(self, inputs: Columns, p: Mapping[str, float]) -> Columns:
        u = np.interp(T - p["early_input.delay"], T, inputs["u"])
        u = u + p["cubic.a"] * u**3 - np.clip(u, -p["dead_band.width"], p["dead_band.width"])
        decay = np.exp(-STEP_s / p["tau"])
        y = p["gain"] * lfilter([1.0 - decay], [1.0, -decay], u)
        if "rate" in self.has:
            swing = np.exp((-0.4 + 2j * np.pi * p["rate"]) * STEP_s)
            poles = [1.0, -2.0 * swing.real, abs(swing) ** 2]
            y = 0.5 * y + 0.5 * lfilter([sum(poles)], poles, y)
        slow = np.exp(-STEP_s / 4.0)
        y = y - p["slow_part.share"] * lfilter([1.0 - slow], [1.0, -slow], y)
        y = np.interp(T - p["late.delay"], T, y) * (1.0 + p["scale.more"])
        y = y + p["bias.level"] + p["walk.rate"] * T + p.get("zero", 0.0)
        return {"y": np.tanh(y) if "bent" in self.has else y}

    @property
    def has(self) -> set[str]:
        choices = self.rng.random(3) < 0.5
        return {name for name, is_in in zip(("rate", "zero", "bent"), choices, strict=True) if is_in}

    @property
    def simulator(self) -> Simulator:
        base = [
            Parameter("tau", "s", 0.02, 20.0, 0.5, scale="log"),
            Parameter("gain", "1", -20.0, 20.0, 1.0),
            Parameter("rate", "Hz", 0.1, 2.0, 0.5),
            Parameter("zero", "1", -5.0, 5.0, 0.1),
        ]
        selected = tuple(p for p in base if p.name in {"tau", "gain", *self.has})
        allowed = {"y": {"zero": 0.3, "gain": 0.08, "delay": 0.2, "drift": 0.02}}
        return Simulator("a plant", self.run, ("u",), ("y",), selected, CANDIDATES, per_run=allowed)

    def recorded(self, noise: float, is_linear: bool, hidden: Mapping[str, float]) -> list[SimulatorRun]:
        """Return recordings; the clock of each is late, as a curve would be or along straight lines between samples."""
        rng = self.rng
        truth = {f"{c.id}.{p.name}": 0.0 for c in CANDIDATES for p in c.parameters}
        truth |= {"tau": rng.uniform(0.2, 0.8), "gain": rng.uniform(0.4, 1.2), "rate": rng.uniform(0.3, 0.7)}
        truth |= {"zero": rng.uniform(-0.3, 0.3) if "zero" in self.has else 0.0} | dict(hidden)
        out = []
        for run in range(RUNS):
            a, b = rng.uniform(0.2, 0.9, 2)
            u = np.sin(2 * np.pi * (a + 0.02 * b * T) * T) * (0.6 + 0.6 * rng.random()) * (T > 1.0)
            y = self.run({"u": u}, truth)["y"]
            late_s, more = rng.uniform(0.0, 0.1), rng.normal(0.0, 0.015)
            at_s = np.maximum(T - late_s, 0.0)
            y = (np.interp(at_s, T, y) if is_linear else CubicSpline(T, y)(at_s)) * (1.0 + more)
            y = y + rng.normal(0.0, 0.05) + rng.normal(0.0, 0.002) * T + rng.normal(0.0, noise, len(T))
            out.append(recorded(self.simulator, str(run + 1), {"t_s": T, "u": u, "y": y}))
        return out


CAUSES = {"none": {}, "cubic": {"cubic.a": 0.15}, "slow_part": {"slow_part.share": 0.15}, "late": {"late.delay": 0.05}}
CAUSES["long_delay"] = {"late.delay": 0.6}


def likely_causes(diagnosis: Diagnosis) -> set[str]:
    return {c.effect for c in diagnosis.causes if c.probability > 0.5}


def diagnosed(seed: int, noise: float, is_linear: bool, hidden: str) -> Diagnosis:
    plant = Plant(seed)
    return diagnose_simulator(plant.simulator, plant.recorded(noise, is_linear, CAUSES[hidden]))


def blind(seed: int) -> Diagnosis:
    """Diagnose a plant whose cause no candidate describes; a dead band bends as its cube does."""
    plant = Plant(seed)
    selected = tuple(c for c in CANDIDATES if c.id != "cubic")
    bare = replace(plant.simulator, candidates=selected, run=lambda i, p: plant.run(i, {"cubic.a": 0.0, **p}))
    return diagnose_simulator(bare, plant.recorded(0.004, False, CAUSES["cubic"]))
