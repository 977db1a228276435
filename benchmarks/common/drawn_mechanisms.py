"""Drawn mechanisms whose true laws are known: a force from place, speed and acceleration, and a rest that has no name.

A mechanism has an inertia and a viscous friction. Of a library of laws some are at work, some of these are left out of
the list that a diagnosis searches. What is left out, a law that is a little wrong, or a drift, is the rest.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from softcal.core.gap.simulator import Columns, Simulator, SimulatorRun, candidate, recorded
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Parameter
from softcal.core.twin.signals import low_pass

Law: TypeAlias = Callable[[Columns, float], Array]


def _way(v: Array) -> Array:
    return np.asarray(np.tanh(v / 0.01))


def _followed(values: Array, t_s: Array, tau_s: float) -> Array:
    return np.asarray(low_pass(values, np.diff(t_s, prepend=t_s[0]), tau_s, np.zeros(2)))


def _stops(q: Array, width: float) -> Array:
    """Return the force of an elastic stop of this width, 1 where it slips."""
    out, at = np.empty(len(q)), 0.0
    for n, step in enumerate(np.diff(q, prepend=q[0])):
        at = min(1.0, max(-1.0, at + step / width))
        out[n] = at
    return out


LAWS: Mapping[str, tuple[Law, float | None]] = {
    "dry_friction": (lambda c, _: _way(c["v"]), None),
    "offset": (lambda c, _: np.ones(len(c["v"])), None),
    "one_sided": (lambda c, _: np.maximum(c["v"], 0.0), None),
    "drag": (lambda c, _: c["v"] * np.abs(c["v"]), None),
    "stribeck": (lambda c, x: _way(c["v"]) * np.exp(-((c["v"] / x) ** 2)), 0.3),
    "spring": (lambda c, _: c["q"], None),
    "hardening": (lambda c, _: c["q"] ** 3, None),
    "ripple": (lambda c, x: np.sin(2.0 * np.pi * c["q"] / x), 0.6),
    "hysteresis": (lambda c, x: _stops(c["q"], x), 0.3),
    "lagging": (lambda c, x: _followed(c["v"], c["t_s"], x) - c["v"], 0.2),
    "warming": (lambda c, x: c["v"] * (1.0 - np.exp(-c["t_s"] / x)), 8.0),
    "drift": (lambda c, _: c["t_s"] / 20.0, None),
    "unbalance": (lambda c, _: np.sign(c["q"]) * c["v"], None),
    "centrifugal": (lambda c, _: c["q"] * c["v"] ** 2, None),
}
"""Laws with the usual value of their shape, None where they have none."""

RESTS = ("none", "unlisted", "unlisted", "wrong_law", "wander")
NOISE = 0.02


@dataclass(frozen=True)
class DrawnMechanism:
    """A mechanism, what of it a diagnosis may name, and what is there.

    Args:
        present: listed laws at work.
        rest: what else there is: one of `RESTS`.
    """

    simulator: Simulator
    runs: tuple[SimulatorRun, ...]
    held_out: tuple[SimulatorRun, ...]
    present: frozenset[str]
    rest: str
    rest_share: float


def _candidate(name: str) -> Effect:
    shape = LAWS[name][1]
    shapes = () if shape is None else (Parameter("shape", "1", shape / 2.0, shape * 2.0, shape, scale="log"),)
    return candidate(name, name, Parameter("size", "N", -30.0, 30.0, 1.0, neutral=0.0), *shapes)


def force(columns: Columns, p: Mapping[str, float]) -> Columns:
    """Return the force under a motion."""
    out = p["inertia"] * columns["a"] + p["viscous"] * columns["v"]
    for name, (law, _) in LAWS.items():
        if size := p.get(f"{name}.size", 0.0):
            out = out + size * law(columns, p.get(f"{name}.shape", 1.0))
    return {"force": out}


def _motion(rng: np.random.Generator, kind: int) -> dict[str, Array]:
    t_s = np.arange(0.0, 20.0, 0.04)
    fastest = (1.0, 3.0, 0.5, 2.0)[kind % 4]
    turns = rng.uniform(0.1, fastest, 5)
    sizes, phases = rng.uniform(0.2, 1.0, 5) / turns, rng.uniform(0.0, 2.0 * np.pi, 5)
    angle = turns[:, None] * t_s + phases[:, None]
    q, v, a = (
        np.sum(each, axis=0)
        for each in (
            sizes[:, None] * np.sin(angle),
            (sizes * turns)[:, None] * np.cos(angle),
            -(sizes * turns**2)[:, None] * np.sin(angle),
        )
    )
    scale = 1.0 / max(float(np.max(np.abs(q))), 1e-9)
    return {"t_s": t_s, "q": scale * q, "v": scale * v, "a": scale * a}


def draw_mechanism(seed: int, withheld_law: str | None = None) -> DrawnMechanism:
    """Draw a mechanism of a seed.

    Args:
        withheld_law: the one law at work, left out of the list: whatever is named then is wrong.
    """
    rng = np.random.default_rng([seed, 77])
    names = [str(name) for name in rng.permutation(list(LAWS))]
    if withheld_law is not None:
        names.remove(withheld_law)
        present, hidden, rest = [], withheld_law, "unlisted"
    else:
        present, hidden = names[: int(rng.integers(0, 3))], names[-1]
        rest = str(rng.choice(RESTS))
        rest = rest if present or rest in ("none", "unlisted") else "unlisted"
    listed = [name for name in names if name != hidden][:10]
    listed = sorted(set(listed) | set(present))
    motions = [_motion(rng, k) for k in range(4)]
    base = {"inertia": float(rng.uniform(0.5, 2.0)), "viscous": float(rng.uniform(0.5, 2.0))}
    p = dict(base)
    for name in present:
        p[f"{name}.size"] = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.5))
        if (shape := LAWS[name][1]) is not None:
            p[f"{name}.shape"] = float(shape * np.exp(rng.uniform(-0.5, 0.5)))
    clean = [force(m, p)["force"] for m in motions]
    gaps = _beyond_base(motions, clean)
    gap = float(np.sqrt(np.mean(np.concatenate(gaps) ** 2))) if present else 1.0
    share = 0.0 if rest == "none" else 1.0 if not present else float(rng.uniform(0.05, 0.4))
    rests = _rest(rng, rest, hidden, present, motions, p)
    beyond = float(np.sqrt(np.mean(np.concatenate(_beyond_base(motions, rests)) ** 2)))
    # Shares are of energy: r² of the rest over that of both.
    ratio = np.sqrt(share / (1.0 - share)) if share < 1.0 else 1.0
    factor = ratio * gap / beyond if beyond > 1e-9 else 0.0
    noise = NOISE * (gap if present else 1.0)
    channels = [c + factor * r + rng.normal(0.0, noise, len(c)) for c, r in zip(clean, rests, strict=True)]
    simulator = Simulator(
        name=f"mechanism {seed}",
        run=force,
        inputs=("q", "v", "a"),
        channels=("force",),
        base=(Parameter("inertia", "kg", 0.0, 50.0, 1.0), Parameter("viscous", "N·s/m", -50.0, 50.0, 1.0)),
        candidates=tuple(map(_candidate, listed)),
    )
    runs = [
        recorded(simulator, str(k + 1), m | {"force": y})
        for k, (m, y) in enumerate(zip(motions, channels, strict=True))
    ]
    return DrawnMechanism(simulator, tuple(runs[:3]), tuple(runs[3:]), frozenset(present), rest, share)


def _rest(
    rng: np.random.Generator,
    kind: str,
    hidden: str,
    present: list[str],
    motions: list[dict[str, Array]],
    p: Mapping[str, float],
) -> list[Array]:
    if kind == "none":
        return [np.zeros(len(m["t_s"])) for m in motions]
    if kind == "wander":
        return [np.cumsum(rng.normal(0.0, 1.0, len(m["t_s"]))) for m in motions]
    if kind == "wrong_law":
        law, shape = LAWS[present[0]][0], p.get(f"{present[0]}.shape", 1.0)
        # The same law as it acts where the mechanism is elsewhere: its size goes with the place.
        return [law(m, shape) * np.cos(2.0 * m["q"]) for m in motions]
    law, usual = LAWS[hidden]
    return [law(m, usual or 1.0) for m in motions]


def _beyond_base(motions: list[dict[str, Array]], values: list[Array]) -> list[Array]:
    """Return what inertia and viscous friction cannot take of a force, run by run."""
    rows = np.concatenate([np.stack([m["a"], m["v"]], axis=1) for m in motions])
    every = np.concatenate(values)
    residual = every - rows @ np.linalg.lstsq(rows, every, rcond=None)[0]
    return np.split(residual, np.cumsum([len(v) for v in values])[:-1])
