"""Forecast what a calibration of the unit's own would leave open: noise, clipping, creep. No label of the unit is seen.

A unit that reads badly with any calibration is not helped by its own; the map is to blame only for what is beyond this.
"""

from collections.abc import Mapping

import numpy as np

from softcal.core.maps.ends import output_noise
from softcal.core.maps.interface import UnitMap
from softcal.core.network.network import Network
from softcal.core.recording import OutputRecording
from softcal.core.unit.forecast import forecast_error
from softcal.core.unit.source_model import SourceModel

WINDOWS = 2_000
"""Windows the noise is carried through, evenly spaced."""

OWN = {"floor": 1.31, "clipping": 2.0, "rest": 0.37}
OWN_ON_STAGE = {"floor": 1.17, "clipping": 1.6, "rest": 0.2, "noise": 2.0, "excess": 0.42}
OWN_PAIRED = {"floor": 1.15, "clipping": 2.0, "rest": 0.48, "noise": 0.65, "excess": 0.51}
"""Coefficients of the terms of `own_terms`, from `benchmarks/verdict.py --fit --seeds 1000 1040`.

Where nothing speaks for the loads the gain is a guess: noise and excess say more of the map than of the unit there.
"""


def forecast_own(terms: Mapping[str, float], budget: Mapping[str, float]) -> float:
    """Return the RMSE a network trained on the unit's own labels would have, in the reference unit: u^2 = sum (c u)^2.

    Args:
        terms: from `own_terms`.
        budget: of the unit's forecast error (`MapEvidence.budget`).
    """
    return float(np.sqrt(sum((c * terms[name]) ** 2 for name, c in own_coefficients(budget).items())))


def own_coefficients(budget: Mapping[str, float]) -> Mapping[str, float]:
    """Return the coefficients that hold for a budget, by what is known of the loads."""
    return OWN_PAIRED if "paired" in budget else OWN_ON_STAGE if "stage" in budget else OWN


def own_terms(
    model: SourceModel, target: OutputRecording, unit_map: UnitMap, budget: Mapping[str, float]
) -> dict[str, float]:
    """Return what the unit's own calibration would suffer from too, in the reference unit.

    `floor`: the error of f on its own source. `noise`: the unit's output noise, carried through map and network, beyond
    the source's. `clipping` and `rest`: as in the budget. `excess`: what the forecast error has beyond the network's;
    creep, lag and loops that a window does not show are misread by any network.

    Args:
        model: the lot's source.
        target: recording of the unit.
        unit_map: its map.
        budget: of its forecast error (`MapEvidence.budget`).
    """
    network = model.network
    noise = noise_error(network, target, unit_map) ** 2 - noise_error(network, model.source.unlabelled) ** 2
    return {
        "floor": model.held_out_rmse,
        "noise": float(np.sqrt(max(noise, 0.0))),
        "clipping": budget["clipping"],
        "rest": budget["rest"],
        "excess": float(np.sqrt(max(forecast_error(budget).rmse ** 2 - budget["model"] ** 2, 0.0))),
    }


def noise_error(network: Network, recording: OutputRecording, unit_map: UnitMap | None = None) -> float:
    """Return the RMS change of the estimates under one more draw of the recording's output noise."""
    rows = np.linspace(0, len(recording.windows) - 1, WINDOWS).astype(np.int64)
    clean = recording.windows[rows]
    noisy = clean + output_noise(recording) * np.random.default_rng(0).standard_normal(clean.shape)
    if unit_map is not None:
        clean, noisy = unit_map.apply(clean), unit_map.apply(noisy)
    return float(np.sqrt(np.mean((network.evaluate(noisy) - network.evaluate(clean)) ** 2)))
