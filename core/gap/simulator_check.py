"""Calls of a simulator before the fit: whether it can be fitted at all. What cannot is refused in one line."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from softcal.core.errors import InputError
from softcal.core.gap.coordinates import fit_scale, from_fit, to_fit
from softcal.core.gap.fit import DIFFERENCE
from softcal.core.gap.method import METHOD
from softcal.core.gap.simulator import Columns, Simulator, SimulatorFailed, SimulatorRun
from softcal.core.recording import Array
from softcal.core.twin.effects import Parameter

CONFIG = METHOD.calls


class _ReadNames(dict[str, float]):
    """Parameters that remember which of them were read by name; reading all at once is told apart."""

    def __init__(self, values: Mapping[str, float]) -> None:
        super().__init__(values)
        self.names: set[str] = set()
        self.is_iterated = False

    def __getitem__(self, name: str) -> float:
        # A copy fetches every value by its name, one after another.
        if not self.is_iterated:
            self.names.add(name)
        return super().__getitem__(name)

    def get(self, name: str, default: Any = None) -> Any:
        self.names.add(name)
        return super().get(name, default)

    # Without these `**p` and `dict(p)` copy the values past both methods above.
    def __iter__(self) -> Iterator[str]:
        self.is_iterated = True
        return super().__iter__()

    def keys(self) -> Any:
        self.is_iterated = True
        return super().keys()

    def values(self) -> Any:
        self.is_iterated = True
        return super().values()

    def items(self) -> Any:
        self.is_iterated = True
        return super().items()


class _Calls:
    """A simulator on the runs of a case, every call with copies of its inputs and parameters."""

    def __init__(self, simulator: Simulator, runs: Sequence[SimulatorRun]) -> None:
        self.simulator, self._runs = simulator, runs
        self.names: set[str] = set()
        self.is_iterated = False
        # Watched where the user's own code reads: what a simulator does before that reads every name.
        self._watched = replace(simulator, run=self._watch)
        self._given: Mapping[str, float] = {}
        self._read = _ReadNames({})

    def first(self, values: Mapping[str, float]) -> Array:
        """Return the channels of the first run, one after another."""
        return self._run(self._runs[0], values)

    def every(self, values: Mapping[str, float]) -> Array:
        """Return the channels of all runs, one after another."""
        return np.concatenate([self._run(run, values) for run in self._runs])

    def excited(self, values: Mapping[str, float]) -> Array:
        """Return the channels of the first run where every input swings about what was recorded."""
        t_s = self._runs[0].columns["t_s"]
        phase = 2.0 * np.pi * (t_s - t_s[0]) / max(float(t_s[-1] - t_s[0]), 1e-300)
        swings = {}
        for k, name in enumerate(self.simulator.inputs, start=1):
            column = self._runs[0].columns[name]
            swings[name] = column + (float(np.max(np.abs(column))) or 1.0) * np.sin((2 * k + 1) * phase)
        return self._run(self._runs[0], values, swings)

    def _run(self, run: SimulatorRun, values: Mapping[str, float], swings: Columns | None = None) -> Array:
        recorded = {name: run.columns[name] for name in ("t_s", *self.simulator.inputs)} | dict(swings or {})
        inputs = {name: column.copy() for name, column in recorded.items()}
        channels = self._watched(inputs, values)
        self.names |= self._read.names
        self.is_iterated |= self._read.is_iterated
        self._refuse_written(inputs, recorded, "copy its inputs before changing them")
        changed = {name: np.asarray(dict.get(self._read, name)) for name in self._given}
        self._refuse_written(changed, {name: np.asarray(v) for name, v in self._given.items()}, "copy the parameters")
        return np.concatenate([channels[name] for name in self.simulator.channels])

    def _watch(self, inputs: Columns, parameters: Mapping[str, float]) -> Columns:
        self._given, self._read = dict(parameters), _ReadNames(parameters)
        return self.simulator.run(inputs, self._read)

    def _refuse_written(self, after: Columns, before: Columns, cure: str) -> None:
        for name, values in before.items():
            if not np.array_equal(after[name], values):
                raise refused(self.simulator, f"writes into {name}; {cure}")


def refused(simulator: Simulator, why: str) -> InputError:
    """Return the refusal of a simulator that cannot be fitted."""
    return InputError(f"simulator {simulator.name}: {why}; nothing was fitted")


def check_calls(simulator: Simulator, runs: Sequence[SimulatorRun]) -> None:
    """Call a simulator a few times, and refuse one whose answers a fit could not use.

    A simulator that fails at its usual values is left to the fit, which goes elsewhere.

    Raises:
        InputError: equal calls differ, an input is written into, channels are rounded, or a parameter is never read.
    """
    calls, usual = _Calls(simulator, runs), {p.name: p.usual for p in _of_base(simulator)}
    off, on = usual | simulator.neutral_values, usual | {name: p.usual for name, p in _of_candidates(simulator)}
    try:
        plain = calls.first(off)
        _refuse_differing(simulator, plain, calls.first(off), "called twice with equal arguments")
        with_causes = calls.first(on)
        _refuse_differing(simulator, plain, calls.first(off), "called again after a call with other parameters")
        near, far = (calls.first(_moved(simulator, on, steps)) for steps in (1.0, CONFIG.long_step))
    except SimulatorFailed:
        return
    if _is_rounded(near - with_causes, far - with_causes):
        raise refused(
            simulator,
            "a small change of its parameters does not show as a hundredth of a larger one: it rounds its channels, "
            "or is not smooth; give them in full precision",
        )
    _refuse_unread(calls, on)


def _of_base(simulator: Simulator) -> tuple[Parameter, ...]:
    return (*simulator.base, *simulator.run_parameters)


def _of_candidates(simulator: Simulator) -> list[tuple[str, Parameter]]:
    return [(f"{effect.id}.{p.name}", p) for effect in simulator.candidates for p in effect.parameters]


def _refuse_differing(simulator: Simulator, one: Array, other: Array, when: str) -> None:
    apart = float(np.max(np.abs(one - other)))
    if apart > CONFIG.repeatable * max(float(np.ptp(one)), float(np.max(np.abs(one)))):
        raise refused(
            simulator, f"{when} its channels differ by {apart:.3g}; fix the seed of its noise, and start anew each time"
        )


def _moved(simulator: Simulator, values: Mapping[str, float], steps: float) -> dict[str, float]:
    """Return the parameters, each moved by so many steps of the fit's difference quotients."""
    out = {}
    for name, p in (*((p.name, p) for p in _of_base(simulator)), *_of_candidates(simulator)):
        x, step = to_fit(p, values[name]), steps * DIFFERENCE * fit_scale(p)
        out[name] = (
            values[name]
            if p.is_fixed
            else from_fit(p, x + step if x + step <= max(to_fit(p, p.low), to_fit(p, p.high)) else x - step)
        )
    return out


def _is_rounded(near: Array, far: Array) -> bool:
    """Whether most samples that a long step moves are not moved in proportion by a short one."""
    moves = np.abs(far) > CONFIG.moved * np.max(np.abs(far), initial=0.0)
    is_apart = np.abs(CONFIG.long_step * near - far)[moves] > CONFIG.rounded * np.abs(far)[moves]
    return bool(moves.any() and np.mean(is_apart) > CONFIG.rounded)


def _refuse_unread(calls: _Calls, values: Mapping[str, float]) -> None:
    """Refuse a parameter that is never read, or that is copied with all others and never changes a channel.

    What these runs alone do not excite is left to the diagnosis, which says that they cannot tell it.
    """
    simulator = calls.simulator
    for name, p in (*((p.name, p) for p in _of_base(simulator)), *_of_candidates(simulator)):
        if name in calls.names or p.is_fixed:
            continue
        makes = (calls.every, calls.excited) if calls.is_iterated else ()
        if not any(_changes_something(make, values, name, p) for make in makes):
            raise refused(
                simulator,
                f"parameter {name} is never read, or changes no channel; check how the simulator spells it, or leave "
                "it out",
            )


def _changes_something(
    make: Callable[[Mapping[str, float]], Array], values: Mapping[str, float], name: str, parameter: Parameter
) -> bool:
    ends = [end for end in (parameter.low, parameter.high) if end != values[name]]
    try:
        usual = make(values)
        return any(not np.array_equal(usual, make({**values, name: end})) for end in ends)
    except SimulatorFailed:
        return True
