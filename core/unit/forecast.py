"""Forecast the error of one unit without a label, as a measurement uncertainty budget (GUM, JCGM 100:2008).

Sensitivity coefficients, chosen on simulated lots for each kind of knowledge about the loads (`knowledge.py`), combine
the terms of the budget (`evidence.py`). What noise, clipping and creep leave with any calibration, one trained on the
unit's own labels too, is forecast beside it. Only the error beyond that is the map's.
"""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from softcal.core.maps.crossing import CACHED
from softcal.core.maps.ends import output_noise
from softcal.core.maps.interface import UnitMap
from softcal.core.metrics import rms
from softcal.core.network.network import Network
from softcal.core.recording import Array, OutputRecording
from softcal.core.unit.evidence import DAY, LINE, MapEvidence, beyond
from softcal.core.unit.knowledge import SHARED, LoadKnowledge
from softcal.core.unit.method import LEVELS
from softcal.core.unit.source_model import SourceModel
from softcal.core.unit.uncertainty import DIRECTIONS, ErrorForecast


def forecast_error(budget: Mapping[str, float], knowledge: LoadKnowledge) -> ErrorForecast:
    """Combine a budget: u_c^2 = u_base^2 + sum (c_i u_i)^2 (GUM, JCGM 100:2008, eq. 10), with its own uncertainty.

    What line and day add has coefficient 1 whatever is known of the loads: no recording of the unit shows it.
    """
    outside = budget.get(LINE, 0.0) ** 2 + budget.get(DAY, 0.0) ** 2
    rmse = float(np.sqrt(_base(budget, knowledge) ** 2 + _squares(budget, knowledge) + outside))
    low, high = knowledge.config.log_error
    return ErrorForecast(rmse, rmse * float(np.exp(low)), rmse * float(np.exp(high)))


def map_variance(budget: Mapping[str, float], knowledge: LoadKnowledge) -> float:
    """Return the part of the forecast's variance that comes from map and recording, without network and line."""
    beyond_model = _base(budget, knowledge) ** 2 - budget["model"] ** 2
    return _squares(budget, knowledge) + max(beyond_model, 0.0)


def _base(budget: Mapping[str, float], knowledge: LoadKnowledge) -> float:
    return knowledge.config.base_factor * budget[knowledge.config.base_term]


def _squares(budget: Mapping[str, float], knowledge: LoadKnowledge) -> float:
    return float(sum((coefficient * budget[name]) ** 2 for name, coefficient in knowledge.sensitivity.items()))


def variance_table(model: SourceModel, evidence: MapEvidence) -> Array:
    """Distribute the map's variance over direction and load level: (3, LEVELS).

    Half is even, half is in proportion to the squared disagreement of the candidate maps. Where the gain of the map
    rests on matched levels alone, half of this in turn grows with the square of the load, as a gain error does. The
    variance of loads that the unit has not shown is added at those loads only. What the line adds grows with the square
    of the load as well.
    """
    budget, knowledge = evidence.budget, evidence.knowledge
    unseen = knowledge.sensitivity["extrapolation"]
    pattern = 0.5 + 0.5 * _disagreement_pattern(model, evidence)
    if not knowledge.is_placed and (budget["gain"] or budget.get(SHARED)):
        pattern = 0.5 * pattern + 0.5 * _load_pattern(model, evidence)
    reach = model.method.map.ends.reach
    unshown = unseen * beyond(model.interval.levels, evidence.estimate, reach)
    spread_out = map_variance(budget, knowledge) - (unseen * budget["extrapolation"]) ** 2
    line = budget.get(LINE, 0.0) ** 2 * _load_pattern(model, evidence)
    return knowledge.config.interval_share * spread_out * pattern + unshown**2 + line + budget.get(DAY, 0.0) ** 2


def _disagreement_pattern(model: SourceModel, evidence: MapEvidence) -> Array:
    pattern = np.ones((len(DIRECTIONS), LEVELS))
    mean_square = float(np.mean(evidence.disagreement**2))
    if mean_square == 0:
        return pattern
    cells = model.interval.direction(evidence.shape), model.interval.column(evidence.estimate)
    flat, size = cells[0] * LEVELS + cells[1], pattern.size
    weights: tuple[Array, Array] = (evidence.disagreement**2 / mean_square, np.ones(len(flat)))
    tables = [np.asarray(np.bincount(flat, one, size), dtype=np.float64).reshape(pattern.shape) for one in weights]
    # Five windows of even disagreement are added to each cell; the table is smoothed over nine load levels.
    kernel = np.ones(9)
    smooth = [np.stack([np.convolve(row, kernel, mode="same") for row in table]) for table in tables]
    return (smooth[0] + 5) / (smooth[1] + 5)


def _load_pattern(model: SourceModel, evidence: MapEvidence) -> Array:
    """Return the squared load over its mean square in the unit's recording: (LEVELS,)."""
    load = np.maximum(model.interval.levels - evidence.rest, 0.0)
    return np.asarray((load / max(evidence.load_rms, 1e-12)) ** 2)


def forecast_own(terms: Mapping[str, float], knowledge: LoadKnowledge) -> float:
    """Return the RMSE, in the reference unit, of a network trained on the unit's own labels: u^2 = sum (c u)^2."""
    return float(np.sqrt(sum((c * terms[name]) ** 2 for name, c in knowledge.own.items())))


def own_terms(
    model: SourceModel, target: OutputRecording, unit_map: UnitMap, evidence: MapEvidence
) -> dict[str, float]:
    """Return the standard uncertainties that a calibration of the unit's own would have too, in the reference unit.

    - `floor`: the error of f on its own source.
    - `noise`: the unit's output noise beyond the source's, carried through map and network.
    - `clipping`, `rest`: as in the budget.
    - `excess`: the forecast error beyond the network's. Part of it is creep, lag and hysteresis that a window does not
      show; no network that reads windows could do better.
    """
    network, budget, rows = model.network, evidence.budget, model.method.map.pairs.pairs // 2
    # Variances subtract: f was trained with the source's noise, so that much is in `floor` already.
    of_source = _source_noise_error(network, model.source.unlabelled, rows)
    estimate = evidence.estimate if len(evidence.rows) == len(target.windows) else None
    noise = noise_error(network, target, rows, unit_map, estimate) ** 2 - of_source**2
    # The line spreads loads, not outputs: an own calibration sees the loads.
    forecast = forecast_error({name: u for name, u in budget.items() if name not in (DAY, LINE)}, evidence.knowledge)
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


@lru_cache(maxsize=1)
def _draw(shape: tuple[int, int]) -> Array:
    """Every unit's noise is drawn from the same seed: equal input, equal result."""
    return np.random.default_rng(0).standard_normal(shape)


_source_noise_error = lru_cache(maxsize=CACHED)(noise_error)
"""Every unit of a lot is compared with one and the same source."""
