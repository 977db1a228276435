"""Release the units of a lot that nobody measured, on what its audited units showed: a bound and a decision.

The ratio of measured to forecast error of the audited units says how far a forecast of this lot can be out. A unit is
released where its forecast times the bound of that ratio is within the limit.
"""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from softcal.core.errors import InputError
from softcal.core.quality.acceptance import min_risk, share_beyond, tolerance_factor
from softcal.core.unit.method import ReleaseConfig
from softcal.core.unit.verdict import Limit


@dataclass(frozen=True)
class AuditedUnit:
    """One unit whose error was measured.

    Args:
        forecast_rmse: forecast before it was measured, in the reference unit.
        sitting: of units whose maps share one error, as they were fitted together; empty where its error is its own.

    Raises:
        InputError: an error is not a positive number.
    """

    serial: str
    forecast_rmse: float
    measured_rmse: float
    lot_id: str = ""
    sitting: str = ""

    def __post_init__(self) -> None:
        for name, value in (("forecast", self.forecast_rmse), ("measured", self.measured_rmse)):
            if not 0 < value < float("inf"):
                raise InputError(f"audit of {self.serial}: {name} RMSE is {value}; a positive number was expected")

    @property
    def ratio(self) -> float:
        """Measured over forecast error."""
        return self.measured_rmse / self.forecast_rmse


@dataclass(frozen=True)
class Ratios:
    """What audited units show of log(measured / forecast error), for a unit nobody measured.

    Args:
        audits, lots: number of audited units, and of the lots and sittings they come from.
        centre: mean of the logarithm, over lots where there are several.
        spread: standard deviation of one more unit about it, with the spread between lots.
        count, degrees: observations behind the centre, degrees of freedom behind the spread.
    """

    audits: int
    lots: int
    centre: float
    spread: float
    largest: float
    count: float
    degrees: float

    def bound(self, config: ReleaseConfig, risk: float | None = None) -> float:
        """Return the factor that measured / forecast of all but a share `risk` of the units stays below.

        The larger of two. exp(mean + k SD) holds with the promise's confidence where the ratios are near log-normal
        (ISO 16269-6, the method of ISO 3951). One unit in audits + 1 exceeds the largest ratio seen, for ratios of any
        distribution. Infinite where the audits are too few.

        Args:
            risk: that of the configuration, or less.
        """
        if self.audits < config.min_audits or (self.lots > 1 and self.lots < config.min_lots):
            return float("inf")
        confidence = 1 - (1 - config.confidence) / config.confidence_margin
        factor = tolerance_factor(self.count, self.degrees, config.risk if risk is None else risk, confidence)
        return float(np.exp(max(self.largest, self.centre + factor * max(self.spread, config.min_spread))))


@dataclass(frozen=True)
class ReleaseDecision:
    """Which of the unmeasured units of a lot are released, and what is promised about them.

    Args:
        factor: largest measured / forecast error reckoned with; infinite where nothing can be promised.
        share_any_form: share of released units beyond the limit that holds at the promise's confidence without any
            assumption on the form of the ratios; 1 where nothing does.
        risk_any_form: the same on average over audits that might have been drawn.
    """

    released: tuple[str, ...]
    factor: float
    ratios: Ratios
    share_any_form: float
    risk_any_form: float


def audited_ratios(audits: Sequence[AuditedUnit], config: ReleaseConfig) -> Ratios:
    """Return what the audited units show; units of several lots or sittings show how these differ as well.

    Over lots the variance of one more unit is that of the lots' means and what one unit adds to it (one-way random
    effects, unweighted means), its degrees of freedom after Satterthwaite 1946.

    Raises:
        InputError: a unit stands in the audits of its lot twice.
    """
    twice = [key for key, times in Counter((a.lot_id, a.serial) for a in audits).items() if times > 1]
    if twice:
        raise InputError(
            f"unit {twice[0][1]} was audited twice; an audit counts once: keep the newer, nothing was released"
        )
    keys = dict.fromkeys((a.lot_id, a.sitting) for a in audits)
    groups = [np.log([a.ratio for a in audits if (a.lot_id, a.sitting) == key]) for key in keys]
    if len(audits) < 2:
        centre = float(groups[0][0]) if groups else 0.0
        return Ratios(len(audits), len(groups), centre, 0.0, centre, 0.0, 0.0)
    largest = max(float(group.max()) for group in groups)
    if len(groups) == 1:
        (group,) = groups
        spread = float(np.std(group, ddof=1))
        return Ratios(len(group), 1, float(group.mean()), spread, largest, len(group), len(group) - 1)
    sizes, means = np.array([len(group) for group in groups]), np.array([group.mean() for group in groups])
    free = float(np.sum(sizes - 1))
    # Each lot about its own mean: a lot whose forecasts are all out by one factor is not a scattered one.
    squares = sum(float(np.sum((group - group.mean()) ** 2)) for group in groups)
    within_lots = squares / free * (1 - float(np.mean(1 / sizes))) if free else 0.0
    # Lots that agree by luck must not prove that lots are alike.
    between_lots = max(float(np.var(means, ddof=1)), config.min_spread**2 / len(groups))
    total = between_lots + within_lots
    degrees = total**2 / (between_lots**2 / (len(groups) - 1) + (within_lots**2 / free if free else 0.0))
    count = len(groups) * total / between_lots
    return Ratios(int(sizes.sum()), len(groups), float(means.mean()), float(np.sqrt(total)), largest, count, degrees)


def release(
    forecasts: Mapping[str, float],
    audits: Sequence[AuditedUnit],
    limit: Limit,
    config: ReleaseConfig,
    min_count: float = 0.0,
    day_errors: Mapping[str, float] | None = None,
    candidates: Collection[str] | None = None,
) -> ReleaseDecision:
    """Choose which unmeasured units to release so that the promise holds for the released ones.

    A unit in a share r of all units exceeds its bound at most. Were m of n released on it, a share r n / m of these
    might. So m units are released only where the bound at r = risk m / n lets m units pass (the step-up of Benjamini
    and Hochberg 1995; Jin and Candès 2023 for selection by forecasts). A choice of the smallest forecasts cannot make
    the promise cheaper.

    Args:
        forecasts: forecast RMSE by serial of the units that nobody measured and nothing else stands against.
        audits: of the same lot, drawn at random; or of several earlier lots.
        candidates: serials that may be released; None for all. The promise counts the others as considered.

    Raises:
        InputError: a unit was audited twice, or a forecast is no positive number.
    """
    for serial, rmse in forecasts.items():
        if not 0 < rmse < float("inf"):
            raise InputError(f"unit {serial}: forecast error is {rmse}; only units with a forecast can be released")
    ratios, considered = audited_ratios(audits, config), len(forecasts)
    day_errors = day_errors or {}
    # What is left of the limit once another day has taken its part; without golden runs the limit itself.
    limits = {
        serial: float(np.sqrt(max(limit.acceptance_rmse**2 - day_errors.get(serial, 0.0) ** 2, 0.0)))
        for serial in forecasts
    }
    need = {serial: forecasts[serial] / limits[serial] if limits[serial] else np.inf for serial in forecasts}
    chosen = forecasts if candidates is None else forecasts.keys() & candidates
    ordered = sorted(chosen, key=lambda serial: (need[serial], serial))
    needed = np.array([need[serial] for serial in ordered])
    count, factor = considered, ratios.bound(config)
    min_count = max(config.min_part * considered, min_count, 1)
    while (passing := int(np.count_nonzero(needed[:count] * factor <= 1))) < count:
        count = passing
        if count < min_count:
            break
        factor = ratios.bound(config, config.risk * count / considered)
    if count < min_count:
        return ReleaseDecision((), factor, ratios, 1.0, 1.0)
    share = risk = 1.0
    if count and ratios.lots > 1:
        # Lots are exchangeable as wholes only: the bound is the largest of that many lots.
        risk = min(1 / (ratios.lots + 1) / (count / considered), 1.0)
    elif count:
        one = min_risk(ratios.audits)
        nonconforming = share_beyond(ratios.audits, one, config.confidence)
        share, risk = (min(value / (count / considered), 1.0) for value in (nonconforming, one))
    return ReleaseDecision(tuple(ordered[:count]), factor, ratios, share, risk)


def min_passing(units: int, audited: int, config: ReleaseConfig) -> float:
    """Return how many unmeasured units must pass so that `min_part` of a lot does, of which `audited` were measured."""
    return config.min_part * units - audited
