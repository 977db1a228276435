"""Forecast the error that a network trained on the unit's own labels would have; no label of the unit is needed.

It is what noise, clipping and creep leave with any calibration. Only the forecast error beyond it is the map's.
"""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from softcal.core.maps.crossing import KEPT
from softcal.core.maps.ends import output_noise
from softcal.core.maps.interface import UnitMap
from softcal.core.network.network import Network
from softcal.core.recording import Array, OutputRecording
from softcal.core.unit.forecast import DAY, LINE, MapEvidence, forecast_error
from softcal.core.unit.knowledge import LoadKnowledge
from softcal.core.unit.source_model import SourceModel


def forecast_own(terms: Mapping[str, float], knowledge: LoadKnowledge) -> float:
    """Return the RMSE a network trained on the unit's own labels would have, in the reference unit: u^2 = sum (c u)^2.

    Args:
        terms: from `own_terms`.
        knowledge: how the unit's loads are known; its coefficients weigh the terms.
    """
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

    Args:
        model: the lot's source.
        evidence: of its map, with the budget of its forecast error.
    """
    network, budget, rows = model.network, evidence.budget, model.method.forecast.own_rows
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


@lru_cache(maxsize=KEPT)
def _source_noise_error(network: Network, source: OutputRecording, windows: int) -> float:
    """Every unit of a lot is compared with one and the same source."""
    return noise_error(network, source, windows)


def noise_error(
    network: Network,
    recording: OutputRecording,
    windows: int,
    unit_map: UnitMap | None = None,
    estimate: Array | None = None,
) -> float:
    """Return the RMS change of the estimates under one more draw of the recording's output noise.

    Args:
        network: the shared network f.
        windows: how many of it are looked at; of a short one some count twice.
        unit_map: its map; None for the source.
        estimate: f on all the recording's mapped windows, where it is known.
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
    return float(np.sqrt(np.mean((network.evaluate(noisy) - without) ** 2)))


@lru_cache(maxsize=1)
def _draw(shape: tuple[int, int]) -> Array:
    """Every unit's noise is drawn from the same seed: equal input, equal result."""
    return np.random.default_rng(0).standard_normal(shape)
