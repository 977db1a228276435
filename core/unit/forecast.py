"""Forecast the error of one unit without a label, as a measurement uncertainty budget (GUM, JCGM 100:2008).

Sensitivity coefficients, chosen on simulated lots for each kind of correspondence (`correspondence.py`), combine the
terms of the budget (`evidence.py`).
"""

from collections.abc import Mapping

import numpy as np

from softcal.core.recording import Array
from softcal.core.unit.correspondence import SHARED, Correspondence
from softcal.core.unit.evidence import DAY, LINE, MapEvidence, beyond
from softcal.core.unit.method import LEVELS
from softcal.core.unit.source_model import SourceModel
from softcal.core.unit.uncertainty import DIRECTIONS, ErrorForecast


def forecast_error(budget: Mapping[str, float], correspondence: Correspondence) -> ErrorForecast:
    """Combine a budget: u_c^2 = u_base^2 + sum (c_i u_i)^2 (GUM, JCGM 100:2008, eq. 10), with its own uncertainty.

    What line and day add has coefficient 1 whatever is known of the loads: no recording of the unit shows it.
    """
    outside = budget.get(LINE, 0.0) ** 2 + budget.get(DAY, 0.0) ** 2
    rmse = float(np.sqrt(_base(budget, correspondence) ** 2 + _squares(budget, correspondence) + outside))
    low, high = correspondence.config.log_error
    return ErrorForecast(rmse, rmse * float(np.exp(low)), rmse * float(np.exp(high)))


def map_variance(budget: Mapping[str, float], correspondence: Correspondence) -> float:
    """Return the part of the forecast's variance that comes from map and recording, without network and line."""
    beyond_model = _base(budget, correspondence) ** 2 - budget["model"] ** 2
    return _squares(budget, correspondence) + max(beyond_model, 0.0)


def _base(budget: Mapping[str, float], correspondence: Correspondence) -> float:
    return correspondence.config.base_factor * budget[correspondence.config.base_term]


def _squares(budget: Mapping[str, float], correspondence: Correspondence) -> float:
    return float(sum((coefficient * budget[name]) ** 2 for name, coefficient in correspondence.sensitivity.items()))


def variance_table(model: SourceModel, evidence: MapEvidence) -> Array:
    """Distribute the map's variance over direction and load level: (3, LEVELS).

    Half is even, half is in proportion to the squared disagreement of the candidate maps. Where the gain of the map
    rests on matched levels alone, half of this in turn grows with the square of the load, as a gain error does. The
    variance of loads that the unit has not shown is added at those loads only. What the line adds grows with the square
    of the load as well.
    """
    budget, correspondence = evidence.budget, evidence.correspondence
    unseen = correspondence.sensitivity["extrapolation"]
    pattern = 0.5 + 0.5 * _disagreement_pattern(model, evidence)
    if not correspondence.is_matched and (budget["gain"] or budget.get(SHARED)):
        pattern = 0.5 * pattern + 0.5 * _load_pattern(model, evidence)
    quantile_range = model.method.map.ends.quantile_range
    unshown = unseen * beyond(model.interval.levels, evidence.estimate, quantile_range)
    spread_out = map_variance(budget, correspondence) - (unseen * budget["extrapolation"]) ** 2
    line = budget.get(LINE, 0.0) ** 2 * _load_pattern(model, evidence)
    return correspondence.config.interval_share * spread_out * pattern + unshown**2 + line + budget.get(DAY, 0.0) ** 2


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
