"""The diagnosis' own Levenberg–Marquardt against scipy.optimize.least_squares: same start, predictions and bounds.

    python benchmarks/gap_solver.py --cases 12 --seed 900

Prints Markdown: χ² that both reach and processor time, for single effects of the withheld generator.
"""

import argparse
import time
from collections.abc import Callable
from functools import partial

import gap as benchmark
import numpy as np
from scipy.optimize import least_squares

from softcal.core.challenge.draw import draw_case
from softcal.core.gap.candidates import Probe, extent_of, probes
from softcal.core.gap.coordinates import start_coordinates
from softcal.core.gap.fit import _Space, fit
from softcal.core.gap.problem import Around, Hypothesis, Problem
from softcal.core.gap.start import base_fit
from softcal.core.recording import Array


def with_scipy(problem: Problem, hypothesis: Hypothesis, start: Array) -> float:
    """Return χ² at scipy's minimum, by its trust-region method with the derivatives of the diagnosis."""
    space = _Space(problem, hypothesis)
    kept: dict[bytes, tuple[Array, Around]] = {}

    def predicted(x: Array) -> tuple[Array, Around]:
        # The derivatives start from the prediction that the residual has just made.
        if x.tobytes() not in kept:
            kept.clear()
            kept[x.tobytes()] = problem.predict_around(hypothesis, x)
        return kept[x.tobytes()]

    found = least_squares(
        lambda x: problem.whitened(predicted(x)[0] - problem.measured),
        np.clip(start, space.low + 1e-12, space.high - 1e-12),
        jac=lambda x: np.array([problem.whitened(row) for row in space.slopes(x, *predicted(x))]).T,
        bounds=(space.low, space.high),
        x_scale=space.scale,
        ftol=1e-7,
        max_nfev=40,
    )
    return float(2.0 * found.cost)


def timed(solve: Callable[[], float]) -> tuple[float, float]:
    """Return what a solver gives and the least processor seconds of three calls."""
    seconds = []
    for _ in range(3):
        begin = time.process_time()
        chi2 = solve()
        seconds.append(time.process_time() - begin)
    return chi2, min(seconds)


def first_probe(sealed_id: str, every: tuple[Probe, ...]) -> Probe | None:
    return next((probe for probe in every if probe.effect.id == sealed_id), None)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=12)
    parser.add_argument("--seed", type=int, default=900)
    options = parser.parse_args()
    rows, ratios = [], []
    for seed in range(options.seed, options.seed + options.cases):
        sealed = draw_case(seed, f"usual-{seed}", "usual")
        case = benchmark.as_case(sealed, sealed.plans)
        base = base_fit(case)
        probe = first_probe(sealed.causes[0].effect, probes(case, extent_of(case, sealed.depth_mm, sealed.peak_N)))
        if probe is None:
            continue
        hypothesis = Hypothesis().adding(probe.effect)
        start = np.append(base.coordinates, start_coordinates([probe.effect], [probe.values]))
        own = timed(partial(own_chi2, base.problem, hypothesis, start))
        theirs = timed(partial(with_scipy, base.problem, hypothesis, start))
        ratios.append(theirs[1] / own[1])
        rows.append(
            (probe.effect.id, f"{own[0]:.1f}", f"{theirs[0]:.1f}", f"{1e3 * own[1]:.1f}", f"{1e3 * theirs[1]:.1f}")
        )
    print(benchmark.table(("effect", "own χ²", "scipy χ²", "own ms", "scipy ms"), rows))
    print(f"\nscipy takes {np.median(ratios):.1f} times as long (median of {len(ratios)} fits)")


def own_chi2(problem: Problem, hypothesis: Hypothesis, start: Array) -> float:
    """Fit with the project's own solver; return what is left."""
    return fit(problem, hypothesis, start).chi2


if __name__ == "__main__":
    main()
