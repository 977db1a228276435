"""What the predicted error of a unit is made of. No drawing here."""

from softcal.core.unit.evidence import DAY, LINE
from softcal.core.unit.fit import Fit


def contributions(fit: Fit) -> dict[str, float]:
    """Return the contributions c_i u_i to the forecast error in the reference unit, largest first."""
    config = fit.correspondence.config
    weights = {config.base_term: config.base_factor, **fit.correspondence.sensitivity, LINE: 1.0, DAY: 1.0}
    parts = {name: weight * fit.budget[name] for name, weight in weights.items() if name in fit.budget}
    return dict(sorted(parts.items(), key=lambda item: -item[1]))
