"""A problem of `mujoco.sysid` as a simulator: its parameters with a neutral value are the candidates.

    params, sequences, transform = ...                      # as for mujoco.sysid.optimize
    PROBLEM = from_sysid(params, sequences, neutral={"rubbing": 0.0}, signal_transform=transform)
    found = diagnose_simulator(PROBLEM.simulator, PROBLEM.runs)

Needs the package mujoco with its extra: pip install 'mujoco[sysid]'.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from softcal.core.errors import InputError
from softcal.core.gap.simulator import Columns, Simulator, SimulatorRun, candidate, recorded
from softcal.core.recording import Array
from softcal.core.twin.effects import Parameter, Scale

RUN = "run"
"""Input column that says which measured sequence a run is: it has its state and control."""

LOG_SCALE_RATIO = 30.0
"""Ratio of the bounds of a positive parameter from which it is fitted by its order of magnitude."""

USUAL_SIZE_SHARE = 0.1
"""Usual size of a candidate, as a share of its range."""


@dataclass(frozen=True, eq=False)
class SysidProblem:
    """A simulator with the recorded runs of a problem of `mujoco.sysid`."""

    simulator: Simulator
    runs: tuple[SimulatorRun, ...]


def from_sysid(  # noqa: V103
    params: Any,
    models_sequences: Sequence[Any],
    neutral: Mapping[str, float],
    signal_transform: Any = None,
    name: str = "a mujoco model",
    per_run: Mapping[str, Mapping[str, float]] | None = None,
) -> SysidProblem:
    """Return the simulator and the runs of a problem of `mujoco.sysid`.

    Args:
        params: its `ParameterDict`; frozen parameters keep their value.
        models_sequences: its `ModelSequences`.
        neutral: parameters that are candidates, with the value that switches each off; the others are the base.
        signal_transform: its `SignalTransform`; gains and biases must act on what is predicted.
        per_run: by signal, what every run may have of its own, as for `Simulator`.

    Raises:
        InputError: the extra is missing, a candidate is no parameter of one number, a transform changes what was
            measured, or there is no candidate or no sequence.
    """
    try:
        from mujoco import sysid
    except ImportError as error:
        raise InputError(f"mujoco is missing ({error}); install it with pip install 'mujoco[sysid]'") from error
    # Without its extra the package imports, and has nothing in it.
    if not hasattr(sysid, "residual"):
        raise InputError("mujoco.sysid lacks its extra packages; install them with pip install 'mujoco[sysid]'")
    free = [p for p in params.copy().parameters.values() if not p.frozen]
    _check(free, neutral, signal_transform)
    trajectories = [(s.spec, each) for s in models_sequences for each in s.measured_rollout]
    if not trajectories:
        raise InputError(f"{name}: no measured sequence; mujoco.sysid.ModelSequences with at least one was expected")
    start = np.concatenate([p.nominal.flatten() for p in free])
    model = _Rollout(sysid, params.copy(), trajectories, signal_transform, neutral)
    _, measured = model.both(0, start)
    candidates = []
    for p in (p for p in free if p.name in neutral):
        low, high = (float(v.flatten()[0]) - neutral[p.name] for v in (p.min_value, p.max_value))
        usual = USUAL_SIZE_SHARE * (high if high >= -low else low)
        candidates.append(candidate(p.name, "model", Parameter("change", "", low, high, usual, neutral=0.0)))
    simulator = Simulator(
        name=name,
        run=model,
        inputs=(RUN,),
        channels=tuple(_channels(measured)),
        base=tuple(each for p in free if p.name not in neutral for each in _parameters(p)),
        candidates=tuple(candidates),
        per_run=per_run or {},
    )
    names = [n for s in models_sequences for n in s.sequence_name]
    runs = []
    for k, sequence in enumerate(names):
        _, measured = model.both(k, start)
        t_s = np.asarray(measured.times, dtype=np.float64)
        columns = {"t_s": t_s, RUN: np.full(len(t_s), float(k)), **_channels(measured)}
        runs.append(recorded(simulator, sequence, columns))
    return SysidProblem(simulator, tuple(runs))


def _check(free: Sequence[Any], neutral: Mapping[str, float], transform: Any) -> None:
    sizes = {p.name: p.size for p in free}
    for name in neutral:
        if sizes.get(name) != 1:
            scalar_names = ", ".join(n for n, size in sizes.items() if size == 1)
            raise InputError(f"neutral names {name}; a free parameter of one number was expected: {scalar_names}")
    for _, name, target in (*getattr(transform, "_gains", ()), *getattr(transform, "_biases", ())):
        if target != "predicted":
            raise InputError(
                f"the transform by {name} changes what was measured (target={target!r}), so that a larger gain would "
                "look like a smaller gap; give it target='predicted'"
            )


@dataclass(frozen=True, eq=False)
class _Rollout:
    """The `run` of the simulator: parameters in, signals at the measured times out."""

    sysid: Any
    params: Any
    trajectories: Sequence[tuple[Any, Any]]
    transform: Any
    neutral: Mapping[str, float]

    def both(self, run: int, vector: Array) -> tuple[Any, Any]:
        """Return the predicted and the measured series of a sequence, at the same times."""
        spec, trajectory = self.trajectories[run]
        _, predicted, measured = self.sysid.residual(
            vector,
            self.params,
            [SimpleNamespace(spec=spec, measured_rollout=[trajectory])],
            modify_residual=None if self.transform is None else self.transform.apply,
            n_threads=1,
            return_pred_all=True,
        )
        return predicted[0][0], measured[0][0]

    def __call__(self, inputs: Columns, p: Mapping[str, float]) -> Columns:
        vector: list[float] = []
        for parameter in self.params.parameters.values():
            if parameter.frozen:
                continue
            if parameter.name in self.neutral:
                vector.append(self.neutral[parameter.name] + p[f"{parameter.name}.change"])
            else:
                vector += [p[name] for name in _names(parameter)]
        return _channels(self.both(int(inputs[RUN][0]), np.array(vector))[0])


def _channels(series: Any) -> dict[str, Array]:
    """Return every component of every signal, (n,), by its name."""
    out = {}
    for name, (_, columns) in series.signal_mapping.items():
        for k, column in enumerate(columns):
            out[name if len(columns) == 1 else f"{name}[{k}]"] = np.array(series.data[:, column], dtype=np.float64)
    return out


def _names(parameter: Any) -> list[str]:
    return [parameter.name] if parameter.size == 1 else [f"{parameter.name}[{k}]" for k in range(parameter.size)]


def _parameters(parameter: Any) -> list[Parameter]:
    low, high, usual = (v.flatten() for v in (parameter.min_value, parameter.max_value, parameter.nominal))
    parameters = []
    for name, lower, upper, nominal in zip(_names(parameter), low, high, usual, strict=True):
        scale: Scale = "log" if lower > 0.0 and upper > LOG_SCALE_RATIO * lower else "linear"
        size = float(nominal) or USUAL_SIZE_SHARE * float(upper - lower)
        parameters.append(Parameter(name, "", float(lower), float(upper), size, scale=scale))
    return parameters
