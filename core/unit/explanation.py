"""The arrays of the one plot per unit that shows why its verdict is what it is. No drawing here."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from softcal.core.recording import Array, OutputRecording
from softcal.core.unit.evidence import DAY, LINE, gather_evidence
from softcal.core.unit.source_model import SourceModel
from softcal.core.unit.state import Fit, UnitState
from softcal.core.unit.uncertainty import DIRECTIONS
from softcal.core.words.reason import Reason

DENSITY_BINS = 48


@dataclass(frozen=True, eq=False)
class Explanation:
    """Why a unit's verdict is what it is, in four panels.

    Args:
        levels: (LEVELS,) load levels in the reference unit, abscissa of the first two panels.
        half_width: (3, LEVELS) of the unit's 90 % interval by direction, rows as `directions`.
        source_half_width: the same for the source itself: what no map can better.
        density_edges: (DENSITY_BINS + 1,) load levels.
        source_density, mapped_density, unmapped_density: (DENSITY_BINS,) share of the windows per level: the source's,
            the unit's with its map, and without.
        contributions: error contributions in the reference unit by name, c_i u_i of the budget, largest first.
        forecast, limit: forecast RMSE with its 95 % interval, and the tolerance limit; None where there is none.
        t_s, estimate, distance: (n,) windows looked at: time, estimate, distance from the source's support.
    """

    levels: Array
    half_width: Array
    source_half_width: Array
    density_edges: Array
    source_density: Array
    mapped_density: Array
    unmapped_density: Array
    contributions: Mapping[str, float]
    forecast: tuple[float, float, float]
    limit: float
    t_s: Array
    estimate: Array
    distance: Array
    familiar_distance: float
    reasons: tuple[Reason, ...]
    directions: tuple[str, ...] = DIRECTIONS


def explain(model: SourceModel, state: UnitState, target: OutputRecording) -> Explanation:
    """Return the arrays that explain a unit's verdict."""
    interval = model.interval
    calibration, forecast = state.calibration, state.forecast
    evidence = gather_evidence(model, target, calibration.unit_map, calibration.output_limits)
    both = np.concatenate([model.estimate, evidence.estimate])
    edges = np.linspace(both.min(), both.max(), DENSITY_BINS + 1)
    return Explanation(
        levels=interval.levels,
        half_width=calibration.interval.half_width,
        source_half_width=interval.half_width,
        density_edges=edges,
        source_density=_density(model.estimate, edges),
        mapped_density=_density(evidence.estimate, edges),
        unmapped_density=_density(evidence.unmapped, edges),
        contributions=contributions(state.fit),
        forecast=(forecast.lower, forecast.rmse, forecast.upper),
        limit=state.limit.maximum_rmse,
        t_s=target.t_s[target.window_rows[evidence.rows]],
        estimate=evidence.estimate,
        distance=evidence.distance,
        familiar_distance=interval.familiar_distance,
        reasons=state.decision.reasons,
    )


def contributions(fit: Fit) -> dict[str, float]:
    """Return the contributions c_i u_i to the forecast error in the reference unit, largest first."""
    config = fit.knowledge.config
    weights = {config.base_term: config.base_factor, **fit.knowledge.sensitivity, LINE: 1.0, DAY: 1.0}
    parts = {name: weight * fit.budget[name] for name, weight in weights.items() if name in fit.budget}
    return dict(sorted(parts.items(), key=lambda item: -item[1]))


def _density(estimate: Array, edges: Array) -> Array:
    counts, _ = np.histogram(np.clip(estimate, edges[0], edges[-1]), edges)
    return counts / len(estimate)
