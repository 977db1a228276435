"""Plain least squares over sets of a simulator's candidates, from several starts: a diagnosis must not be worse."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from scipy.optimize import least_squares

from softcal.core.gap.simulator import Simulator, SimulatorFailed, SimulatorRun
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect

FAILED = 1e6
"""Error, in spreads of a channel, of parameters at which a simulator fails."""


def error_of(simulator: Simulator, runs: Sequence[SimulatorRun], parameters: dict[str, float]) -> float:
    """Return the root mean square of all channels' errors on runs."""
    return float(np.sqrt(np.mean(_errors(simulator, runs, parameters) ** 2)))


def _errors(simulator: Simulator, runs: Sequence[SimulatorRun], parameters: dict[str, float]) -> Array:
    parts = []
    for run in runs:
        try:
            predicted = simulator(run.columns, parameters)
        except SimulatorFailed:
            return np.full(sum(len(r) for r in runs) * len(simulator.channels), FAILED)
        parts += [predicted[c] - run.columns[c] for c in simulator.channels]
    return np.concatenate(parts)


def fitted_set(
    simulator: Simulator, runs: Sequence[SimulatorRun], causes: Sequence[Effect], starts: int
) -> dict[str, float]:
    """Return the parameters of the least squares of a set of causes over a few starts within the bounds."""
    pairs = [(p.name, p) for p in simulator.base]
    pairs += [(f"{cause.id}.{p.name}", p) for cause in causes for p in cause.parameters]
    low, high, usual = (np.array([getattr(p, end) for _, p in pairs]) for end in ("low", "high", "usual"))
    rng, best, min_error = np.random.default_rng(len(causes)), dict[str, float](), np.inf

    def values_by_name(values: Array) -> dict[str, float]:
        return simulator.neutral_values | {name: float(v) for (name, _), v in zip(pairs, values, strict=True)}

    for start in range(starts):
        at = usual if start == 0 else usual * np.exp(rng.uniform(-1.5, 1.5, len(usual))) * rng.choice([-1.0, 1.0])
        span = np.maximum(np.abs(usual), 1e-12)
        solution = least_squares(
            lambda values: _errors(simulator, runs, values_by_name(values)),
            np.clip(at, low, high),
            bounds=(low, high),
            x_scale=span,
            max_nfev=60,
        )
        if solution.cost < min_error:
            best, min_error = values_by_name(solution.x), float(solution.cost)
    return best


def best_sets(
    simulator: Simulator,
    fitted: Sequence[SimulatorRun],
    held_out: Sequence[SimulatorRun],
    starts: int = 3,
    max_size: int = 3,
) -> list[tuple[tuple[str, ...], float, float]]:
    """Return every set of up to so many causes with its error on fitted and held-out runs, the best held out first."""
    out = []
    for size in range(max_size + 1):
        for causes in combinations(simulator.candidates, size):
            fit = fitted_set(simulator, fitted, causes, starts)
            ids = tuple(sorted(c.id for c in causes))
            out.append((ids, error_of(simulator, fitted, fit), error_of(simulator, held_out, fit)))
    return sorted(out, key=lambda row: row[2])
