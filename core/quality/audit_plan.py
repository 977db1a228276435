"""Which few units of a lot to check with the load cell, and what their results say about all the others."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy

from softcal.core.errors import InputError
from softcal.core.messages.figures import format_limit
from softcal.core.quality.acceptance import failing_share
from softcal.core.unit.verdict import Limit

CONFIDENCE = 0.95


@dataclass(frozen=True)
class AuditConfig:
    """How many units to check.

    Args:
        doubtful: units with the largest forecast error among the accepted ones, checked beside the draw.
        random: units drawn from all other accepted ones; they alone carry the statement on the rest. Ten promise one
            in ten (`softcal.core.quality.release`).
        seed: drives the draw.
        allowed_share: share of nonconforming units the lot may hold, agreed before measuring.
    """

    doubtful: int = 0
    random: int = 10
    seed: int = 0
    allowed_share: float = 0.1


@dataclass(frozen=True)
class AuditPlan:
    """The units to check, and the number of accepted units that the random ones were drawn from."""

    doubtful: tuple[str, ...]
    random: tuple[str, ...]
    population: int
    allowed_share: float

    @property
    def serials(self) -> tuple[str, ...]:
        return (*self.doubtful, *self.random)

    def settings(self) -> dict[str, object]:
        return {**vars(self), "doubtful": list(self.doubtful), "random": list(self.random)}


@dataclass(frozen=True)
class LotStatement:
    """What the checked units say about the lot.

    Args:
        word: `pass` no checked unit failed and, at 95 % confidence, no more than the allowed share of the rest does;
            `conditional` none failed but too few were checked to say that; `fail` a checked unit failed.
        nonconforming_upper: largest number of nonconforming units among the unchecked ones (95 %, hypergeometric).
        process_upper: largest nonconforming share of the process (95 %, Clopper and Pearson 1934).
        error_ratio: RMS of measured over forecast error; well above 1, the forecasts of this lot are too low.
    """

    word: str
    failed: tuple[str, ...]
    nonconforming_upper: int
    process_upper: float  # noqa: V107
    error_ratio: float
    text: str


def plan_audit(forecasts: Mapping[str, float], config: AuditConfig = AuditConfig()) -> AuditPlan:  # noqa: B008 - frozen
    """Choose the units to check among the accepted ones.

    Raises:
        InputError: a forecast is not a number, no unit is asked for, or the share is not between 0 and 1.
    """
    if config.doubtful < 0 or config.random < 0 or config.doubtful + config.random == 0:
        raise InputError(f"{config.doubtful} doubtful and {config.random} random units; at least one unit is needed")
    if not 0 < config.allowed_share < 1:
        raise InputError(f"allowed share {config.allowed_share:g}; a share between 0 and 1 was expected, such as 0.1")
    for serial, rmse in forecasts.items():
        if not np.isfinite(rmse):
            raise InputError(f"unit {serial}: forecast error is {rmse}; only units with a forecast can be accepted")
    ranked = sorted(forecasts, key=lambda serial: (-forecasts[serial], serial))
    doubtful, rest = ranked[: config.doubtful], sorted(ranked[config.doubtful :])
    chosen = np.random.default_rng(config.seed).permutation(len(rest))[: config.random]
    return AuditPlan(tuple(doubtful), tuple(rest[k] for k in sorted(chosen)), len(rest), config.allowed_share)


def evaluate_audit(
    plan: AuditPlan, forecasts: Mapping[str, float], measured: Mapping[str, float], limit: Limit
) -> LotStatement:
    """Update the lot's verdict with the measured errors of the checked units.

    Args:
        measured: RMSE against the load cell by serial, every unit of the plan.

    Raises:
        InputError: a unit of the plan was not measured.
    """
    missing = [serial for serial in plan.serials if serial not in measured]
    if missing:
        raise InputError(f"audit incomplete: no measurement of {', '.join(missing)}; the statement needs every unit")
    failed = tuple(serial for serial in plan.serials if not measured[serial] <= limit.maximum_rmse)
    random_failed = sum(serial in failed for serial in plan.random)
    upper = nonconforming_upper(plan.population, len(plan.random), random_failed)
    allowed = plan.allowed_share * max(plan.population, 1)
    word = "fail" if failed else "pass" if upper <= allowed else "conditional"
    ratios = [measured[serial] / forecasts[serial] for serial in plan.serials]
    ratio = float(np.sqrt(np.mean(np.square(ratios)))) if ratios else float("nan")
    max_nonconforming, unchecked = upper - random_failed, plan.population - len(plan.random)
    bound = f"{format_limit(limit.maximum_rmse)} {limit.unit}"
    text = f"units checked: {len(plan.serials)}, of these beyond {bound}: {len(failed)}; " + (
        f"accepted units that were not drawn: {unchecked}, of these beyond it: {max_nonconforming} at most (95 %"
        " confidence)"
        if unchecked
        else "every accepted unit was drawn"
    )
    process = failing_share(len(plan.random), random_failed, CONFIDENCE)
    return LotStatement(word, failed, max_nonconforming, process, ratio, text)


def nonconforming_upper(population: int, checked: int, failed: int) -> int:
    """Return the largest number of nonconforming units in the population that the sample does not contradict.

    The largest D with P(at most `failed` among `checked` | D of `population`) > 5 % (hypergeometric).
    """
    if checked >= population:
        return failed
    candidates = np.arange(failed, population - (checked - failed) + 1)
    plausible = scipy.stats.hypergeom.cdf(failed, population, candidates, checked) > 1 - CONFIDENCE
    return int(candidates[plausible].max())
