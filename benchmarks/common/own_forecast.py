"""Forecast the error of a calibration of the unit's own, which ranks units whose map is the reason of their error.

What noise, clipping and creep leave with any calibration is no fault of the map. Only the error beyond that is.
"""

from collections.abc import Mapping

import numpy as np

from softcal.core.maps.choose import choose_map
from softcal.core.maps.ends import output_noise
from softcal.core.maps.interface import UnitMap
from softcal.core.metrics import rms
from softcal.core.network.network import Network
from softcal.core.recording import Array, OutputRecording
from softcal.core.unit.evidence import DAY, LINE, gather_evidence, other_maps
from softcal.core.unit.forecast import forecast_error
from softcal.core.unit.health import output_limits
from softcal.core.unit.unit_problem import UnitProblem

COEFFICIENTS = {
    "paired": {"floor": 1.15, "clipping": 2.0, "rest": 0.48, "noise": 0.65, "excess": 0.51},
    "stage": {"floor": 1.17, "clipping": 1.6, "rest": 0.2, "noise": 2.0, "excess": 0.42},
    # The gain is a guess there: noise and excess say more of the map than of the unit.
    "blind": {"floor": 1.31, "clipping": 2.0, "rest": 0.37},
}
"""By how the loads are known: benchmarks/verdict.py --fit --seeds 1000 1040, ratio of own calibrations."""


def forecast_own_error(terms: Mapping[str, float], kind: str) -> float:
    """Return the RMSE, in the reference unit, of a network trained on the unit's own labels: u^2 = sum (c u)^2."""
    return float(np.sqrt(sum((c * terms[name]) ** 2 for name, c in COEFFICIENTS[kind].items())))


def own_terms(problem: UnitProblem) -> dict[str, float]:
    """Return the standard uncertainties that a calibration of the unit's own would have too, in the reference unit.

    - `floor`: the error of f on its own source.
    - `noise`: the unit's output noise beyond the source's, carried through map and network.
    - `clipping`, `rest`: as in the budget.
    - `excess`: the forecast error beyond the network's. Part of it is creep, lag and hysteresis that a window does not
      show; no network that reads windows could do better.
    """
    model, target = problem.source, problem.recording.bridged
    network, source, method = model.network, model.source.unlabelled, model.method
    limits = output_limits(problem.recording, source, is_rising=model.interval.slope_limit > 0, method=method)
    chosen = choose_map(problem.fit)
    evidence = gather_evidence(
        model,
        target,
        chosen.unit_map,
        limits,
        other_maps(problem.fit, chosen, method, reference_rmse=0.0),
        is_anchored=problem.anchors is not None,
    )
    budget, rows = evidence.budget, method.map.pairs.pairs // 2
    # Variances subtract: f was trained with the source's noise, so that much is in `floor` already.
    estimate = evidence.estimate if len(evidence.rows) == len(target.windows) else None
    noise = noise_error(network, target, rows, chosen.unit_map, estimate) ** 2 - noise_error(network, source, rows) ** 2
    # The line spreads loads, not outputs: an own calibration sees the loads.
    forecast = forecast_error(
        {name: u for name, u in budget.items() if name not in (DAY, LINE)}, evidence.correspondence
    )
    return {
        "floor": model.held_out_rmse,
        "noise": float(np.sqrt(max(noise, 0.0))),
        "clipping": budget["clipping"],
        "rest": budget["rest"],
        "excess": float(np.sqrt(max(forecast.rmse**2 - budget["model"] ** 2, 0.0))),
    }


def noise_error(
    network: Network,
    recording: OutputRecording,
    windows: int,
    unit_map: UnitMap | None = None,
    estimate: Array | None = None,
) -> float:
    """Return the RMS change of so many estimates under one more draw of the recording's output noise.

    `estimate` is f on all the recording's mapped windows, where it is known.
    """
    rows = np.linspace(0, len(recording.windows) - 1, windows).astype(np.int64)
    clean = recording.windows[rows]
    # One more draw of the noise on top of the recorded one: its effect is that of the noise itself.
    noisy = clean + output_noise(recording) * _draw(clean.shape)
    if unit_map is not None:
        noisy = unit_map.apply(noisy)
    if estimate is None:
        without = network.evaluate(clean if unit_map is None else unit_map.apply(clean))
    else:
        without = estimate[rows]
    return rms(network.evaluate(noisy) - without)


def _draw(shape: tuple[int, int]) -> Array:
    """Every unit's noise is drawn from the same seed: equal input, equal result."""
    return np.random.default_rng(0).standard_normal(shape)
