"""Where the base fit begins: rough base parameters and noise levels read off the recordings."""

from collections.abc import Sequence
from dataclasses import replace
from math import comb

import numpy as np
from scipy.optimize import nnls

from softcal.core.gap.case import HALF_WIDTH, Case
from softcal.core.gap.coordinates import RigScale, fit_scale, to_fit
from softcal.core.gap.fit import Fit, fit
from softcal.core.gap.linear import energy
from softcal.core.gap.problem import BASE, Hypothesis, Problem
from softcal.core.recording import Array
from softcal.core.twin.effects import Parameter

TRIMMED = 0.02
"""Share of squared differences, the largest, left out of a noise estimate: steps are not noise."""


def unfitted(case: Case) -> Fit:
    """Return the base at its rough start, for recordings that are not to be fitted."""
    return fit(Problem(case, _first_noise(case)), Hypothesis(), np.nan_to_num(rough_start(case)), steps=0)


def base_fit(case: Case) -> Fit:
    """Fit the base alone to all runs, with noise levels taken from its own residual."""
    problem = Problem(case, _first_noise(case))
    fitted = fit(problem, Hypothesis(), rough_start(case))
    for _ in range(2):
        problem = with_driving_noise(problem.with_noise(noise_levels(fitted)), fitted)
        fitted = fit(problem, Hypothesis(), fitted.coordinates)
    return fitted


def scattered(parameters: Sequence[Parameter], count: int) -> Array:
    """Return (count, parameters) coordinates within bounds: the usual values, then near and far.

    A value that may be far off in either direction is drawn by its order of magnitude.
    """
    rng = np.random.default_rng(1)
    out = np.empty((count, len(parameters)))
    for k, p in enumerate(parameters):
        usual, scale = to_fit(p, p.usual), fit_scale(p)
        low, high = sorted((to_fit(p, p.low), to_fit(p, p.high)))
        near = usual + 0.5 * scale * rng.normal(size=count)
        if p.scale == "log":
            far = rng.uniform(max(low, usual - 4.0), min(high, usual + 4.0), count)
        elif high - low > 30.0 * scale:
            side = np.where(rng.random(count) < 0.5, -1.0, 1.0) if low < 0.0 < high else np.sign(usual or 1.0)
            far = side * scale * 10.0 ** rng.uniform(-1.5, 1.5, count)
        else:
            far = rng.uniform(low, high, count)
        out[:, k] = np.clip(np.where(rng.random(count) < 0.5, near, far), low, high)
        out[0, k] = usual
    return out


def best_start(problem: Problem, hypothesis: Hypothesis, scattering: int = 32, tried: int = 5, steps: int = 60) -> Fit:
    """Return the best minimum found from starts all over the bounds.

    Args:
        scattering: places at which the prediction is made once.
        tried: of these, those from which a fit takes a few steps, besides the usual values.
        steps: most steps from the best two of them.
    """
    usual, *others = scattered(hypothesis.parameters, scattering)
    places = [usual, *likeliest(problem, hypothesis, others)[:tried]]
    rough = sorted((fit(problem, hypothesis, place, steps=6) for place in places), key=lambda f: f.chi2)
    fits = [fit(problem, hypothesis, found.coordinates, steps=steps) for found in rough[:2]]
    return min(fits, key=lambda found: found.chi2)


def likeliest(problem: Problem, hypothesis: Hypothesis, places: Sequence[Array]) -> list[Array]:
    """Return places in the order of what a prediction at each leaves; those without one last."""

    def left(place: Array) -> float:
        cost = energy(problem.whitened(problem.measured - problem.predict(hypothesis, place)))
        return cost if np.isfinite(cost) else np.inf

    return sorted(places, key=left)


def noise_levels(found: Fit) -> dict[str, float]:
    """Return σ of the white noise per channel from the differences of neighbouring residuals.

    A structured residual is smooth and hardly enters.
    """
    problem, order = found.problem, found.problem.smooth_order
    squares: dict[str, list[Array]] = {}
    for block in problem.blocks:
        error = (problem.measured - found.predicted)[block.place]
        # White noise of variance 1 gives differences of variance 2, second ones of 6.
        squares.setdefault(block.channel, []).append(np.diff(error, order) ** 2 / comb(2 * order, order))
    levels = dict(problem.sigma)
    for channel, parts in squares.items():
        every = np.sort(np.concatenate(parts))
        trimmed = every[: max(1, int(len(every) * (1 - TRIMMED)))]
        # A Gaussian without its largest 2 % of squares keeps 0.873 of its variance.
        variance = float(np.mean(trimmed)) / 0.873
        levels[channel] = max(float(np.sqrt(variance)), problem.least_noise(channel))
    return levels


def with_driving_noise(problem: Problem, found: Fit) -> Problem:
    """Return the problem with the noise of a measured force where it drives the chain.

    σ² = σV² + (dV/dF·σF)²: errors in variables to first order.
    """
    case = problem.case
    if not any(run.kind == "press" and run.stage_mm is None and run.force_N is not None for run in case.runs):
        return problem
    extra = np.zeros(len(problem.measured))
    for block in problem.blocks:
        run = case.runs[block.run]
        if run.kind != "press" or run.stage_mm is not None or run.force_N is None:
            continue
        order = np.argsort(run.force_N, kind="stable")
        x, y = run.force_N[order], found.predicted[block.place][order]
        # A slope from neighbours would be noise over noise; a 24th of the samples shows the curve's.
        edges = np.linspace(0, len(x) - 1, 25).astype(int)
        keep = np.concatenate([[True], np.diff(x[edges]) > 1e-7 * np.ptp(x)])
        slopes = np.gradient(y[edges][keep], x[edges][keep]) if keep.sum() > 2 else np.zeros(int(keep.sum()))
        slope = np.interp(run.force_N, x[edges][keep], slopes)
        # Smoothed noise moves slowly: it counts as often as samples share it.
        extra[block.place] = (2 * HALF_WIDTH + 1) * (slope * run.driving_force.sigma_N) ** 2
    return replace(problem, extra_variance=extra)


def _first_noise(case: Case) -> dict[str, float]:
    of_rig = RigScale.of(case)
    levels = {
        "force_N": 0.02 * of_rig.factor("N"),
        "output_V": case.readout.step_V,
        "stage_mm": 0.002 * of_rig.factor("mm"),
    }
    for channel in ("force_N", "output_V"):
        if values := case.recorded(channel):
            spread = float(np.std(np.concatenate(values)))
            levels[channel] = max(0.02 * spread, 1e-5 * levels[channel])
    return levels


def rough_start(case: Case) -> Array:
    """Return base coordinates read off the recordings, (5,)."""
    stage, force, output = (
        np.concatenate(case.recorded(c)) if case.has(c) else None for c in ("stage_mm", "force_N", "output_V")
    )
    u0, k1, k3, r0, kappa = (RigScale.of(case).sized(p).usual for p in BASE)
    loaded = force if force is not None else output
    if stage is not None and loaded is not None:
        # The lowest twentieth of the stroke is off the pad in every profile.
        rest = float(np.median(loaded[stage <= np.quantile(stage, 0.05)]))
        is_pressed = loaded - rest > 0.03 * (loaded.max() - rest)
        # Not the very first touch: one noisy sample would set it.
        u0 = float(np.quantile(stage[is_pressed], 0.02)) if is_pressed.any() else float(np.median(stage))
        bent = np.maximum(0.0, stage - u0)
        if force is not None:
            # Never negative: a pad that pulls would begin the fit outside its bounds.
            (k1, k3), _ = nnls(np.column_stack([bent, bent**3]), np.maximum(force, 0.0))
        force = k1 * bent + k3 * bent**3
    if output is not None and force is not None:
        readout = case.readout
        resistance = output * readout.r_series_ohm / np.maximum(readout.vref_V - output, readout.step_V)
        drive = np.maximum(0.0, stage - u0) if readout.sensor_type == "strain" and stage is not None else force
        r0 = float(np.median(resistance[drive <= max(np.quantile(drive, 0.1), 0.02 * drive.max())]))
        # At the largest loads the resistance has grown most, so that kappa shows best.
        top = drive >= np.quantile(drive, 0.98)
        kappa = max((1.0 - r0 / float(np.median(resistance[top]))) / float(np.median(drive[top])), 1e-3 * kappa)
    values = (u0, k1, k3, max(r0, 1e-4 * case.readout.r_series_ohm), kappa)
    return np.array([to_fit(p, v) for p, v in zip(BASE, values, strict=True)])
